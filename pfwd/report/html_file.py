"""A report as one HTML file: pictures inside, no script, nothing fetched."""

from collections.abc import Iterator, Sequence
from typing import Any

import jinja2

from pfwd.report.blocks import SIGNS, Block, Picture, Together
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
    return (
        _environment()
        .get_template("report.html.j2")
        .render(blocks=_with_pictures(blocks), code=texts.code, title=title, signs=SIGNS)
    )


def render_part(blocks: Sequence[Block]) -> str:
    """Return blocks as a part of a page that has the style of `style_sheet`."""
    template = _environment().get_template("blocks.html.j2")
    return template.render(blocks=_with_pictures(blocks), signs=SIGNS)


def style_sheet() -> str:
    """Return the style of reports, CSS."""
    return _environment().get_template("style.css").render()


def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("pfwd.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _with_pictures(blocks: Sequence[Block]) -> list[dict[str, Any]]:
    """Return the values of the template: kind and block, of a picture its address too."""
    items: list[dict[str, Any]] = [
        {"kind": type(block).__name__, "block": block} for block in _flat(blocks)
    ]
    for item in items:
        if isinstance(item["block"], Picture):
            item["data"] = data_address(item["block"])
    return items


def _flat(blocks: Sequence[Block]) -> Iterator[Block]:
    """Yield the blocks without those that keep others on one page: HTML has no pages."""
    for block in blocks:
        if isinstance(block, Together):
            yield from _flat(block.blocks)
        else:
            yield block
