"""AASHTO's Pavement Deflection Data Exchange (PDDX): peaks as text, sections of ``key = value``.

``[Units]`` says in which units the rest is, ``[Device Configuration]`` the radius of the plate and
the positions of the sensors, each ``[Test Location N]`` one point with ``DropData_N = load,
deflections``. Learned from a file that a viewer writes, and from what this program writes itself.
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
    PLATES,
    Station,
    force_of,
    lines_of,
    local_moment,
    number_of,
    plate_radius,
    points_of_stations,
)
from pfwd.files.foreign.units import INCH, POUND_FORCE, celsius
from pfwd.files.traces import TracePoint

BEGIN = b"[Pavement Deflection Data Exchange File]"
MOST_ENTRIES = 200_000
"""Keys of a file; a point has some twelve."""

LENGTHS: Mapping[str, float] = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "micron": 1e-6,
    "inch": INCH,
    "mil": 1e-3 * INCH,
    "foot": 12 * INCH,
    "feet": 12 * INCH,
}
LOADS: Mapping[str, float] = {
    "kilo-newton": 1e3,
    "kilonewton": 1e3,
    "newton": 1.0,
    "pound-force": POUND_FORCE,
    "pound": POUND_FORCE,
    "kip": 1e3 * POUND_FORCE,
}
TEMPERATURES = {
    "air": "air_temperature_c",
    "surface": "surface_temperature_c",
    "pavement": "surface_temperature_c",
    "asphalt": "asphalt_temperature_c",
    "manual": "manual_temperature_c",
}

_SECTION = re.compile(r"\[([^\]]{1,100})\]\s*")
_ENTRY = re.compile(r"([A-Za-z]\w{0,99})\s*=\s*(.*?)\s*")
_LOCATION = re.compile(r"Test Location (\d{1,9})")
_DROP = re.compile(r"DropData_(\d{1,9})")
_DATE = re.compile(r"(\d{1,2})-([A-Za-z]{3})-(\d{4})")
_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}))?")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

Section = dict[str, tuple[str, int]]
"""Text and line of each key."""


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a file.

    Parameters
    ----------
    file : str
    request : Request

    Raises
    ------
    TraceError
        If it is another file, or a unit, the plate or a drop is none.
    """
    return _Reader(file, request, _sections(file)).points()


def _sections(file: str) -> dict[str, Section]:
    found: dict[str, Section] = {}
    section: Section = {}
    entries = 0
    for number, line in lines_of(file):
        if match := _SECTION.fullmatch(line):
            name = match[1].strip()
            if _LOCATION.match(name) and name in found:
                name = f"{name} in line {number}"  # another point under the same number
            section = found.setdefault(name, {})
        elif match := _ENTRY.fullmatch(line):
            entries += 1
            if entries > MOST_ENTRIES:
                raise TraceError(refusal(file, f"at most {MOST_ENTRIES} keys", "more"))
            section.setdefault(match[1], (match[2], number))
    return found


class _Reader:
    """Takes what is known out of the sections."""

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
        """Written by a viewer that has its own way with units."""

    def points(self) -> list[TracePoint]:
        """All of the file."""
        device = "Device Configuration"
        length = self._unit("SensorLocationUnits", LENGTHS)
        moved = self._unit("DeflectionUnits", LENGTHS)
        offsets = [length * n for n in self._numbers(device, "DeflectionSensorXAxisDistances")]
        across = self._numbers(device, "DeflectionSensorYAxisDistances", needed=False)
        count = int(next(iter(self._numbers(device, "NumberOfDeflectionSensors")), 0))
        if len(offsets) == count + 1 and offsets[0] == 0 and self._viewer:
            # The viewer lists the load cell among them.
            offsets = offsets[1:]
        if len(offsets) != count or any(across[: count + 1]):
            expected = f"{count} distances along one line in DeflectionSensorXAxisDistances"
            raise TraceError(refusal(self._file, expected, f"{len(offsets)}"))
        radius, per_load = self._plate()
        stations = [
            self._station(name, section, count, per_load, moved)
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
        """Radius, m, and newtons of one of the file's loads."""
        key = "LoadPlateRadius"
        text, line = self._sections.get("Device Configuration", {}).get(key, ("", 0))
        where = f"{self._file}, line {line}" if line else self._file
        said = number_of(text.replace(self._decimal, "."), f"{key}, a number", where)
        radius = plate_radius(self._request, said * self._unit("LoadPlateRadiusUnits", LENGTHS))
        per_load = self._unit("LoadUnits", LOADS)
        name = os.path.basename(self._file)
        if self._viewer and PLATES[0] <= said / 2 <= PLATES[1]:
            # Metres, and the whole width: no plate has a radius of half a millimetre.
            radius = plate_radius(self._request, round(said / 2, 6)) or 0.0
            per_load = force_of(1e3, radius)
            values: dict[str, Value] = {"file": name, "line": line, "diameter_m": said}
            self._remarks.append(Notice("plate-diameter-taken", values))
        if radius is None or not PLATES[0] <= radius <= PLATES[1]:
            came = "none" if radius is None else f"{1e3 * radius:g} mm"
            hint = "declare plate_radius_m with --header"
            raise TraceError(refusal(where, "a plate radius of 20 to 1000 mm", came, hint))
        return radius, per_load

    def _station(
        self, name: str, section: Section, count: int, per_load: float, moved: float
    ) -> Station:
        title = short_text(_plain(section, "TestComment"))
        found = Station(title or _LOCATION.sub(r"location \1", name.partition(" in line")[0]))
        place = self._split(_plain(section, "GPSLocation"))
        found.known.update(position_of(*place[:2]) if len(place) >= 2 else {})
        chainage = finite(next(iter(self._split(_plain(section, "TestLocation"))), None))
        if chainage is not None:
            unit = self._get("Units", "TestLocationUnits").split(",")[0].strip().lower()
            found.noted["chainage_m"] = chainage * (1.0 if self._viewer else LENGTHS.get(unit, 1.0))
        found.noted.update(self._temperatures(section))
        found.noted["time_local"] = self._moment(section)
        found.noted["lane"] = short_text(_plain(section, "TestLane"))
        drops = [(int(match[1]), key) for key in section if (match := _DROP.fullmatch(key))]
        for _, key in sorted(drops):
            text, line = section[key]
            where = f"{self._file}, line {line}"
            load, *peaks = [
                number_of(cell, "a load and deflections", where) for cell in self._split(text)
            ]
            if len(peaks) != count:
                raise TraceError(refusal(where, f"{count} deflections", str(len(peaks))))
            found.drops.append((per_load * load, tuple(moved * peak for peak in peaks), line))
        return found

    def _temperatures(self, section: Section) -> dict[str, float | None]:
        use = self._get("Device Configuration", "TemperatureSensorUse").lower()
        names = [name.strip() for name in use.split(self._delimiter)]
        in_celsius = "fahr" not in self._get("Units", "TemperatureUnits").lower()
        found = {}
        values = self._split(_plain(section, "TestTemperatures"))
        for name, text in zip(names, values, strict=False):
            value = finite(text)
            if name in TEMPERATURES and value is not None:
                value = value if in_celsius else celsius(value)
                found[TEMPERATURES[name]] = temperature_of(value)
        return found

    def _moment(self, section: Section) -> str | None:
        date = _DATE.match(self._get("Operations Information", "StartDate"))
        time = _TIME.match(_plain(section, "TestTime"))
        if date is None or time is None or date[2].lower() not in _MONTHS:
            return None
        month = _MONTHS.index(date[2].lower()) + 1
        hours = (int(time[1]), int(time[2]), int(time[3] or 0))
        return local_moment(int(date[3]), month, int(date[1]), *hours)

    def _split(self, text: str) -> list[str]:
        return [one.strip().replace(self._decimal, ".") for one in text.split(self._delimiter)]

    def _get(self, section: str, key: str) -> str:
        return _plain(self._sections.get(section, {}), key)

    def _unit(self, key: str, known: Mapping[str, float]) -> float:
        text, line = self._sections.get("Units", {}).get(key, ("", 0))
        found = known.get(text.strip().lower().removesuffix("s"), known.get(text.strip().lower()))
        if found is None:
            where = f"{self._file}, line {line}" if line else self._file
            raise TraceError(refusal(where, f"{key}: one of {', '.join(known)}", quote(text)))
        return found

    def _numbers(self, section: str, key: str, *, needed: bool = True) -> Sequence[float]:
        text, line = self._sections.get(section, {}).get(key, ("", 0))
        if not text and not needed:
            return []
        where = f"{self._file}, line {line}" if line else self._file
        return [number_of(one, f"{key}, numbers", where) for one in self._split(text)]


def _plain(section: Mapping[str, Any], key: str) -> str:
    """The text of a key; empty when there is none, or what a program writes for none."""
    text = str(section.get(key, ("", 0))[0]).strip()
    return "" if text.lower() == "undefined" else text
