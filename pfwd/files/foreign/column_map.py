"""Column maps: TOML files in which a user describes the columns of another program's text."""

import codecs
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from pfwd.errors import TraceError, quote, refusal
from pfwd.files.header import Declaration, Declarations
from pfwd.toml_reading import parse_user_toml, read_toml_text
from pfwd_device.schema import (
    AnyOf,
    Array,
    Choice,
    Flag,
    Integer,
    Key,
    Number,
    TableReader,
    Text,
    TomlTable,
)
from pfwd_plugins.quantities import MOTIONS, Measurand, motion

COLUMN_UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    **{quantity: quantity.units for quantity in (Measurand.LOAD, *MOTIONS)},
}
"""Units of a column of numbers, by what it has, as factors from the unit to SI."""

DELIMITERS = {",": ",", ";": ";", "\t": "\t", "tab": "\t", "|": "|", "blank": None}
"""Characters between columns, by the name in a map; None: one or more blanks."""


class Encoding(Text):
    """Type of a key whose value names a text encoding."""

    expected: ClassVar[str] = "an encoding such as utf-8 or cp1252"

    def accepts(self, value: Any) -> bool:
        """Return whether a value is the name of a text encoding."""
        try:
            # Some codecs are not for texts (hex, zip).
            return isinstance(value, str) and codecs.lookup(value)._is_text_encoding
        except (LookupError, ValueError):
            return False


@dataclass(frozen=True, slots=True)
class Column:
    """Column of numbers, with the factor that converts them to SI."""

    column: str | int
    """Name of the column, or its position from 1."""
    factor: float
    """SI units in one unit of the column; negative: the column is positive upward."""


@dataclass(frozen=True, slots=True)
class SensorColumn:
    """Column with the trace of a sensor."""

    where: Column
    quantity: Measurand
    offset: float
    """Distance from the plate centre, m; negative: the other side of the plate."""


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Layout of a text with columns of numbers."""

    file: str
    """Path of the map or of the text, for messages."""
    delimiter: str | None
    """Character between columns; None: one or more blanks."""
    decimal: str
    encoding: str
    skip_lines: int
    """Number of lines to skip before the column names, or before the numbers if there are no names.
    """
    names: bool
    """True if a line with column names precedes the numbers."""
    units_line: bool
    """True if the line after the names is skipped, because it holds units."""


@dataclass(frozen=True, slots=True)
class ColumnMap(TextLayout):
    """Layout of a text, and the meaning of its columns."""

    time: Column | None
    """Column with the time; None: `rate` replaces it."""
    rate: float | None
    """Sampling rate, Hz; None: the text has a column with the time."""
    trigger: float
    """Time in the file at which the trigger occurred, s; subtracted from all times."""
    load: Column
    sensors: tuple[SensorColumn, ...]
    drop: str | int | None
    """Column with the drop numbers; None: all rows belong to drop 1."""
    declarations: Declarations
    """Other keys of the map, which declare the measurement like header keys of a trace file."""


def read_map(path: str | os.PathLike[str]) -> ColumnMap:
    """Read a column map.

    Parameters
    ----------
    path : path of a TOML file

    Raises
    ------
    TraceError
        If the file cannot be read, a key is missing, or a value is outside its range.
    """
    file = os.fspath(path)
    return parse_map(parse_user_toml(read_toml_text(file, TraceError), file, TraceError), file)


_COLUMN_POSITION = AnyOf((Text(min_length=1), Integer(1)), "a name, or a position from 1")
_MAP_EXAMPLE = "an example is examples/column-map.toml"


def _column_keys(quantity: str) -> dict[str, Key]:
    """Return the keys that describe a column, with the allowed units of its quantity."""
    return {
        "column": Key(
            _COLUMN_POSITION, meaning="Name of the column, or its position.", hint=_MAP_EXAMPLE
        ),
        "unit": Key(
            Choice(COLUMN_UNITS[quantity]), meaning="Unit of the numbers.", hint=_MAP_EXAMPLE
        ),
        "factor": Key(
            Number(nonzero=True), meaning="SI units in one unit of the numbers.", hint=_MAP_EXAMPLE
        ),
    }


def _signed(keys: Mapping[str, Key]) -> dict[str, Key]:
    return {**keys, "positive": Key(Choice(("down", "up")), meaning="Positive direction.")}


_SENSOR_KEYS = _signed(
    {
        **_column_keys(Measurand.DISPLACEMENT),
        "unit": Key(
            Choice([unit for quantity in reversed(MOTIONS) for unit in quantity.units]),
            meaning="Unit of the numbers.",
            hint=_MAP_EXAMPLE,
        ),
        "quantity": Key(
            Choice(MOTIONS),
            meaning="Recorded quantity.",
            hint=_MAP_EXAMPLE,
            required=True,
        ),
        "offset_m": Key(
            Number("m"),
            "offset",
            "Distance from the plate centre; negative on the other side of the plate.",
            _MAP_EXAMPLE,
            required=True,
        ),
    }
)
COLUMN_MAP_KEYS = {
    "text": Key(
        TomlTable(
            {
                "delimiter": Key(Choice(DELIMITERS), meaning="Sign between columns."),
                "decimal": Key(Choice((".", ",")), meaning="Decimal sign."),
                "encoding": Key(Encoding(), meaning="Encoding of the text."),
                "skip_lines": Key(Integer(0, 100_000), meaning="Lines before the names."),
                "names": Key(Flag(), meaning="True: a line with names precedes the numbers."),
                "units_line": Key(Flag(), meaning="True: a line with units follows the names."),
            }
        ),
        meaning="Layout of the text.",
    ),
    "time": Key(
        TomlTable(
            {
                **_column_keys("time"),
                "sampling_rate_hz": Key(
                    Number("Hz", above=0), "rate", "Sampling rate, in place of a column."
                ),
                "trigger_s": Key(
                    Number("s"), "trigger", "Time of the trigger by the clock of the file."
                ),
            }
        ),
        meaning="Time of the samples.",
        hint=_MAP_EXAMPLE,
        required=True,
    ),
    "load": Key(
        TomlTable(_signed(_column_keys("load"))), meaning="Load.", hint=_MAP_EXAMPLE, required=True
    ),
    "sensor": Key(
        Array(TomlTable(_SENSOR_KEYS), min_items=1),
        "sensors",
        "Sensors, one table each.",
        _MAP_EXAMPLE,
        required=True,
    ),
    "drop": Key(
        TomlTable({"column": Key(_COLUMN_POSITION, meaning="Column with the number of the drop.")}),
        meaning="Number of the drop; without it the file is one drop.",
    ),
}
"""Keys of a column map; any other key declares the measurement, as in a header."""


def parse_map(table: Mapping[str, Any], file: str) -> ColumnMap:
    """Check the keys of a column map and return it.

    Parameters
    ----------
    table : mapping
        Content of the TOML file.
    file : str
        Path of the file, for messages.

    Raises
    ------
    TraceError
        If a key is missing, or a value is not accepted.
    """
    entries = {key: value for key, value in table.items() if key in COLUMN_MAP_KEYS}
    values = TableReader(TraceError, file).read(entries, COLUMN_MAP_KEYS)
    text, time, drop = (values.get(key, {}) for key in ("text", "time", "drop"))
    column_map = ColumnMap(
        file=file,
        delimiter=DELIMITERS[text.get("delimiter", ",")],
        decimal=text.get("decimal", "."),
        encoding=text.get("encoding", "utf-8-sig"),
        skip_lines=text.get("skip_lines", 0),
        names=text.get("names", True),
        units_line=text.get("units_line", False),
        time=_column(time, "time", f"{file}, time") if "column" in time else None,
        rate=time.get("rate"),
        trigger=time.get("trigger", 0.0),
        load=_column(values["load"], "load", f"{file}, load"),
        sensors=tuple(
            SensorColumn(
                _column(sensor, sensor["quantity"], f"{file}, sensor[{number}]"),
                motion(sensor["quantity"]),
                sensor["offset"],
            )
            for number, sensor in enumerate(values["sensors"], 1)
        ),
        drop=drop.get("column"),
        declarations={
            key: Declaration(value, file)
            for key, value in table.items()
            if key not in COLUMN_MAP_KEYS
        },
    )
    _refuse_contradictions(column_map)
    return column_map


def _column(values: Mapping[str, Any], quantity: str, where: str) -> Column:
    if "column" not in values:
        raise TraceError(
            refusal(f"{where}.column", _COLUMN_POSITION.expected, "none", _MAP_EXAMPLE)
        )
    units = COLUMN_UNITS[quantity]
    if ("unit" in values) == ("factor" in values):
        got = "both" if "unit" in values else "neither"
        expected = f"either unit ({', '.join(units)}) or factor to SI"
        raise TraceError(refusal(where, expected, got, _MAP_EXAMPLE))
    if "unit" in values:
        Key(Choice(units), hint=_MAP_EXAMPLE).check(values["unit"], f"{where}.unit", TraceError)
    factor = units[values["unit"]] if "unit" in values else values["factor"]
    return Column(values["column"], -factor if values.get("positive") == "up" else factor)


def _refuse_contradictions(column_map: ColumnMap) -> None:
    def require(holds: bool, key: str, expected: str, got: object) -> None:
        if not holds:
            place = f"{column_map.file}, {key}"
            raise TraceError(refusal(place, expected, quote(got), _MAP_EXAMPLE))

    has_time, has_rate = column_map.time is not None, column_map.rate is not None
    got = "both" if has_time else "neither"
    require(has_time != has_rate, "time", "either column or sampling_rate_hz", got)
    distinct = column_map.decimal != column_map.delimiter
    require(distinct, "text.decimal", "another sign than the delimiter", column_map.decimal)
    columns = [column_map.load, *(sensor.where for sensor in column_map.sensors)]
    columns += [column_map.time] if column_map.time else []
    places = [column.column for column in columns]
    places += [] if column_map.drop is None else [column_map.drop]
    require(len(set(places)) == len(places), "column", "every column once", places)
    named = any(isinstance(place, str) for place in places)
    expected = "positions from 1, as the file has no names"
    require(column_map.names or not named, "column", expected, places)
    kinds = [(sensor.quantity, sensor.offset) for sensor in column_map.sensors]
    require(len(set(kinds)) == len(kinds), "sensor", "every sensor at another offset", kinds)
