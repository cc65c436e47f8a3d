"""JILS ``.THY``: the time histories of a trailer FWD as text.

Lines of ``Name: value`` (``Date-Time``, ``Sensors``, ``Weight/spring``, ``Location``, ``Temp`` in
degrees Fahrenheit, ``Operator``, ``Comments``), then for each drop its ``Station``, ``Lane`` and
``Milepost``, ``Drop # 1 Desired peak force`` in lbf, the names of the columns, ``Impact`` with
``Number_of_samples``, and so many rows: time in ms, force in kip, displacements in mil, negative
downward. Layout as seen in public files. Neither the plate nor the distances of the sensors are
among what is understood of it: they have to be declared.
"""

import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    Values,
    distinct,
    even_time,
    finite,
    make_drop,
    point_of,
    short_text,
)
from pfwd.files.foreign.jils_head import OFFSETS, head_facts, sensor_offsets, station_name
from pfwd.files.foreign.jils_peaks import PeaksStation, beside, compared, parse
from pfwd.files.foreign.units import DISPLACEMENT, FORCE, POUND_FORCE, TIME
from pfwd.files.traces import MAX_FILE_DROPS, MAX_FILE_NUMBERS, TracePoint
from pfwd_device import Drop

MOST_SAMPLES = 1_000_000
LONGEST_LINE = 4096

_STATION = re.compile(r"\s*Station:\s*(\S*)\s+Lane:\s*(\S*)\s+Milepost:\s*(\S*)")
_DROP = re.compile(r"\s*Drop\s*#\s*(\d{1,6})\s+Desired peak force:\s*(\S+)")
_IMPACT = re.compile(r"\s*Impact:\s*(\S+)\s+Number_of_samples:\s*(\d{1,9})\s*$")
_COLUMNS = re.compile(r"\s*Time\s+Force((?:\s+Disp\d{1,3})+)\s*$")
_HEADING = re.compile(r"\s*([A-Z][\w/-]*):\s*(.*?)\s*$")


@dataclass(slots=True)
class _Block:
    """One drop as it stands in the file."""

    station: tuple[str, str, str]
    """Station, lane, milepost."""
    number: int
    wanted: float | None
    """lbf."""
    line: int
    """Line of the first row, from 1."""
    width: int
    """Numbers of a row."""
    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    """Row after row: ms, kip, mil."""

    @property
    def table(self) -> Values:
        """(rows, columns)."""
        return np.frombuffer(self.numbers).reshape(-1, self.width)


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a file, one for each station, lane and milepost.

    Parameters
    ----------
    file : str
    request : Request
        Its declarations give ``plate_radius_m`` and, for more than the first sensor,
        ``sensor_offsets_m``.

    Raises
    ------
    TraceError
        If it is another file, cut off, or the plate is not declared.
    """
    with open(file, encoding="latin-1", newline=None) as stream:
        headings, blocks = _parse(_Lines(stream, file))
    if not blocks:
        hint = "is it a JILS time history?"
        raise TraceError(refusal(file, "drops with Impact: and rows of numbers", "none", hint))
    said = dict(request.said)
    declared = said.pop(OFFSETS, None)
    request = Request(said, request.channels, request.column_map)
    count = blocks[0].width - 2
    offsets, remarks = sensor_offsets(file, declared and declared.value, count, headings)
    other, peaks = _peaks_beside(file, remarks)
    common, about = head_facts(headings, "JILS time history (.THY)")
    stations: dict[tuple[str, str, str], list[_Block]] = {}
    for block in blocks:
        stations.setdefault(block.station, []).append(block)
    names = distinct([station_name(station) for station in stations])
    found = []
    for name, (station, of_station) in zip(names, stations.items(), strict=True):
        drops = [_drop(file, number, block, offsets) for number, block in _numbered(of_station)]
        known, noted = {**common, "point": name}, about | {"milepost": short_text(station[2])}
        wanted = [block.wanted * POUND_FORCE for block in of_station if block.wanted is not None]
        noted["desired_peak_force_n"] = wanted or None
        texts = list(remarks)
        beside_it = peaks.pop(station, None)
        if beside_it is not None:
            known |= beside_it.place
            noted |= beside_it.noted
            texts += compared([_block_peaks(block) for block in of_station], beside_it, other)
        elif other:
            texts.append(Notice("peaks-file-without-station", {"file": other}))
        found.append(point_of(file, known, drops, request, noted=noted, remarks=texts))
    return found


def _peaks_beside(
    file: str, remarks: list[Notice]
) -> tuple[str, dict[tuple[str, str, str], PeaksStation]]:
    """Name and stations of the .DAT beside a file; a damaged one is a remark."""
    path = beside(file)
    if path is None:
        return "", {}
    name = os.path.basename(path)
    try:
        stations = parse(path)[1]
    except (TraceError, OSError) as err:
        reason = str(err).removeprefix(path).lstrip(", :")
        remarks.append(Notice("peaks-file-not-read", {"file": name, "reason": reason}))
        return "", {}
    return name, {station.key: station for station in stations}


def _block_peaks(block: _Block) -> tuple[float, list[float]]:
    """Largest load (N) and deflections (m) of a drop, as they stand in the file."""
    table = block.table
    moved = -table[:, 2:].min(axis=0) * DISPLACEMENT["mil"]
    return float(table[:, 1].max()) * FORCE["kip"], moved.tolist()


class _Lines:
    """Lines with their numbers; one without end is refused."""

    def __init__(self, stream: Iterator[str], file: str) -> None:
        self._stream = stream
        self._file = file
        self.number = 0

    @property
    def here(self) -> str:
        return f"{self._file}, line {self.number}"

    def next(self) -> str | None:
        """The next line; None at the end."""
        text: str = self._stream.readline(LONGEST_LINE)  # type: ignore[attr-defined]
        self.number += 1
        if len(text) == LONGEST_LINE or "\0" in text:
            raise TraceError(refusal(self.here, "a line of text", "binary data"))
        return text or None


def _parse(lines: _Lines) -> tuple[dict[str, str], list[_Block]]:
    headings: dict[str, str] = {}
    blocks: list[_Block] = []
    station, number, wanted, columns = ("", "", ""), 0, None, 0
    total = 0
    while (text := lines.next()) is not None:
        if match := _STATION.match(text):
            station = (match[1], match[2], match[3])
        elif match := _DROP.match(text):
            number, wanted = int(match[1]), finite(match[2])
        elif match := _COLUMNS.match(text):
            columns = len(match[1].split())
        elif match := _IMPACT.match(text):
            if not columns:
                expected = "a line Time Force Disp1 ... before the first Impact"
                raise TraceError(refusal(lines.here, expected, "none"))
            block = _Block(station, number, wanted, lines.number + 1, columns + 2)
            _rows(lines, block, int(match[2]))
            blocks.append(block)
            total += len(block.numbers)
            if total > MAX_FILE_NUMBERS or len(blocks) > MAX_FILE_DROPS:
                expected = f"at most {MAX_FILE_DROPS} drops and {MAX_FILE_NUMBERS} numbers"
                raise TraceError(refusal(lines.here, expected, "more"))
        elif (match := _HEADING.match(text)) and not blocks:
            headings.setdefault(match[1], match[2])
        elif text.strip() and columns and text.split()[0].lstrip("-").replace(".", "").isdigit():
            expected = "as many rows as Number_of_samples says"
            raise TraceError(refusal(lines.here, expected, quote(text.strip())))
    return headings, blocks


def _rows(lines: _Lines, block: _Block, samples: int) -> None:
    if not 0 < samples <= MOST_SAMPLES:
        raise TraceError(refusal(lines.here, "a number of samples", str(samples)))
    for row in range(samples):
        text = lines.next()
        if text is None:
            hint = "the file was cut off: copy it again"
            came = f"the end of the file after {row}"
            raise TraceError(refusal(lines.here, f"{samples} rows", came, hint))
        cells = text.split()
        numbers = [finite(cell) for cell in cells]
        if len(cells) != block.width or None in numbers:
            raise TraceError(refusal(lines.here, f"{block.width} numbers", quote(text.strip())))
        block.numbers.extend([number for number in numbers if number is not None])


def _numbered(blocks: Sequence[_Block]) -> Iterator[tuple[int, _Block]]:
    """The drops with the numbers they have, or counted on where a number comes again."""
    taken: set[int] = set()
    for block in blocks:
        number = block.number
        if number < 1 or number in taken:
            number = max(taken, default=0) + 1
        taken.add(number)
        yield number, block


def _drop(file: str, number: int, block: _Block, offsets: Sequence[float]) -> Drop:
    where = f"{file}, line {block.line}, drop {number}"
    table = block.table
    if table.shape[1] != len(offsets) + 2:
        expected = f"{len(offsets)} sensors as in the first drop"
        raise TraceError(refusal(where, expected, str(table.shape[1] - 2)))
    wanted = [index for index, offset in enumerate(offsets) if not np.isnan(offset)]
    sensors = []
    for index in wanted:
        # Negative is downward in the file; 0.0 - x, so that nothing becomes -0.
        values = 0.0 - table[:, 2 + index] * DISPLACEMENT["mil"]
        sensors.append((offsets[index], "displacement", values))
    time = even_time(table[:, 0] * TIME["ms"], where)
    load = table[:, 1] * FORCE["kip"]
    return make_drop(number, time, load, sensors, where)  # type: ignore[arg-type]
