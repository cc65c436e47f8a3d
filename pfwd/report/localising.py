"""Numbers and messages in the language of a report."""

import re
from collections.abc import Collection, Iterable
from dataclasses import replace

from pfwd.report.blocks import (
    Block,
    Listing,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd.report.texts import Texts

_DECIMAL = re.compile(r"(?<![\w.:/])(\d+)\.(\d+)(?![\w]|[.:]\d)")
"""A number with decimals; no version, date, part of a name or of a path."""


def localised(blocks: Iterable[Block], texts: Texts, keep: Collection[str] = ()) -> list[Block]:
    """Blocks with the decimal sign of the language.

    Parameters
    ----------
    blocks : iterable of Block
    texts : Texts
    keep : collection of str
        Labels of pairs whose values stay (names, paths, commands), and paragraphs that stay.
    """
    if texts.decimal == ".":
        return list(blocks)
    return [_block(block, texts, keep) for block in blocks]


def with_decimals(text: str, texts: Texts) -> str:
    """A text with the decimal sign of the language."""
    if texts.decimal == ".":
        return text
    return _DECIMAL.sub(rf"\1{texts.decimal}\2", text)


def _block(block: Block, texts: Texts, keep: Collection[str]) -> Block:
    def said(text: str) -> str:
        return with_decimals(text, texts)

    def cell(value: str | Mark) -> str | Mark:
        return said(value) if isinstance(value, str) else value

    match block:
        case Paragraph(text):
            return block if text in keep else replace(block, text=said(text))
        case Pairs(rows):
            return Pairs(tuple((k, v if k in keep else said(v)) for k, v in rows))
        case Table(columns, rows, right):
            return Table(columns, tuple(tuple(map(cell, row)) for row in rows), right)
        case Listing(items):
            return replace(block, items=tuple(map(said, items)))
        case Picture(caption=caption):
            return replace(block, caption=said(caption))
        case Together(inner):
            return Together(tuple(_block(part, texts, keep) for part in inner))
    return block
