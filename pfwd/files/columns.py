"""The row of column names of a trace file."""

import csv
import math
import re
from dataclasses import dataclass

from pfwd.errors import TraceError, quote, refusal
from pfwd_device import Quantity

DROP, TIME, LOAD = "drop", "time_s", "load_N"

_PREFIXES: dict[str, Quantity] = {"velocity_m_s": "velocity", "displacement_m": "displacement"}
_SENSOR = re.compile(rf"({'|'.join(_PREFIXES)})@([0-9.eE+-]+)")
_KNOWN = f"{DROP}, {TIME}, {LOAD}, velocity_m_s@R or displacement_m@R with R in metres"


@dataclass(frozen=True, slots=True)
class Sensor:
    """A column with the record of a sensor."""

    index: int
    """Position of the column, from 0."""
    quantity: Quantity
    """What it holds."""
    offset: float
    """Distance from the plate centre, m; negative: the other side of the plate."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Which column holds what."""

    names: tuple[str, ...]
    """All names, in their order."""
    drop: int | None
    """Position of the drop numbers; None: the file is drop 1."""
    time: int
    """Position of the time."""
    load: int
    """Position of the load."""
    sensors: tuple[Sensor, ...]
    """The sensors, in their order."""


def parse_columns(row: str, where: str) -> Columns:
    """What the columns of a trace file hold.

    Parameters
    ----------
    row : str
        The line with the names.
    where : str
        File and line, for messages.

    Returns
    -------
    Columns

    Raises
    ------
    TraceError
        If a column is unknown, given twice, or missing.
    """
    names = [name.strip() for name in next(csv.reader([row.strip()]), [])]
    sensors = [
        _parse_sensor(index, name, where)
        for index, name in enumerate(names)
        if name not in (DROP, TIME, LOAD)
    ]
    for name in (TIME, LOAD):
        if name not in names:
            raise TraceError(refusal(where, f"a column {name}", f"columns {quote(row.strip())}"))
    _refuse_twins(names, sensors, where)
    return Columns(
        names=tuple(names),
        drop=names.index(DROP) if DROP in names else None,
        time=names.index(TIME),
        load=names.index(LOAD),
        sensors=tuple(sensors),
    )


def sensor_name(quantity: Quantity, offset: float) -> str:
    """The column name of a sensor, such as ``velocity_m_s@0.3``."""
    prefix = next(name for name, value in _PREFIXES.items() if value == quantity)
    return f"{prefix}@{offset!r}"


def _parse_sensor(index: int, name: str, where: str) -> Sensor:
    found = _SENSOR.fullmatch(name)
    offset = _offset(found[2]) if found else math.nan
    if found is None or not math.isfinite(offset):
        hint = "separate the columns with commas" if re.search(r"[;\t]", name) else ""
        if name in _PREFIXES:
            hint = f"the centre sensor is {name}@0.0000"
        raise TraceError(refusal(where, f"a column {_KNOWN}", quote(name), hint))
    return Sensor(index, _PREFIXES[found[1]], offset)


def _offset(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _refuse_twins(names: list[str], sensors: list[Sensor], where: str) -> None:
    # @0.3 and @0.30 are one sensor; a velocity and a displacement may share a place.
    keys = {sensor.index: (sensor.quantity, sensor.offset) for sensor in sensors}
    seen: set[object] = set()
    for index, name in enumerate(names):
        key = keys.get(index, name)
        if key in seen:
            raise TraceError(refusal(where, "every column once", f"{quote(name)} again"))
        seen.add(key)
