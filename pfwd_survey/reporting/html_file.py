"""A report as one HTML file: pictures inside, no script, nothing fetched."""

import base64
import io
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any

import jinja2

from pfwd_survey.matplotlib_start import start_matplotlib
from pfwd_survey.reporting.blocks import SIGNS, Block, Picture, Together
from pfwd_survey.reporting.fonts import families
from pfwd_survey.reporting.texts import Texts

WIDTH = 180.0
"""mm, of a picture."""

_MM_PER_INCH = 25.4


def render_html(blocks: Sequence[Block], texts: Texts, title: str) -> str:
    """The text of the file.

    Parameters
    ----------
    blocks : sequence of Block
    texts : Texts
    title : str
        For the window.

    Returns
    -------
    str
        Everything from a survey is escaped; the pictures are SVG in data addresses, in which a
        browser runs and loads nothing.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        resources.files(__package__)
        .joinpath("templates/report.html.j2")
        .read_text(encoding="utf-8")
    )
    shown = [{"kind": type(block).__name__, "block": block} for block in _flat(blocks)]
    for item in shown:
        block = item["block"]
        if isinstance(block, Picture):
            item["data"] = _data_address(block)
    return template.render(blocks=shown, code=texts.code, title=title, signs=SIGNS)


def _flat(blocks: Sequence[Block]) -> Iterator[Block]:
    """Paper alone has pages."""
    for block in blocks:
        if isinstance(block, Together):
            yield from _flat(block.blocks)
        else:
            yield block


def _data_address(picture: Picture) -> str:
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
