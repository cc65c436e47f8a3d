"""The pictures of a page as SVG in data addresses, drawn by one process or by two from both ends.

Drawing keeps one processor busy. A second process starts while this one reads the survey; it draws
the last picture, then the one before, until this one has come there from the beginning.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from typing import Any

from pfwd.files.folders import has_ledger_of
from pfwd.matplotlib_start import start_matplotlib
from pfwd.report.blocks import Picture
from pfwd.report.fonts import families
from pfwd.spawning import HelperProcess, beside, helper_result, processors

WIDTH = 180.0
"""mm, of a picture."""

MANY_DROPS = 3_000
"""Bytes of a ledger, those of 20 drops: in the time that a second process takes to start the
pictures of so many are drawn."""

_MM_PER_INCH = 25.4


class SecondDrawer(HelperProcess):
    """A process that draws pictures."""

    def __init__(self) -> None:
        super().__init__(_load)

    def ask(self, pictures: Sequence[Picture]) -> Sequence[Future[str] | None]:
        """Request these pictures, the last one first; None: the process has ended."""
        return self.submit(data_address, pictures)


def second_drawer(survey: str, output: str) -> AbstractContextManager[SecondDrawer | None]:
    """Return a context with a second drawing process, or None where it would not be faster.

    Parameters
    ----------
    survey : path of a survey
    output : path of the report; HTML alone has its pictures one by one
    """
    html = output.lower().endswith(".html")
    return beside(SecondDrawer, html and processors() > 1 and has_ledger_of(survey, MANY_DROPS))


def _load() -> None:
    """What drawing needs, loaded before the first picture comes."""
    start_matplotlib()

    import pfwd.report.drawing  # noqa: F401


def data_addresses(
    pictures: Sequence[Picture], second: SecondDrawer | None = None
) -> Iterator[str]:
    """The address of each picture, in their order."""
    asked = [None] * len(pictures) if second is None else second.ask(pictures)
    for picture, future in zip(pictures, asked, strict=True):
        made = helper_result(future)
        yield data_address(picture) if made is None else made


def data_address(picture: Picture) -> str:
    """Return a picture as a data URI with SVG."""
    svg = svg_of(picture).encode("utf-8")
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


def svg_of(picture: Picture, width: float = WIDTH) -> str:
    """Return a picture as SVG.

    Parameters
    ----------
    picture : Picture
    width : float, mm
    """
    start_matplotlib()
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Letters as outlines: the reader's computer may have other fonts.
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": "pfwd", "font.family": families()}):
        figure: Any = Figure(figsize=(width / _MM_PER_INCH, picture.height / _MM_PER_INCH))
        FigureCanvasSVG(figure)
        picture.draw(figure)
        stream = io.StringIO()
        # What margins in parts of the width leave no room for is not cut on a narrow picture.
        box = "tight" if width < WIDTH else None
        figure.savefig(
            stream, format="svg", metadata={"Date": None, "Creator": None}, bbox_inches=box
        )
    return stream.getvalue()
