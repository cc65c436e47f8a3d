"""The pictures of a page as SVG in data addresses, drawn by one process or by two from both ends.

Drawing keeps one processor busy. A second process starts while this one reads the survey; it draws
the last picture, then the one before, until this one has come there from the beginning.
"""

from __future__ import annotations

import base64
import contextlib
import io
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pfwd_device.recording.layout import Layout
from pfwd_survey.matplotlib_start import start_matplotlib
from pfwd_survey.reporting.blocks import Picture
from pfwd_survey.reporting.fonts import families
from pfwd_survey.spawning import beside, processors, worker_pool

WIDTH = 180.0
"""mm, of a picture."""

MANY_DROPS = 3_000
"""Bytes of a ledger, those of 20 drops: in the time that a second process takes to start the
pictures of so many are drawn."""

_MM_PER_INCH = 25.4


class SecondDrawer:
    """A process that draws pictures."""

    def __init__(self) -> None:
        self._pool = worker_pool(1)
        self._pool.submit(_load)

    def ask(self, pictures: Sequence[Picture]) -> Sequence[Future[str] | None]:
        """Ask for these; the last one is drawn first. None: the process has ended."""
        asked: list[Future[str] | None] = [None] * len(pictures)
        with contextlib.suppress(BrokenProcessPool):
            for number in reversed(range(len(pictures))):
                asked[number] = self._pool.submit(data_address, pictures[number])
        return asked

    def close(self) -> None:
        """End it; what it has not begun is not drawn."""
        self._pool.shutdown(cancel_futures=True)


def second_drawer(survey: str, output: str) -> AbstractContextManager[SecondDrawer | None]:
    """One for the block; None where it would not help, or cannot be had.

    Parameters
    ----------
    survey : path of a survey
    output : path of the report; HTML alone has its pictures one by one
    """
    html = output.lower().endswith(".html")
    return beside(SecondDrawer, html and processors() > 1 and _has_many_drops(survey))


def _has_many_drops(survey: str) -> bool:
    try:
        return Layout(Path(survey)).ledger.stat().st_size >= MANY_DROPS
    except OSError:
        return False  # no survey, which is said when it is read


def _load() -> None:
    """What drawing needs, loaded before the first picture comes."""
    start_matplotlib()

    import pfwd_survey.reporting.drawing  # noqa: F401


def data_addresses(
    pictures: Sequence[Picture], second: SecondDrawer | None = None
) -> Iterator[str]:
    """The address of each picture, in their order."""
    asked = [None] * len(pictures) if second is None else second.ask(pictures)
    for picture, future in zip(pictures, asked, strict=True):
        made = None if future is None or future.cancel() else _made(future)
        yield data_address(picture) if made is None else made


def _made(future: Future[str]) -> str | None:
    """Return what the second process has drawn; None: it has ended, or could not draw it."""
    try:
        return future.result()
    except Exception:  # of any kind, pickling included: this process draws it, or raises the same
        return None


def data_address(picture: Picture) -> str:
    """A picture as SVG, in an address that holds it."""
    start_matplotlib()
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    # Letters as outlines: the reader's computer may have other fonts.
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": "pfwd", "font.family": families()}):
        figure: Any = Figure(figsize=(WIDTH / _MM_PER_INCH, picture.height / _MM_PER_INCH))
        FigureCanvasSVG(figure)
        picture.draw(figure)
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
