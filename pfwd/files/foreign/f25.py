"""Reader of Dynatest's ``.F25``: peaks of an FWD as text.

A line begins with a number that states its kind, then fields between commas follow:

=================== ==========================================================================
number              content
=================== ==========================================================================
less than 5000      drop: its number, pressure under the plate (kPa), deflections (um)
``5002``            units (``"25SI"``)
``5011``            date
``5020``            radius of the plate and positions of the sensors, mm (``N0``: no sensor)
``5030`` to ``5032`` operator, road, section
``5280``            position on the earth
``5301`` to ``5303`` station, comment, temperatures of asphalt, surface and air
=================== ==========================================================================

The layout was inferred from one file of Dynatest's own program and one of a viewer. Lines of other
kinds are not read.

A deflection belongs to the position in the same column of the preceding ``5020`` line, of which a
file may have several. If a drop has more or fewer deflections than there are positions, those
with a position are read and a remark names the line. Two kinds of drops are left out with a remark,
because their numbers would be wrong: a last line of the file that is cut off, and a drop with
surplus deflections whose largest one is not at the plate, so that columns and positions do not
match.
"""

import os
import re
from collections.abc import Sequence
from itertools import zip_longest
from math import inf

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
    force_of,
    lines_of,
    local_moment,
    number_of,
    plate_radius,
    points_of_stations,
    require_plate_radius,
)
from pfwd.files.header import RADIUS_KEY
from pfwd.files.traces import TracePoint

MISSING_FIELD = "N0"
"""Content of a field without a measurement."""

_CELL = re.compile(r'((?:"[^"]*"|[^",]|"(?=[^"]*$))*),')

FIRST_HEADER_CODE = 5000
"""Smallest number of a kind of line that is not a drop."""

_LEADING_DIGITS = re.compile(r"\s*[1-9]\d{0,2}")
_THREE_DIGITS = re.compile(r"\d{3}(\.\d*)?\s*")
"""Second field of a number that a comma between the thousands divides into two fields."""


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test points of a Dynatest ``.F25`` file, one for each station.

    Parameters
    ----------
    file : str
        Path of the file.
    request : Request
        Options of the user.

    Raises
    ------
    TraceError
        If the file has another format or other units than SI, or a line of a drop is damaged.
    """
    reader = _Reader(file, request)
    for number, line in lines_of(file):
        if line.strip():
            reader.take(_fields(line), number)
    return reader.points()


class _Reader:
    """Parser of the lines in their order; a header line applies to the drops after it."""

    def __init__(self, file: str, request: Request) -> None:
        self._file = file
        self._request = request
        self._common: dict[str, object] = {"source": "Dynatest F25"}
        self._offsets: list[float] = []
        """Positions of all sensors of the file, m."""
        self._columns: list[int | None] = []
        """For each column of a drop the index of its position; None: it has no position."""
        self._radius: float | None = None
        self._radii: list[float] = []
        self._stations: list[StationDrops] = []
        self._position: dict[str, float] = {}
        self._unreadable_lines: list[int] = []
        """Numbers of the lines that do not begin with a number."""
        self._width_before = inf
        """Number of deflection columns of the last drop."""
        self._cut_off = False
        """True if the last line is a drop that is cut off."""
        self._remarks: dict[str, list[dict[str, Value]]] = {}
        """Values of the remarks on drop lines, by the code of the remark."""

    def take(self, fields: list[str], line: int) -> None:
        """Parse one line of the file, split into its fields."""
        where = f"{self._file}, line {line}"
        cells = [field.strip() for field in fields]
        self._cut_off = False
        kind = finite(cells[0])
        if kind is None:
            self._unreadable_lines.append(line)
        elif kind < FIRST_HEADER_CODE:
            self._add_drop(fields, line, where)
        elif kind == 5001:
            self._common["device"] = _text(cells, 6)
        elif kind == 5002 and "SI" not in (cells[1] if len(cells) > 1 else ""):
            raise TraceError(refusal(where, "units SI (25SI)", quote(",".join(cells[1:2]))))
        elif kind == 5020:
            self._read_plate(cells, where)
        elif kind == 5030:
            self._common["operator"] = _text(cells, 1)
        elif kind == 5031:
            self._common["site"] = _text(cells, 1)
        elif kind == 5280:
            # The first field is an error code of the receiver, 0 with a valid position.
            failed = len(cells) < 6 or finite(cells[1]) != 0
            self._position = {} if failed else position_of(cells[3], cells[4])
        elif kind == 5301:
            self._add_station(cells)
        elif kind == 5302 and self._stations:
            self._stations[-1].noted["comment"] = _text(cells, 9)
        elif kind == 5303 and self._stations:
            self._read_temperatures(cells)

    def _read_plate(self, cells: Sequence[str], where: str) -> None:
        recorded = number_of(
            cells[1] if len(cells) > 1 else "", "the radius of the plate, mm", where
        )
        self._radius = plate_radius(self._request, recorded / 1e3)
        self._columns = []
        for cell in _without_empty_end(cells[2:]):
            column = None
            if cell not in (MISSING_FIELD, ""):
                offset = number_of(cell, "the position of a sensor, mm", where) / 1e3
                column = self._sensor_index(offset)
            self._columns.append(column)
        self._radius = require_plate_radius(self._radius, where)
        if self._radius not in self._radii:
            self._radii.append(self._radius)

    def _sensor_index(self, offset: float) -> int:
        """Return the index of a sensor position, which is added if it is new.

        Two equal positions in one ``5020`` line are two sensors.
        """
        for index, position in enumerate(self._offsets):
            if position == offset and index not in self._columns:
                return index
        self._offsets.append(offset)
        return len(self._offsets) - 1

    def _add_station(self, cells: Sequence[str]) -> None:
        station = _text(cells, 5) or "?"
        moment = local_moment(*(finite(cell) for cell in cells[9:14]))
        # Stored as text: the unit is kilometres in one program and metres in another.
        noted: dict[str, object] = {"station": station, "time_local": moment}
        noted["lane"] = _text(cells, 7)
        new_station = StationDrops(f"station {station}", dict(self._position), noted)
        self._position = {}
        self._stations.append(new_station)

    def _read_temperatures(self, cells: Sequence[str]) -> None:
        noted = self._stations[-1].noted
        in_celsius = len(cells) > 1 and cells[1] == "0"
        names = ("asphalt_temperature_c", "surface_temperature_c", "air_temperature_c")
        for name, cell in zip(names, cells[2:5], strict=False):
            value = finite(cell)
            if value is not None:
                noted[name] = temperature_of(value, fahrenheit=not in_celsius)

    def _add_drop(self, fields: Sequence[str], line: int, where: str) -> None:
        cells = [field.strip() for field in fields]
        sensors = sum(column is not None for column in self._columns)
        if not self._stations or self._radius is None or not sensors:
            expected = "lines 5020 and 5301 before the first drop"
            raise TraceError(refusal(where, expected, quote(",".join(cells[:3]))))
        station = self._stations[-1]
        radius = station.declared.setdefault(RADIUS_KEY, self._radius)
        if radius != self._radius:
            expected = f"one plate at a station, of radius {1e3 * radius:g} mm"
            raise TraceError(refusal(where, expected, f"{1e3 * self._radius:g} mm"))
        width = len(self._columns)
        # A row may end with empty fields for sensors that the device does not have.
        joined = _with_joined_thousands(fields, len(_without_empty_end(cells[2:])) - width)
        if joined is not None and self._largest_is_at_plate(joined[2:]):
            self._add_remark("thousands-joined", line)
            cells = joined
        values = cells[2:]
        deflections = {
            index: 1e-6 * number_of(cell, "a deflection, um", where)
            for index, cell in zip(self._columns, values, strict=False)
            if index is not None and cell not in (MISSING_FIELD, "")
        }
        pressure = number_of(cells[1] if len(cells) > 1 else "", "the pressure, kPa", where)
        without_position = [
            number
            for number, cell in enumerate(values)
            if cell not in (MISSING_FIELD, "")
            and (number >= width or self._columns[number] is None)
        ]
        counts = {"deflections": len(_without_empty_end(values)), "positions": sensors}
        if without_position and not self._largest_is_at_plate(values):
            self._add_remark("drop-columns-suspect", line, **counts)
            return
        if without_position:
            columns = tuple(str(number + 1) for number in without_position)
            self._add_remark("deflections-without-position", line, **counts, columns=columns)
        too_short = len(values) < width
        if too_short:
            self._add_remark("deflections-missing", line, **counts)
        load = force_of(1e3 * pressure, self._radius)
        peaks = tuple(deflections.get(index) for index in range(len(self._offsets)))
        station.drops.append((load, peaks, line))
        # If the drop before is as short, the device has fewer sensors.
        self._cut_off = too_short and self._width_before > len(values)
        self._width_before = len(values)

    def _largest_is_at_plate(self, values: Sequence[str]) -> bool:
        """Return whether the largest deflection is at the position nearest to the plate's centre.

        The ground deflects most under the plate. If another column has the largest deflection,
        columns and positions do not match.
        """
        deflections = [
            (finite(cell), column) for cell, column in zip_longest(values, self._columns)
        ]
        measured = [(value, column) for value, column in deflections if value is not None]
        _, largest = max(measured, key=lambda pair: pair[0], default=(0.0, None))
        nearest = min(
            (column for _, column in measured if column is not None),
            key=lambda column: abs(self._offsets[column]),
            default=None,
        )
        return largest is not None and largest == nearest

    def _add_remark(self, code: str, line: int, **values: Value) -> None:
        name = os.path.basename(self._file)
        self._remarks.setdefault(code, []).append({"file": name, "line": line, **values})

    def points(self) -> list[TracePoint]:
        """Return the test points of all stations that have drops."""
        if not self._offsets:
            hint = "is it a Dynatest F25 file?"
            raise TraceError(
                refusal(self._file, "a line 5020 with plate and sensors", "none", hint)
            )
        common = {key: value for key, value in self._common.items() if value}
        name = os.path.basename(self._file)
        if self._cut_off:
            *_, line = self._stations[-1].drops.pop()
            self._add_remark("drop-cut-off", line)
        if len(self._radii) == 1:
            (radius,) = self._radii
            remarks = [Notice("load-from-pressure", {"file": name, "plate_radius_m": radius})]
        else:
            radii = " or ".join(f"{radius:g}" for radius in self._radii)
            remarks = [Notice("load-from-pressure-on-plates", {"file": name, "radii": radii})]
        for line in self._unreadable_lines:
            self._add_remark("line-not-read", line)
        remarks += [
            Notice(code, {**first, "more": len(more)})
            for code, (first, *more) in self._remarks.items()
        ]
        return points_of_stations(
            self._file, self._stations, self._offsets, common, self._request, remarks
        )


def _fields(line: str) -> list[str]:
    """Split a line into fields; commas between quotation marks do not separate."""
    return [field.replace('"', "") for field in _CELL.findall(line + ",")]


def _without_empty_end(cells: Sequence[str]) -> list[str]:
    """Return the fields up to the last one that has a measurement."""
    count = max(
        (n for n, cell in enumerate(cells, start=1) if cell not in (MISSING_FIELD, "")), default=0
    )
    return list(cells[:count])


def _with_joined_thousands(fields: Sequence[str], surplus: int) -> list[str] | None:
    """Join pairs of fields that are one number with a comma between its thousands.

    Parameters
    ----------
    fields : sequence of str
        Fields of a drop with the blanks around them: in aligned columns, three digits directly
        behind a comma are the rest of a number.
    surplus : int
        Number of fields for which there is no position.

    Returns
    -------
    list of str or None
        None: the number of such pairs is not `surplus`.
    """
    joined: list[str] = []
    pairs = 0
    for number, field in enumerate(fields):
        divided = (
            number > 1
            and _THREE_DIGITS.fullmatch(field)
            and _LEADING_DIGITS.fullmatch(fields[number - 1])
        )
        if divided:
            joined[-1] += field.strip()
            pairs += 1
        else:
            joined.append(field.strip())
    return joined if pairs and pairs == surplus else None


def _text(cells: Sequence[str], index: int) -> str | None:
    return (
        short_text(cells[index]) if len(cells) > index and cells[index] != MISSING_FIELD else None
    )
