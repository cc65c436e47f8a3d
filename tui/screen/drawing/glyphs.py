"""The characters that are drawn with: braille dots, or plain ASCII where a terminal has no more."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

GlyphName = Literal["braille", "ascii"]

_ASCII = str.maketrans(
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
    """One set."""

    name: GlyphName

    @property
    def dots(self) -> bool:
        """Whether there are dots: two by four of them in a cell."""
        return self.name == "braille"

    def shown(self, text: str) -> str:
        """Text in letters that the terminal has, column for column."""
        if self.dots:
            return text
        return "".join(
            letter if letter < "\x7f" or (not letter.isascii() and letter.isalpha()) else "?"
            for letter in text.translate(_ASCII)
        )


BRAILLE = Glyphs("braille")
ASCII = Glyphs("ascii")
BY_NAME: Mapping[str, Glyphs] = {"braille": BRAILLE, "ascii": ASCII}


def glyphs_of_terminal(environment: Mapping[str, str] = os.environ) -> Glyphs:
    """What the terminal is likely to have; ``PFWD_GLYPHS`` = braille or ascii decides."""
    said = BY_NAME.get(environment.get("PFWD_GLYPHS", ""))
    if said is not None:
        return said
    # The Linux console has 512 glyphs, none of them dots.
    if environment.get("TERM") in ("linux", "dumb", "vt100", "vt220"):
        return ASCII
    encoding = getattr(sys.__stdout__, "encoding", None) or "utf-8"
    return BRAILLE if "utf" in encoding.lower() else ASCII
