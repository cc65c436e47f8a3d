"""A report as a PDF, laid out by Typst: PDF/A-2a and PDF/UA-1, with its fonts embedded.

Typst is a wheel without libraries of the system. A renderer of HTML would need Pango or a browser,
which a field computer often lacks.
"""

import json
from collections.abc import Sequence
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Any

from pfwd.report.blocks import (
    SIGNS,
    Block,
    Mark,
    Paragraph,
    Picture,
    Table,
)
from pfwd.report.fonts import Letters, families, font_folders
from pfwd.report.pictures_as_svg import svg_of
from pfwd.report.texts import Texts
from pfwd.report.typst_process import STANDARDS, render_apart

_CHECKSUM_CHARACTERS = 64
"""Number of characters of a SHA-256; a table with one has smaller letters."""

_MIN_SMALL_COLUMNS = 9
"""Number of columns from which a table has smaller letters."""

_TABLE_WIDTH_PT = 510.0
"""Width of a table, points: that of A4 without its margins."""

_CELL_SIZE_PT, _SMALL_CELL_SIZE_PT = 7.0, 6.2
"""Font sizes of a table and of one with many columns, points, as in the template."""

_BOLD_OVER_PLAIN_WIDTH = 1.17
"""Width of bold letters over plain ones."""

_CELL_PADDING_PT = 6.5
"""Space left and right of the text of a cell together, points."""


def render_pdf(
    blocks: Sequence[Block],
    texts: Texts,
    title: str,
    letters: Letters,
    template: Path | None = None,
) -> bytes:
    """Return the bytes of the PDF with these blocks.

    Parameters
    ----------
    blocks : sequence of Block
    texts : Texts
    title : str
        Title of the document and foot of its pages.
    letters : Letters
    template : Path, optional
        Template of the user, in place of the one that comes with the program.

    Raises
    ------
    OptionError
        If the template of the user cannot be rendered.
    """
    data = json.dumps(typst_data(blocks, texts, title, letters), ensure_ascii=False)
    if template is not None:
        return render_apart(template, data, font_folders())
    import typst

    compiler = typst.Compiler(
        resources.files(__package__).joinpath("templates/report.typ").read_bytes(),
        font_paths=typst.Fonts(False, False, [*font_folders()]),
        sys_inputs={"data": data},
    )
    pdf = compiler.compile(format="pdf", pdf_standards=[*STANDARDS])
    assert isinstance(pdf, bytes)
    return pdf


def typst_data(
    blocks: Sequence[Block], texts: Texts, title: str, letters: Letters
) -> dict[str, Any]:
    """Return the data of a template, described in docs/reports.md."""
    block_data = [_block_data(block, letters) for block in blocks]
    if letters.missing:
        text = texts.say("missing_letters", count=letters.missing)
        block_data.append(_block_data(Paragraph(text, "warning"), letters))
    return {
        "title": _drawable(title, letters),
        "language": texts.code,
        "fonts": families(),
        "page": texts.say("page", page="{page}", pages="{pages}"),
        "blocks": block_data,
    }


def _drawable(text: str, letters: Letters) -> str:
    # The sign for a harmful letter would break the rules of PDF/A: it stands for no letter.
    return letters.drawable(text).replace("\N{REPLACEMENT CHARACTER}", "?")


def _block_data(block: Block, letters: Letters) -> dict[str, Any]:
    data = {field.name: _drawn(getattr(block, field.name), letters) for field in fields(block)}
    match block:
        case Picture():
            data["alternative"] = data["alternative"] or data["caption"]
            del data["draw"], data["height"]
            data["svg"] = svg_of(block, letters_as_text=True)
        case Table():
            data |= _table_layout(data["columns"], data["rows"], letters)
    return {"kind": type(block).__name__, **data}


def _drawn(value: Any, letters: Letters) -> Any:
    """Return the value of a field of a block as data for Typst."""
    match value:
        case str():
            return _drawable(value, letters)
        case tuple():
            return [_drawn(item, letters) for item in value]
        case Mark():
            text = _drawable(value.text, letters)
            return {"kind": value.kind, "sign": SIGNS[value.kind], "text": text}
    return _block_data(value, letters) if isinstance(value, Block) else value


def _table_layout(columns: Any, rows: Any, letters: Letters) -> dict[str, Any]:
    """Return whether a table has small letters, and the widths of its columns."""
    lengths = [len(cell) for row in rows for cell in row if isinstance(cell, str)]
    small = len(columns) >= _MIN_SMALL_COLUMNS or max(lengths, default=0) == _CHECKSUM_CHARACTERS
    size = _SMALL_CELL_SIZE_PT if small else _CELL_SIZE_PT
    return {"small": small, "widths": _column_widths(columns, rows, size, letters)}


def _column_widths(
    columns: Sequence[str],
    rows: Sequence[Sequence[str | dict[str, str]]],
    size: float,
    letters: Letters,
) -> list[float]:
    """Return the width of each column, points.

    A column is as wide as its longest cell; if the table is too wide, the widest are narrowed.
    """
    widths_needed = []
    for title, *cells in zip(columns, *rows, strict=True):
        widths = [letters.width(word, size * _BOLD_OVER_PLAIN_WIDTH) for word in title.split(" ")]
        for cell in cells:
            bold = isinstance(cell, dict)
            text = f"{cell['sign']} {cell['text']}" if isinstance(cell, dict) else cell
            scale = size * (_BOLD_OVER_PLAIN_WIDTH if bold else 1.03)
            widths += [letters.width(line, scale) for line in text.split("\n")]
        widths_needed.append(max(widths, default=0.0) + _CELL_PADDING_PT)
    if sum(widths_needed) <= _TABLE_WIDTH_PT:
        spare = (_TABLE_WIDTH_PT - sum(widths_needed)) / len(widths_needed)
        return [width + spare for width in widths_needed]
    low, high = 0.0, max(widths_needed)  # limit of a column's width, by bisection
    for _ in range(40):
        limit = (low + high) / 2
        if sum(min(width, limit) for width in widths_needed) > _TABLE_WIDTH_PT:
            high = limit
        else:
            low = limit
    return [min(width, low) for width in widths_needed]
