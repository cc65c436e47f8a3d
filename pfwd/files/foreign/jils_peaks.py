"""Reader of JILS ``.DAT``: peaks of a trailer FWD as text, often in the folder of a ``.THY``.

The file begins with lines of ``Name: value`` as a ``.THY`` does. Each drop is one line: station,
lane, milepost, a number of unknown meaning (1), load in kip, deflections in mil, positive downward,
and the surface temperature in degrees Fahrenheit. After the drops of a station follow ``Drop
Sequence Completed Time`` with the air temperature, ``GPS`` with a position, and ``Note``. The
layout was inferred from one file.

The reader of ``.THY`` (:mod:`.jils`) uses the functions for the first lines, the names of
stations and the sensor offsets as well.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import (
    Request,
    Values,
    distinct_sensors,
    finite,
    position_of,
    short_text,
    temperature_of,
)
from pfwd.files.foreign.peaks_text import (
    OFFSETS_KEY,
    StationDrops,
    declared_offsets,
    lines_of,
    number_of,
    points_of_stations,
)
from pfwd.files.header import MAX_REMARK_CHARACTERS
from pfwd.files.traces import TracePoint
from pfwd_plugins.quantities import Measurand

MIN_DROP_CELLS = 7
"""Smallest number of fields in the line of a drop: four numbers, load, one deflection, temperature.
"""

HEADING_LINE = re.compile(r"\s*([A-Z][\w/-]*):\s*(.*?)\s*$")
_DAT_DROP = re.compile(r"\s*[\d+.-]\S{0,15}\s+\S{1,16}\s+-?\d{1,6}\.\d{1,6}\s")
_GPS = re.compile(
    r"GPS:.*?Latitude\s*=\s*(\d{1,2})\s*deg\s*(\d{1,2}(?:\.\d{1,9})?)\s*([NS])"
    r".*?Longitude\s*=\s*(\d{1,3})\s*deg\s*(\d{1,2}(?:\.\d{1,9})?)\s*([EW])"
)
_DILUTION = re.compile(r"[PH]DOP\s*=\s*(\d{1,4}(?:\.\d{1,4})?)")
_AIR = re.compile(r"Air Temp \(F\):\s*(-?\d{1,4}(?:\.\d{1,4})?)")
_TEMPERATURE = re.compile(r"\s*(-?\d{1,4}(?:\.\d{1,4})?)")
_DAT_TIME = re.compile(r"Completed Time:\s*(\d{1,2}:\d{2})")


Key = tuple[str, str, str]
"""Station, lane and milepost."""


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a JILS ``.DAT`` file, one for each station, lane and milepost.

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
        If the file has another format, a line of a drop is damaged, or the plate radius is not
        declared.
    """
    headings, stations = parse(file)
    if not stations:
        hint = "is it a JILS .DAT?"
        raise TraceError(refusal(file, "lines with load and deflections", "none", hint))
    request, declared = request.without(OFFSETS_KEY)
    count = len(next(iter(stations.values())).drops[0][1])
    offsets, remarks = sensor_offsets(file, declared and declared.value, count, headings)
    common, head_noted = head_facts(headings, "JILS peaks (.DAT)")
    complete = [
        replace(station, noted=head_noted | station.noted | {"milepost": key[2]})
        for key, station in stations.items()
    ]
    return points_of_stations(file, complete, offsets, common, request, remarks)


def parse(file: str) -> tuple[dict[str, str], dict[Key, StationDrops]]:
    """Return the first lines (value by name) and the stations of a file.

    Raises
    ------
    TraceError
        If a line of a drop is damaged, or drops have different numbers of deflections.
    """
    headings: dict[str, str] = {}
    stations: dict[Key, StationDrops] = {}
    last: StationDrops | None = None
    for number, line in lines_of(file):
        if _DAT_DROP.match(line):
            last = _add_drop(stations, line.split(), f"{file}, line {number}", number)
        elif last is None:
            if match := HEADING_LINE.match(line):
                headings.setdefault(match[1], match[2])
        else:
            _add_facts(last, line)
    counts = {
        len(deflections) for station in stations.values() for _, deflections, _ in station.drops
    }
    if len(counts) > 1:
        raise TraceError(refusal(file, "one number of sensors", f"{sorted(counts)}"))
    return headings, stations


def _add_drop(
    stations: dict[Key, StationDrops], cells: list[str], where: str, line: int
) -> StationDrops:
    if len(cells) < MIN_DROP_CELLS:
        raise TraceError(refusal(where, "a load and deflections", quote(" ".join(cells))))
    key = (cells[0], cells[1], cells[2])
    load, *deflections = [number_of(cell, "a load and deflections", where) for cell in cells[4:-1]]
    station = stations.setdefault(key, StationDrops(station_name(key)))
    kip, mil = Measurand.LOAD.units["kip"], Measurand.DISPLACEMENT.units["mil"]
    station.drops.append((kip * load, tuple(mil * deflection for deflection in deflections), line))
    surface = finite(cells[-1])
    if surface is not None:
        station.noted.setdefault("surface_temperature_c", _celsius(surface))
    return station


def _add_facts(station: StationDrops, line: str) -> None:
    if match := _GPS.search(line):
        north = int(match[1]) + float(match[2]) / 60
        east = int(match[4]) + float(match[5]) / 60
        sides = (-north if match[3] == "S" else north, -east if match[6] == "W" else east)
        station.declared.update(position_of(*sides))
        dilution = _DILUTION.search(line)
        station.noted["position_dop"] = float(dilution[1]) or None if dilution else None
    elif match := _AIR.search(line):
        station.noted["air_temperature_c"] = _celsius(float(match[1]))
        time = _DAT_TIME.search(line)
        station.noted["completed_local"] = time[1] if time else None
    elif line.startswith("Note:"):
        station.noted["note"] = short_text(line.removeprefix("Note:"), MAX_REMARK_CHARACTERS)


def _celsius(fahrenheit: float) -> float | None:
    return temperature_of(round((fahrenheit - 32.0) / 1.8, 2))


LOAD_ROUNDING_N = 0.006 * Measurand.LOAD.units["kip"]
"""Largest difference of a load that rounding to two decimals in kip explains."""

DEFLECTION_ROUNDING_M = 0.011 * Measurand.DISPLACEMENT.units["mil"]
"""Largest difference of a deflection that rounding to two decimals in mil explains."""


def compare_peaks(
    traced: Sequence[tuple[float, Values]], station: StationDrops, name: str
) -> list[Notice]:
    """Compare the peaks of a ``.DAT`` with those of the traces.

    Parameters
    ----------
    traced : sequence of load (N) and deflections ((sensors,), m), one for each drop
    station : StationDrops
    name : str
        Name of the ``.DAT``.

    Returns
    -------
    list of Notice
        Remarks on differences that rounding does not explain; for each sensor on the largest one.
    """
    if len(traced) != len(station.drops):
        counts = {"file_drops": len(station.drops), "drops": len(traced)}
        return [Notice("peaks-file-drops-differ", {"file": name, **counts})]
    loads, deflections, lines = zip(*station.drops, strict=True)
    remarks = [
        Notice(
            "peaks-file-load-differs",
            {"file": name, "line": line, "file_load_n": file_load, "load_n": load},
        )
        for (load, _), file_load, line in zip(traced, loads, lines, strict=True)
        if abs(load - file_load) > LOAD_ROUNDING_N
    ]
    ours, theirs = np.array([peaks for _, peaks in traced]), np.array(deflections, np.float64)
    sensors = min(ours.shape[1], theirs.shape[1])
    off = np.abs(ours[:, :sensors] - theirs[:, :sensors])
    for sensor, row in enumerate(off.argmax(axis=0).tolist()):
        difference = float(off[row, sensor])
        if difference > DEFLECTION_ROUNDING_M:
            values = {"line": lines[row], "sensor": sensor + 1, "difference_m": difference}
            remarks.append(Notice("peaks-file-deflection-differs", {"file": name, **values}))
    return remarks


def sensor_offsets(
    file: str, declared: object, count: int, headings: Mapping[str, str]
) -> tuple[list[float], list[Notice]]:
    """Return the offset of each sensor, m, and remarks.

    Parameters
    ----------
    file : str
        Path of the file, for messages.
    declared : object
        Value of ``sensor_offsets_m``; None: not declared, the first sensor is in the centre and the
        others are omitted.
    count : int
        Number of sensors.
    headings : mapping of str to str
        First lines of the file.

    Returns
    -------
    offsets : list of float, m
        NaN: the sensor is omitted.
    remarks : list of Notice
    """
    if declared is None:
        sensors = short_text(headings.get("Sensors")) or "nothing"
        remark = Notice("positions-not-declared", {"sensors": sensors})
        return [0.0] + [nan] * (count - 1), [remark] if count > 1 else []
    offsets = declared_offsets(declared, count, file)
    used, remarks = distinct_sensors(offsets)
    return [offset if index in used else nan for index, offset in enumerate(offsets)], remarks


def station_name(station: Key) -> str:
    """Return the name of a test point, such as "station 12 lane 1".

    Parameters
    ----------
    station : tuple of str
        Station, lane and milepost.
    """
    place = f"station {station[0] or '?'}"
    return f"{place} lane {station[1]}" if station[1] else place


def head_facts(headings: Mapping[str, str], source: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what the first lines of a file state about all its points.

    Returns
    -------
    common : dict
        Values of header keys.
    noted : dict
        Further data to store with each point.
    """
    # The first temperature is that of the air, a second one that of the surface.
    air = _TEMPERATURE.match(headings.get("Temp", ""))
    common = {
        "site": short_text(headings.get("Location")),
        "operator": short_text(headings.get("Operator")),
        "source": source,
        "temperature_c": None if air is None else _celsius(float(air[1])),
    }
    noted = {
        # The file has no time zone, and the order of day and month is uncertain.
        "date_time": short_text(headings.get("Date-Time")),
        "sensors": short_text(headings.get("Sensors"), MAX_REMARK_CHARACTERS),
        "weight_spring": short_text(headings.get("Weight/spring"), MAX_REMARK_CHARACTERS),
        "comment": short_text(headings.get("Comments"), MAX_REMARK_CHARACTERS),
    }
    return common, noted
