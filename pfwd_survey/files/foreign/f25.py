"""Dynatest's ``.F25``: peaks of an FWD as text.

A line is a number that says what it is, then fields between commas. ``5002`` has the units
(``"25SI"``), ``5011`` the date, ``5020`` the radius of the plate and the positions of the sensors
(mm; ``N0``: none), ``5030`` to ``5032`` operator, road and section, ``5280`` a position, ``5301``
to ``5303`` station, comment and temperatures (asphalt, surface, air). A line whose number is less
than 5000 is a drop: its number, the pressure under the plate (kPa), deflections (um). Learned from
one file of Dynatest's own program and one of a viewer; lines of other numbers are not read.
"""

import os
import re
from collections.abc import Sequence

from pfwd_survey.errors import TraceError, quote, refusal
from pfwd_survey.files.foreign.common import (
    Request,
    finite,
    position_of,
    short_text,
    temperature_of,
)
from pfwd_survey.files.foreign.peaks_text import (
    PLATES,
    Station,
    force_of,
    lines_of,
    local_moment,
    number_of,
    plate_radius,
    points_of_stations,
)
from pfwd_survey.files.foreign.units import celsius
from pfwd_survey.files.traces import TracePoint

NONE = "N0"
"""What stands where nothing was measured."""

_CELL = re.compile(r'((?:"[^"]*"|[^",]|"(?=[^"]*$))*),')

DROPS_BELOW = 5000
"""Numbers of lines from here on are no drops."""


def read(file: str, request: Request) -> list[TracePoint]:
    """The test points of a file, one a station.

    Parameters
    ----------
    file : str
    request : Request

    Raises
    ------
    TraceError
        If it is another file, its units are not SI, or a line is no drop.
    """
    reader = _Reader(file, request)
    for number, line in lines_of(file):
        if line.strip():
            reader.take(_cells(line), number)
    return reader.points()


class _Reader:
    """Collects stations; what stands before a drop belongs to it."""

    def __init__(self, file: str, request: Request) -> None:
        self._file = file
        self._request = request
        self._common: dict[str, object] = {"source": "Dynatest F25"}
        self._offsets: list[float] = []
        self._radius: float | None = None
        self._stations: list[Station] = []
        self._place: dict[str, float] = {}
        self._strange: list[int] = []
        """Lines that do not say what they are."""

    def take(self, cells: list[str], line: int) -> None:
        """One line."""
        where = f"{self._file}, line {line}"
        kind = finite(cells[0])
        if kind is None:
            self._strange.append(line)
        elif kind < DROPS_BELOW:
            self._drop(cells, line, where)
        elif kind == 5001:
            self._common["device"] = _text(cells, 6)
        elif kind == 5002 and "SI" not in (cells[1] if len(cells) > 1 else ""):
            raise TraceError(refusal(where, "units SI (25SI)", quote(",".join(cells[1:2]))))
        elif kind == 5020:
            self._plate(cells, where)
        elif kind == 5030:
            self._common["operator"] = _text(cells, 1)
        elif kind == 5031:
            self._common["site"] = _text(cells, 1)
        elif kind == 5280:
            self._position(cells)
        elif kind == 5301:
            self._station(cells)
        elif kind == 5302 and self._stations:
            self._stations[-1].noted["comment"] = _text(cells, 9)
        elif kind == 5303 and self._stations:
            self._temperatures(cells)

    def _plate(self, cells: Sequence[str], where: str) -> None:
        said = number_of(cells[1] if len(cells) > 1 else "", "the radius of the plate, mm", where)
        self._radius = plate_radius(self._request, said / 1e3)
        self._offsets = []
        for cell in cells[2:]:
            if cell in (NONE, ""):
                break
            self._offsets.append(number_of(cell, "the position of a sensor, mm", where) / 1e3)
        if self._radius is None or not PLATES[0] <= self._radius <= PLATES[1]:
            expected = "a plate radius of 20 to 1000 mm"
            raise TraceError(refusal(where, expected, quote(cells[1]), "declare plate_radius_m"))
        self._common["plate_radius_m"] = self._radius

    def _position(self, cells: Sequence[str]) -> None:
        # A cause of failure that is not 0: no fix.
        failed = len(cells) < 6 or finite(cells[1]) != 0
        self._place = {} if failed else position_of(cells[3], cells[4])

    def _station(self, cells: Sequence[str]) -> None:
        station = _text(cells, 5) or "?"
        moment = local_moment(*(finite(cell) for cell in cells[9:14]))
        # Kilometres in one program, metres in another: it is kept as it was written.
        noted: dict[str, object] = {"station": station, "time_local": moment}
        noted["lane"] = _text(cells, 7)
        found = Station(f"station {station}", dict(self._place), noted)
        self._place = {}
        self._stations.append(found)

    def _temperatures(self, cells: Sequence[str]) -> None:
        noted = self._stations[-1].noted
        in_celsius = len(cells) > 1 and cells[1] == "0"
        names = ("asphalt_temperature_c", "surface_temperature_c", "air_temperature_c")
        for name, cell in zip(names, cells[2:5], strict=False):
            value = finite(cell)
            if value is not None:
                noted[name] = temperature_of(value if in_celsius else celsius(value))

    def _drop(self, cells: Sequence[str], line: int, where: str) -> None:
        if not self._stations or self._radius is None or not self._offsets:
            expected = "lines 5020 and 5301 before the first drop"
            raise TraceError(refusal(where, expected, quote(",".join(cells[:3]))))
        wanted = 2 + len(self._offsets)
        # A row may end with fields for sensors that there are not.
        if len(cells) < wanted or any(cell not in (NONE, "") for cell in cells[wanted:]):
            expected = f"a drop with {len(self._offsets)} deflections, as line 5020 has positions"
            raise TraceError(refusal(where, expected, f"{len(cells) - 2}"))
        pressure = number_of(cells[1], "the pressure, kPa", where)
        moved = tuple(
            None if cell in (NONE, "") else 1e-6 * number_of(cell, "a deflection, um", where)
            for cell in cells[2:wanted]
        )
        load = force_of(1e3 * pressure, self._radius)
        self._stations[-1].drops.append((load, moved, line))

    def points(self) -> list[TracePoint]:
        """All that were found; the first lines 5301 to 5303 are the file's own."""
        if not self._offsets:
            hint = "is it a Dynatest F25 file?"
            raise TraceError(
                refusal(self._file, "a line 5020 with plate and sensors", "none", hint)
            )
        common = {key: value for key, value in self._common.items() if value}
        name = os.path.basename(self._file)
        remarks = [f"{name}: load from the pressure and a plate of radius {self._radius:g} m"]
        if self._strange:
            count = len(self._strange)
            remarks.append(
                f"{name}, line {self._strange[0]}: no number at its beginning, it was not read"
                + (f"; {count - 1} more of that kind" if count > 1 else "")
            )
        return points_of_stations(
            self._file, self._stations, self._offsets, common, self._request, remarks
        )


def _cells(line: str) -> list[str]:
    """Fields of a line; a comma between quotation marks separates nothing."""
    return [cell.replace('"', "").strip() for cell in _CELL.findall(line + ",")]


def _text(cells: Sequence[str], index: int) -> str | None:
    return short_text(cells[index]) if len(cells) > index and cells[index] != NONE else None
