"""Schema of the TOML files that users write: keys, accepted values, units and meanings.

Users write setup files (instrument), headers (declarations about imported traces), column maps
(columns of a delimited text), procedures (test standards) and scenarios (simulated instruments).
Each key is described once, by a :class:`Key`. The description serves the reader, its error
messages and the JSON Schema with which a text editor completes and checks a file.
"""

import dataclasses
import datetime
import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

from pfwd_device.errors import quote, refusal

JSON_SCHEMA = "https://json-schema.org/draft/2020-12/schema"

_KEY = "pfwd key"
"""Name under which the metadata of a dataclass field hold the name of its key and the `Key`."""


class Value(Protocol):
    """Interface of the kinds of value that a key of a TOML file can have."""

    @property
    def expected(self) -> str:
        """Description of the accepted values for a message, such as "a number > 0, in m"."""
        ...

    def accepts(self, value: Any) -> bool:
        """Return True if the key accepts a value, given as the TOML parser returned it."""
        ...

    def convert(self, value: Any) -> Any:
        """Return an accepted value in the type that the program uses, for example a float."""
        ...

    def json_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the accepted values."""
        ...


class _Unchanged:
    """Mixin for values that the program uses in the type that the TOML parser returns."""

    def convert(self, value: Any) -> Any:
        return value


@dataclass(frozen=True, slots=True)
class Number:
    """Real number within limits. Infinity is accepted only if it has a declared meaning."""

    unit: str = ""
    above: float = -math.inf
    """Exclusive lower limit."""
    minimum: float = -math.inf
    below: float = math.inf
    """Exclusive upper limit."""
    maximum: float = math.inf
    nonzero: bool = False
    integral: bool = False
    """True: only whole numbers are accepted, also written as 3.0."""
    infinity_means: str = ""
    """Meaning of inf; empty: inf is not accepted."""

    @property
    def expected(self) -> str:
        signs = ((">", self.above), (">=", self.minimum), ("<", self.below), ("<=", self.maximum))
        limits = [f"{sign} {limit:.10g}" for sign, limit in signs if math.isfinite(limit)]
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            limits = [f"from {self.minimum:.10g} to {self.maximum:.10g}"]
        if self.nonzero:
            limits.append("other than 0")
        kind = "a whole number" if self.integral else "a number" if limits else "a finite number"
        text = f"{kind} {' and '.join(limits)}".strip()
        text += f", in {self.unit}" if self.unit else ""
        return text + (f", or inf for {self.infinity_means}" if self.infinity_means else "")

    def accepts(self, value: Any) -> bool:
        # bool is an int to Python.
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            return False
        if number == math.inf:
            return bool(self.infinity_means)
        return (
            math.isfinite(number)
            and self.above < number < self.below
            and self.minimum <= number <= self.maximum
            and not (self.nonzero and number == 0)
            and not (self.integral and number != int(number))
        )

    def convert(self, value: Any) -> float:
        return float(value)

    def json_schema(self) -> dict[str, Any]:
        limits = {
            "exclusiveMinimum": self.above,
            "minimum": self.minimum,
            "exclusiveMaximum": self.below,
            "maximum": self.maximum,
        }
        schema: dict[str, Any] = {"type": "integer" if self.integral else "number"}
        if not self.infinity_means:
            schema |= {name: limit for name, limit in limits.items() if math.isfinite(limit)}
        else:  # an accepted infinity exceeds each upper limit: keep the lower limits only
            schema |= {name: v for name, v in list(limits.items())[:2] if math.isfinite(v)}
        return schema | ({"not": {"const": 0}} if self.nonzero else {})


@dataclass(frozen=True, slots=True)
class Integer(_Unchanged):
    """Whole number within limits, written without a decimal point."""

    minimum: int
    maximum: int | None = None

    @property
    def expected(self) -> str:
        if self.maximum is None:
            return f"a whole number >= {self.minimum}"
        return f"a whole number from {self.minimum} to {self.maximum}"

    def accepts(self, value: Any) -> bool:
        return (
            type(value) is int
            and self.minimum <= value
            and (self.maximum is None or value <= self.maximum)
        )

    def json_schema(self) -> dict[str, Any]:
        top = {} if self.maximum is None else {"maximum": self.maximum}
        return {"type": "integer", "minimum": self.minimum, **top}


@dataclass(frozen=True, slots=True)
class Text(_Unchanged):
    """Text; with a limit of its length it must be one line of printable characters."""

    max_length: int | None = None
    """Largest number of characters; None: no limit, and line breaks are accepted."""
    min_length: int = 0
    """Smallest number of characters, without leading and trailing blanks."""

    @property
    def expected(self) -> str:
        if self.max_length is None:
            return "text in quotation marks" + (", not empty" if self.min_length else "")
        return f"text of {self.min_length} to {self.max_length} letters on one line"

    def accepts(self, value: Any) -> bool:
        if not isinstance(value, str) or len(value.strip()) < self.min_length:
            return False
        return self.max_length is None or (len(value) <= self.max_length and value.isprintable())

    def json_schema(self) -> dict[str, Any]:
        top = {} if self.max_length is None else {"maxLength": self.max_length}
        return {"type": "string", **({"pattern": r"\S"} if self.min_length else {}), **top}


@dataclass(frozen=True, slots=True)
class Choice(_Unchanged):
    """Text that must be one of several given words."""

    words: Iterable[str] | Callable[[], Iterable[str]]
    """The accepted words, or a function that returns them where they are known only later."""

    def _words(self) -> list[str]:
        # A StrEnum class is iterable and callable: its members are the words.
        return list(self.words if isinstance(self.words, Iterable) else self.words())

    @property
    def expected(self) -> str:
        return " or ".join(f'"{word}"' for word in self._words())

    def accepts(self, value: Any) -> bool:
        return isinstance(value, str) and value in self._words()

    def json_schema(self) -> dict[str, Any]:
        return {"enum": [str(word) for word in self._words()]}


@dataclass(frozen=True, slots=True)
class Flag(_Unchanged):
    """The value true or false."""

    expected: ClassVar[str] = "true or false"

    def accepts(self, value: Any) -> bool:
        return isinstance(value, bool)

    def json_schema(self) -> dict[str, Any]:
        return {"type": "boolean"}


@dataclass(frozen=True, slots=True)
class Date:
    """Calendar date without a time of day."""

    text: bool = False
    """True: the date may also be a text in quotation marks, "2026-05-31"."""

    @property
    def expected(self) -> str:
        return "a date as 2026-05-31" + ("" if self.text else ", without quotation marks")

    def accepts(self, value: Any) -> bool:
        try:
            value = self.convert(value)
        except ValueError:
            return False
        return isinstance(value, datetime.date) and not isinstance(value, datetime.datetime)

    def convert(self, value: Any) -> Any:
        is_text = self.text and isinstance(value, str)
        return datetime.date.fromisoformat(value) if is_text else value

    def json_schema(self) -> dict[str, Any]:
        return {"type": "string", "format": "date"}


@dataclass(frozen=True, slots=True)
class AnyOf(_Unchanged):
    """Value of one of several kinds, for example a number or a word."""

    kinds: tuple[Value, ...]
    expected: str

    def accepts(self, value: Any) -> bool:
        return any(kind.accepts(value) for kind in self.kinds)

    def json_schema(self) -> dict[str, Any]:
        return {"anyOf": [kind.json_schema() for kind in self.kinds]}


@dataclass(frozen=True, slots=True)
class TomlTable(_Unchanged):
    """TOML table within a table; :class:`TableReader` checks the values inside it."""

    keys: Mapping[str, "Key"]
    expected: str = "a table"
    build: Callable[..., Any] | None = None
    """Class that is called with the values of the keys; None: the value is a dictionary."""

    def accepts(self, value: Any) -> bool:
        return isinstance(value, Mapping)

    def json_schema(self) -> dict[str, Any]:
        return table_schema(self.keys)


@dataclass(frozen=True, slots=True)
class Array:
    """TOML array whose items are of one kind; `TomlTable` items make an array of tables."""

    item: Value
    min_items: int = 0

    @property
    def expected(self) -> str:
        items = "an array of tables" if isinstance(self.item, TomlTable) else "an array"
        return f"{items} with {self.min_items} or more" if self.min_items else items

    def accepts(self, value: Any) -> bool:
        # The items are checked one by one, so that a message names the one at fault.
        return isinstance(value, list | tuple) and len(value) >= self.min_items

    def convert(self, value: Any) -> Any:
        return tuple(self.item.convert(item) for item in value)

    def json_schema(self) -> dict[str, Any]:
        schema: dict[str, Any] = {"type": "array", "items": self.item.json_schema()}
        return schema | ({"minItems": self.min_items} if self.min_items else {})


@dataclass(frozen=True, slots=True)
class Key:
    """Description of one key of a TOML table."""

    value: Value
    """Kind of the accepted values."""
    attribute: str = ""
    """Name of the value in the result of `TableReader.read`; empty: the name of the key."""
    meaning: str = ""
    """Description of the key in the JSON Schema."""
    hint: str = ""
    """Advice in the message that refuses a value."""
    required: bool = False
    """True: a table without the key is refused."""

    def optional(self) -> "Key":
        """Return a copy of this key that a table need not have."""
        return dataclasses.replace(self, required=False)

    def check(self, value: object, where: str, error: type[Exception]) -> None:
        """Raise an error if the key does not accept a value.

        Parameters
        ----------
        value : object
            Value as the TOML parser returned it.
        where : str
            File, line and key, for the message.
        error : type of exception
            Class of the error to raise.
        """
        if not self.value.accepts(value):
            raise error(refusal(where, self.value.expected, quote(value), self.hint))


def describe(value: Value, meaning: str = "", *, key: str = "", hint: str = "") -> dict[str, Any]:
    """Return the metadata of a dataclass field whose value is read from a key of a TOML file.

    :func:`keys_of` collects them. A field without a default is a required key.

    Parameters
    ----------
    value : Value
        Kind of the accepted values.
    meaning : str
        Description of the key in the JSON Schema.
    key : str
        Name of the key in the file; empty: the name of the field.
    hint : str
        Advice in the message that refuses a value.
    """
    return {_KEY: (key, Key(value, "", meaning, hint))}


def declared(
    default: Any, value: Value, meaning: str = "", *, key: str = "", hint: str = ""
) -> Any:
    """Return a dataclass field with a default, whose value may be read from a key of a TOML file.

    Parameters
    ----------
    default : object
        Value of the field if the file does not have the key.
    value, meaning, key, hint
        As in :func:`describe`.
    """
    return field(default=default, metadata=describe(value, meaning, key=key, hint=hint))


def keys_of(class_: type[Any]) -> dict[str, Key]:
    """Return the keys of a TOML table that :func:`describe` declares for a dataclass, by name."""
    keys = {}
    for item in dataclasses.fields(class_):
        if _KEY in item.metadata:
            name, key = item.metadata[_KEY]
            missing = item.default is dataclasses.MISSING
            no_default = missing and item.default_factory is dataclasses.MISSING
            keys[name or item.name] = dataclasses.replace(
                key, attribute=item.name, required=no_default
            )
    return keys


def table_of(class_: type[Any]) -> TomlTable:
    """Return the kind of a TOML table that is read into an object of a dataclass."""
    return TomlTable(keys_of(class_), build=class_)


@dataclass(frozen=True, slots=True)
class TableReader:
    """Checks and converts TOML tables; its errors name the file, the key and the value."""

    error: type[Exception]
    """Class of the errors to raise."""
    path: str = field(default="")
    """Name of the file, for the messages."""

    def read(self, table: object, keys: Mapping[str, Key], where: str = "") -> dict[str, Any]:
        """Return the converted values of a table by `Key.attribute`.

        A table inside is converted to an object of its `Table.build`, or to a dictionary.

        Parameters
        ----------
        table : object
            Value as the TOML parser returned it.
        keys : mapping of str to Key
            Keys that the table may have, by name.
        where : str
            Place of the table in the file, such as ``channels[2]``; empty: the file itself.

        Raises
        ------
        Exception
            Of the class `error`: a key is unknown or missing, or a value is not accepted.
        """
        if not isinstance(table, Mapping):
            raise self.error(refusal(self._place(where), "a table", quote(table)))
        for name in table:
            if name not in keys:
                raise self.error(unknown_key(name, keys, self._place(where)))
        values = {}
        for name, key in keys.items():
            inner = f"{where}.{name}" if where else name
            if name in table:
                values[key.attribute or name] = self._value(key, table[name], inner)
            elif key.required:
                raise self.error(refusal(self._place(inner), key.value.expected, "none", key.hint))
        return values

    def _value(self, key: Key, value: Any, where: str) -> Any:
        key.check(value, self._place(where), self.error)
        kind = key.value
        if isinstance(kind, TomlTable):
            values = self.read(value, kind.keys, where)
            return values if kind.build is None else kind.build(**values)
        if isinstance(kind, Array):
            item_key = dataclasses.replace(key, value=kind.item)
            items = enumerate(value, 1)
            return tuple(self._value(item_key, item, f"{where}[{n}]") for n, item in items)
        return kind.convert(value)

    def _place(self, where: str) -> str:
        return f"{self.path}, {where}" if self.path and where else self.path or where


def readable_values(table: object, keys: Mapping[str, Key]) -> dict[str, Any]:
    """Return the valid values of a table by `Key.attribute`; skip unknown keys and invalid values.

    It serves for tables that another version of the program stored. Values inside a nested table
    are not checked.

    Parameters
    ----------
    table : object
        Stored table; anything but a mapping gives an empty result.
    keys : mapping of str to Key
        Known keys, by name.
    """
    if not isinstance(table, Mapping):
        return {}

    def is_readable(kind: Value, value: Any) -> bool:
        if not kind.accepts(value):
            return False
        return not isinstance(kind, Array) or all(map(kind.item.accepts, value))

    return {
        key.attribute or name: key.value.convert(table[name])
        for name, key in keys.items()
        if name in table and is_readable(key.value, table[name])
    }


def unknown_key(name: str, keys: Iterable[str], where: str) -> str:
    """Return the message that refuses an unknown key and suggests a similar known key.

    Parameters
    ----------
    name : str
        The unknown key.
    keys : iterable of str
        The known keys; all are listed if none is similar.
    where : str
        File and table, for the message.
    """
    keys = list(keys)
    similar = difflib.get_close_matches(name, keys, 1)
    hint = f"did you mean {similar[0]}?" if similar else f"known are {', '.join(keys)}"
    return refusal(where, "a known key", quote(name), hint)


def table_schema(keys: Mapping[str, Key], *, more_keys: bool = False) -> dict[str, Any]:
    """Return the JSON Schema of a TOML table as a dictionary.

    Parameters
    ----------
    keys : mapping of str to Key
        Keys of the table, by name.
    more_keys : bool
        True: keys of any other name are accepted.
    """
    properties = {}
    for name, key in keys.items():
        described = key.value.json_schema()
        meaning = f"{key.meaning[:1].upper()}{key.meaning[1:]}".rstrip(".")
        sentences = [meaning] if meaning else []
        if not isinstance(key.value, TomlTable | Array):
            sentences.append(f"Expected {key.value.expected}")
        if sentences:
            described["description"] = f"{'. '.join(sentences)}."
        properties[name] = described
    required = [name for name, key in keys.items() if key.required]
    return {
        "type": "object",
        "properties": properties,
        **({"required": required} if required else {}),
        "additionalProperties": more_keys,
    }
