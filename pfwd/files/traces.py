"""Trace files: reading and writing the drops of one test point as text.

The format is a CSV file with a header of TOML lines, each behind a ``#``. A damaged file is refused
with one :class:`~pfwd.errors.TraceError`, which names the line. Implausible drops in an intact
file are reported by :mod:`pfwd.analysis.screening.drops`.
"""

import contextlib
import csv
import itertools
import math
import os
import re
import stat
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.header import (
    TRACES_FORMAT_KEY,
    TRACES_FORMAT_VERSION,
    Declarations,
    PointSetup,
    declared_lines,
    declared_values,
    parse_declaration,
    setup_from,
    setup_warnings,
)
from pfwd.files.output_path import replaced_at_once
from pfwd.toml_reading import LARGEST_TOML
from pfwd_device import Channel, Drop
from pfwd_device.recording import SurveyDrop
from pfwd_plugins.quantities import MOTIONS, Measurand

MAX_FILE_BYTES = 500_000_000
"""Largest trace file; a point of ten drops takes under 10 MB."""

MAX_FILE_NUMBERS = 20_000_000
"""Numbers in a file: three drops of 10 s at 50 kHz with 8 channels, a hundred times a typical
point. In memory they take 160 MB as a table, and again as drops."""

MAX_FILE_DROPS = 10_000
"""Drops in a file; a file is one point, which has about ten."""

MIN_SAMPLES = 16
"""Samples of a drop; with fewer, pulse and rest cannot be distinguished."""

RELATIVE_STEP_TOLERANCE = 0.01
"""Largest relative deviation of a time step: more than rounding, less than a missing sample."""

MAX_DROP_NUMBER = 1_000_000
"""Largest drop number; larger values belong to another column."""

MAX_TEXT_LINE_CHARACTERS = 65_536
"""Longest line; a file with a longer one is no text."""

_BLOCK_LINES = 4096
"""Lines that are parsed together in the search for a damaged line."""

DROP_COLUMN, TIME_COLUMN, LOAD_COLUMN = "drop", "time_s", Measurand.LOAD.column

_SENSOR_COLUMNS = {quantity.column: quantity for quantity in MOTIONS}
_SENSOR_NAME = re.compile(rf"({'|'.join(_SENSOR_COLUMNS)})@([0-9.eE+-]+)")
_COLUMN_NAMES = (
    f"{DROP_COLUMN}, {TIME_COLUMN}, {LOAD_COLUMN}, "
    f"{' or '.join(f'{name}@R' for name in _SENSOR_COLUMNS)} with R in metres"
)

_FORMAT_LINE = re.compile(rf"#\s*{TRACES_FORMAT_KEY}\s*=")


@dataclass(frozen=True, eq=False, slots=True)
class TracePoint:
    """One test point: its declared setup and its drops."""

    file: str
    """Path of the file, as given by the caller."""
    setup: PointSetup
    """Declared setup."""
    drops: tuple[Drop, ...]
    """The drops in the order of the file."""
    warnings: tuple[Notice, ...] = ()
    """Warnings that concern all drops of the point."""
    survey_drops: tuple[SurveyDrop, ...] = field(default=(), compare=False, repr=False)
    """The same drops as entries of their survey; empty: the point was not read from a survey."""

    @property
    def name(self) -> str | None:
        """Declared name; None: not declared."""
        return None if self.setup.point is None else str(self.setup.point)

    @property
    def declared(self) -> dict[str, Any]:
        """Declared values of instrument and ground, by header key (docs/traces.md)."""
        return declared_values(self.setup)


def read_traces(
    path: str | os.PathLike[str], declared: Declarations | None = None, *, foreign: bool = False
) -> TracePoint:
    """Read the test point of a trace file.

    Parameters
    ----------
    path : path of a trace file
    declared : dict of header key to Declaration, optional
        Override those of the file.
    foreign : bool
        True: the line ``pfwd-traces`` may be missing; then the lines behind ``#`` are another
        program's comments and are skipped.

    Returns
    -------
    TracePoint

    Raises
    ------
    TraceError
        If the file is refused.
    """
    file = os.fspath(path)
    try:
        _check_file(file)
        with _open(file) as stream:
            top = _read_top(stream, file, foreign=foreign)
            setup = setup_from(top.declarations | (declared or {}), _at(file, top.line))
            table = _read_numbers(stream, file, top)
    except UnicodeDecodeError as err:
        raise TraceError(_no_text(file, "UTF-8 text", err.reason)) from err
    except (OSError, ValueError) as err:
        if isinstance(err, TraceError):
            raise
        reason = getattr(err, "strerror", None) or str(err)
        raise TraceError(refusal(file, "a readable trace file", reason)) from err
    drops = _split(table, file, top)
    return TracePoint(file, setup, drops, setup_warnings(setup, drops))


def is_trace_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a file begins with the line ``# pfwd-traces = ...``."""
    try:
        _check_file(os.fspath(path))
        with _open(os.fspath(path), errors="replace") as stream:
            return _FORMAT_LINE.match(stream.readline(MAX_TEXT_LINE_CHARACTERS)) is not None
    except (OSError, TraceError):
        return False


def write_traces(path: str | os.PathLike[str], point: TracePoint) -> None:
    """Write a test point as a trace file, with all digits of its numbers.

    Parameters
    ----------
    path : path of the file, which is replaced in one step
    point : TracePoint
        All its drops have the same sensors.

    Raises
    ------
    TraceError
        If the drops do not have the same sensors, or a text cannot be written as UTF-8.
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
    names = [
        DROP_COLUMN,
        TIME_COLUMN,
        LOAD_COLUMN,
        *(sensor_name(*sensor) for group in sensors for sensor in group),
    ]
    try:
        with (
            replaced_at_once(Path(os.path.abspath(path))) as draft,
            open(draft, "w", encoding="utf-8", newline="\n") as stream,
        ):
            stream.writelines(f"# {line}\n" for line in declared_lines(point.setup))
            stream.write(",".join(names) + "\n")
            for drop in point.drops:
                rows = np.column_stack([drop.time, drop.load, *(c.values for c in drop.channels)])
                # repr is the shortest text that reads back as the same number.
                stream.writelines(
                    f"{drop.number},{','.join(map(repr, row))}\n" for row in rows.tolist()
                )
    except UnicodeEncodeError as err:
        raise TraceError(
            refusal(point.file, "text that UTF-8 can hold", quote(err.object))
        ) from err


@dataclass(frozen=True, slots=True)
class _Top:
    """Declarations and columns, by their indices from 0, of a trace file."""

    declarations: Declarations
    line: int
    """Line with the column names, from 1; the numbers begin on the next."""
    names: list[str]
    """Names of all columns."""
    sensors: list[tuple[int, Measurand, float]]
    """Column, quantity and offset (m; negative: the other side of the plate) of each sensor."""

    @property
    def drop(self) -> int | None:
        """Column with the drop numbers; None: all rows belong to drop 1."""
        return self.names.index(DROP_COLUMN) if DROP_COLUMN in self.names else None


def _at(file: str, line: int) -> str:
    return f"{file}, line {line}"


def _no_text(where: str, expected: str, content: str) -> str:
    hint = "save a table as CSV in UTF-8, copy a damaged file again"
    return refusal(where, expected, content, hint)


def _check_file(file: str) -> None:
    # Checked before it is opened: a pipe may wait for ever, and 500 MB take a while.
    status = os.stat(file)
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or pipe"
        raise TraceError(refusal(file, "a trace file", kind))
    if status.st_size > MAX_FILE_BYTES:
        expected = f"at most {MAX_FILE_BYTES / 1e6:.0f} MB"
        raise TraceError(refusal(file, expected, f"{status.st_size / 1e6:.1f} MB"))


def _open(file: str, errors: str = "strict") -> TextIO:
    # utf-8-sig: spreadsheets write a byte order mark. Any of the three line ends is accepted.
    return open(file, encoding="utf-8-sig", errors=errors, newline=None)


def _read_top(stream: TextIO, file: str, *, foreign: bool) -> _Top:
    """Read the header and the column names.

    Parameters
    ----------
    stream : TextIO
        At its beginning; afterwards at the first row of numbers.
    file : str
        Path, for messages.
    foreign : bool
        True: the file may begin without the line ``pfwd-traces``.
    """
    declarations: Declarations = {}
    native = False
    length = 0
    for line, text in numbered_lines(stream, file):
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
                expected = f"# {TRACES_FORMAT_KEY} = {TRACES_FORMAT_VERSION}"
                raise TraceError(refusal(where, expected, quote(text.rstrip()), hint))
        if text.startswith("#"):
            parsed = parse_declaration(text[1:], where) if native else None
            if parsed is not None:
                key, declaration = parsed
                if key in declarations:
                    raise TraceError(refusal(where, "every key once", f"{quote(key)} again"))
                declarations[key] = declaration
        elif text.strip():
            return _Top(declarations, line, *_parse_columns(text, where))
    raise TraceError(refusal(file, "a row of column names", "the end of the file"))


def numbered_lines(stream: TextIO, file: str) -> Iterator[tuple[int, str]]:
    """Yield number (from 1) and text of each line.

    Parameters
    ----------
    stream : TextIO
        At its beginning.
    file : str
        Path, for messages.

    Raises
    ------
    TraceError
        If a line has binary data, or is longer than `MAX_TEXT_LINE_CHARACTERS`.
    """
    for line in itertools.count(1):
        text = stream.readline(MAX_TEXT_LINE_CHARACTERS)
        if "\0" in text or len(text) == MAX_TEXT_LINE_CHARACTERS:
            raise TraceError(_no_text(_at(file, line), "a line of text", "binary data"))
        if not text:
            return
        yield line, text


def _read_numbers(stream: TextIO, file: str, top: _Top) -> NDArray[np.float64]:
    """Return the numbers below the column names, (rows, columns); refuse NaN and infinity."""
    width = len(top.names)
    refuse_long(file, width)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: refused below
            table = np.loadtxt(stream, delimiter=",", comments=None, ndmin=2)
    except UnicodeDecodeError:
        raise
    except ValueError as err:
        # numpy counts neither blank lines nor the header, hence a second, slower pass.
        raise TraceError(_find_bad_line(file, top) or refusal(file, "numbers", str(err))) from err
    if table.size and table.shape[1] != width:
        raise TraceError(_find_bad_line(file, top) or refusal(file, f"{width} columns", "others"))
    finite = np.isfinite(table)
    if not finite.all():
        row, column = np.unravel_index(np.argmin(finite), table.shape)
        name = top.names[column]
        where = _row_place(file, top, int(row))
        raise TraceError(refusal(where, f"a finite number in {name}", f"{table[row, column]}"))
    return table.reshape(-1, width)


def refuse_long(file: str, width: int) -> None:
    """Raise TraceError if a text has an endless line or too many numbers to be parsed.

    Parameters
    ----------
    file : str
        Path of the text.
    width : int
        Numbers in a line.
    """
    ends = 0
    with open(file, "rb") as stream:
        while block := stream.read(MAX_TEXT_LINE_CHARACTERS):
            lines = max(block.count(b"\n"), block.count(b"\r"))
            if not lines and len(block) == MAX_TEXT_LINE_CHARACTERS:
                actual = f"none in {MAX_TEXT_LINE_CHARACTERS} bytes"
                raise TraceError(refusal(_at(file, ends + 1), "the end of a line", actual))
            ends += lines
            if ends * width > MAX_FILE_NUMBERS:
                expected, actual = (
                    f"at most {MAX_FILE_NUMBERS} numbers",
                    f"over {ends} lines of {width}",
                )
                hint = "give the drops in several files"
                raise TraceError(refusal(file, expected, actual, hint))


def _data_lines(file: str, top: _Top) -> Iterator[tuple[int, str]]:
    """Yield line number and text of the rows of numbers; numpy skips the other lines."""
    with _open(file, errors="surrogateescape") as stream:
        for line, text in enumerate(stream, start=1):
            if line > top.line and text != "\n":
                yield line, text


def _row_place(file: str, top: _Top, row: int) -> str:
    line, _ = next(itertools.islice(_data_lines(file, top), row, None))
    return _at(file, line)


def _find_bad_line(file: str, top: _Top) -> str | None:
    """Return a message about the first row without one number in each column; None: there is no
    such row.
    """
    lines = _data_lines(file, top)
    while block := list(itertools.islice(lines, _BLOCK_LINES)):
        # numpy is thirty times as fast as a check of each number, of which there may be millions.
        try:
            table = np.loadtxt([text for _, text in block], delimiter=",", comments=None, ndmin=2)
            if table.shape[1] == len(top.names):
                continue
        except ValueError:
            pass
        if (problem := _bad_line_of(block, file, top)) is not None:
            return problem
    return None


def _bad_line_of(lines: list[tuple[int, str]], file: str, top: _Top) -> str | None:
    names = top.names
    for line, text in lines:
        if "\0" in text or not text.isascii():
            return _no_text(_at(file, line), "a line of text", "bytes that are no digits")
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
    """Return the drops of a table; refuse drops that are too short or have uneven time steps."""
    if table.shape[0] < MIN_SAMPLES:
        raise TraceError(too_short(_at(file, top.line), table.shape[0]))
    numbers = table[:, top.drop] if top.drop is not None else np.ones(table.shape[0])
    time, load = top.names.index(TIME_COLUMN), top.names.index(LOAD_COLUMN)
    drops = []
    for number, start, end in split_drops(numbers, file, lambda row: _row_place(file, top, row)):
        if end - start < MIN_SAMPLES:
            where = _row_place(file, top, start)
            raise TraceError(too_short(where, end - start, f" in drop {number}"))
        rows = table[start:end]
        _check_time(rows[:, time], start, file, top)
        channels = tuple(
            Channel(offset, quantity, rows[:, column]) for column, quantity, offset in top.sensors
        )
        drops.append(Drop(number, rows[:, time], rows[:, load], channels))
    return tuple(drops)


def too_short(where: str, samples: int, of: str = "") -> str:
    """Return the message that a record has fewer than `MIN_SAMPLES` samples."""
    return refusal(where, f"at least {MIN_SAMPLES} samples{of}", str(samples))


def split_drops(
    numbers: NDArray[np.float64], file: str, place_of: Callable[[int], str]
) -> list[tuple[int, int, int]]:
    """Return number, first row and end of each drop in a table.

    Parameters
    ----------
    numbers : (rows,) ndarray of float
        Drop number of each row.
    file : str
        Path, for messages.
    place_of : callable
        Returns file and line of a row, for messages.

    Raises
    ------
    TraceError
        If a number is no drop number, a drop has rows at two places, or there are too many drops.
    """
    odd = ~((numbers == np.floor(numbers)) & (numbers >= 1) & (numbers <= MAX_DROP_NUMBER))
    if odd.any():
        row = int(np.argmax(odd))
        raise TraceError(refusal(place_of(row), "a whole drop number from 1", f"{numbers[row]:g}"))
    starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), numbers.size]
    if len(starts) > MAX_FILE_DROPS + 1:
        raise TraceError(refusal(file, f"at most {MAX_FILE_DROPS} drops", str(len(starts) - 1)))
    drops: dict[int, tuple[int, int, int]] = {}
    for start, end in itertools.pairwise(starts):
        number = int(numbers[start])
        if number in drops:
            actual, hint = f"drop {number} again after another drop", "sort the rows by drop"
            expected = "the rows of a drop together"
            raise TraceError(refusal(place_of(start), expected, actual, hint))
        drops[number] = (number, start, end)
    return list(drops.values())


def _check_time(time: NDArray[np.float64], start: int, file: str, top: _Top) -> None:
    steps = np.diff(time)
    step = float(np.median(steps))  # a gap changes the mean, but not the median
    uneven = ~(np.abs(steps - step) <= RELATIVE_STEP_TOLERANCE * step) | (steps <= 0)
    if uneven.any():
        row = int(np.argmax(uneven))
        actual = f"a step of {steps[row]:.6g} s"
        hint = ""
        if steps[row] <= 0 and top.drop is None:
            hint = "several drops in one file need a column drop"
        expected = f"even time steps, each within 1 % of {step:.6g} s"
        raise TraceError(refusal(_row_place(file, top, start + row + 1), expected, actual, hint))


def _parse_columns(row: str, where: str) -> tuple[list[str], list[tuple[int, Measurand, float]]]:
    """Return the names of all columns, and column, quantity and offset of each sensor.

    Raises
    ------
    TraceError
        If a column is unknown, occurs twice, or is missing.
    """
    names = [name.strip() for name in next(csv.reader([row.strip()]), [])]
    sensors = [
        (column, *_parse_sensor(name, where))
        for column, name in enumerate(names)
        if name not in (DROP_COLUMN, TIME_COLUMN, LOAD_COLUMN)
    ]
    for name in (TIME_COLUMN, LOAD_COLUMN):
        if name not in names:
            raise TraceError(refusal(where, f"a column {name}", f"columns {quote(row.strip())}"))
    # @0.3 and @0.30 are one sensor; a velocity and a displacement may share an offset.
    keys: list[object] = list(names)
    for column, *sensor in sensors:
        keys[column] = tuple(sensor)
    if len(set(keys)) < len(keys):
        twin = next(name for n, name in enumerate(names) if keys[n] in keys[:n])
        raise TraceError(refusal(where, "every column once", f"{quote(twin)} again"))
    return names, sensors


def sensor_name(quantity: Measurand, offset: float) -> str:
    """Return the column name of a sensor, such as ``velocity_m_s@0.3``."""
    return f"{quantity.column}@{offset!r}"


def _parse_sensor(name: str, where: str) -> tuple[Measurand, float]:
    match = _SENSOR_NAME.fullmatch(name)
    offset = math.nan
    if match is not None:
        with contextlib.suppress(ValueError):
            offset = float(match[2])
    if match is None or not math.isfinite(offset):
        hint = "separate the columns with commas" if re.search(r"[;\t]", name) else ""
        if name in _SENSOR_COLUMNS:
            hint = f"the centre sensor is {name}@0.0000"
        raise TraceError(refusal(where, f"a column {_COLUMN_NAMES}", quote(name), hint))
    return _SENSOR_COLUMNS[match[1]], offset
