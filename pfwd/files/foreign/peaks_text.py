"""Shared parts of the readers of texts with peaks: lines, numbers, plates, sensors, points."""

import datetime
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isinf, pi
from typing import Any

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    decoded,
    distinct_names,
    distinct_sensors,
    finite,
    peaks_drop,
    point_of,
)
from pfwd.files.header import RADIUS_KEY
from pfwd.files.traces import MAX_FILE_DROPS, MAX_TEXT_LINE_CHARACTERS, TracePoint
from pfwd_device import Drop

MAX_TEXT_BYTES = 32_000_000
"""Largest file with peaks; a line is a drop, and 10,000 drops take 1 MB."""

PEAKS_REMARK = Notice("peaks-imported")

PLATE_RADII_M = (0.02, 1.0)
"""Range of plate radii: real ones are 0.05 m, for trenches, to 0.4 m. A value outside the range is
in another unit."""

OFFSETS_KEY = "sensor_offsets_m"
"""Header key with the offsets of the sensors, m, in the order of the columns; nan omits a sensor.
"""


@dataclass(frozen=True, slots=True)
class StationDrops:
    """Test point of a file with peaks, before its checks."""

    name: str
    declared: dict[str, Any] = field(default_factory=dict)
    """Values of header keys."""
    noted: dict[str, Any] = field(default_factory=dict)
    """Further data to store with the point."""
    drops: list[tuple[float, tuple[float | None, ...], int]] = field(default_factory=list)
    """Peak load (N), peak deflections (m, in the order of the sensors; None or no entry: not
    measured) and line of each drop."""


def lines_of(file: str) -> Iterator[tuple[int, str]]:
    """Yield number (from 1) and text of each line of a file.

    Raises
    ------
    TraceError
        If the file or a line is too long.
    """
    if os.path.getsize(file) > MAX_TEXT_BYTES:
        raise TraceError(refusal(file, f"at most {MAX_TEXT_BYTES // 10**6} MB of peaks", "more"))
    with open(file, "rb") as stream:
        data = stream.read(MAX_TEXT_BYTES + 1)
    # DOS programs end a text with the control character 1A.
    text = decoded(data)[0].rstrip("\x1a\0\r\n")
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > MAX_TEXT_LINE_CHARACTERS:
            actual = f"one of over {MAX_TEXT_LINE_CHARACTERS} characters"
            raise TraceError(refusal(f"{file}, line {number}", "a line of text", actual))
        yield number, line.rstrip("\r")


def number_of(text: str, expected: str, where: str) -> float:
    """Convert a text to a finite number.

    Parameters
    ----------
    text : str
    expected, where : str
        Expected content, and file and line, for the message.

    Raises
    ------
    TraceError
        If the text is no number.
    """
    number = None if "_" in text else finite(text.strip())
    if number is None:
        raise TraceError(refusal(where, expected, quote(text.strip())))
    return number


def plate_radius(request: Request, recorded: float | None) -> float | None:
    """Return the plate radius, m: the declared one, else `recorded`, which the file states."""
    declared = request.declarations.get(RADIUS_KEY)
    value = None if declared is None else finite(declared.value)
    return recorded if value is None else value


def require_plate_radius(radius: float | None, where: str) -> float:
    """Return a plate radius, m, if it is in the range `PLATE_RADII_M`.

    Raises
    ------
    TraceError
        If it is outside the range, or None.
    """
    if radius is None or not PLATE_RADII_M[0] <= radius <= PLATE_RADII_M[1]:
        actual = "none" if radius is None else f"{1e3 * radius:g} mm"
        hint = f"declare {RADIUS_KEY} with --header"
        raise TraceError(refusal(where, "a plate radius of 20 to 1000 mm", actual, hint))
    return radius


def declared_offsets(value: object, count: int, where: str) -> list[float]:
    """Return the declared sensor offsets, m; NaN: the sensor is omitted.

    Parameters
    ----------
    value : object
        Value of the header key `OFFSETS_KEY`.
    count : int
        Number of sensors in the file.
    where : str
        Place of the declaration, for messages.

    Raises
    ------
    TraceError
        If the value is not a list of `count` numbers.
    """
    offsets = [
        float(each)
        for each in (value if isinstance(value, list) else [])
        if isinstance(each, int | float) and not isinstance(each, bool) and not isinf(each)
    ]
    if not isinstance(value, list) or not len(offsets) == len(value) == count:
        expected = f"{OFFSETS_KEY}: {count} distances in m, one a column, nan to leave one out"
        raise TraceError(refusal(where, expected, quote(value)))
    return offsets


def force_of(pressure: float, radius: float) -> float:
    """Return the load, N, that causes a mean pressure, Pa, under a plate of the given radius, m."""
    return pressure * pi * radius**2


def local_moment(*parts: float | None) -> str | None:
    """Return a date and time without time zone in ISO 8601; None: the numbers are no date.

    Parameters
    ----------
    *parts : float or None
        Year, month, day, and optionally hour, minute, second.
    """
    try:
        numbers = [int(part) for part in parts if part is not None]
        return datetime.datetime(*numbers).isoformat() if len(numbers) == len(parts) else None  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None


def points_of_stations(
    file: str,
    stations: Sequence[StationDrops],
    offsets: Sequence[float],
    common: Mapping[str, Any],
    request: Request,
    remarks: Sequence[Notice] = (),
) -> list[TracePoint]:
    """Return test points whose drops have peaks and no traces.

    Parameters
    ----------
    file : str
        Path of the file.
    stations : sequence of Station
        Stations without drops are omitted.
    offsets : sequence of float, m
        NaN: the sensor is omitted.
    common : mapping of header key to value
        Values that all stations share.
    request : Request
        Options of the user.
    remarks : sequence of Notice
        Remarks on how the file was read.

    Raises
    ------
    TraceError
        If there is no drop, or the plate radius is missing.
    """
    stations = [station for station in stations if station.drops]
    if not stations:
        raise TraceError(refusal(file, "drops with a load and deflections", "none"))
    if sum(len(station.drops) for station in stations) > MAX_FILE_DROPS:
        raise TraceError(refusal(file, f"at most {MAX_FILE_DROPS} drops", "more"))
    used, sensor_remarks = distinct_sensors(offsets)
    points = []
    names = distinct_names([station.name for station in stations])
    for name, station in zip(names, stations, strict=True):
        drops: list[Drop] = []
        for number, (load, deflections, line) in enumerate(station.drops, start=1):
            pairs = [(offsets[i], deflections[i]) for i in used if i < len(deflections)]
            drops.append(peaks_drop(number, load, pairs, f"{file}, line {line}"))
        declared = {**common, **station.declared, "point": name}
        all_remarks = (PEAKS_REMARK, *remarks, *sensor_remarks)
        points.append(
            point_of(file, declared, drops, request, noted=station.noted, remarks=all_remarks)
        )
    return points
