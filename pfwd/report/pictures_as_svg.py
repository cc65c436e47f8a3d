"""Pictures of a page as SVG in data addresses."""

import base64
import io
import re
from typing import Any

from pfwd.matplotlib_start import start_matplotlib
from pfwd.report.blocks import Picture
from pfwd.report.fonts import families

PICTURE_WIDTH_MM = 180.0
"""Width of a picture."""

_MM_PER_INCH = 25.4


def data_address(picture: Picture) -> str:
    """Return a picture as a data URI with SVG."""
    svg = svg_of(picture).encode("utf-8")
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


def svg_of(
    picture: Picture, width: float = PICTURE_WIDTH_MM, *, letters_as_text: bool = False
) -> str:
    """Return a picture as SVG.

    Parameters
    ----------
    picture : Picture
    width : float, mm
    letters_as_text : bool
        Keep letters as text, for a program that has the fonts. False: draw them as outlines,
        because the computer of a reader may have other fonts.
    """
    start_matplotlib()
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    settings: Any = {
        "svg.fonttype": "none" if letters_as_text else "path",
        "svg.hashsalt": "pfwd",
        "font.family": families(),
    }
    with rc_context(settings):
        figure: Any = Figure(figsize=(width / _MM_PER_INCH, picture.height / _MM_PER_INCH))
        FigureCanvasSVG(figure)
        picture.draw(figure)
        stream = io.StringIO()
        # Margins are parts of the width: on a narrow picture they may be too small for the labels.
        box = "tight" if width < PICTURE_WIDTH_MM else None
        figure.savefig(
            stream, format="svg", metadata={"Date": None, "Creator": None}, bbox_inches=box
        )
    svg = stream.getvalue()
    return _chinese_font_first(svg) if letters_as_text else svg


_TEXT_OF_TWO_FAMILIES = re.compile(r"(font-family: )('[^']*'), ('[^']*')([^>]*>)([^<]*)")
"""Beginning, two families, attributes and letters of a text in an SVG."""

_FIRST_CHINESE = "\N{CJK RADICAL REPEAT}"
"""First letter that only the Chinese family has, and with it its punctuation."""


def _chinese_font_first(svg: str) -> str:
    """Return an SVG with the Chinese family first for texts with Chinese letters.

    Typst looks for a letter that the first family lacks in all fonts of the folder, and would take
    it from a Japanese one.
    """

    def reorder(match: re.Match[str]) -> str:
        begin, latin, chinese, attributes, letters = match.groups()
        if max(letters, default="") < _FIRST_CHINESE:
            return match[0]
        return f"{begin}{chinese}, {latin}{attributes}{letters}"

    return _TEXT_OF_TWO_FAMILIES.sub(reorder, svg)
