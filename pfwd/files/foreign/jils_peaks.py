"""JILS ``.DAT``: peaks of a trailer FWD as text, beside the time histories of its ``.THY``.

Lines of ``Name: value`` as in a ``.THY``, then one line a drop: station, lane, milepost, a number
whose meaning is not known (1), load in kip, deflections in mil downward, surface temperature in
degrees Fahrenheit. Behind the drops of a station stand ``Drop Sequence Completed Time`` with the
air temperature, ``GPS`` with a position, and ``Note``. Learned from one file.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from inversion.notices import Notice, Value
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    finite,
    position_of,
    short_text,
    temperature_of,
)
from pfwd.files.foreign.jils_head import OFFSETS, head_facts, sensor_offsets, station_name
from pfwd.files.foreign.peaks_text import (
    Station,
    lines_of,
    number_of,
    points_of_stations,
)
from pfwd.files.foreign.units import DISPLACEMENT, FORCE, celsius
from pfwd.files.header import LONGEST_REMARK
from pfwd.files.traces import TracePoint

FEWEST_CELLS = 7
"""Of the line of a drop: four numbers, load, a deflection and a temperature."""

_HEADING = re.compile(r"\s*([A-Z][\w/-]*):\s*(.*?)\s*$")
_DROP = re.compile(r"\s*[\d+.-]\S{0,15}\s+\S{1,16}\s+-?\d{1,6}\.\d{1,6}\s")
_GPS = re.compile(
    r"GPS:.*?Latitude\s*=\s*(\d{1,2})\s*deg\s*(\d{1,2}(?:\.\d{1,9})?)\s*([NS])"
    r".*?Longitude\s*=\s*(\d{1,3})\s*deg\s*(\d{1,2}(?:\.\d{1,9})?)\s*([EW])"
)
_DILUTION = re.compile(r"[PH]DOP\s*=\s*(\d{1,4}(?:\.\d{1,4})?)")
_AIR = re.compile(r"Air Temp \(F\):\s*(-?\d{1,4}(?:\.\d{1,4})?)")
_TIME = re.compile(r"Completed Time:\s*(\d{1,2}:\d{2})")


@dataclass(frozen=True, slots=True)
class PeaksStation:
    """A station with what the file says of it."""

    key: tuple[str, str, str]
    """Station, lane, milepost, as a ``.THY`` writes them too."""
    place: dict[str, float] = field(default_factory=dict)
    noted: dict[str, object] = field(default_factory=dict)
    drops: list[tuple[float, tuple[float, ...], int]] = field(default_factory=list)
    """Load (N), deflections (m), line."""


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a file, one for each station, lane and milepost.

    Parameters
    ----------
    file : str
    request : Request
        As for a time history.

    Raises
    ------
    TraceError
        If it is another file, a line is no drop, or the plate is not declared.
    """
    headings, stations = parse(file)
    if not stations:
        hint = "is it a JILS .DAT?"
        raise TraceError(refusal(file, "lines with load and deflections", "none", hint))
    said = dict(request.said)
    declared = said.pop(OFFSETS, None)
    count = len(stations[0].drops[0][1])
    offsets, remarks = sensor_offsets(file, declared and declared.value, count, headings)
    common, about = head_facts(headings, "JILS peaks (.DAT)")
    found = [
        Station(
            station_name(one.key),
            dict(one.place),
            about | one.noted | {"milepost": one.key[2]},
            [(load, tuple(moved), line) for load, moved, line in one.drops],
        )
        for one in stations
    ]
    return points_of_stations(file, found, offsets, common, replace(request, said=said), remarks)


def parse(file: str) -> tuple[dict[str, str], list[PeaksStation]]:
    """What a file says: its headings and stations.

    Raises
    ------
    TraceError
        If a line is no drop.
    """
    headings: dict[str, str] = {}
    found: dict[tuple[str, str, str], PeaksStation] = {}
    last: PeaksStation | None = None
    for number, line in lines_of(file):
        if _DROP.match(line):
            last = _take_drop(found, line.split(), f"{file}, line {number}", number)
        elif last is None:
            if match := _HEADING.match(line):
                headings.setdefault(match[1], match[2])
        else:
            _take_facts(last, line)
    stations = list(found.values())
    counts = {len(moved) for one in stations for _, moved, _ in one.drops}
    if len(counts) > 1:
        raise TraceError(refusal(file, "one number of sensors", f"{sorted(counts)}"))
    return headings, stations


def _take_drop(
    found: dict[tuple[str, str, str], PeaksStation], cells: list[str], where: str, line: int
) -> PeaksStation:
    if len(cells) < FEWEST_CELLS:
        raise TraceError(refusal(where, "a load and deflections", quote(" ".join(cells))))
    key = (cells[0], cells[1], cells[2])
    load, *moved = [number_of(cell, "a load and deflections", where) for cell in cells[4:-1]]
    station = found.setdefault(key, PeaksStation(key))
    mil = DISPLACEMENT["mil"]
    station.drops.append((load * FORCE["kip"], tuple(mil * one for one in moved), line))
    surface = finite(cells[-1])
    if surface is not None:
        station.noted.setdefault("surface_temperature_c", _celsius(surface))
    return station


def _take_facts(station: PeaksStation, line: str) -> None:
    if match := _GPS.search(line):
        north = int(match[1]) + float(match[2]) / 60
        east = int(match[4]) + float(match[5]) / 60
        sides = (-north if match[3] == "S" else north, -east if match[6] == "W" else east)
        station.place.update(position_of(*sides))
        dilution = _DILUTION.search(line)
        station.noted["position_dop"] = float(dilution[1]) or None if dilution else None
    elif match := _AIR.search(line):
        station.noted["air_temperature_c"] = _celsius(float(match[1]))
        time = _TIME.search(line)
        station.noted["completed_local"] = time[1] if time else None
    elif line.startswith("Note:"):
        station.noted["note"] = short_text(line.removeprefix("Note:"), LONGEST_REMARK)


def _celsius(fahrenheit: float) -> float | None:
    return temperature_of(round(celsius(fahrenheit), 2))


def beside(file: str) -> str | None:
    """The ``.DAT`` of a ``.THY`` in the same folder; None when there is none."""
    path = Path(file)
    for suffix in (".DAT", ".dat", ".Dat"):
        other = path.with_suffix(suffix)
        if other.is_file():
            return os.fspath(other)
    return None


LOAD_ROUNDING = 0.006 * FORCE["kip"]
"""N; a load of the .DAT has two decimals in kip."""

PEAK_ROUNDING = 0.011 * DISPLACEMENT["mil"]
"""m; a deflection of the .DAT has two decimals in mil."""


def compared(
    traced: Sequence[tuple[float, Sequence[float]]], station: PeaksStation, name: str
) -> list[Notice]:
    """What the peaks of a .DAT differ in from those of the traces.

    Parameters
    ----------
    traced : sequence of load (N) and deflections (m, NaN: not compared), one a drop
    station : PeaksStation
    name : str
        Of the .DAT.

    Returns
    -------
    list of Notice
    """
    if len(traced) != len(station.drops):
        counts: dict[str, Value] = {
            "file": name,
            "file_drops": len(station.drops),
            "drops": len(traced),
        }
        return [Notice("peaks-file-drops-differ", counts)]
    found = []
    worst: dict[int, tuple[float, int]] = {}
    for (load, moved), (said_load, said, line) in zip(traced, station.drops, strict=True):
        if abs(load - said_load) > LOAD_ROUNDING:
            values: dict[str, Value] = {
                "file": name,
                "line": line,
                "file_load_n": said_load,
                "load_n": load,
            }
            found.append(Notice("peaks-file-load-differs", values))
        for index, (ours, theirs) in enumerate(zip(moved, said, strict=False), start=1):
            off = abs(ours - theirs)
            if not np.isnan(off) and off > PEAK_ROUNDING and off > worst.get(index, (0.0, 0))[0]:
                worst[index] = (off, line)
    found += [
        Notice(
            "peaks-file-deflection-differs",
            {"file": name, "line": line, "sensor": index, "difference_m": off},
        )
        for index, (off, line) in sorted(worst.items())
    ]
    return found
