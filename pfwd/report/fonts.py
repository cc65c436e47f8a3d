"""Which letters can be drawn on this computer."""

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
"""Parts of the names of their files."""

LATIN = "DejaVu Sans"
"""Comes with matplotlib."""


@cache
def chinese_family() -> str | None:
    """The family that Chinese letters are drawn with; None: there is none."""
    start_matplotlib()
    from matplotlib.font_manager import findSystemFonts, fontManager

    found = _among(entry.name for entry in fontManager.ttflist)
    if found is not None:
        return found
    # The list of matplotlib is kept from its first run: a font installed since is not in it.
    for path in findSystemFonts():
        name = os.path.basename(path).lower().replace("-", "").replace(" ", "")
        if any(hint in name for hint in _FILES):
            with contextlib.suppress(OSError, RuntimeError):  # not every file is a sound font
                fontManager.addfont(path)
    return _among(entry.name for entry in fontManager.ttflist)


def _among(known: Iterable[str]) -> str | None:
    names = set(known)
    return next((name for name in CHINESE if name in names), None)


def families() -> list[str]:
    """Families to draw with, in the order in which they are asked for a letter."""
    found = chinese_family()
    return [LATIN] if found is None else [LATIN, found]


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
    """Widths of letters, and the letters that no font has."""

    def __init__(self) -> None:
        start_matplotlib()
        from matplotlib.font_manager import FontProperties, findfont, get_font

        self._faces = [get_font(findfont(FontProperties(family=name))) for name in families()]
        self._maps = [face.get_charmap() for face in self._faces]
        self._widths: dict[str, float] = {}
        self.missing = 0
        """How many letters were replaced."""

    def __reduce__(self) -> tuple[type["Letters"], tuple[()]]:
        """Pickle nothing: faces of FreeType cannot be, and another process has the same fonts."""
        return Letters, ()

    def drawable(self, text: object) -> str:
        """The text with every letter that no font has replaced by a question mark."""
        shown = []
        for letter in str(text):
            if letter == "\n":
                shown.append(letter)
            elif unicodedata.category(letter)[0] == "C":
                shown.append(" ")  # control characters have no business on paper
            elif any(ord(letter) in known for known in self._maps):
                shown.append(letter)
            else:
                self.missing += 1
                shown.append("?")
        return "".join(shown)

    def width(self, text: str, size: float) -> float:
        """Width of a text in points at a size in points."""
        return sum(self._advance(letter) for letter in text) * size

    def _advance(self, letter: str) -> float:
        found = self._widths.get(letter)
        if found is None:
            found = 0.6
            for face, letters in zip(self._faces, self._maps, strict=True):
                if ord(letter) in letters:
                    face.set_size(100.0, 72.0)
                    found = face.load_char(ord(letter)).linearHoriAdvance / 65536 / 100
                    break
            self._widths[letter] = found
        return found
