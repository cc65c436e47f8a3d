"""Reader of Dynatest's older ``.fwd`` (``R80``) as another maker's viewer writes it: peaks as text.

Line 3 has the radius of the plate and the positions of seven sensors, mm, four characters each.
The lines from line 5 are of three kinds. ``G`` begins a position, ``S`` a station with the
temperatures of surface and air. The others are drops: pressure, kPa, and deflections, um, each with
two decimals and without separators. A value that was not positive is written as a blank and 0.1.

A drop has a deflection for every sensor of the device, also for sensors on the other side of the
plate and beyond the seventh, whose positions line 3 does not have. The largest deflection is in
the centre, which identifies the columns.

No file of Dynatest's own programs was available to test with; such files are refused.
"""

import os
import re
from collections.abc import Sequence

from inversion.notices import Notice, Value
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    finite,
    position_of,
    short_text,
    temperature_of,
)
from pfwd.files.foreign.peaks_text import (
    OFFSETS_KEY,
    StationDrops,
    declared_offsets,
    force_of,
    lines_of,
    number_of,
    plate_radius,
    points_of_stations,
    require_plate_radius,
)
from pfwd.files.traces import TracePoint

ASSUMED_PLATE_RADIUS_M = 0.15
"""Radius of nearly every plate of an FWD; used with a remark if the file states 0."""

_R80_VALUE = re.compile(r" +0\.1|-?\d{1,5}\.\d\d")
_R80_VALUES = re.compile(rf"(?:{_R80_VALUE.pattern})+\s*")
_R80_STATION = re.compile(r"S\s*(-?\d{1,6}\.\d\d)\s+(-?\d{1,3}\.\d)00\s+(-?\d{1,3})\s")
_R80_POSITION = re.compile(r"G\d{7}\+(-?\d{1,2}\.\d{1,20})\+(-?\d{1,3}\.\d{1,20})999\.9\s*")


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a Dynatest ``.fwd`` file, one for each station.

    Parameters
    ----------
    file : str
        Path of the file.
    request : Request
        The declaration ``sensor_offsets_m`` replaces the sensor positions of the file.

    Raises
    ------
    TraceError
        If the file has another format, or a line of a drop is damaged.
    """
    request, declared = request.without(OFFSETS_KEY)
    name = os.path.basename(file)
    lines = list(lines_of(file))
    if len(lines) < 4 or not lines[0][1].startswith("R80"):
        expected = "a .fwd that begins with R80 (Dynatest) or has the line ROAD SYSTEM (Sweco)"
        first = next((line for _, line in lines if line.strip()), "")
        raise TraceError(refusal(file, expected, quote(first), "copy a damaged file again"))
    where = f"{file}, line 3"
    recorded_radius, offsets = _head(lines[2][1], where)
    remarks = []
    radius = plate_radius(request, recorded_radius)
    if radius == 0:
        radius = ASSUMED_PLATE_RADIUS_M
        assumed: dict[str, Value] = {"file": name, "line": 3, "plate_radius_m": radius}
        remarks.append(Notice("plate-radius-assumed", assumed))
    radius = require_plate_radius(radius, where)
    stations = _stations(file, lines, radius)
    columns = {len(deflections) for station in stations for _, deflections, _ in station.drops}
    if len(columns) > 1:
        raise TraceError(refusal(file, "one number of sensors", f"{sorted(columns)}"))
    count = columns.pop() if columns else len(offsets)
    if declared is not None:
        offsets = declared_offsets(declared.value, count, declared.where)
    elif count != len(offsets):
        values: dict[str, Value] = {
            "file": name,
            "line": 3,
            "positions": len(offsets),
            "deflections": count,
            "left_out": count - len(offsets),
        }
        offsets = _placed(stations, offsets, count, where)
        remarks.append(Notice("sensors-without-position", values))
    common = {
        "source": "Dynatest .fwd (R80), as a viewer writes it",
        "site": short_text(lines[0][1][14:]),
        "plate_radius_m": radius,
    }
    remarks.append(Notice("load-from-pressure", {"file": name, "plate_radius_m": radius}))
    return points_of_stations(file, stations, offsets, common, request, remarks)


def _head(line: str, where: str) -> tuple[float, list[float]]:
    """Return the plate radius and the offsets of the sensors, m, from line 3."""
    fields = [line[start : start + 4] for start in range(0, 32, 4)]
    expected = "eight whole numbers of four letters, mm"
    numbers = [number_of(field, expected, where) for field in fields]
    return numbers[0] / 1e3, [number / 1e3 for number in numbers[1:]]


def _stations(file: str, lines: Sequence[tuple[int, str]], radius: float) -> list[StationDrops]:
    stations: list[StationDrops] = []
    position: dict[str, float] = {}
    for number, line in lines[4:]:
        if match := _R80_POSITION.fullmatch(line):
            position = position_of(match[1], match[2])
        elif match := _R80_STATION.match(line):
            noted = {
                "chainage_m": finite(match[1]),
                "air_temperature_c": temperature_of(match[2]),
                "surface_temperature_c": temperature_of(match[3]),
            }
            stations.append(StationDrops(f"chainage {float(match[1]):g}", position, noted))
            position = {}
        elif stations and _R80_VALUES.fullmatch(line):
            pressure, *deflections = [
                number_of(text, "a number", f"{file}, line {number}")
                for text in _R80_VALUE.findall(line)
            ]
            load = force_of(1e3 * pressure, radius)
            stations[-1].drops.append((load, tuple(1e-6 * each for each in deflections), number))
        elif stations and line[:1].isdigit() and "." in line and stations[-1].drops:
            expected = "a drop: pressure and deflections with two decimals"
            raise TraceError(refusal(f"{file}, line {number}", expected, quote(line.strip()[:60])))
    return stations


def _placed(
    stations: Sequence[StationDrops], offsets: list[float], count: int, where: str
) -> list[float]:
    """Return the offsets of all columns, m, for a file with fewer positions than columns.

    The column that most often has the largest deflection is the centre. Columns without a position
    get NaN.

    Raises
    ------
    TraceError
        If no position is 0, or the largest deflection changes its column from drop to drop.
    """
    rows = [
        [deflection or 0.0 for deflection in deflections]
        for station in stations
        for _, deflections, _ in station.drops
    ]
    peaks = [row.index(max(row)) for row in rows]
    centre = max(set(peaks), key=peaks.count)
    first = centre - offsets.index(0.0) if 0.0 in offsets else -1
    if first < 0 or first + len(offsets) > count or peaks.count(centre) < 0.9 * len(peaks):
        expected = f"{len(offsets)} deflections, as the head has positions"
        raise TraceError(refusal(where, expected, f"{count}", f"declare {OFFSETS_KEY}"))
    positions = [float("nan")] * count
    positions[first : first + len(offsets)] = offsets
    return positions
