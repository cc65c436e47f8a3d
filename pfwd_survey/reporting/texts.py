"""The texts of a report in one language, from a catalogue."""

import string
import tomllib
from functools import cache
from importlib import resources

from pfwd_survey.errors import OptionError, quote, refusal


class Texts:
    """Texts by key.

    Parameters
    ----------
    code : str
        Of the language.
    table : dict
        As the catalogue has it.
    """

    def __init__(self, code: str, table: dict[str, str]) -> None:
        self.code = code
        self._table = table

    def __getitem__(self, key: str) -> str:
        return self._table[key]

    def say(self, key: str, **values: object) -> str:
        """A text with its words in braces filled in."""
        return self._table[key].format(**values)


@cache
def _catalogues() -> dict[str, str]:
    folder = resources.files(__package__).joinpath("catalogues")
    return {
        one.name.removesuffix(".toml"): one.read_text(encoding="utf-8")
        for one in sorted(folder.iterdir(), key=lambda one: one.name)
        if one.name.endswith(".toml")
    }


def languages() -> tuple[str, ...]:
    """Codes of the languages that there are catalogues for, sorted."""
    return tuple(_catalogues())


def load_texts(code: str) -> Texts:
    """The texts of a language.

    Raises
    ------
    OptionError
        If there is no catalogue for it.
    """
    text = _catalogues().get(code)
    if text is None:
        raise OptionError(refusal("--language", f"one of {', '.join(languages())}", quote(code)))
    return Texts(code, tomllib.loads(text))


def placeholders(text: str) -> set[str]:
    """The words in braces of a text."""
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}
