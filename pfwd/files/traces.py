"""Trace files: the drops of one test point as text, read and written.

The format is a CSV file with a header of TOML lines, each behind a ``#``. A file is refused with
one :class:`~pfwd.errors.TraceError`, which names the line; what is odd about a drop in a
sound file is judged by :mod:`pfwd.analysis.screening.drops`.
"""

import itertools
import os
import re
import stat
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.columns import DROP, LOAD, TIME, Columns, parse_columns, sensor_name
from pfwd.files.header import (
    FORMAT_KEY,
    FORMAT_VERSION,
    Declaration,
    Declarations,
    PointSetup,
    declared_lines,
    parse_declaration,
    read_header_file,
    setup_from,
    setup_warnings,
)
from pfwd.toml_reading import LARGEST_TOML
from pfwd_device import Channel, Drop
from pfwd_device.recording import SurveyDrop

LARGEST_FILE = 500_000_000
"""Bytes; a point of ten drops takes under 10 MB, so a larger file is something else."""

MOST_NUMBERS = 20_000_000
"""Of a file: three drops of 10 s at 50 kHz with 8 channels, and a hundred times a usual point. They
take 160 MB, and as much again as drops."""

MOST_DROPS = 10_000
"""Of a file; a point has some ten, and a file is one point."""

FEWEST_SAMPLES = 16
"""A pulse, its flanks and a stretch before and after it cannot be told from fewer."""

STEP_TOLERANCE = 0.01
"""Largest deviation of a time step over the step: more than rounding, less than a lost sample."""

LARGEST_DROP_NUMBER = 1_000_000
"""Anything above is no drop number but another column's value."""

LONGEST_LINE = 65_536
"""Characters of a line; without a line end in so many the file is no text."""

_BLOCK = 4096

_FORMAT_LINE = re.compile(rf"#\s*{FORMAT_KEY}\s*=")


@dataclass(frozen=True, eq=False, slots=True)
class TracePoint:
    """One test point: what was declared about it and its drops."""

    file: str
    """Where it was read from, as the caller named it."""
    setup: PointSetup
    """What is declared."""
    drops: tuple[Drop, ...]
    """The drops in the order of the file."""
    warnings: tuple[Notice, ...] = ()
    """What a user should know of the point as a whole."""
    kept: tuple[SurveyDrop, ...] = field(default=(), compare=False, repr=False)
    """The drops as their survey keeps them; empty: they are from no survey."""


def read_traces(
    path: str | os.PathLike[str],
    header: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, object] | None = None,
) -> TracePoint:
    """The test point that a trace file holds.

    Parameters
    ----------
    path : path of a trace file
    header : path of a TOML file, optional
        Its keys win over those of the file. With it the file needs no ``pfwd-traces`` line; in a
        file without that line, lines behind ``#`` are another program's remarks and skipped.
    overrides : mapping of header key to value, optional
        Win over both.

    Returns
    -------
    TracePoint

    Raises
    ------
    TraceError
        If the file is refused.
    """
    file = os.fspath(path)
    declared: Declarations = read_header_file(header) if header is not None else {}
    declared |= {
        key: Declaration(value, "command line") for key, value in (overrides or {}).items()
    }
    try:
        _check_file(file)
        with _open(file) as stream:
            top = _read_top(stream, file, foreign=header is not None)
            setup = setup_from(top.declarations | declared, _at(file, top.names_line))
            table = _read_numbers(stream, file, top)
    except UnicodeDecodeError as err:
        raise TraceError(_not_text(file, err.reason)) from err
    except (OSError, ValueError) as err:
        if isinstance(err, TraceError):
            raise
        reason = getattr(err, "strerror", None) or str(err)
        raise TraceError(refusal(file, "a readable trace file", reason)) from err
    drops = _split(table, file, top)
    return TracePoint(file, setup, drops, setup_warnings(setup, drops))


def is_trace_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins with the line of a trace file."""
    try:
        _check_file(os.fspath(path))
        with _open(os.fspath(path), errors="replace") as stream:
            return _FORMAT_LINE.match(stream.readline(LONGEST_LINE)) is not None
    except (OSError, TraceError):
        return False


def write_traces(path: str | os.PathLike[str], point: TracePoint) -> None:
    """Write a test point as a trace file; nothing is lost, nothing is left half written.

    Parameters
    ----------
    path : path of the file, which is replaced
    point : TracePoint
        Its drops share one set of sensors.

    Raises
    ------
    TraceError
        If the drops do not share their sensors, or a text cannot be written as UTF-8.
    OSError
        If the file cannot be written.
    """
    sensors = {
        tuple((channel.quantity, channel.offset) for channel in drop.channels)
        for drop in point.drops
    }
    if len(sensors) > 1:
        raise TraceError(
            refusal(point.file, "the same sensors in every drop of a point", "different ones")
        )
    names = [DROP, TIME, LOAD, *(sensor_name(*sensor) for group in sensors for sensor in group)]
    target = os.path.abspath(path)
    draft = f"{target}.{os.getpid()}.tmp"
    try:
        with open(draft, "w", encoding="utf-8", newline="\n") as stream:
            stream.writelines(f"# {line}\n" for line in declared_lines(point.setup))
            stream.write(",".join(names) + "\n")
            for drop in point.drops:
                rows = np.column_stack([drop.time, drop.load, *(c.values for c in drop.channels)])
                # repr is the shortest text that reads back as the same number.
                stream.writelines(
                    f"{drop.number},{','.join(map(repr, row))}\n" for row in rows.tolist()
                )
        os.replace(draft, target)
    except UnicodeEncodeError as err:
        raise TraceError(
            refusal(point.file, "text that UTF-8 can hold", quote(err.object))
        ) from err
    finally:
        if os.path.exists(draft):
            os.unlink(draft)


@dataclass(frozen=True, slots=True)
class _Top:
    """What stands above the numbers."""

    declarations: Declarations
    columns: Columns
    names_line: int
    """Line with the column names, from 1; the numbers begin on the next."""


def _at(file: str, line: int) -> str:
    return f"{file}, line {line}"


def _not_text(where: str, came: str) -> str:
    return refusal(where, "UTF-8 text", came, "save it as CSV in UTF-8")


def _check_file(file: str) -> None:
    # Looked at before it is opened: a pipe may wait for ever, and 500 MB take a while.
    status = os.stat(file)
    if not stat.S_ISREG(status.st_mode):
        came = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or pipe"
        raise TraceError(refusal(file, "a trace file", came))
    if status.st_size > LARGEST_FILE:
        expected = f"at most {LARGEST_FILE / 1e6:.0f} MB"
        raise TraceError(refusal(file, expected, f"{status.st_size / 1e6:.1f} MB"))


def _open(file: str, errors: str = "strict") -> TextIO:
    # utf-8-sig: spreadsheets write a byte order mark. Any of the three line ends is accepted.
    return open(file, encoding="utf-8-sig", errors=errors, newline=None)


def _read_top(stream: TextIO, file: str, *, foreign: bool) -> _Top:
    """Read up to and with the column names; `foreign`: the ``pfwd-traces`` line may be missing."""
    declarations: Declarations = {}
    native = False
    length = 0
    for line, text in _numbered(stream, file):
        where = _at(file, line)
        length += len(text)
        if length > LARGEST_TOML:
            raise TraceError(
                refusal(where, f"a header of at most {LARGEST_TOML} characters", "more")
            )
        if line == 1:
            native = _FORMAT_LINE.match(text) is not None
            if not native and not foreign:
                hint = (
                    "for a file of another program give its keys with --header FILE.toml, or what "
                    "its columns hold with pfwd import --map FILE.toml, which pfwd map writes"
                )
                expected = f"# {FORMAT_KEY} = {FORMAT_VERSION}"
                raise TraceError(refusal(where, expected, quote(text.rstrip()), hint))
        if text.startswith("#"):
            if native:
                _declare(declarations, text[1:], where)
        elif text.strip():
            return _Top(declarations, parse_columns(text, where), line)
    raise TraceError(refusal(file, "a row of column names", "the end of the file"))


def _numbered(stream: TextIO, file: str) -> Iterator[tuple[int, str]]:
    for line in itertools.count(1):
        text = stream.readline(LONGEST_LINE)
        if "\0" in text or len(text) == LONGEST_LINE:
            raise TraceError(_not_text(_at(file, line), "binary data"))
        if not text:
            return
        yield line, text


def _declare(declarations: Declarations, text: str, where: str) -> None:
    parsed = parse_declaration(text, where)
    if parsed is None:
        return
    key, declaration = parsed
    if key in declarations:
        raise TraceError(refusal(where, "every key once", f"{quote(key)} again"))
    declarations[key] = declaration


def _read_numbers(stream: TextIO, file: str, top: _Top) -> NDArray[np.float64]:
    """The numbers below the column names, (rows, columns), all finite."""
    width = len(top.columns.names)
    refuse_long(file, width)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows at all: refused further on
            table = np.loadtxt(stream, delimiter=",", comments=None, ndmin=2)
    except UnicodeDecodeError:
        raise
    except ValueError as err:
        # numpy counts neither blank lines nor the header, hence a second, slow and exact look.
        raise TraceError(_find_bad_line(file, top) or refusal(file, "numbers", str(err))) from err
    if table.size and table.shape[1] != width:
        raise TraceError(_find_bad_line(file, top) or refusal(file, f"{width} columns", "others"))
    finite = np.isfinite(table)
    if not finite.all():
        row, column = np.unravel_index(np.argmin(finite), table.shape)
        name = top.columns.names[column]
        where = _row_place(file, top, int(row))
        raise TraceError(refusal(where, f"a finite number in {name}", f"{table[row, column]}"))
    return table.reshape(-1, width)


def refuse_long(file: str, width: int) -> None:
    """Refuse a text whose lines have no end, or hold too many numbers, before it is read.

    Parameters
    ----------
    file : str
    width : int
        How many numbers are taken of a line.

    Raises
    ------
    TraceError
    """
    ends = 0
    with open(file, "rb") as stream:
        while block := stream.read(LONGEST_LINE):
            lines = max(block.count(b"\n"), block.count(b"\r"))
            if not lines and len(block) == LONGEST_LINE:
                came = f"none in {LONGEST_LINE} bytes"
                raise TraceError(refusal(_at(file, ends + 1), "the end of a line", came))
            ends += lines
            if ends * width > MOST_NUMBERS:
                expected = f"at most {MOST_NUMBERS} numbers"
                came = f"over {ends} lines of {width}"
                hint = "give the drops in several files"
                raise TraceError(refusal(file, expected, came, hint))


def _data_lines(file: str, top: _Top) -> Iterator[tuple[int, str]]:
    """Line number and text of the rows, without those that numpy passes over."""
    with _open(file, errors="surrogateescape") as stream:
        for line, text in enumerate(stream, start=1):
            if line > top.names_line and text != "\n":
                yield line, text


def _row_place(file: str, top: _Top, row: int) -> str:
    line, _ = next(itertools.islice(_data_lines(file, top), row, None))
    return _at(file, line)


def _find_bad_line(file: str, top: _Top) -> str | None:
    """What is wrong with the first row that is not as many numbers as there are columns."""
    lines = _data_lines(file, top)
    while block := list(itertools.islice(lines, _BLOCK)):
        # numpy is thirty times as fast as a look at each number, of which there may be millions.
        try:
            table = np.loadtxt([text for _, text in block], delimiter=",", comments=None, ndmin=2)
            if table.shape[1] == len(top.columns.names):
                continue
        except ValueError:
            pass
        if (found := _bad_line_of(block, file, top)) is not None:
            return found
    return None


def _bad_line_of(lines: list[tuple[int, str]], file: str, top: _Top) -> str | None:
    names = top.columns.names
    for line, text in lines:
        if "\0" in text or not text.isascii():
            return _not_text(_at(file, line), "bytes that are no digits")
        cells = text.rstrip("\n").split(",")
        if len(cells) != len(names):
            expected = f"{len(names)} values, one per column"
            return refusal(_at(file, line), expected, f"{len(cells)}: {quote(text.rstrip())}")
        for name, cell in zip(names, cells, strict=True):
            if not _is_number(cell):
                return refusal(_at(file, line), f"a number in {name}", quote(cell.strip()))
    return None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell  # Python reads 1_000 as a number, numpy and other programs do not


def _split(table: NDArray[np.float64], file: str, top: _Top) -> tuple[Drop, ...]:
    """The drops of the table, each checked for its length and its time steps."""
    if table.shape[0] < FEWEST_SAMPLES:
        raise TraceError(_too_few(_at(file, top.names_line), "", table.shape[0]))
    columns = top.columns
    numbers = table[:, columns.drop] if columns.drop is not None else np.ones(table.shape[0])
    _check_drop_numbers(numbers, file, top)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1, [numbers.size]])
    if starts.size > MOST_DROPS + 1:
        raise TraceError(refusal(file, f"at most {MOST_DROPS} drops", str(starts.size - 1)))
    drops = []
    for start, end in itertools.pairwise(starts.tolist()):
        number = int(numbers[start])
        if end - start < FEWEST_SAMPLES:
            where = _row_place(file, top, start)
            raise TraceError(_too_few(where, f" in drop {number}", end - start))
        rows = table[start:end]
        _check_time(rows[:, columns.time], start, file, top)
        channels = tuple(
            Channel(sensor.offset, sensor.quantity, rows[:, sensor.index])
            for sensor in columns.sensors
        )
        drops.append(Drop(number, rows[:, columns.time], rows[:, columns.load], channels))
    return tuple(drops)


def _too_few(where: str, of: str, samples: int) -> str:
    return refusal(where, f"at least {FEWEST_SAMPLES} samples{of}", str(samples))


def _check_drop_numbers(numbers: NDArray[np.float64], file: str, top: _Top) -> None:
    odd = (numbers != np.floor(numbers)) | (numbers < 1) | (numbers > LARGEST_DROP_NUMBER)
    if odd.any():
        row = int(np.argmax(odd))
        where = _row_place(file, top, row)
        raise TraceError(refusal(where, "a whole drop number from 1", f"{numbers[row]:g}"))
    starts = np.concatenate([[0], np.flatnonzero(np.diff(numbers)) + 1])
    seen: set[float] = set()
    for row in starts.tolist():
        if numbers[row] in seen:
            came = f"drop {numbers[row]:g} again after another drop"
            raise TraceError(
                refusal(_row_place(file, top, row), "the rows of a drop together", came)
            )
        seen.add(numbers[row])


def _check_time(time: NDArray[np.float64], start: int, file: str, top: _Top) -> None:
    steps = np.diff(time)
    usual = float(np.median(steps))  # unlike the mean not moved by the gap that is looked for
    uneven = ~(np.abs(steps - usual) <= STEP_TOLERANCE * usual) | (steps <= 0)
    if uneven.any():
        row = int(np.argmax(uneven))
        came = f"a step of {steps[row]:.6g} s"
        hint = ""
        if steps[row] <= 0 and top.columns.drop is None:
            hint = "several drops in one file need a column drop"
        expected = f"even time steps, each within 1 % of {usual:.6g} s"
        raise TraceError(refusal(_row_place(file, top, start + row + 1), expected, came, hint))
