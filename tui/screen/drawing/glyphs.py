"""Characters for drawing: braille dots, or plain ASCII for terminals without them."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

GlyphName = Literal["braille", "ascii"]

_ASCII_REPLACEMENTS = str.maketrans(
    {
        "·": ".",
        "°": "d",
        "µ": "u",
        "ν": "v",
        "²": "2",
        "³": "3",
        "×": "x",
        "±": "~",
        "─": "-",
        "│": "|",
        "┤": "|",
        "┬": "+",
        "┼": "+",
        "└": "+",
        "█": "#",
        "▀": "#",
        "▄": "#",
        "■": "#",
        "□": "_",
        "●": "*",
        "○": "o",
        "▶": ">",
        "▲": "^",
        "→": ">",
        "\N{REPLACEMENT CHARACTER}": "?",
    }
)


@dataclass(frozen=True, slots=True)
class Glyphs:
    """Characters that a terminal can show, and the replacements for those that it cannot."""

    name: GlyphName

    @property
    def has_dots(self) -> bool:
        """True for braille, with two by four dots in a cell."""
        return self.name == "braille"

    def to_terminal(self, text: str) -> str:
        """Replace characters that the terminal lacks, column for column."""
        if self.has_dots:
            return text
        return "".join(
            letter if letter < "\x7f" or (not letter.isascii() and letter.isalpha()) else "?"
            for letter in text.translate(_ASCII_REPLACEMENTS)
        )


BRAILLE = Glyphs("braille")
ASCII = Glyphs("ascii")
GLYPHS_BY_NAME: Mapping[str, Glyphs] = {"braille": BRAILLE, "ascii": ASCII}


def glyphs_of_terminal(environment: Mapping[str, str] = os.environ) -> Glyphs:
    """Guess the characters of the terminal; ``PFWD_GLYPHS`` = braille or ascii sets them."""
    override = GLYPHS_BY_NAME.get(environment.get("PFWD_GLYPHS", ""))
    if override is not None:
        return override
    # The Linux console has 512 glyphs, none of them dots.
    if environment.get("TERM") in ("linux", "dumb", "vt100", "vt220"):
        return ASCII
    encoding = getattr(sys.__stdout__, "encoding", None) or "utf-8"
    return BRAILLE if "utf" in encoding.lower() else ASCII
