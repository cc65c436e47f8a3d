"""A report as one HTML file: pictures inside, no script, nothing fetched."""

from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Any

import jinja2

from pfwd.report.blocks import SIGNS, Block, Picture, Together
from pfwd.report.pictures_as_svg import SecondDrawer, data_addresses
from pfwd.report.texts import Texts


def render_html(
    blocks: Sequence[Block], texts: Texts, title: str, second: SecondDrawer | None = None
) -> str:
    """The text of the file.

    Parameters
    ----------
    blocks : sequence of Block
    texts : Texts
    title : str
        For the window.
    second : SecondDrawer, optional
        Draws pictures, too.

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
    shown: list[dict[str, Any]] = [
        {"kind": type(block).__name__, "block": block} for block in _flat(blocks)
    ]
    drawn = [item for item in shown if isinstance(item["block"], Picture)]
    for item, data in zip(
        drawn, data_addresses([item["block"] for item in drawn], second), strict=True
    ):
        item["data"] = data
    return template.render(blocks=shown, code=texts.code, title=title, signs=SIGNS)


def _flat(blocks: Sequence[Block]) -> Iterator[Block]:
    """Paper alone has pages."""
    for block in blocks:
        if isinstance(block, Together):
            yield from _flat(block.blocks)
        else:
            yield block
