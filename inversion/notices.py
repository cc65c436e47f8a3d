"""Warnings as codes with values, from which sentences in several languages are made.

Each code has one template, an English sentence with fields such as ``{plate_radius_m:g}``. A format
follows the colon. It may end with a factor or divisor that converts from SI to the unit of the
sentence: ``{duration_s:.2g*1000} ms``. Two numbers are an interval: ``0.5 to 1.2``. In addition to
the formats of Python there are: ``.2p``, which is ``.2g`` without powers of ten; ``words``, a name
whose underscores become spaces; ``terms``, registered phrases; ``list``, several texts; ``more``, a
number of further cases, omitted if it is 0.
"""

import math
import re
import string
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, Self

from inversion.notice_texts import TEMPLATES, Invalidates, Template

Value = float | int | str | tuple[float, ...] | tuple[str, ...]

WARNINGS, WARNING_CODES = "warnings", "warning_codes"
"""Keys in JSON of the sentences of warnings, and of their codes in the same order."""

OTHER = "other"
"""Code of a sentence without a code of its own; the sentence is the value ``text``."""

_templates: dict[str, str] = {OTHER: "{text}", **TEMPLATES}
_terms: dict[str, str] = {}


class Notice(str):
    """Warning: an English sentence, with its code and the values in it.

    As a `str` it is the sentence, so that scripts and tables can use it as any text.

    Parameters
    ----------
    code : str
        Name of the kind of warning, such as ``depth-not-unique``.
    values : mapping of name to value, in SI units
        One for each field of the template.

    Raises
    ------
    ValueError
        If the code is not registered, or the names of the values are not those of its template.

    Examples
    --------
    >>> warning = Notice("depth-not-unique", {"depth_low_m": 0.484, "depth_high_m": 1.3})
    >>> print(warning)  # doctest: +ELLIPSIS
    depth not unique: the data allow bedrock from 0.48 m to 1.3 m; ...
    >>> warning.code, warning.values["depth_high_m"]
    ('depth-not-unique', 1.3)
    """

    code: str
    values: Mapping[str, Value]

    def __new__(cls, code: str, values: Mapping[str, Value] | None = None) -> Self:
        template = _templates.get(code)
        if template is None:
            raise ValueError(f"expected the code of a warning, got {code!r}")
        values = MappingProxyType(dict(values or {}))
        forms = gaps_of(template)
        if forms.keys() != values.keys():
            raise ValueError(f"{code}: expected {sorted(forms)}, got {sorted(values)}")
        texts = {name: _text_of(values[name], form) for name, form in forms.items()}
        notice = super().__new__(cls, fill_template(template, texts))
        notice.code, notice.values = code, values
        return notice

    def __reduce__(self) -> tuple[type[Self], tuple[str, dict[str, Value]]]:
        return type(self), (self.code, dict(self.values))

    @property
    def invalidates(self) -> Invalidates:
        """What the warning forbids as the basis of a verdict; a property of its code."""
        template = _templates[self.code]
        return template.invalidates if isinstance(template, Template) else "nothing"

    def texts(self) -> dict[str, str]:
        """Return the values as texts, formatted as in the English sentence, by name."""
        return {
            name: _text_of(self.values[name], form)
            for name, form in gaps_of(_templates[self.code]).items()
        }

    def words(self) -> dict[str, tuple[str, ...]]:
        """Return the values that are words and have to be translated, by name."""
        forms = gaps_of(_templates[self.code])
        return {
            name: _as_words(value)
            for name, value in self.values.items()
            if forms[name] in ("words", "terms")
        }

    def to_json(self) -> dict[str, Any]:
        """Return the warning as an entry of ``warning_codes``: ``code`` and ``values``."""
        return {"code": self.code, "values": {k: _plain(v) for k, v in self.values.items()}}


def invalidating(notices: Iterable[str], what: Invalidates) -> Notice | None:
    """Return the first warning that invalidates the "fit" or the "record"; None: there is none.

    A fit to an invalid record is invalid, too. Sentences without a code invalidate nothing.
    """
    coded = (notice for notice in notices if isinstance(notice, Notice))
    return next((notice for notice in coded if notice.invalidates in (what, "record")), None)


def text_notice(text: str) -> Notice:
    """Return a sentence without a code as a warning."""
    return Notice(OTHER, {"text": text})


def register(templates: Mapping[str, str], terms: Mapping[str, str] | None = None) -> None:
    """Add the templates of another package's warnings.

    Parameters
    ----------
    templates : mapping of code to template
    terms : mapping of word to phrase, optional
        Phrases for the format ``terms``.

    Raises
    ------
    ValueError
        If a code or a word is already registered.
    """
    for table, more in ((_templates, templates), (_terms, terms or {})):
        twice = table.keys() & more.keys()
        if twice:
            raise ValueError(f"expected new codes, got {', '.join(sorted(twice))} a second time")
        table.update(more)


def templates() -> dict[str, str]:
    """Return the templates of all registered warnings, by code."""
    return dict(_templates)


def terms() -> dict[str, str]:
    """Return all registered phrases for the format ``terms``, by word."""
    return dict(_terms)


def from_json(sentences: Sequence[str], codes: object = None) -> tuple[Notice, ...]:
    """Return the stored warnings of a record.

    A sentence whose entry is missing or cannot be read has the code `OTHER`.

    Parameters
    ----------
    sentences : sequence of str
        Value of the key ``warnings``.
    codes : list or None
        Value of the key ``warning_codes``, with an entry for each sentence.
    """
    entries = codes if isinstance(codes, list) and len(codes) == len(sentences) else ()
    notices = [_from_entry(entry) for entry in entries] or [None] * len(sentences)
    return tuple(
        notice or text_notice(text) for notice, text in zip(notices, sentences, strict=True)
    )


def codes(notices: Iterable[Notice]) -> list[dict[str, Any]]:
    """Return the value of the JSON key ``warning_codes``, in the order of the warnings."""
    return [notice.to_json() for notice in notices]


def to_json(notices: Sequence[Notice]) -> dict[str, Any]:
    """Return the JSON keys ``warnings`` and ``warning_codes`` with their values."""
    return {WARNINGS: list(map(str, notices)), WARNING_CODES: codes(notices)}


@cache
def gaps_of(template: str) -> Mapping[str, str]:
    """Return the format of each field of a template, by name."""
    return {name: form or "" for _, name, form, _ in _parts(template) if name is not None}


def fill_template(template: str, texts: Mapping[str, str]) -> str:
    """Return a template with texts in its fields; the formats are ignored."""
    return "".join(
        literal + ("" if name is None else texts[name]) for literal, name, _, _ in _parts(template)
    )


def _parts(template: str) -> Iterator[tuple[str, str | None, str | None, str | None]]:
    return iter(string.Formatter().parse(template))


def _text_of(value: Value, form: str) -> str:
    if isinstance(value, tuple):
        joint = ", " if form in ("list", "terms") else " to "
        return joint.join(_text_of(item, form) for item in value)
    if form == "more":
        return f"; {value} more of that kind" if value else ""
    if isinstance(value, str):
        word = _terms.get(value, value) if form == "terms" else value
        return word.replace("_", " ") if form in ("words", "terms") else word
    number_form, scale = _scale(form)
    displayed = value if scale is None else scale(value)
    if number_form.endswith("p"):
        return f"{float(format(displayed, number_form[:-1] + 'g')):g}"
    text = format(displayed, number_form)
    if text.startswith("-") and not text.strip("-0.%"):  # rounded to zero: without its sign
        return format(0.0, number_form)
    return text


def _scale(form: str) -> tuple[str, Callable[[float], float] | None]:
    """Split a format into that of the number and the conversion to the unit of the sentence."""
    number_form, sign, factor = re.fullmatch(r"([^*/]*)([*/]?)(.*)", form).groups()  # type: ignore[union-attr]
    if not sign:
        return number_form, None
    by = float(factor)
    return number_form, (lambda value: value * by) if sign == "*" else (lambda value: value / by)


def _as_words(value: Value) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, tuple) else (str(value),)


def _plain(value: Value) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON cannot represent infinity and NaN
    return value


def _from_entry(entry: object) -> Notice | None:
    """Return an entry of ``warning_codes`` as a warning.

    The result is None if this version has no such template.
    """
    if not isinstance(entry, Mapping):
        return None
    template, values = _templates.get(str(entry.get("code"))), entry.get("values")
    if template is None or not isinstance(values, Mapping):
        return None
    forms = gaps_of(template)
    if forms.keys() != values.keys():
        return None
    try:
        return Notice(str(entry["code"]), {k: _value_of(values[k], forms[k]) for k in forms})
    except (TypeError, ValueError):
        return None


def _value_of(written: Any, form: str) -> Value:
    """Convert a value from JSON to the type that a format requires.

    Raises
    ------
    TypeError, ValueError
        If the value is of another type.
    """
    if isinstance(written, list):
        items: list[Any] = [_value_of(item, form) for item in written]
        return tuple(items)
    if form in _TEXT_FORMS:
        if not isinstance(written, str):
            raise TypeError(f"expected a text, got {type(written).__name__}")
        return written
    if isinstance(written, int) and not isinstance(written, bool):
        return written
    return float(written)


_TEXT_FORMS = ("", "words", "terms", "list")
