"""A TOML file that says what the columns of another program's text hold."""

import codecs
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.units import DISPLACEMENT, FORCE, TIME, VELOCITY
from pfwd.files.header import Declaration, Declarations
from pfwd.toml_reading import LARGEST_TOML, parse_toml
from pfwd_device.drop import Quantity

DELIMITERS = {",": ",", ";": ";", "\t": "\t", "tab": "\t", "|": "|", "blank": None}
"""What separates columns; None: any run of blanks."""

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": TIME,
    "load": FORCE,
    "velocity": VELOCITY,
    "displacement": DISPLACEMENT,
}


@dataclass(frozen=True, slots=True)
class Column:
    """Where numbers stand and what they are multiplied by."""

    column: str | int
    """Name, or position from 1."""
    factor: float
    """To SI, downward positive."""


@dataclass(frozen=True, slots=True)
class SensorColumn:
    """A column with the record of a sensor."""

    where: Column
    quantity: Quantity
    offset: float
    """Distance from the plate centre, m; negative: the other side of the plate."""


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Layout of a text with columns."""

    file: str
    """Of the map or of the text, for messages."""
    delimiter: str | None
    """None: runs of blanks."""
    decimal: str
    encoding: str
    skip_lines: int
    """Lines before the names, or before the numbers where there are no names."""
    names: bool
    """Whether a line with names comes before the numbers."""
    units_line: bool
    """Whether a line to skip follows the names."""


@dataclass(frozen=True, slots=True)
class ColumnMap(TextLayout):
    """Layout of a text and the meaning of its columns."""

    time: Column | None
    rate: float | None
    """Hz; in place of a column with the time."""
    trigger: float
    """Time of the trigger by the file's clock, s; it becomes 0."""
    load: Column
    sensors: tuple[SensorColumn, ...]
    drop: str | int | None
    """Column with the number of the drop; None: the file is drop 1."""
    declarations: Declarations
    """Header keys that stand in the map."""


def read_map(path: str | os.PathLike[str]) -> ColumnMap:
    """The column map in a TOML file.

    Raises
    ------
    TraceError
        If it cannot be read, a key is missing or unknown, or a value is outside its range.
    """
    file = os.fspath(path)
    try:
        with open(file, "rb") as stream:
            data = stream.read(LARGEST_TOML + 1)
        if len(data) > LARGEST_TOML:
            raise TraceError(refusal(file, "a column map", "a file of over 1 MB"))
        table = parse_toml(data.decode("utf-8-sig"))
    except OSError as err:
        raise TraceError(refusal(file, "a readable TOML file", err.strerror or str(err))) from err
    except ValueError as err:
        if isinstance(err, TraceError):
            raise
        raise TraceError(refusal(file, "TOML", quote(str(err)))) from err
    return _Reader(file, table).read()


class _Reader:
    """Takes keys out of tables; what is left over is a mistake."""

    def __init__(self, file: str, table: dict[str, Any]) -> None:
        self._file = file
        self._table = table

    def read(self) -> ColumnMap:
        text = self._section("text", needed=False)
        time, load = self._section("time"), self._section("load")
        sensors = self._table.pop("sensor", None)
        if not isinstance(sensors, list) or not sensors:
            raise self._error("sensor", "at least one table [[sensor]]", sensors)
        drop = self._section("drop", needed=False)
        made = ColumnMap(
            file=self._file,
            delimiter=DELIMITERS[self._choice(text, "text.delimiter", ",", DELIMITERS)],
            decimal=self._choice(text, "text.decimal", ".", (".", ",")),
            encoding=self._encoding(text),
            skip_lines=self._count(text, "text.skip_lines"),
            names=self._flag(text, "text.names", True),
            units_line=self._flag(text, "text.units_line", False),
            time=self._column(time, "time", "time") if "column" in time else None,
            rate=self._number(time, "time.sampling_rate_hz", None),
            trigger=self._number(time, "time.trigger_s", 0.0) or 0.0,
            load=self._column(load, "load", "load"),
            sensors=tuple(self._sensor(one, n) for n, one in enumerate(sensors, start=1)),
            drop=self._place(drop, "drop") if drop else None,
            declarations={},
        )
        for name, left in (("text", text), ("time", time), ("load", load), ("drop", drop)):
            self._refuse_unknown(name, left)
        self._refuse_contradictions(made)
        where = self._file
        declared = {key: Declaration(value, where) for key, value in self._table.items()}
        return replace(made, declarations=declared)

    def _refuse_contradictions(self, made: ColumnMap) -> None:
        if (made.time is None) == (made.rate is None):
            came = "both" if made.time else "neither"
            raise self._error("time", "either column or sampling_rate_hz", came)
        if made.rate is not None and made.rate <= 0:
            raise self._error("time.sampling_rate_hz", "a number > 0", made.rate)
        if made.decimal == made.delimiter:
            raise self._error("text.decimal", "another sign than the delimiter", made.decimal)
        columns = [made.load, *(sensor.where for sensor in made.sensors)]
        columns += [made.time] if made.time else []
        places = [column.column for column in columns] + ([made.drop] if made.drop else [])
        if len(set(places)) < len(places):
            raise self._error("column", "every column once", places)
        if not made.names and any(isinstance(place, str) for place in places):
            hint = "positions from 1, as the file has no names"
            raise self._error("column", hint, places)
        kinds = [(sensor.quantity, sensor.offset) for sensor in made.sensors]
        if len(set(kinds)) < len(kinds):
            raise self._error("sensor", "every sensor at a place of its own", kinds)

    def _sensor(self, table: object, number: int) -> SensorColumn:
        name = f"sensor {number}"
        if not isinstance(table, dict):
            raise self._error(name, "a table [[sensor]]", table)
        kinds: dict[str, Quantity] = {"velocity": "velocity", "displacement": "displacement"}
        quantity = kinds[self._choice(table, f"{name}.quantity", None, kinds)]
        offset = self._number(table, f"{name}.offset_m", None)
        if offset is None:
            raise self._error(f"{name}.offset_m", "a distance in m", offset)
        made = SensorColumn(self._column(table, name, quantity), quantity, offset)
        self._refuse_unknown(name, table)
        return made

    def _column(self, table: dict[str, Any], name: str, quantity: str) -> Column:
        place = self._place(table, name)
        units = UNITS[quantity]
        factor = self._number(table, f"{name}.factor", None)
        if ("unit" in table) == (factor is not None):
            raise self._error(name, f"either unit ({', '.join(units)}) or factor to SI", "not one")
        if factor is None:
            factor = units[self._choice(table, f"{name}.unit", None, units)]
        positive = "down" if quantity != "time" else None
        if positive and self._choice(table, f"{name}.positive", "down", ("down", "up")) == "up":
            factor = -factor
        if factor == 0:
            raise self._error(f"{name}.factor", "a number other than 0", factor)
        return Column(place, factor)

    def _place(self, table: dict[str, Any], name: str) -> str | int:
        place = table.pop("column", None)
        if isinstance(place, bool) or not isinstance(place, str | int) or place in (0, ""):
            raise self._error(f"{name}.column", "a name, or a position from 1", place)
        if isinstance(place, int) and place < 0:
            raise self._error(f"{name}.column", "a name, or a position from 1", place)
        return place

    def _section(self, name: str, *, needed: bool = True) -> dict[str, Any]:
        table = self._table.pop(name, None if needed else {})
        if not isinstance(table, dict):
            raise self._error(name, f"a table [{name}]", table)
        return table

    def _choice(self, table: dict[str, Any], name: str, default: str | None, among: Any) -> str:
        value = table.pop(name.rpartition(".")[2], default)
        if not isinstance(value, str) or value not in among:
            raise self._error(name, "one of " + ", ".join(map(repr, among)), value)
        return value

    def _encoding(self, table: dict[str, Any]) -> str:
        value = table.pop("encoding", "utf-8-sig")
        try:
            # Some codecs are none of texts (hex, zip).
            known = isinstance(value, str) and codecs.lookup(value)._is_text_encoding
        except (LookupError, ValueError):
            known = False
        if not known:
            raise self._error("text.encoding", "an encoding such as utf-8 or cp1252", value)
        return str(value)

    def _number(self, table: dict[str, Any], name: str, default: float | None) -> float | None:
        value = table.pop(name.rpartition(".")[2], default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(name, "a number", value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self._error(name, "a finite number", value)
        return number

    def _count(self, table: dict[str, Any], name: str) -> int:
        value = table.pop(name.rpartition(".")[2], 0)
        if type(value) is not int or not 0 <= value <= 100_000:
            raise self._error(name, "a whole number >= 0", value)
        return value

    def _flag(self, table: dict[str, Any], name: str, default: bool) -> bool:
        value = table.pop(name.rpartition(".")[2], default)
        if not isinstance(value, bool):
            raise self._error(name, "true or false", value)
        return value

    def _refuse_unknown(self, name: str, table: Mapping[str, Any]) -> None:
        if table:
            raise self._error(name, "known keys only", ", ".join(table))

    def _error(self, name: str, expected: str, came: object) -> TraceError:
        text = "none" if came is None else quote(came)
        hint = "an example is examples/column-map.toml"
        return TraceError(refusal(f"{self._file}, {name}", expected, text, hint))
