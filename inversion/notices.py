"""Warnings and reasons as codes with values, from which sentences in several languages are made.

Each code has one template, an English sentence with fields such as ``{plate_radius_m:g}``. A format
follows the colon. It may end with a factor or divisor that converts from SI to the unit of the
sentence: ``{duration_s:.2g*1000} ms``. Two numbers are an interval: ``0.5 to 1.2``. In addition to
the formats of Python there are: ``.2p``, which is ``.2g`` without powers of ten; ``names``, which
other languages translate; ``words``, names whose underscores become spaces; ``terms``, registered
phrases; ``list``, several texts; ``more``, a number of further cases, omitted if it is 0;
``drops``, numbers of drops; ``digits``, a number as text with its significant digits; ``message``,
another message, or a text that a person wrote.
"""

import math
import re
import string
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal, NamedTuple


@dataclass(frozen=True, slots=True)
class Joined:
    """Different values of one field, of messages that are shown as one."""

    values: tuple[Any, ...]
    """Numbers, also as texts, or intervals."""


WARNINGS, WARNING_CODES = "warnings", "warning_codes"
"""Keys in JSON of the sentences of warnings, and of their codes in the same order."""

OTHER = "other"
"""Code of a sentence without a code of its own; the sentence is the value ``text``."""

OF_DROPS = "of-drops"
"""Code of a message that names the drops it is about."""

MORE = "more-of-that-kind"
"""Code of the end of a sentence that stands for further cases."""

RANGE_DASH = "\N{EN DASH}"
"""Sign between the ends of a range; not "to", which may be in the message already."""

MAX_LISTED_VALUES = 2
"""Largest number of different values that are listed; more are written as a range."""

Invalidates = Literal["nothing", "fit", "record"]
"""What a warning forbids as the basis of a verdict: "fit" is a fitted modulus, "record" is every
value of the drop."""

_PACKAGES = ["inversion"]
"""Packages with messages, each in its file ``messages.toml``."""


class _Catalogue(NamedTuple):
    """English texts of all messages."""

    templates: dict[str, str]
    """Sentences by code."""
    terms: dict[str, str]
    """Phrases by word."""
    invalidates: dict[str, Invalidates]
    """What a message invalidates, by code; missing: nothing."""


@cache
def _catalogue() -> _Catalogue:
    catalogue = _Catalogue({OTHER: "{text}"}, {}, {})
    for package in _PACKAGES:
        file = resources.files(package).joinpath("messages.toml")
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
        catalogue.templates.update(tables["messages"])
        catalogue.terms.update(tables.get("terms", {}))
        for level, codes_of_level in tables["invalidates"].items():
            catalogue.invalidates.update(dict.fromkeys(codes_of_level, level))
    return catalogue


@dataclass(frozen=True, slots=True)
class Notice:
    """Warning, remark or reason: a code, and the values in it. `text_of` returns its sentence.

    Parameters
    ----------
    code : str
        Name of the kind of message, such as ``depth-not-unique``.
    values : mapping of name to value, in SI units
        One for each field of the template.

    Raises
    ------
    ValueError
        If the code is not registered, or the names of the values are not those of its template.

    Examples
    --------
    >>> warning = Notice("depth-not-unique", {"depth_low_m": 0.484, "depth_high_m": 1.3})
    >>> print(text_of(warning))  # doctest: +ELLIPSIS
    depth not unique: the data allow bedrock from 0.48 m to 1.3 m; ...
    >>> warning.code, warning.values["depth_high_m"]
    ('depth-not-unique', 1.3)
    """

    code: str
    values: Mapping[str, "Value"] = field(default_factory=dict)

    def __post_init__(self) -> None:
        template = _catalogue().templates.get(self.code)
        if template is None:
            raise ValueError(f"expected the code of a message, got {self.code!r}")
        forms = gaps_of(template)
        if forms.keys() != self.values.keys():
            raise ValueError(f"{self.code}: expected {sorted(forms)}, got {sorted(self.values)}")

    def __hash__(self) -> int:
        return hash((self.code, frozenset(self.values.items())))

    @property
    def invalidates(self) -> Invalidates:
        """What the warning forbids as the basis of a verdict; a property of its code."""
        return invalidated_by(self.code)

    def to_json(self) -> dict[str, Any]:
        """Return the warning as an entry of ``warning_codes``: ``code`` and ``values``."""
        return {"code": self.code, "values": {k: _plain(v) for k, v in self.values.items()}}


Value = float | int | str | tuple[float, ...] | tuple[str, ...] | Joined | Notice
"""Value of a message; a `Notice` is a message within a message."""


def invalidating(notices: Iterable[Notice], what: Invalidates) -> Notice | None:
    """Return the first warning that invalidates the "fit" or the "record"; None: there is none.

    A fit to an invalid record is invalid, too.
    """
    return next((notice for notice in notices if notice.invalidates in (what, "record")), None)


@dataclass(frozen=True, slots=True)
class Language:
    """Templates, words and signs of a language, in which messages are written."""

    templates: Mapping[str, str] = field(default_factory=dict)
    """Sentences by code, with the fields of the English ones; a missing one stays English."""
    words: Mapping[str, str] = field(default_factory=dict)
    """Translations of words and of registered terms."""
    decimal: str = "."
    to: str = "to"
    """Word between the ends of an interval."""
    and_: str = "and"


ENGLISH = Language()


def text_of(message: Notice | None, language: Language = ENGLISH) -> str:
    """Return a message as a sentence; empty for None."""
    if message is None:
        return ""
    template = _catalogue().templates[message.code]
    texts = {
        name: _value_text(message.values[name], form, language)
        for name, form in gaps_of(template).items()
    }
    return fill_template(language.templates.get(message.code, template), texts)


def term_text(term: str, language: Language = ENGLISH) -> str:
    """Return a registered phrase by its word, or the word without underscores."""
    return language.words.get(term) or _catalogue().terms.get(term) or term.replace("_", " ")


def text_notice(text: str) -> Notice:
    """Return a text that a person wrote, or that has no code, as a message."""
    return Notice(OTHER, {"text": text})


def of_drops(message: Notice, *numbers: int) -> Notice:
    """Return a message that names the drops it is about."""
    return Notice(OF_DROPS, {"drops": numbers, "message": message})


def without_drops(message: Notice) -> tuple[Notice, tuple[int, ...]]:
    """Return a message without the drops that it names, and their numbers."""
    if message.code == OF_DROPS:
        inner, numbers = message.values["message"], message.values["drops"]
        if isinstance(inner, Notice) and isinstance(numbers, tuple):
            return inner, tuple(map(int, numbers))
    return message, ()


def register(package: str) -> None:
    """Add the messages of another package, from its file ``messages.toml``."""
    _PACKAGES.append(package)
    _catalogue.cache_clear()


def invalidated_by(code: str) -> Invalidates:
    """Return what a message forbids as the basis of a verdict."""
    return _catalogue().invalidates.get(code, "nothing")


def templates() -> dict[str, str]:
    """Return the templates of all registered warnings, by code."""
    return dict(_catalogue().templates)


def terms() -> dict[str, str]:
    """Return all registered phrases for the format ``terms``, by word."""
    return dict(_catalogue().terms)


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
    notices = [from_entry(entry) for entry in entries] or [None] * len(sentences)
    return tuple(
        notice or text_notice(text) for notice, text in zip(notices, sentences, strict=True)
    )


def messages_in(entries: object) -> tuple[Notice, ...]:
    """Return the messages of stored entries as `codes` returns them, without unreadable ones."""
    listed = entries if isinstance(entries, list | tuple) else ()
    return tuple(message for entry in listed if (message := from_entry(entry)) is not None)


def codes(notices: Iterable[Notice]) -> list[dict[str, Any]]:
    """Return the value of the JSON key ``warning_codes``, in the order of the warnings."""
    return [notice.to_json() for notice in notices]


def to_json(notices: Sequence[Notice]) -> dict[str, Any]:
    """Return the JSON keys ``warnings`` and ``warning_codes`` with their values."""
    return {WARNINGS: list(map(text_of, notices)), WARNING_CODES: codes(notices)}


def form_of(code: str, name: str) -> str:
    """Return the format of a value of a message."""
    return gaps_of(_catalogue().templates[code])[name]


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


def _value_text(value: Any, form: str, language: Language) -> str:
    if form == "more":
        return text_of(Notice(MORE, {"count": value}), language) if value else ""
    if form == "drops":
        code = "one-drop" if len(value) == 1 else "several-drops"
        return text_of(Notice(code, {"numbers": ", ".join(map(str, value))}), language)
    if isinstance(value, Joined):
        return _joined_text(value, form, language)
    if isinstance(value, tuple):
        joint = _JOINTS.get(form, f" {language.to} ")
        return joint.join(_value_text(item, form, language) for item in value)
    if isinstance(value, Notice):
        return text_of(value, language)
    if form == "digits":
        return str(value).replace(".", language.decimal)
    if isinstance(value, str):
        if form not in ("names", "words", "terms"):
            return value
        if form == "terms":
            return term_text(value, language)
        if form == "names":
            return language.words.get(value, value)
        return language.words.get(value) or value.replace("_", " ")
    return _number_text(value, form).replace(".", language.decimal)


_JOINTS = {"list": ", ", "names": ", ", "words": ", ", "terms": "; "}
"""Text between several values, by their format; other formats are of intervals."""


def _joined_text(value: Joined, form: str, language: Language) -> str:
    """Return two numbers with "and" between them, more numbers or intervals as one range."""
    items = [item if isinstance(item, tuple) else (item,) for item in value.values]
    numbers = sorted({number for item in items for number in item}, key=float)
    texts = list(dict.fromkeys(_value_text(number, form, language) for number in numbers))
    if len(texts) <= MAX_LISTED_VALUES and all(len(item) == 1 for item in items):
        return f" {language.and_} ".join(texts)
    joint = f" {language.to} " if "+" in form else RANGE_DASH
    return joint.join(dict.fromkeys((texts[0], texts[-1])))


def _number_text(value: float, form: str) -> str:
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


def _plain(value: Value) -> Any:
    if isinstance(value, Notice):
        return value.to_json()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON cannot represent infinity and NaN
    return value


def from_entry(entry: object) -> Notice | None:
    """Return an entry of ``warning_codes`` as a warning.

    The result is None if this version has no such template.
    """
    if not isinstance(entry, Mapping):
        return None
    template, values = _catalogue().templates.get(str(entry.get("code"))), entry.get("values")
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
        items: list[Any] = [_value_of(item, "d" if form == "drops" else form) for item in written]
        return tuple(items)
    if form == "message" and isinstance(written, Mapping):
        message = from_entry(written)
        if message is None:
            raise ValueError("expected a message with its code and values")
        return message
    if form in TEXT_FORMS:
        if not isinstance(written, str):
            raise TypeError(f"expected a text, got {type(written).__name__}")
        return written
    if isinstance(written, int) and not isinstance(written, bool):
        return written
    return float(written)


TEXT_FORMS = ("", "names", "words", "terms", "list", "message", "digits")
"""Formats of values that are texts or messages, not numbers."""
