"""Characters for drawing: braille dots, those of a code page, or plain ASCII."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

_ASCII_REPLACEMENTS = {
    letter: replacement
    for letters, replacement in (
        *(("·…", "."), ("•●", "*"), ("×✗╳", "x"), ("±", "~"), ("\N{NO-BREAK SPACE}", " ")),
        *(("°", "d"), ("µμ", "u"), ("ν√▼↓✓", "v"), ("η", "n"), ("ρ", "r"), ("σ", "s")),
        *(("λ", "l"), ("π", "p"), ("²", "2"), ("³", "3"), ("₀", "0"), ("○", "o")),
        *(("–—−─━▔", "-"), ("│┃┤▌▐▊▎▉▋▍▏▕", "|"), ("┬┼└┌┐┘┏┓┗┛╭╮╰╯", "+")),
        *(("▁▂▃□", "_"), ("▀▄▅▆▇█■", "#"), ("▶→≥", ">"), ("◀←≤", "<"), ("▲↑", "^")),
    )
    for letter in letters
}


@dataclass(frozen=True, slots=True)
class Glyphs:
    """Characters that a terminal can show, and the replacements for those that it cannot."""

    has_dots: bool
    """True for braille, with two by four dots in a cell."""
    code_pages: tuple[str, ...] = ()
    """Without dots: code pages whose characters the terminal can show besides ASCII."""

    def to_terminal(self, text: str) -> str:
        """Replace characters that the terminal lacks, column for column."""
        if self.has_dots or text.isascii():
            return text
        return "".join(_to_terminal(letter, self.code_pages) for letter in text)


@lru_cache(maxsize=2048)
def _to_terminal(letter: str, code_pages: tuple[str, ...]) -> str:
    if letter.isascii() or any(_has(page, letter) for page in code_pages):
        return letter
    # Letters of names stay, although the font may lack them.
    return _ASCII_REPLACEMENTS.get(letter, letter if letter.isalpha() else "?")


def _has(code_page: str, letter: str) -> bool:
    try:
        letter.encode(code_page)
    except (UnicodeEncodeError, LookupError):  # the second: Python does not know the code page
        return False
    return True


BRAILLE, ASCII = Glyphs(has_dots=True), Glyphs(has_dots=False)

UTF_8 = 65001
"""Number of the code page with all characters. The fonts of the console of Windows have only some
of them, those of `_FONT_PAGES`."""

_FONT_PAGES = ("cp437", "cp850", "cp1252", "cp1253")

_WIDE_PAGES = (932, 936, 949, 950)
"""Code pages of Chinese, Japanese and Korean, with which the console draws lines and Greek letters
two columns wide."""

_CAPABLE_TERMINALS = ("WT_SESSION", "TERM_PROGRAM", "TERM", "TEXTUAL_DRIVER")
"""Environment variables of terminals on Windows with fonts for braille: Windows Terminal, editors,
a connection by SSH, a browser."""


def glyphs_of_terminal(environment: Mapping[str, str] = os.environ) -> Glyphs:
    """Guess the characters of the terminal; ``PFWD_GLYPHS`` = braille or ascii sets them."""
    override = {"braille": BRAILLE, "ascii": ASCII}.get(environment.get("PFWD_GLYPHS", ""))
    if override is not None:
        return override
    # The Linux console has 512 glyphs, none of them dots.
    if environment.get("TERM") in ("linux", "dumb", "vt100", "vt220"):
        return ASCII
    encoding = getattr(sys.__stdout__, "encoding", None) or "utf-8"
    if "utf" not in encoding.lower():
        return Glyphs(False, (encoding,))
    page = console_code_page()
    if page == 0 or any(name in environment for name in _CAPABLE_TERMINALS):
        return BRAILLE
    if page in _WIDE_PAGES:
        return ASCII
    return Glyphs(False, _FONT_PAGES if page == UTF_8 else (f"cp{page}",))


def console_code_page() -> int:
    """Return the number of the code page of the console of Windows; 0: there is no such console."""
    if sys.platform == "win32":
        import ctypes

        return int(ctypes.windll.kernel32.GetConsoleOutputCP())
    else:  # noqa: RET505 - only an else is left out of the checks for other platforms
        return 0
