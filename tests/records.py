"""Values that a test expects, and records of which it states some values."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from inversion.notices import Notice, Value, gaps_of, templates, terms
from inversion.records import JsonRecord, stored_fields, without_none

_T = TypeVar("_T")
_Record = TypeVar("_Record", bound=JsonRecord)
_EMPTY: dict[Any, Any] = {float: math.nan, str: "", bool: False, int: 0}


def known(value: _T | None) -> _T:
    """Return a value that is not None."""
    assert value is not None
    return value


def read(kind: type[_Record], written: Mapping[str, Any]) -> _Record:
    """Return the record of which JSON has some keys, see `complete`."""
    return kind.from_json(complete(kind, written))


def complete(kind: type[JsonRecord], written: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON of a record with an empty value for each missing key, also in its parts."""
    hints = get_type_hints(kind)
    values = dict(written)
    for field in stored_fields(kind):
        hint = without_none(hints[field.name])
        if field.name not in values:
            if field.name not in kind.OPTIONAL_KEYS:
                values[field.name] = _empty(field, hints[field.name])
        elif values[field.name] is not None:
            values[field.name] = _complete_part(hint, values[field.name])
    return values


def _complete_part(hint: Any, value: Any) -> Any:
    if get_origin(hint) is tuple and isinstance(value, list):
        return [_complete_part(get_args(hint)[0], item) for item in value]
    is_record = isinstance(hint, type) and issubclass(hint, JsonRecord)
    return complete(hint, value) if is_record else value


def _empty(field: dataclasses.Field[Any], hint: Any) -> Any:
    if field.default not in (dataclasses.MISSING, None):
        return list(field.default) if isinstance(field.default, tuple) else field.default
    if without_none(hint) is not hint:
        return None
    if get_origin(hint) is tuple:
        return [] if ... in get_args(hint) else [math.nan] * len(get_args(hint))
    return get_args(hint)[0] if get_origin(hint) is Literal else _EMPTY[hint]


def sample_notice(code: str) -> Notice:
    """Return a message with plausible values."""
    samples: dict[str, Value] = {
        "": "a.F25", "words": "density", "names": "seating",
        "list": ("one", "two"), "d": 3, "more": 2,
        "terms": tuple(terms()), "drops": (1, 2), "digits": "4.5", "message": Notice("no-drop"),
    }  # fmt: skip
    forms = gaps_of(templates()[code])
    return Notice(code, {name: samples.get(form, 0.25) for name, form in forms.items()})
