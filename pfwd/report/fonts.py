"""The fonts of this computer, and the letters that they have."""

import contextlib
import os
import unicodedata
from collections.abc import Iterable
from functools import cache

from pfwd.errors import OptionError, refusal
from pfwd.matplotlib_start import start_matplotlib

CHINESE = (
    "Noto Sans CJK SC",
    "Noto Sans SC",
    "Source Han Sans SC",
    "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei",
    "Microsoft YaHei",
    "SimHei",
    "PingFang SC",
    "Heiti SC",
    "Hiragino Sans GB",
    "Droid Sans Fallback",
    "Arial Unicode MS",
)
"""Families with Chinese letters on Linux, Windows and macOS, the better ones first."""

_FILES = (
    *("cjk", "notosanssc", "sourcehansans", "wqy", "msyh", "simhei", "pingfang", "heiti"),
    *("hiragino", "droidsansfallback", "arialuni"),
)
"""Parts of the file names of fonts with Chinese letters, in lower case."""

LATIN = "DejaVu Sans"
"""Family for Latin letters; it comes with matplotlib."""


@cache
def chinese_family() -> str | None:
    """Return the family that Chinese letters are drawn with; None: there is none."""
    start_matplotlib()
    from matplotlib.font_manager import findSystemFonts, fontManager

    family = _first_chinese(entry.name for entry in fontManager.ttflist)
    if family is not None:
        return family
    # The list of matplotlib is kept from its first run: a font installed since is not in it.
    for path in findSystemFonts():
        name = os.path.basename(path).lower().replace("-", "").replace(" ", "")
        if any(hint in name for hint in _FILES):
            with contextlib.suppress(OSError, RuntimeError):  # not every file is a sound font
                fontManager.addfont(path)
    return _first_chinese(entry.name for entry in fontManager.ttflist)


def _first_chinese(families: Iterable[str]) -> str | None:
    names = set(families)
    return next((name for name in CHINESE if name in names), None)


def families() -> list[str]:
    """Return the families to draw with, in the order in which they are searched for a letter."""
    chinese = chinese_family()
    return [LATIN] if chinese is None else [LATIN, chinese]


def font_folders() -> list[str]:
    """Return the folders that hold the fonts of `families`."""
    start_matplotlib()
    from matplotlib.font_manager import FontProperties, findfont

    files = [findfont(FontProperties(family=name)) for name in families()]
    return list(dict.fromkeys(os.path.dirname(file) for file in files))


def require_letters(language: str) -> None:
    """Refuse a language whose letters would come out as boxes.

    Raises
    ------
    OptionError
    """
    if language == "zh" and chinese_family() is None:
        raise OptionError(
            refusal(
                "--language zh",
                "a font with Chinese letters for the pictures",
                "none on this computer",
                "install one, as fonts-noto-cjk or fonts-wqy-microhei on Debian and Ubuntu",
            )
        )


class Letters:
    """Widths of letters, and the number of letters that no font has."""

    def __init__(self) -> None:
        start_matplotlib()
        from matplotlib.font_manager import FontProperties, findfont, get_font

        self._faces = [get_font(findfont(FontProperties(family=name))) for name in families()]
        self._widths: dict[str, float] = {}
        self.missing = 0
        """Number of replaced letters."""

    def drawable(self, text: object) -> str:
        """Return the text with a question mark for every letter that no font has."""
        drawable = []
        for letter in str(text):
            if letter == "\n":
                drawable.append(letter)
            elif unicodedata.category(letter)[0] == "C":
                drawable.append(" ")  # control characters have no business on paper
            elif any(face.get_char_index(ord(letter)) for face in self._faces):
                drawable.append(letter)
            else:
                self.missing += 1
                drawable.append("?")
        return "".join(drawable)

    def width(self, text: str, size: float) -> float:
        """Return the width of a text in points, at a size in points."""
        return sum(self._advance(letter) for letter in text) * size

    def _advance(self, letter: str) -> float:
        width = self._widths.get(letter)
        if width is None:
            width = 0.6
            for face in self._faces:
                if face.get_char_index(ord(letter)):
                    face.set_size(100.0, 72.0)
                    width = face.load_char(ord(letter)).linearHoriAdvance / 65536 / 100
                    break
            self._widths[letter] = width
        return width
