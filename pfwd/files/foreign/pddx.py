"""Reader of AASHTO's Pavement Deflection Data Exchange (PDDX): peaks as lines ``key = value``.

The section ``[Units]`` has the units of all other sections, ``[Device Configuration]`` the radius
of the plate and the positions of the sensors. Each ``[Test Location N]`` is one point with
``DropData_N = load, deflections``. The layout was inferred from a file that a viewer writes.
"""

import os
import re
from collections.abc import Mapping, Sequence
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
    PLATE_RADII_M,
    StationDrops,
    force_of,
    lines_of,
    local_moment,
    number_of,
    plate_radius,
    points_of_stations,
    require_plate_radius,
)
from pfwd.files.traces import TracePoint
from pfwd_plugins.quantities import INCH_M, POUND_FORCE_N

BEGIN = b"[Pavement Deflection Data Exchange File]"
MAX_ENTRIES = 200_000
"""Largest number of keys in a file; a point has about twelve."""

LENGTH_UNITS: Mapping[str, float] = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "micron": 1e-6,
    "inch": INCH_M,
    "mil": 1e-3 * INCH_M,
    "foot": 12 * INCH_M,
    "feet": 12 * INCH_M,
}
LOAD_UNITS: Mapping[str, float] = {
    "kilo-newton": 1e3,
    "kilonewton": 1e3,
    "newton": 1.0,
    "pound-force": POUND_FORCE_N,
    "pound": POUND_FORCE_N,
    "kip": 1e3 * POUND_FORCE_N,
}
PDDX_TEMPERATURE_KEYS = {
    "air": "air_temperature_c",
    "surface": "surface_temperature_c",
    "pavement": "surface_temperature_c",
    "asphalt": "asphalt_temperature_c",
    "manual": "manual_temperature_c",
}

_SECTION = re.compile(r"\[([^\]]{1,100})\]\s*")
_ENTRY = re.compile(r"([A-Za-z]\w{0,99})\s*=\s*(.*?)\s*")
_LOCATION = re.compile(r"Test Location (\d{1,9})")
_PDDX_DROP_KEY = re.compile(r"DropData_(\d{1,9})")
_PDDX_DATE = re.compile(r"(\d{1,2})-([A-Za-z]{3})-(\d{4})")
_PDDX_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}))?")
_PDDX_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

Section = dict[str, tuple[str, int]]
"""Value and line of each key of a section."""


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a PDDX file.

    Parameters
    ----------
    file : str
        Path of the file.
    request : Request
        Options of the user.

    Raises
    ------
    TraceError
        If the file has another format, or a unit, the plate or a drop is invalid.
    """
    return _Reader(file, request, _sections(file)).points()


def _sections(file: str) -> dict[str, Section]:
    sections: dict[str, Section] = {}
    section: Section = {}
    entries = 0
    for number, line in lines_of(file):
        if match := _SECTION.fullmatch(line):
            name = match[1].strip()
            if _LOCATION.match(name) and name in sections:
                name = f"{name} in line {number}"  # another point has the same number
            section = sections.setdefault(name, {})
        elif match := _ENTRY.fullmatch(line):
            entries += 1
            if entries > MAX_ENTRIES:
                raise TraceError(refusal(file, f"at most {MAX_ENTRIES} keys", "more"))
            section.setdefault(match[1], (match[2], number))
    return sections


class _Reader:
    """Conversion of the sections to test points."""

    def __init__(self, file: str, request: Request, sections: Mapping[str, Section]) -> None:
        self._file = file
        self._request = request
        self._sections = sections
        begin = sections.get("Pavement Deflection Data Exchange File")
        if begin is None:
            hint = "is it a PDDX file?"
            raise TraceError(refusal(file, f"a section {BEGIN.decode()}", "none", hint))
        self._delimiter = begin.get("DelimiterSymbol", (",", 0))[0] or ","
        self._decimal = begin.get("DecimalSymbol", (".", 0))[0] or "."
        self._remarks: list[Notice] = []
        self._viewer = "rincent" in self._get("Device Information", "DeviceDesignationName").lower()
        """True if Rincent's viewer wrote the file: its units are not those that it states."""

    def points(self) -> list[TracePoint]:
        """Return the test points of the file."""
        device = "Device Configuration"
        length = self._unit("SensorLocationUnits", LENGTH_UNITS)
        deflection_factor = self._unit("DeflectionUnits", LENGTH_UNITS)
        offsets = [length * n for n in self._numbers(device, "DeflectionSensorXAxisDistances")]
        across = self._numbers(device, "DeflectionSensorYAxisDistances", needed=False)
        count = int(next(iter(self._numbers(device, "NumberOfDeflectionSensors")), 0))
        if len(offsets) == count + 1 and offsets[0] == 0 and self._viewer:
            # The viewer lists the load cell, at 0, before the sensors.
            offsets = offsets[1:]
        if len(offsets) != count or any(across[: count + 1]):
            expected = f"{count} distances along one line in DeflectionSensorXAxisDistances"
            raise TraceError(refusal(self._file, expected, f"{len(offsets)}"))
        radius, per_load = self._plate()
        stations = [
            self._station(name, section, count, per_load, deflection_factor)
            for name, section in self._sections.items()
            if _LOCATION.match(name)
        ]
        parts = ("DeviceDesignationName", "DeviceModelNumber", "DeviceSerialNumber")
        names = [self._get("Device Information", part) for part in parts]
        common = {
            "source": "PDDX",
            "site": short_text(self._get("Location Identification", "SiteName"))
            or short_text(self._get("Operations Information", "FileName")),
            "operator": short_text(self._get("Operations Information", "OperatorName")),
            "device": short_text(" ".join(name for name in names if name)),
            "plate_radius_m": radius,
        }
        return points_of_stations(
            self._file, stations, offsets, common, self._request, self._remarks
        )

    def _plate(self) -> tuple[float, float]:
        """Return the plate radius, m, and the factor from the file's unit of load to N."""
        key = "LoadPlateRadius"
        text, line, where = self._entry("Device Configuration", key)
        recorded = number_of(text.replace(self._decimal, "."), f"{key}, a number", where)
        radius = plate_radius(
            self._request, recorded * self._unit("LoadPlateRadiusUnits", LENGTH_UNITS)
        )
        per_load = self._unit("LoadUnits", LOAD_UNITS)
        name = os.path.basename(self._file)
        if self._viewer and PLATE_RADII_M[0] <= recorded / 2 <= PLATE_RADII_M[1]:
            # The viewer writes the diameter in metres and states millimetres.
            radius = plate_radius(self._request, round(recorded / 2, 6)) or 0.0
            per_load = force_of(1e3, radius)
            values: dict[str, Value] = {"file": name, "line": line, "diameter_m": recorded}
            self._remarks.append(Notice("plate-diameter-taken", values))
        return require_plate_radius(radius, where), per_load

    def _station(
        self, name: str, section: Section, count: int, per_load: float, deflection_factor: float
    ) -> StationDrops:
        title = short_text(_plain(section, "TestComment"))
        station = StationDrops(
            title or _LOCATION.sub(r"location \1", name.partition(" in line")[0])
        )
        position = self._split(_plain(section, "GPSLocation"))
        station.declared.update(position_of(*position[:2]) if len(position) >= 2 else {})
        chainage = finite(next(iter(self._split(_plain(section, "TestLocation"))), None))
        if chainage is not None:
            unit = self._get("Units", "TestLocationUnits").split(",")[0].strip().lower()
            station.noted["chainage_m"] = chainage * (
                1.0 if self._viewer else LENGTH_UNITS.get(unit, 1.0)
            )
        station.noted.update(self._temperatures(section))
        station.noted["time_local"] = self._moment(section)
        station.noted["lane"] = short_text(_plain(section, "TestLane"))
        drops = [
            (int(match[1]), key) for key in section if (match := _PDDX_DROP_KEY.fullmatch(key))
        ]
        for _, key in sorted(drops):
            text, line = section[key]
            where = f"{self._file}, line {line}"
            load, *peaks = [
                number_of(cell, "a load and deflections", where) for cell in self._split(text)
            ]
            if len(peaks) != count:
                raise TraceError(refusal(where, f"{count} deflections", str(len(peaks))))
            station.drops.append(
                (per_load * load, tuple(deflection_factor * peak for peak in peaks), line)
            )
        return station

    def _temperatures(self, section: Section) -> dict[str, float | None]:
        use = self._get("Device Configuration", "TemperatureSensorUse").lower()
        names = [name.strip() for name in use.split(self._delimiter)]
        in_fahrenheit = "fahr" in self._get("Units", "TemperatureUnits").lower()
        temperatures = {}
        values = self._split(_plain(section, "TestTemperatures"))
        for name, text in zip(names, values, strict=False):
            value = finite(text)
            if name in PDDX_TEMPERATURE_KEYS and value is not None:
                key = PDDX_TEMPERATURE_KEYS[name]
                temperatures[key] = temperature_of(value, fahrenheit=in_fahrenheit)
        return temperatures

    def _moment(self, section: Section) -> str | None:
        date = _PDDX_DATE.match(self._get("Operations Information", "StartDate"))
        time = _PDDX_TIME.match(_plain(section, "TestTime"))
        if date is None or time is None or date[2].lower() not in _PDDX_MONTHS:
            return None
        month = _PDDX_MONTHS.index(date[2].lower()) + 1
        hours = (int(time[1]), int(time[2]), int(time[3] or 0))
        return local_moment(int(date[3]), month, int(date[1]), *hours)

    def _split(self, text: str) -> list[str]:
        return [part.strip().replace(self._decimal, ".") for part in text.split(self._delimiter)]

    def _entry(self, section: str, key: str) -> tuple[str, int, str]:
        """Return the text, the line, and the place for messages, of a key; 0: it is missing."""
        text, line = self._sections.get(section, {}).get(key, ("", 0))
        return text, line, f"{self._file}, line {line}" if line else self._file

    def _get(self, section: str, key: str) -> str:
        return _plain(self._sections.get(section, {}), key)

    def _unit(self, key: str, units: Mapping[str, float]) -> float:
        text, _, where = self._entry("Units", key)
        name = text.strip().lower()
        factor = units.get(name.removesuffix("s"), units.get(name))
        if factor is None:
            raise TraceError(refusal(where, f"{key}: one of {', '.join(units)}", quote(text)))
        return factor

    def _numbers(self, section: str, key: str, *, needed: bool = True) -> Sequence[float]:
        text, _, where = self._entry(section, key)
        if not text and not needed:
            return []
        return [number_of(part, f"{key}, numbers", where) for part in self._split(text)]


def _plain(section: Mapping[str, Any], key: str) -> str:
    """Return the value of a key; empty: the key is missing or its value is ``undefined``."""
    text = str(section.get(key, ("", 0))[0]).strip()
    return "" if text.lower() == "undefined" else text
