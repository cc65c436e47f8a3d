"""The texts of a report in one language, from a catalogue or a file."""

import re
import string
import tomllib
from collections.abc import Collection
from dataclasses import replace
from functools import cache
from importlib import resources
from typing import Any

from inversion.notices import ENGLISH, RANGE_DASH, Language, Notice, term_text, text_of
from pfwd.analysis.options import METHOD_WORDS, PLATE_WORDS
from pfwd.analysis.results import EffectResult
from pfwd.errors import OptionError, quote, refusal
from pfwd.procedures import Procedure
from pfwd.procedures.profile import SourcedNumber, term_of_number
from pfwd_device.text import clean

MAX_TEXTS_BYTES = 1_000_000
"""Size of a file with texts; a catalogue has under 30,000 bytes."""

_LANGUAGE_CODE = re.compile(r"[a-z]{2,3}(-[A-Za-z0-9]{2,8})*")
"""Code of a language, as in HTML (BCP 47)."""


class Texts:
    """Texts of a report in one language, by key.

    Parameters
    ----------
    code : str
        Code of the language.
    table : dict
        Texts of the catalogue.
    """

    def __init__(self, code: str, table: dict[str, str]) -> None:
        self.code = code
        self._table = table
        catalogue = _messages().get(code, {})
        self._words: dict[str, str] = catalogue.get("words", METHOD_WORDS | PLATE_WORDS)
        self._advice: dict[str, str] = catalogue.get("advice", {})
        self._procedures: dict[str, dict[str, str]] = catalogue.get("procedures", {})
        self._language = ENGLISH
        if catalogue:
            signs = table["decimal_sign"], table["range_to"], table["and"]
            self._language = Language(catalogue["messages"], self._words, *signs)

    @property
    def decimal(self) -> str:
        """Decimal sign of the language."""
        return self._table["decimal_sign"]

    @property
    def figures(self) -> Language:
        """Language of numbers: an interval has a dash between its ends."""
        return replace(self._language, to=RANGE_DASH)

    def decimals(self, number: str) -> str:
        """Return a number, or several, with the decimal sign of this language."""
        return number.replace(".", self.decimal)

    def __getitem__(self, key: str) -> str:
        return self._table[key]

    @property
    def with_messages(self) -> tuple[str, ...]:
        """Codes of the languages that messages are translated into."""
        return tuple(_messages())

    def message(self, message: Notice | None) -> str:
        """Return a message in this language; empty for None."""
        return text_of(message, self._language)

    def title(self, procedure: Procedure) -> str:
        """Return the title of a procedure in this language; of a user's own, as it is."""
        return self._of_procedure(procedure, "title", procedure.title)

    def about(self, procedure: Procedure) -> str:
        """Return the remarks on a procedure in this language."""
        return self._of_procedure(procedure, "about", procedure.about)

    def source(self, procedure: Procedure, key: str, number: SourcedNumber) -> str:
        """Return the source of a number of a procedure; a document keeps its name."""
        return self._of_procedure(procedure, key, number.source)

    def _of_procedure(self, procedure: Procedure, key: str, text: str) -> str:
        shipped = procedure.file is None
        return self._procedures.get(procedure.name, {}).get(key, text) if shipped else text

    def word(self, name: str) -> str:
        """Return a name of the program, as of an effect, in this language, without underscores."""
        return self._words.get(name.replace(" ", "_")) or name.replace("_", " ")

    def advice(self, effect: EffectResult) -> str:
        """Return the advice for the field on an effect; empty: none."""
        return self._advice.get(str(effect.name)) or effect.advice or ""

    def number_name(self, key: str) -> str:
        """Return the name of a number of a procedure by its key."""
        return term_text(term_of_number(key), self._language)

    def say(self, key: str, **values: object) -> str:
        """Return a text of the catalogue with values in place of its words in braces."""
        return self._table[key].format(**values)


@cache
def _catalogues() -> dict[str, str]:
    folder = resources.files(__package__).joinpath("catalogues")
    return {
        file.name.removesuffix(".toml"): file.read_text(encoding="utf-8")
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".toml")
    }


@cache
def _messages() -> dict[str, dict[str, dict[str, Any]]]:
    """Return messages, words and texts of procedures by the code of a language.

    A message has its code as key, a word that of the program, a procedure its name.
    """
    folder = resources.files(__package__).joinpath("catalogues", "messages")
    return {
        file.name.removesuffix(".toml"): tomllib.loads(file.read_text(encoding="utf-8"))
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".toml")
    }


def languages() -> tuple[str, ...]:
    """Return the codes of the languages with a catalogue, sorted."""
    return tuple(_catalogues())


def load_texts(language: str) -> Texts:
    """Return the texts of a language by its code, or those of a TOML file.

    Parameters
    ----------
    language : str
        One of `languages`, or a path that ends in .toml.

    Raises
    ------
    OptionError
        If there is no catalogue for it, or the file is refused.
    """
    text = _catalogues().get(language)
    if text is not None:
        return Texts(language, tomllib.loads(text))
    if language.lower().endswith(".toml"):
        return _read_texts(language)
    expected = f"one of {', '.join(languages())}, or a file .toml"
    raise OptionError(refusal("--language", expected, quote(language)))


def _read_texts(file: str) -> Texts:
    """Return the texts of an untrusted file, which needs the same keys and words in braces.

    Raises
    ------
    OptionError
    """
    where = f"--language {file}"
    try:
        with open(file, "rb") as stream:
            data = stream.read(MAX_TEXTS_BYTES + 1)
        if len(data) > MAX_TEXTS_BYTES:
            raise OptionError(refusal(where, f"at most {MAX_TEXTS_BYTES} bytes", "more"))
        table = tomllib.loads(data.decode("utf-8-sig"))
    except OSError as err:
        raise OptionError(refusal(where, "a TOML file", err.strerror or str(err))) from err
    except (ValueError, RecursionError) as err:
        if isinstance(err, OptionError):
            raise
        raise OptionError(refusal(where, "TOML", quote(str(err)))) from err
    english = tomllib.loads(_catalogues()["en"])
    hint = "en.toml in pfwd/report/catalogues has all of them"
    missing, unknown = english.keys() - table.keys(), table.keys() - english.keys()
    if missing:
        raise OptionError(refusal(where, "every text", f"none for {_some(missing)}", hint))
    if unknown:
        raise OptionError(refusal(where, "the keys of the English texts", _some(unknown), hint))
    for key, text in table.items():
        if not isinstance(text, str) or _filled_in(text) != _filled_in(english[key]):
            expected = f"{key}: a text with the words in braces of {english[key]!r}"
            raise OptionError(refusal(where, expected, quote(text)))
    if not _LANGUAGE_CODE.fullmatch(table["code"]):
        raise OptionError(refusal(where, 'code: one such as "fr"', quote(table["code"])))
    return Texts(table["code"], table)


def _some(keys: Collection[str]) -> str:
    return clean(", ".join(sorted(keys)[:3])) + (" and more" if len(keys) > 3 else "")


def _filled_in(text: str) -> set[tuple[str, str | None, str | None]] | None:
    """Return the words in braces of a text and their format; None if the braces are wrong.

    Names and formats are compared in full: `{point.__class__}` or `{point:>99999999}` of an
    untrusted file would be evaluated, too.
    """
    try:
        parts = list(string.Formatter().parse(text))
    except ValueError:
        return None
    return {(name, form, conversion) for _, name, form, conversion in parts if name is not None}
