"""A report as one HTML file: pictures inside, no script, nothing fetched."""

from collections.abc import Sequence

import jinja2

from pfwd.report.blocks import SIGNS, Block
from pfwd.report.pictures_as_svg import data_address
from pfwd.report.texts import Texts


def render_html(blocks: Sequence[Block], texts: Texts, title: str) -> str:
    """Return the text of the file.

    Parameters
    ----------
    blocks : sequence of Block
    texts : Texts
    title : str
        Title of the window.

    Returns
    -------
    str
        Everything from a survey is escaped; the pictures are SVG in data addresses, in which a
        browser runs and loads nothing.
    """
    template = _environment().get_template("report.html.j2")
    return template.render(blocks=blocks, code=texts.code, title=title)


def render_part(blocks: Sequence[Block]) -> str:
    """Return blocks as a part of a page that has the style of `style_sheet`."""
    return _environment().get_template("blocks.html.j2").render(blocks=blocks)


def style_sheet() -> str:
    """Return the style of reports, CSS."""
    return _environment().get_template("style.css").render()


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pfwd.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"signs": SIGNS, "kind_of": _kind_of, "data_address": data_address}
    return environment


def _kind_of(block: Block) -> str:
    return type(block).__name__
