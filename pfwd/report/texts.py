"""The texts of a report in one language, from a catalogue or a file."""

import re
import string
import tomllib
from collections.abc import Collection, Sequence
from functools import cache
from importlib import resources
from typing import Any

from inversion.notices import OTHER, fill_template
from pfwd.analysis.options import METHOD_WORDS, PLATE_WORDS
from pfwd.errors import OptionError, quote, refusal
from pfwd.message_groups import GAP, MessageGroup, fill, split_numbers
from pfwd.procedures.profile import CHECKS
from pfwd_device.text import clean

MAX_TEXTS_BYTES = 1_000_000
"""Size of a file with texts; a catalogue has under 30,000 bytes."""

_LANGUAGE_CODE = re.compile(r"[a-z]{2,3}(-[A-Za-z0-9]{2,8})*")
"""Code of a language, as in HTML (BCP 47)."""


_LINE = re.compile(r"(\.\w+, )line( \{\})")
"""Pattern of the number of a line behind the name of its file."""


_DROP_NUMBERS = re.compile(r"(drops?) \{\}(?:, \{\})*")
"""Pattern of a clause that only has numbers of drops."""

_NUMBERS_FOLLOW = (
    "not verified, hence not enforced",
    "used in the formula without being verified",
)
"""Beginnings of messages that end with a list of keys of a procedure."""

NAMES_OF_NUMBERS = {
    "seating": "seating drops",
    "measured": "measured drops",
    "factor": "plate factor",
    "nominal_pressure_pa": "nominal pressure",
    "nominal_load_n": "nominal load",
    "poisson_ratio": "Poisson's ratio",
    "plate_radius_m": "plate radius",
}
"""English names of the numbers of a procedure that are no checks, by key."""


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
        self._messages: dict[str, str] = catalogue.get("messages", {})
        self._warnings: dict[str, str] = catalogue.get("warnings", {})
        self._words: dict[str, str] = catalogue.get("words", METHOD_WORDS | PLATE_WORDS)
        self._sources: dict[str, str] = catalogue.get("sources", {})
        self._named = [
            (_pattern_with_name(text), translation)
            for text, translation in catalogue.get("with_names", {}).items()
        ]
        self.untranslated: set[str] = set()
        """Messages that stayed English, as names of files and of people do."""

    @property
    def decimal(self) -> str:
        """Decimal sign of the language."""
        return self._table["decimal_sign"]

    def __getitem__(self, key: str) -> str:
        return self._table[key]

    @property
    def with_messages(self) -> tuple[str, ...]:
        """Codes of the languages that messages are translated into."""
        return tuple(_messages())

    def message(self, text: str) -> str:
        """Return a message of the program in this language; in English where it is not known."""
        return self.grouped_message(*split_numbers(text))

    def title(self, text: str) -> str:
        """Return a title in this language; the numbers in it stay as they are."""
        pattern, numbers = split_numbers(text)
        return fill(self._messages.get(pattern, pattern), numbers)

    def source(self, text: str) -> str:
        """Return the source of a number of a procedure; a document keeps its name."""
        return self._sources.get(text, text)

    def word(self, name: str) -> str:
        """Return a name of the program, as of an effect, in this language, without underscores."""
        return self._words.get(name.replace(" ", "_")) or name.replace("_", " ")

    def number_name(self, key: str) -> str:
        """Return the name of a number of a procedure by its key."""
        check = CHECKS.get(key)
        return self.title(NAMES_OF_NUMBERS.get(key, key) if check is None else check.words)

    def _list_of_words(self, text: str) -> str | None:
        """Return a list of names of the program in this language; None: it is something else."""
        names = [name.replace(" ", "_") for name in text.split(", ")]
        if not all(name in self._words for name in names):
            return None
        return ", ".join(self._words[name] for name in names)

    def grouped(self, group: MessageGroup[Any]) -> str:
        """Return a message about several things in this language."""
        texts = {
            name: self.grouped_message(pattern, group.numbers[name])
            for name, pattern in group.patterns.items()
        }
        template = self._warnings.get(group.code)
        if template is None:
            return "".join(texts.values()) if group.code == OTHER else group.text
        for name, words in group.words.items():
            if all(word in self._words for word in words):
                texts[name] = ", ".join(self._words[word] for word in words)
        return fill_template(template, texts)

    def grouped_message(self, pattern: str, numbers: Sequence[str]) -> str:
        """Return a message in this language, with the numbers in the gaps of its pattern.

        Each clause of a message is translated by itself. The name of a file or of a procedure may
        stand before a clause.
        """
        translation = GAP if pattern == GAP else self._messages.get(pattern)
        if translation is not None:
            to, joint = f" {self['range_to']} ", f" {self['and']} "
            localised = [
                number.replace(".", self.decimal).replace(" to ", to).replace(" and ", joint)
                for number in numbers
            ]
            return fill(translation, localised)
        words = self._list_of_words(pattern)
        if words is not None:
            return words
        drop = _DROP_NUMBERS.fullmatch(pattern)
        if drop is not None:
            return fill(pattern.replace(drop[1], self[drop[1]]), numbers)
        for named, translation in self._named:
            match = named.fullmatch(fill(pattern, numbers))
            if match is not None:
                texts = list(match.groups())
                texts.remove(match["name"])
                values = [text.replace(".", self.decimal) for text in texts]
                return fill(translation, values).replace("{name}", match["name"])
        for start in _NUMBERS_FOLLOW:
            if pattern.startswith(f"{start}: "):
                names = map(self.number_name, pattern[len(start) + 2 :].split(", "))
                return f"{self._messages.get(start, start)}: {'; '.join(names)}"
        for separator in ("; ", ": ", ", "):
            for match in re.finditer(re.escape(separator), pattern):
                head, rest = pattern[: match.start()], pattern[match.end() :]
                if not self._has_translation(head) and not self._has_translation(rest):
                    continue
                gaps = head.count(GAP)
                clauses = (
                    self.grouped_message(head, numbers[:gaps]),
                    self.grouped_message(rest, numbers[gaps:]),
                )
                return separator.join(clauses)
        text = fill(_LINE.sub(rf"\1{self['line']}\2", pattern), numbers)
        if self._messages:
            self.untranslated.add(text)
        return text

    def _has_translation(self, clause: str) -> bool:
        return (
            clause in self._messages
            or _DROP_NUMBERS.fullmatch(clause) is not None
            or self._list_of_words(clause) is not None
        )

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
def _messages() -> dict[str, dict[str, dict[str, str]]]:
    """Return messages, warnings and words by the code of a language.

    A message has its English text with ``{}`` for each number as key, a warning its code, a word
    that of the program.
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


def _pattern_with_name(message: str) -> re.Pattern[str]:
    """Return the pattern of a message with a name in it: a group for that, then for its numbers."""
    pattern = re.escape(message).replace(r"\{name\}", "(?P<name>.+?)")
    return re.compile(pattern.replace(r"\{\}", r"(\S+?)"))


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


def placeholders(text: str) -> set[str]:
    """Return the words in braces of a text."""
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}
