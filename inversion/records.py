"""Records: frozen dataclasses whose fields are the keys of their JSON, with unit and meaning.

The type of a field decides what is read. A value of another type is not taken for one but kept in
``more``, as is an unknown key, and both are written again as they were read. `quantity` gives a
field its meaning and its unit, from which the columns of tables are generated.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from typing import (
    Any,
    ClassVar,
    Literal,
    Self,
    TypeGuard,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from inversion import notices
from inversion.errors import RecordFormatError
from inversion.notices import WARNING_CODES, WARNINGS, Notice

Interval = tuple[float, float]
_T = TypeVar("_T")

TableColumn = Literal["established", "layers", "last"]
"""Part of a table that a quantity stands in. New ones come last, so that readers who count columns
are not disturbed. None: it is in no table."""


def quantity(meaning: str = "", unit: str = "", *, column: TableColumn | None = "last") -> Any:
    """Return a field of a record whose default is None.

    Parameters
    ----------
    meaning : str
        What the value is, without its unit.
    unit : str
        SI.
    column : TableColumn or None
    """
    metadata = {"meaning": meaning, "unit": unit, "column": column}
    return dataclasses.field(default=None, metadata=metadata)


def not_stored(default: Any = None, *, repr: bool = True) -> Any:
    """Return a field of a record that belongs to this run alone.

    No JSON has it, and records that differ in it alone are equal.
    """
    return dataclasses.field(default=default, repr=repr, compare=False, metadata={"stored": False})


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class JsonRecord:
    """Frozen dataclass that is written as JSON and read from it.

    Examples
    --------
    >>> @dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
    ... class Peak(JsonRecord):
    ...     load_n: float | None = None
    >>> peak = Peak.from_json({"load_n": 8000.0, "colour": "red"})
    >>> peak.load_n, peak.to_json()
    (8000.0, {'load_n': 8000.0, 'colour': 'red'})
    """

    OPTIONAL_KEYS: ClassVar[frozenset[str]] = frozenset()
    """Keys that are written only when there is a value."""

    FIRST: ClassVar[tuple[str, ...]] = ()
    """Keys that are written before those of the base class."""

    more: Mapping[str, Any] = dataclasses.field(default_factory=dict, kw_only=True)
    """By key: what this version does not know, and values of another type than a key has."""

    def to_json(self) -> dict[str, Any]:
        """Return the record with the keys of its JSON, in their order."""
        written: dict[str, Any] = {}
        for name in _readers(type(self)):
            value = getattr(self, name)
            if value is not None or name not in self.OPTIONAL_KEYS:
                written[name] = _plain(value)
                if name == WARNINGS:
                    written[WARNING_CODES] = _codes(value)
        return written | dict(self.more)

    @classmethod
    def from_json(cls, written: object, where: str = "a stored record") -> Self:
        """Return the record that was written as JSON, by any version of any program.

        Parameters
        ----------
        written : mapping
            Parsed JSON.
        where : str
            File or place, for the error.

        Raises
        ------
        RecordFormatError
            If it is no mapping; a single value that cannot be used is no error, see ``more``.
        """
        if not isinstance(written, Mapping):
            found = type(written).__name__
            raise RecordFormatError(f"{where}: expected a record with its keys, got {found}")
        readers = _readers(cls)
        known: dict[str, Any] = {}
        more: dict[str, Any] = {}
        for key, value in written.items():
            read = readers.get(key)
            if read is None:
                more[str(key)] = value
            elif value is not None:
                known[key] = read(value)
                if known[key] is None:
                    more[key] = value
        if known.get(WARNINGS) is not None:
            known[WARNINGS] = notices.from_json(written[WARNINGS], more.pop(WARNING_CODES, None))
        elif WARNINGS in readers and more.get(WARNING_CODES, 0) is None:
            del more[WARNING_CODES]
        return cls(**known, more=more)

    def values(self, keys: Iterable[str]) -> dict[str, Any]:
        """Return what :meth:`to_json` has for these keys; records within it are left out."""
        readers, more = _readers(type(self)), self.more
        written: dict[str, Any] = {}
        for key in keys:
            if key in more:
                written[key] = more[key]
            elif key in readers:
                value = getattr(self, key)
                if (value is None and key in self.OPTIONAL_KEYS) or isinstance(value, JsonRecord):
                    continue
                written[key] = _plain(value)
            elif key == WARNING_CODES and WARNINGS in readers:
                written[key] = _codes(getattr(self, WARNINGS))
        return written

    @property
    def unreadable(self) -> frozenset[str]:
        """Keys whose value was of another type."""
        return frozenset(_readers(type(self))) & frozenset(self.more)


def _codes(warnings: Iterable[Notice] | None) -> list[dict[str, Any]] | None:
    return None if warnings is None else notices.codes(warnings)


def known(value: _T | None) -> _T:
    """Return a value of a record that has to be there.

    Raises
    ------
    ValueError
        If it is None.
    """
    if value is None:
        raise ValueError("expected a result with this value, got one without it")
    return value


def stored_fields(kind: "type[JsonRecord]") -> list[dataclasses.Field[Any]]:
    """Return the fields of a record that its JSON has."""
    fields = dataclasses.fields(kind)
    return [f for f in fields if f.name != "more" and f.metadata.get("stored", True)]


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite number; True and False are none.

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
    except OverflowError:  # a whole number beyond what can be computed with
        return False


def _number(value: Any) -> float | None:
    if type(value) is float:  # nearly always
        return value if math.isfinite(value) else None
    return value if is_number(value) else None


def _whole(value: Any) -> int | None:
    return value if type(value) is int else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None


def _free_text(value: Any) -> str | int | float | None:
    return value if isinstance(value, str) or is_number(value) else None


def _flag(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None


def _interval(value: Any) -> Interval | None:
    sound = isinstance(value, list | tuple) and len(value) == 2 and all(map(is_number, value))
    return (value[0], value[1]) if sound else None


def _texts(value: Any) -> tuple[str, ...] | None:
    sound = isinstance(value, list | tuple) and all(isinstance(item, str) for item in value)
    return tuple(value) if sound else None


def _notices(value: Any) -> tuple[Notice, ...] | None:
    texts = _texts(value)
    return None if texts is None else notices.from_json(texts)


def _numbers(value: Any) -> tuple[int, ...] | None:
    sound = isinstance(value, list | tuple) and all(type(item) is int for item in value)
    return tuple(value) if sound else None


_READERS: dict[Any, Callable[[Any], Any]] = {
    float | None: _number,
    int | None: _whole,
    str | None: _text,
    str | int | float | None: _free_text,
    bool | None: _flag,
    Interval | None: _interval,
    tuple[str, ...] | None: _texts,
    tuple[int, ...] | None: _numbers,
    tuple[Notice, ...] | None: _notices,
}


_known: dict[type[JsonRecord], Mapping[str, Callable[[Any], Any]]] = {}


def _readers(kind: type[JsonRecord]) -> Mapping[str, Callable[[Any], Any]]:
    """How each field of a record is read, in the order of the fields."""
    if kind not in _known:
        hints = get_type_hints(kind)
        names = [item.name for item in stored_fields(kind)]
        first = [name for name in kind.FIRST if name in names]
        names = [*first, *(name for name in names if name not in first)]
        _known[kind] = {name: _reader(hints[name]) for name in names}
    return _known[kind]


def _reader(hint: Any) -> Callable[[Any], Any]:
    if hint in _READERS:
        return _READERS[hint]
    (inner,) = (part for part in get_args(hint) if part is not type(None))
    if get_origin(inner) is Literal:
        words = get_args(inner)
        return lambda value: value if isinstance(value, str) and value in words else None
    if get_origin(inner) is tuple:
        return _records_of(get_args(inner)[0])
    return _record_of(inner)


def _record_of(kind: type[JsonRecord]) -> Callable[[Any], JsonRecord | None]:
    return lambda value: kind.from_json(value) if isinstance(value, Mapping) else None


def _records_of(kind: type[JsonRecord]) -> Callable[[Any], tuple[JsonRecord, ...] | None]:
    def read(value: Any) -> tuple[JsonRecord, ...] | None:
        sound = isinstance(value, list | tuple) and all(isinstance(v, Mapping) for v in value)
        return tuple(kind.from_json(item) for item in value) if sound else None

    return read


def _plain(value: Any) -> Any:
    if isinstance(value, JsonRecord):
        return value.to_json()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Notice):
        return str(value)
    return value
