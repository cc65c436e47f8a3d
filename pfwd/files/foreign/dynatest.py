"""Dynatest's older ``.fwd`` (``R80``) as a viewer of another maker writes it.

Line 3 has the radius of the plate and the positions of seven sensors (mm, four letters each).
After the head follow ``G`` with a position, ``S`` with station and temperatures (surface, air), and
one line a drop: pressure (kPa) and deflections (um), each of at least four letters and two
decimals, with nothing between them; a blank and 0.1 stand for all that was not positive. All
sensors are in these lines, those at the other side and beyond the seventh too: the columns are told
by the largest deflection, which is in the centre.

Files of Dynatest's own programs were not seen, and are refused.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import replace

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
    PLATES,
    Station,
    force_of,
    lines_of,
    number_of,
    plate_radius,
    points_of_stations,
)
from pfwd.files.traces import TracePoint

OFFSETS = "sensor_offsets_m"
"""Key of ``--header``: distances of the sensors, m, one a column; nan leaves one out."""

USUAL_RADIUS = 0.15
"""m; of nearly every FWD's plate, taken with a remark where the file says 0."""

_VALUE = re.compile(r" +0\.1|-?\d{1,5}\.\d\d")
_ROW = re.compile(rf"(?:{_VALUE.pattern})+\s*")
_STATION = re.compile(r"S\s*(-?\d{1,6}\.\d\d)\s+(-?\d{1,3}\.\d)00\s+(-?\d{1,3})\s")
_POSITION = re.compile(r"G\d{7}\+(-?\d{1,2}\.\d{1,20})\+(-?\d{1,3}\.\d{1,20})999\.9\s*")


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a file.

    Parameters
    ----------
    file : str
    request : Request
        ``sensor_offsets_m`` says where the sensors of all columns stand.

    Raises
    ------
    TraceError
        If it is another file, or a line is no drop.
    """
    said = dict(request.said)
    declared = said.pop(OFFSETS, None)
    request = replace(request, said=said)
    name = os.path.basename(file)
    lines = list(lines_of(file))
    if len(lines) < 4 or not lines[0][1].startswith("R80"):
        hint = "is it a Dynatest .fwd?"
        raise TraceError(refusal(file, "a text that begins with R80", quote(lines[0][1]), hint))
    where = f"{file}, line 3"
    said_radius, offsets = _head(lines[2][1], where)
    remarks = []
    radius = plate_radius(request, said_radius)
    if radius == 0:
        radius = USUAL_RADIUS
        assumed: dict[str, Value] = {"file": name, "line": 3, "plate_radius_m": radius}
        remarks.append(Notice("plate-radius-assumed", assumed))
    if radius is None or not PLATES[0] <= radius <= PLATES[1]:
        raise TraceError(refusal(where, "a plate radius of 20 to 1000 mm", f"{radius}"))
    stations = _stations(file, lines, radius)
    columns = {len(moved) for one in stations for _, moved, _ in one.drops}
    if len(columns) > 1:
        raise TraceError(refusal(file, "one number of sensors", f"{sorted(columns)}"))
    count = columns.pop() if columns else len(offsets)
    if declared is not None:
        offsets = _declared(declared.value, count, declared.where)
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
    """Radius of the plate and positions of the sensors, m."""
    fields = [line[start : start + 4] for start in range(0, 32, 4)]
    numbers = [number_of(one, "eight whole numbers of four letters, mm", where) for one in fields]
    return numbers[0] / 1e3, [number / 1e3 for number in numbers[1:]]


def _stations(file: str, lines: Sequence[tuple[int, str]], radius: float) -> list[Station]:
    found: list[Station] = []
    place: dict[str, float] = {}
    for number, line in lines[4:]:
        if match := _POSITION.fullmatch(line):
            place = position_of(match[1], match[2])
        elif match := _STATION.match(line):
            noted = {
                "chainage_m": finite(match[1]),
                "air_temperature_c": temperature_of(match[2]),
                "surface_temperature_c": temperature_of(match[3]),
            }
            found.append(Station(f"chainage {float(match[1]):g}", place, noted))
            place = {}
        elif found and _ROW.fullmatch(line):
            pressure, *moved = [
                number_of(one, "a number", f"{file}, line {number}") for one in _VALUE.findall(line)
            ]
            load = force_of(1e3 * pressure, radius)
            found[-1].drops.append((load, tuple(1e-6 * one for one in moved), number))
        elif found and line[:1].isdigit() and "." in line and found[-1].drops:
            expected = "a drop: pressure and deflections with two decimals"
            raise TraceError(refusal(f"{file}, line {number}", expected, quote(line.strip()[:60])))
    return found


def _placed(
    stations: Sequence[Station], offsets: list[float], count: int, where: str
) -> list[float]:
    """Positions of all columns, NaN where the head has none: the largest deflection is at 0.

    Raises
    ------
    TraceError
        If no sensor of the head is in the centre, or the largest is not in one column.
    """
    rows = [[one or 0.0 for one in moved] for station in stations for _, moved, _ in station.drops]
    peaks = [row.index(max(row)) for row in rows]
    centre = max(set(peaks), key=peaks.count)
    first = centre - offsets.index(0.0) if 0.0 in offsets else -1
    if first < 0 or first + len(offsets) > count or peaks.count(centre) < 0.9 * len(peaks):
        expected = f"{len(offsets)} deflections, as the head has positions"
        raise TraceError(refusal(where, expected, f"{count}", f"declare {OFFSETS}"))
    found = [float("nan")] * count
    found[first : first + len(offsets)] = offsets
    return found


def _declared(value: object, count: int, where: str) -> list[float]:
    numbers = value if isinstance(value, list) else []
    plain = [float(one) for one in numbers if isinstance(one, int | float)]
    if len(plain) != count or len(numbers) != count:
        expected = f"{OFFSETS}: {count} distances in m, one a column, nan to leave one out"
        raise TraceError(refusal(where, expected, quote(value)))
    return plain
