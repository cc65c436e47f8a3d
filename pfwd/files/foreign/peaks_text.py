"""What readers of texts with peaks share: bounded lines, numbers with their place, remarks."""

import datetime
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan, pi
from typing import Any

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    distinct,
    finite,
    one_a_place,
    peaks_drop,
    point_of,
)
from pfwd.files.header import RADIUS
from pfwd.files.traces import MAX_FILE_DROPS, MAX_LINE_CHARACTERS, TracePoint
from pfwd_device import Drop

LARGEST_TEXT = 32_000_000
"""Bytes of a file with peaks; a line is a drop, and 10,000 drops have 1 MB."""

PEAKS_REMARK = Notice("peaks-imported")

PLATES = (0.02, 1.0)
"""m; the smallest plate is that of a light deflectometer for trenches, 0.05 m in radius, and load
plates end at 0.4 m. What is outside was written in another unit."""


@dataclass(frozen=True, slots=True)
class Station:
    """A test point as it stands in a file."""

    name: str
    known: dict[str, Any] = field(default_factory=dict)
    """Header keys."""
    noted: dict[str, Any] = field(default_factory=dict)
    """What else is kept."""
    drops: list[tuple[float, tuple[float | None, ...], int]] = field(default_factory=list)
    """Load (N), deflections (m, one a sensor; None: not measured), and line."""


def lines_of(file: str) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers from 1.

    Raises
    ------
    TraceError
        If it is too large, or a line has no end.
    """
    if os.path.getsize(file) > LARGEST_TEXT:
        raise TraceError(refusal(file, f"at most {LARGEST_TEXT // 10**6} MB of peaks", "more"))
    with open(file, "rb") as stream:
        data = stream.read(LARGEST_TEXT + 1)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    # What ended a text under DOS.
    text = text.rstrip("\x1a\0\r\n")
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > MAX_LINE_CHARACTERS:
            raise TraceError(refusal(f"{file}, line {number}", "a line of text", "one without end"))
        yield number, line.rstrip("\r")


def number_of(text: str, what: str, where: str) -> float:
    """A finite number.

    Raises
    ------
    TraceError
    """
    found = None if "_" in text else finite(text.strip())
    if found is None:
        raise TraceError(refusal(where, what, quote(text.strip())))
    return found


def plate_radius(request: Request, said: float | None) -> float | None:
    """Radius of the plate, m: as declared, else as the file says."""
    declared = request.said.get(RADIUS)
    value = None if declared is None else finite(declared.value)
    return said if value is None else value


def force_of(pressure: float, radius: float) -> float:
    """Load in N of a mean pressure in Pa under the plate."""
    return pressure * pi * radius**2


def local_moment(*parts: float | None) -> str | None:
    """Date and time without a zone, ISO 8601; None when they are none."""
    try:
        whole = [int(part) for part in parts if part is not None]
        return datetime.datetime(*whole).isoformat() if len(whole) == len(parts) else None  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None


def points_of_stations(
    file: str,
    stations: Sequence[Station],
    offsets: Sequence[float],
    common: Mapping[str, Any],
    request: Request,
    remarks: Sequence[Notice] = (),
) -> list[TracePoint]:
    """Test points with drops of kind peaks.

    Parameters
    ----------
    file : str
    stations : sequence of Station
        Without drops: left out.
    offsets : sequence of float, m
        NaN: the sensor is left out.
    common : mapping
        Header keys of all stations.
    request : Request
    remarks : sequence of Notice

    Raises
    ------
    TraceError
        If there is no drop, or the plate is not known.
    """
    stations = [station for station in stations if station.drops]
    if not stations:
        raise TraceError(refusal(file, "drops with a load and deflections", "none"))
    if sum(len(station.drops) for station in stations) > MAX_FILE_DROPS:
        raise TraceError(refusal(file, f"at most {MAX_FILE_DROPS} drops", "more"))
    placed = [index for index, offset in enumerate(offsets) if not isnan(offset)]
    taken, left_out = one_a_place([offsets[index] for index in placed])
    used = [placed[index] for index in taken]
    found = []
    names = distinct([station.name for station in stations])
    for name, station in zip(names, stations, strict=True):
        drops: list[Drop] = []
        for number, (load, moved, line) in zip(itertools.count(1), station.drops, strict=False):
            pairs = [(offsets[index], moved[index]) for index in used]
            drops.append(peaks_drop(number, load, pairs, f"{file}, line {line}"))
        known = {**common, **station.known, "point": name}
        said = (PEAKS_REMARK, *remarks, *left_out)
        found.append(point_of(file, known, drops, request, noted=station.noted, remarks=said))
    return found
