"""Base class of records: frozen dataclasses that are written to JSON and read from it.

The fields are the keys of the JSON. The type of a field decides which values are accepted. A value
of another type and an unknown key are errors. `quantity` gives a field its meaning and unit, from
which the columns of tables are generated.
"""

import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import (
    Any,
    ClassVar,
    Literal,
    Self,
    TypeGuard,
    get_args,
    get_origin,
    get_type_hints,
)

from inversion import notices
from inversion.errors import RecordFormatError
from inversion.notices import WARNING_CODES, WARNINGS, Notice, text_of

Interval = tuple[float, float]
DepthRange = tuple[float, float | None]
"""Depths from and to, m; to None: any depth below."""

TableColumn = Literal["established", "layers", "last"]
"""Part of a table in which a quantity is a column. New quantities are in the last part, so that
readers who count columns are not disturbed. None: the quantity is in no table."""


def quantity(
    meaning: str, unit: str = "", *, column: TableColumn | None = "last", default: Any = None
) -> Any:
    """Return a dataclass field for a quantity that some results do not have.

    Parameters
    ----------
    meaning : str
        Name of the quantity, without its unit.
    unit : str
        SI unit.
    column : TableColumn or None
        Part of the table in which the quantity is a column.
    default : optional
        Value of a result that does not have it.
    """
    metadata = {"meaning": meaning, "unit": unit, "column": column}
    return dataclasses.field(default=default, metadata=metadata)


def required(meaning: str, unit: str = "", *, column: TableColumn | None = "last") -> Any:
    """Return a dataclass field for a quantity that every record has, see `quantity`."""
    return quantity(meaning, unit, column=column, default=dataclasses.MISSING)


def not_stored(default: Any = None, *, repr: bool = True) -> Any:
    """Return a dataclass field that is not written to JSON, and not compared between records."""
    return dataclasses.field(default=default, repr=repr, compare=False, metadata={"stored": False})


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class JsonRecord:
    """Frozen dataclass that is written as JSON and read from it.

    Examples
    --------
    >>> @dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
    ... class Peak(JsonRecord):
    ...     load_n: float | None = None
    >>> peak = Peak.from_json({"load_n": 8000.0})
    >>> peak.load_n, peak.to_json()
    (8000.0, {'load_n': 8000.0})
    """

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset()
    """Keys that are written only if their value is not None."""

    FIRST: ClassVar[tuple[str, ...]] = ()
    """Keys that are written before those of the base class."""

    def to_json(self) -> dict[str, Any]:
        """Return the record as values that JSON can hold, in the order of its keys."""
        written: dict[str, Any] = {}
        for name in _readers(type(self)):
            value = getattr(self, name)
            if value is not None or name not in self.OPTIONAL_KEYS:
                written[name] = _plain(value)
                if name == WARNINGS:
                    written[WARNING_CODES] = _codes(value)
        return written

    def to_dict(self) -> dict[str, Any]:
        """Return the values of `to_json`, with None in place of NaN and infinity."""
        return {key: without_nan(value) for key, value in self.to_json().items()}

    def __getitem__(self, key: str) -> Any:
        values = self.to_dict()
        if key not in values:
            raise KeyError(f"expected one of {', '.join(values)}, got {key!r}")
        return values[key]

    @classmethod
    def from_json(cls, written: object) -> Self:
        """Return the record that JSON contains.

        Parameters
        ----------
        written : mapping
            Parsed JSON.

        Raises
        ------
        RecordFormatError
            If it is not a mapping, has an unknown key, lacks one that `to_json` always writes, or
            has a value of another type than its key requires.
        """
        if not isinstance(written, Mapping):
            got = type(written).__name__
            raise RecordFormatError(f"expected a record with its keys, got {got}")
        readers = _readers(cls)
        values: dict[str, Any] = {}
        for key, value in written.items():
            if key == WARNING_CODES and WARNINGS in readers:
                continue
            if key not in readers:
                raise RecordFormatError(f"expected one of {', '.join(readers)}, got {key!r}")
            read, may_be_none = readers[key]
            values[key] = None if value is None else read(value)
            if values[key] is None and not (value is None and may_be_none):
                raise RecordFormatError(f"{key}: expected a value of its type, got {value!r}")
        for key in readers:
            if key not in values and key not in cls.OPTIONAL_KEYS:
                raise RecordFormatError(f"{key}: expected a value, got none")
        if WARNINGS in values:
            values[WARNINGS] = notices.from_json(written[WARNINGS], written.get(WARNING_CODES))
        return cls(**values)

    def values(self, keys: Iterable[str]) -> dict[str, Any]:
        """Return the values of some fields as in `to_json`."""
        values = {key: getattr(self, key) for key in keys}
        return {
            key: _plain(value)
            for key, value in values.items()
            if value is not None or key not in self.OPTIONAL_KEYS
        }


def _codes(warnings: Iterable[Notice] | None) -> list[dict[str, Any]] | None:
    return None if warnings is None else notices.codes(warnings)


def stored_fields(kind: "type[JsonRecord]") -> list[dataclasses.Field[Any]]:
    """Return the fields of a record class that are written to JSON."""
    fields = dataclasses.fields(kind)
    return [f for f in fields if f.metadata.get("stored", True)]


def without_nan(value: Any) -> Any:
    """Return a value with None in place of every NaN and infinity in it; arrays become lists."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {str(key): without_nan(item) for key, item in value.items()}
        case list() | tuple():
            return [without_nan(item) for item in value]
    return value


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite int or float; bool does not count.

    Examples
    --------
    >>> [is_number(value) for value in (2, 0.5, True, float("nan"), 10**400, "2")]
    [True, True, False, False, False, False]
    """
    try:
        return (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and math.isfinite(float(value))
        )
    except OverflowError:  # an int that is too large for a float
        return False


def _number(value: Any) -> float | None:
    if type(value) is float:  # also NaN and infinity, which a computed result may have
        return value
    return float(value) if is_number(value) else None


def _whole(value: Any) -> int | None:
    return value if type(value) is int else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _free_text(value: Any) -> str | int | float | None:
    return value if isinstance(value, str) or is_number(value) else None


def _flag(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _interval(value: Any) -> Interval | None:
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    low, high = map(_number, value)
    return None if low is None or high is None else (low, high)


def _depth_range(value: Any) -> DepthRange | None:
    if isinstance(value, list | tuple) and len(value) == 2 and value[1] is None:
        top = _number(value[0])
        return None if top is None else (top, None)
    return _interval(value)


def _notices(value: Any) -> tuple[Notice, ...] | None:
    texts = _tuple_of(_text)(value)
    return None if texts is None else notices.from_json(texts)


_Reader = Callable[[Any], Any]
"""Function that returns the value of a field from JSON; None: the value is of another type."""

_READERS: dict[Any, _Reader] = {
    float: _number,
    int: _whole,
    str: _text,
    str | int | float: _free_text,
    bool: _flag,
    Interval: _interval,
    DepthRange: _depth_range,
    tuple[Notice, ...]: _notices,
    Notice: notices.from_entry,
}


_known: dict[type[JsonRecord], Mapping[str, tuple[_Reader, bool]]] = {}


def _readers(kind: type[JsonRecord]) -> Mapping[str, tuple[_Reader, bool]]:
    """Return the function that reads each field, and whether the field may be None, in order."""
    if kind not in _known:
        hints = get_type_hints(kind)
        names = [item.name for item in stored_fields(kind)]
        first = [name for name in kind.FIRST if name in names]
        names = [*first, *(name for name in names if name not in first)]
        inner = {name: without_none(hints[name]) for name in names}
        _known[kind] = {
            name: (_reader(hint), hint is not hints[name]) for name, hint in inner.items()
        }
    return _known[kind]


def without_none(hint: Any) -> Any:
    """Return the type of a field without its None."""
    parts = get_args(hint)
    if type(None) not in parts:
        return hint
    return functools.reduce(operator.or_, (part for part in parts if part is not type(None)))


def _reader(hint: Any) -> _Reader:
    if hint in _READERS:
        return _READERS[hint]
    if get_origin(hint) is Literal:
        words = get_args(hint)
        return lambda value: value if isinstance(value, str) and value in words else None
    if get_origin(hint) is tuple:
        return _tuple_of(_reader(get_args(hint)[0]))
    return lambda value: hint.from_json(value) if isinstance(value, Mapping) else None


def _tuple_of(read: _Reader) -> _Reader:
    def read_all(value: Any) -> tuple[Any, ...] | None:
        items = tuple(map(read, value)) if isinstance(value, list | tuple) else (None,)
        return None if None in items else items

    return read_all


def _plain(value: Any) -> Any:
    if isinstance(value, JsonRecord):
        return value.to_json()
    if isinstance(value, tuple):
        return [text_of(item) if isinstance(item, Notice) else _plain(item) for item in value]
    if isinstance(value, Notice):
        return value.to_json()
    return value
