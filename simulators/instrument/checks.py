"""TOML tables as frozen dataclasses, strictly: an error names the key at fault."""

from __future__ import annotations

import dataclasses
import datetime
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, field
from typing import Any, NamedTuple

from simulators.mesh import SimulationError


class ScenarioError(SimulationError, ValueError):
    """A scenario cannot be simulated as it is written; the message names the key."""


class Requirement(NamedTuple):
    """What a value has to be."""

    holds: Callable[[Any], bool]
    expected: str


ANY = Requirement(
    lambda value: not isinstance(value, float) or math.isfinite(value), "a finite number"
)
POSITIVE = Requirement(lambda value: 0 < value < math.inf, "> 0")
POSITIVE_OR_INFINITE = Requirement(lambda value: value > 0, "> 0, or inf")
AT_LEAST_0 = Requirement(lambda value: 0 <= value < math.inf, ">= 0")
FRACTION = Requirement(lambda value: 0 <= value <= 1, "0 to 1")


def below(limit: float) -> Requirement:
    """At least 0 and less than a limit."""
    return Requirement(lambda value: 0 <= value < limit, f"0 to below {limit:g}")


def one_of(*values: object) -> Requirement:
    """One of a few values."""
    return Requirement(lambda value: value in values, "one of " + ", ".join(map(str, values)))


def key(default: Any, rule: Requirement, meaning: str, table: type | None = None) -> Any:
    """A field of a dataclass that is a key of a table.

    Parameters
    ----------
    rule : for the value, or for every value of an array
    meaning : for the reader of this source
    table : the dataclass of a table, or of each table of an array
    """
    return field(default=default, metadata=about(rule, meaning, table))


def about(rule: Requirement, meaning: str, table: type | None = None) -> dict[str, Any]:
    """The metadata of a field that is a key of a table; see `key`."""
    return {"rule": rule, "meaning": meaning, "table": table}


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Tables over tables, key by key; arrays are replaced as a whole."""
    result = dict(base)
    for name, value in over.items():
        below_it = result.get(name)
        both = isinstance(value, Mapping) and isinstance(below_it, Mapping)
        result[name] = merged(below_it, value) if both and below_it is not None else value
    return result


def read_table(class_: type[Any], table: Any, source: str, where: str) -> Any:
    """The dataclass that a table describes.

    Parameters
    ----------
    source : of the scenario, for messages
    where : path of the table within it, with a dot at the end, for messages

    Raises
    ------
    ScenarioError
        If a key is unknown or its value is not of its type or range.
    """
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{source}: {where.rstrip('.')}: expected a table, got {table!r}")
    fields = {entry.name: entry for entry in dataclasses.fields(class_)}
    hints = typing.get_type_hints(class_)
    values = {}
    for name, value in table.items():
        if name not in fields:
            known = ", ".join(n for n, f in fields.items() if "hidden" not in f.metadata)
            raise ScenarioError(f"{source}: {where}{name}: unknown key; known are {known}")
        values[name] = _read(fields[name], hints[name], value, source, where + name)
    for name, entry in fields.items():
        if name not in values and entry.default is MISSING:
            raise ScenarioError(f"{source}: {where}{name}: expected a value, got none")
    if hasattr(class_, "KEYS"):
        _check_keys_of_kind(class_, values, source, where)
    return class_(**values)


def _check_keys_of_kind(
    class_: type[Any], values: Mapping[str, Any], source: str, where: str
) -> None:
    """A key that only another kind of fault or effect takes is a mistake here."""
    kind = values.get("kind")
    if kind is None:
        raise ScenarioError(f"{source}: {where}kind: expected one of {', '.join(class_.KEYS)}")
    special = {name for names in class_.KEYS.values() for name in names}
    for name in values:
        if name in special and name not in class_.KEYS[kind]:
            taken = ", ".join(class_.KEYS[kind]) or "none"
            raise ScenarioError(f"{source}: {where}{name}: unknown to a {kind}, which has: {taken}")


def _read(entry: Any, hint: Any, value: Any, source: str, where: str) -> Any:
    if "hidden" in entry.metadata:
        return value
    table, rule = entry.metadata["table"], entry.metadata["rule"]
    if table is not None and typing.get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise ScenarioError(f"{source}: {where}: expected an array of tables, got {value!r}")
        parts = enumerate(value, start=1)
        return tuple(read_table(table, part, source, f"{where}[{i}].") for i, part in parts)
    if table is not None:
        return read_table(table, value, source, where + ".")
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise ScenarioError(f"{source}: {where}: expected an array, got {value!r}")
        (type_, _) = typing.get_args(hint)
        return tuple(_value(part, type_, rule, source, where) for part in value)
    return _value(value, hint, rule, source, where)


def _value(value: Any, hint: Any, rule: Requirement, source: str, where: str) -> Any:
    """One number, text, truth or day, checked."""
    union = isinstance(hint, types.UnionType)
    type_ = typing.get_args(hint)[0] if union else hint
    result = value
    if type_ is float and isinstance(value, int) and not isinstance(value, bool):
        result = float(value)
    elif type_ is datetime.date and isinstance(value, str):
        try:
            result = datetime.date.fromisoformat(value)
        except ValueError:
            result = value
    words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
    wrong = not isinstance(result, type_) or (type_ is int and isinstance(result, bool))
    wrong = wrong or (isinstance(result, float) and math.isnan(result))
    if wrong:
        expected = words.get(type_, "a day, YYYY-MM-DD")
        raise ScenarioError(f"{source}: {where}: expected {expected}, got {value!r}")
    if not rule.holds(result):
        raise ScenarioError(f"{source}: {where}: expected {rule.expected}, got {value!r}")
    return result
