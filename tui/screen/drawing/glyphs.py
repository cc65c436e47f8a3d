"""Characters for drawing: braille dots, or plain ASCII for terminals without them."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass

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
        **dict.fromkeys("▁▂▃", "_"),
        **dict.fromkeys("▅▆▇█", "#"),
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

    has_dots: bool
    """True for braille, with two by four dots in a cell."""

    def to_terminal(self, text: str) -> str:
        """Replace characters that the terminal lacks, column for column."""
        if self.has_dots:
            return text
        return "".join(
            letter if letter < "\x7f" or (not letter.isascii() and letter.isalpha()) else "?"
            for letter in text.translate(_ASCII_REPLACEMENTS)
        )


BRAILLE, ASCII = Glyphs(has_dots=True), Glyphs(has_dots=False)


def glyphs_of_terminal(environment: Mapping[str, str] = os.environ) -> Glyphs:
    """Guess the characters of the terminal; ``PFWD_GLYPHS`` = braille or ascii sets them."""
    override = {"braille": BRAILLE, "ascii": ASCII}.get(environment.get("PFWD_GLYPHS", ""))
    if override is not None:
        return override
    # The Linux console has 512 glyphs, none of them dots.
    if environment.get("TERM") in ("linux", "dumb", "vt100", "vt220"):
        return ASCII
    encoding = getattr(sys.__stdout__, "encoding", None) or "utf-8"
    return BRAILLE if "utf" in encoding.lower() else ASCII
