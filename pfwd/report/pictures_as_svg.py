"""The pictures of a page as SVG in data addresses, drawn by one process or by two from both ends.

Drawing keeps one processor busy. A second process starts while this one reads the survey. It draws
the pictures from the last one on, until it meets this process, which begins with the first.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any

from pfwd.files.folders import has_ledger_of
from pfwd.matplotlib_start import start_matplotlib
from pfwd.report.blocks import Picture
from pfwd.report.fonts import families
from pfwd.report.plain_axes import draw_axes_plainly
from pfwd.spawning import HelperProcess, beside, helper_result, processors

PICTURE_WIDTH_MM = 180.0
"""Width of a picture."""

MIN_DRAWN_LEDGER_BYTES = 3_000
"""Size of the ledger from which a second process helps, that of 20 drops: their pictures take as
long as the process takes to start."""

_MM_PER_INCH = 25.4


class SecondDrawer(HelperProcess):
    """Helper process that draws pictures."""

    def __init__(self) -> None:
        super().__init__(_load)

    def request(self, pictures: Sequence[Picture]) -> Sequence[Future[str] | None]:
        """Start drawing pictures, the last one first; None for each if the process has ended."""
        return self.submit(data_address, pictures)


def second_drawer(survey: str, output: str) -> AbstractContextManager[SecondDrawer | None]:
    """Return a context with a second drawing process, or None where it would not be faster.

    Parameters
    ----------
    survey : path of a survey
    output : path of the report; only HTML has its pictures one by one
    """
    html = output.lower().endswith(".html")
    return beside(
        SecondDrawer, html and processors() > 1 and has_ledger_of(survey, MIN_DRAWN_LEDGER_BYTES)
    )


def _load() -> None:
    """Import the modules that drawing needs, before the first picture is requested."""
    start_matplotlib()

    import pfwd.report.drawing  # noqa: F401


def data_addresses(
    pictures: Sequence[Picture], second: SecondDrawer | None = None
) -> Iterator[str]:
    """Yield the address of each picture, in their order."""
    futures = [None] * len(pictures) if second is None else second.request(pictures)
    for picture, future in zip(pictures, futures, strict=True):
        address = helper_result(future)
        yield data_address(picture) if address is None else address


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
        "axes.titley": 1.0,  # else matplotlib makes ticks to look whether they touch the title
    }
    with rc_context(settings):
        figure: Any = Figure(figsize=(width / _MM_PER_INCH, picture.height / _MM_PER_INCH))
        FigureCanvasSVG(figure)
        picture.draw(figure)
        draw_axes_plainly(figure)
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
