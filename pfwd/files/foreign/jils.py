"""Reader of JILS ``.THY``: traces of a trailer FWD as text.

The file begins with lines of ``Name: value``: ``Date-Time``, ``Sensors``, ``Weight/spring``,
``Location``, ``Temp`` in degrees Fahrenheit, ``Operator``, ``Comments``. For each drop follow its
``Station``, ``Lane`` and ``Milepost``, ``Drop # 1 Desired peak force`` in lbf, the column names,
``Impact`` with ``Number_of_samples``, and that number of rows: time in ms, force in kip,
displacements in mil, negative downward.

The layout was inferred from public files. Plate radius and sensor offsets have to be declared: the
meaning of the fields that may hold them is not known.
"""

import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    Values,
    distinct_names,
    even_time,
    finite,
    make_drop,
    point_of,
    short_text,
)
from pfwd.files.foreign.jils_peaks import (
    HEADING_LINE,
    Key,
    compare_peaks,
    head_facts,
    parse,
    sensor_offsets,
    station_name,
)
from pfwd.files.foreign.peaks_text import OFFSETS_KEY, StationDrops
from pfwd.files.traces import MAX_FILE_DROPS, MAX_FILE_NUMBERS, TracePoint, numbered_lines
from pfwd_device import Drop
from pfwd_plugins.quantities import POUND_FORCE_N, Measurand

MAX_DROP_SAMPLES = 1_000_000
"""Largest number of samples of a drop; longer records are damaged headers."""

_THY_STATION = re.compile(r"\s*Station:\s*(\S*)\s+Lane:\s*(\S*)\s+Milepost:\s*(\S*)")
_THY_DROP = re.compile(r"\s*Drop\s*#\s*(\d{1,6})\s+Desired peak force:\s*(\S+)")
_THY_IMPACT = re.compile(r"\s*Impact:\s*(\S+)\s+Number_of_samples:\s*(\d{1,9})\s*$")
_THY_COLUMNS = re.compile(r"\s*Time\s+Force((?:\s+Disp\d{1,3})+)\s*$")


@dataclass(slots=True)
class _Block:
    """Traces of one drop, in the units of the file."""

    station: Key
    """Station, lane and milepost."""
    number: int
    desired_load: float | None
    """Desired peak force, lbf."""
    line: int
    """Line of the first row, from 1."""
    width: int
    """Number of columns."""
    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    """Values row after row: time (ms), load (kip), displacements (mil)."""

    @property
    def table(self) -> Values:
        """Values, (rows, columns), in the units of the file."""
        return np.frombuffer(self.numbers).reshape(-1, self.width)


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a JILS ``.THY`` file, one for each station, lane and milepost.

    A ``.DAT`` with the same name in the same folder contributes positions, notes and peaks, which
    are compared with the traces.

    Parameters
    ----------
    file : str
        Path of the file.
    request : Request
        Declares ``plate_radius_m`` and ``sensor_offsets_m``. Without the latter only the first
        sensor is read, at the centre.

    Raises
    ------
    TraceError
        If the file has another format or is cut off, or the plate radius is not declared.
    """
    with open(file, encoding="latin-1", newline=None) as stream:
        headings, blocks = _parse(stream, file)
    if not blocks:
        hint = "is it a JILS time history?"
        raise TraceError(refusal(file, "drops with Impact: and rows of numbers", "none", hint))
    request, declared = request.without(OFFSETS_KEY)
    count = blocks[0].width - 2
    offsets, remarks = sensor_offsets(file, declared and declared.value, count, headings)
    peaks_name, peaks = _read_peaks_file(file, remarks)
    common, head_noted = head_facts(headings, "JILS time history (.THY)")
    stations: dict[Key, list[_Block]] = {}
    for block in blocks:
        stations.setdefault(block.station, []).append(block)
    names = distinct_names([station_name(station) for station in stations])
    points = []
    for name, (station, station_blocks) in zip(names, stations.items(), strict=True):
        drops = [_drop(file, number, block, offsets) for number, block in _numbered(station_blocks)]
        values, noted = {**common, "point": name}, head_noted | {"milepost": short_text(station[2])}
        desired = [block.desired_load for block in station_blocks if block.desired_load is not None]
        noted["desired_peak_force_n"] = [POUND_FORCE_N * load for load in desired] or None
        point_remarks = list(remarks)
        peaks_station = peaks.pop(station, None)
        if peaks_station is not None:
            values |= peaks_station.declared
            noted |= peaks_station.noted
            traced = [_block_peaks(block) for block in station_blocks]
            point_remarks += compare_peaks(traced, peaks_station, peaks_name)
        elif peaks_name:
            point_remarks.append(Notice("peaks-file-without-station", {"file": peaks_name}))
        points.append(point_of(file, values, drops, request, noted=noted, remarks=point_remarks))
    return points


def _read_peaks_file(file: str, remarks: list[Notice]) -> tuple[str, dict[Key, StationDrops]]:
    """Read the ``.DAT`` that belongs to a ``.THY``; if it is damaged, add a remark.

    Returns
    -------
    name : str
        File name; empty: there is no readable one.
    stations : dict
        By station, lane and milepost.
    """
    candidates = (Path(file).with_suffix(suffix) for suffix in (".DAT", ".dat", ".Dat"))
    path = next((candidate for candidate in candidates if candidate.is_file()), None)
    if path is None:
        return "", {}
    try:
        return path.name, parse(os.fspath(path))[1]
    except (TraceError, OSError) as err:
        reason = str(err).removeprefix(os.fspath(path)).lstrip(", :")
        remarks.append(Notice("peaks-file-not-read", {"file": path.name, "reason": reason}))
        return "", {}


def _block_peaks(block: _Block) -> tuple[float, Values]:
    """Return peak load, N, and peak deflections, m, of a drop."""
    table = block.table
    deflections = -table[:, 2:].min(axis=0) * Measurand.DISPLACEMENT.units["mil"]
    return float(table[:, 1].max()) * Measurand.LOAD.units["kip"], deflections


def _parse(stream: TextIO, file: str) -> tuple[dict[str, str], list[_Block]]:
    headings: dict[str, str] = {}
    blocks: list[_Block] = []
    station, number, desired, columns = ("", "", ""), 0, None, 0
    total = 0
    lines = numbered_lines(stream, file)
    for line, text in lines:
        where = f"{file}, line {line}"
        if match := _THY_STATION.match(text):
            station = (match[1], match[2], match[3])
        elif match := _THY_DROP.match(text):
            number, desired = int(match[1]), finite(match[2])
        elif match := _THY_COLUMNS.match(text):
            columns = len(match[1].split())
        elif match := _THY_IMPACT.match(text):
            if not columns:
                expected = "a line Time Force Disp1 ... before the first Impact"
                raise TraceError(refusal(where, expected, "none"))
            block = _Block(station, number, desired, line + 1, columns + 2)
            samples = int(match[2])
            if not 0 < samples <= MAX_DROP_SAMPLES:
                raise TraceError(refusal(where, f"1 to {MAX_DROP_SAMPLES} samples", str(samples)))
            _read_rows(lines, file, block, samples)
            blocks.append(block)
            total += len(block.numbers)
            if total > MAX_FILE_NUMBERS or len(blocks) > MAX_FILE_DROPS:
                expected = f"at most {MAX_FILE_DROPS} drops and {MAX_FILE_NUMBERS} numbers"
                raise TraceError(refusal(where, expected, "more"))
        elif (match := HEADING_LINE.match(text)) and not blocks:
            headings.setdefault(match[1], match[2])
        elif text.strip() and columns and text.split()[0].lstrip("-").replace(".", "").isdigit():
            expected = "the number of rows that Number_of_samples states"
            actual = f"another row: {quote(text.strip())}"
            raise TraceError(refusal(where, expected, actual))
    return headings, blocks


def _read_rows(lines: Iterator[tuple[int, str]], file: str, block: _Block, samples: int) -> None:
    for row in range(samples):
        where = f"{file}, line {block.line + row}"
        _, text = next(lines, (0, None))
        if text is None:
            hint = "the file was cut off: copy it again"
            actual = f"the end of the file after {row}"
            raise TraceError(refusal(where, f"{samples} rows", actual, hint))
        cells = text.split()
        numbers = [number for cell in cells if (number := finite(cell)) is not None]
        if not len(numbers) == len(cells) == block.width:
            raise TraceError(refusal(where, f"{block.width} numbers", quote(text.strip())))
        block.numbers.extend(numbers)


def _numbered(blocks: Sequence[_Block]) -> Iterator[tuple[int, _Block]]:
    """Yield drops with their numbers; a repeated or missing number is replaced by the next free
    one.
    """
    numbers: set[int] = set()
    for block in blocks:
        number = block.number
        if number < 1 or number in numbers:
            number = max(numbers, default=0) + 1
        numbers.add(number)
        yield number, block


def _drop(file: str, number: int, block: _Block, offsets: Sequence[float]) -> Drop:
    where = f"{file}, line {block.line}, drop {number}"
    table = block.table
    if table.shape[1] != len(offsets) + 2:
        expected = f"{len(offsets)} sensors as in the first drop"
        raise TraceError(refusal(where, expected, str(table.shape[1] - 2)))
    used = [index for index, offset in enumerate(offsets) if not np.isnan(offset)]
    sensors = []
    for index in used:
        # The file is positive upward. 0.0 - x and not -x, which would turn 0 into -0.
        values = 0.0 - table[:, 2 + index] * Measurand.DISPLACEMENT.units["mil"]
        sensors.append((offsets[index], Measurand.DISPLACEMENT, values))
    time = even_time(table[:, 0] * 1e-3, where)
    load = table[:, 1] * Measurand.LOAD.units["kip"]
    return make_drop(number, time, load, sensors, where)
