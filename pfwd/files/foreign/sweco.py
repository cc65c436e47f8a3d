"""Reader of Sweco's ``.fwd`` (ROAD SYSTEM): peaks of an FWD as text, with tabs between fields.

``$1`` begins the first lines (``Load plate radius [mm]``, ``Radial offset [cm]``, date), ``$2`` a
point (``Chainage [m]``, position in degrees, minutes and seconds), ``$3`` its drops: a line with
the column names (``Drop``, ``D(1)`` ..., ``kPa``, ``kN``, ``Air``, ``Sur.``, ``Man.``, ``Pulse
time``) and one line for each drop, deflections in um. The layout was inferred from files that a
viewer writes. Traces that may follow a drop are not read.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
    StationDrops,
    lines_of,
    local_moment,
    number_of,
    plate_radius,
    points_of_stations,
)
from pfwd.files.traces import TracePoint

_FIELD = re.compile(r"([^.:\[\]]+(?:\[[^\]]*\])?)[.:]*\t(.*)")
_DEGREES = re.compile(r"(\d{1,3})\D{1,2}(\d{1,2})'(\d{1,2}(?:\.\d{1,9})?)\"?\s*([NSEW])")
_COLUMN = re.compile(r"D\((\d{1,3})\)")
_SWECO_DATE = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})")
_SWECO_TIME = re.compile(r"Time:\s*(\d{1,2}):(\d{2})")
_SWECO_TEMPERATURE_KEYS = {
    "Air": "air_temperature_c",
    "Sur.": "surface_temperature_c",
    "Man.": "manual_temperature_c",
}


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a Sweco ``.fwd`` file.

    Parameters
    ----------
    file : str
        Path of the file.
    request : Request
        Options of the user.

    Raises
    ------
    TraceError
        If the file has another format, or a line of a drop is damaged.
    """
    common: dict[str, Any] = {"source": "Sweco .fwd"}
    stations: list[StationDrops] = []
    offsets: list[float] = []
    date: Sequence[int] = ()
    names: list[str] = []
    histories = 0
    for number, line in lines_of(file):
        where = f"{file}, line {number}"
        text = line.strip()
        cells = [cell.strip() for cell in line.split("\t")]
        if text == "$2":
            stations.append(StationDrops("?"))
            names = []
        elif text.startswith("Position of Drop") and stations:
            stations[-1].declared.update(_position(text))
        elif text.startswith("Sequence:") and stations and (match := _SWECO_TIME.search(text)):
            moment = local_moment(*reversed(date), int(match[1]), int(match[2])) if date else None
            stations[-1].noted["time_local"] = moment
        elif cells[0] == "Drop" and len(cells) > 2:
            names = cells
        elif text.startswith(("LoadCell", "Sensor")):
            histories += 1
        elif names and stations and finite(cells[0]) is not None:
            _drop(stations[-1], cells, names, len(offsets), number, where)
        elif match := _FIELD.match(line):
            key, value = match[1].strip(), match[2].strip()
            if key == "Load plate radius [mm]":
                radius = number_of(value, "the radius of the plate, mm", where) / 1e3
                common["plate_radius_m"] = plate_radius(request, radius)
            elif key == "Radial offset [cm]":
                offsets = [
                    number_of(cell, "an offset, cm", where) / 100 for cell in value.split("\t")
                ]
            elif key == "Filename":
                common["site"] = short_text(value)
            elif key.startswith("Date") and (match := _SWECO_DATE.search(value)):
                date = [int(part) for part in match.groups()]
            elif key == "Chainage [m]" and stations:
                stations[-1] = replace(stations[-1], name=f"chainage {value}")
                stations[-1].noted["chainage_m"] = finite(value)
            elif key == "Remarks" and stations:
                stations[-1].noted["comment"] = short_text(value)
    remarks = []
    if histories:
        values: dict[str, Value] = {"file": os.path.basename(file), "lines": histories}
        remarks.append(Notice("time-histories-not-read", values))
    if not offsets:
        expected = "a line Radial offset [cm]"
        raise TraceError(refusal(file, expected, "none", "is it a Sweco .fwd?"))
    return points_of_stations(file, stations, offsets, common, request, remarks)


def _drop(
    station: StationDrops, cells: list[str], names: list[str], sensors: int, line: int, where: str
) -> None:
    deflection_columns = [index for index, name in enumerate(names) if _COLUMN.fullmatch(name)]
    if len(deflection_columns) != sensors or "kN" not in names or len(cells) < len(names):
        expected = f"a drop with {sensors} deflections and kN"
        raise TraceError(refusal(where, expected, quote("\t".join(cells)[:80])))
    load = 1e3 * number_of(cells[names.index("kN")], "the load, kN", where)
    values = tuple(
        1e-6 * number_of(cells[index], "a deflection, um", where) for index in deflection_columns
    )
    station.drops.append((load, values, line))
    for name, key in _SWECO_TEMPERATURE_KEYS.items():
        if name in names:
            station.noted.setdefault(key, temperature_of(cells[names.index(name)]))
    # The pulse time is in the last column, which has no name of its own.
    duration = finite(cells[-1])
    if duration is not None and "Pulse time" in names:
        station.noted.setdefault("pulse_durations_s", []).append(duration / 1e3)


def _position(text: str) -> dict[str, float]:
    degrees_by_axis = {}
    for degrees, minutes, seconds, side in _DEGREES.findall(text):
        value = int(degrees) + int(minutes) / 60 + float(seconds) / 3600
        degrees_by_axis[side in "NS"] = -value if side in "SW" else value
    return position_of(degrees_by_axis.get(True), degrees_by_axis.get(False))
