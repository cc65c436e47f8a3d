"""Numbers and messages in the language of a report."""

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from functools import partial

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
from pfwd.report.content import Report
from pfwd.report.texts import Texts

_DECIMAL = re.compile(r"(?<![\w.:/])(\d+)\.(\d+)(?![\w]|[.:]\d)")
"""A number with decimals, but no version, date, part of a name or of a path."""


def names_of(report: Report) -> list[str]:
    """Return the names in a report whose dots are no decimal signs."""
    names = {name for point in report.points for name in (point.name, point.shown_name)}
    return sorted({*names, report.title, report.survey_name}, key=len, reverse=True)


def localised(
    blocks: Iterable[Block],
    texts: Texts,
    keep: Collection[str] = (),
    names: Iterable[str] = (),
) -> list[Block]:
    """Return blocks with the decimal sign of the language.

    Parameters
    ----------
    blocks : iterable of Block
    texts : Texts
    keep : collection of str
        Labels of pairs whose values stay (names, paths, commands), and paragraphs that stay.
    names : iterable of str
        Names that stay wherever they stand, the longer ones first.
    """
    if texts.decimal == ".":
        return list(blocks)
    dotted = [re.escape(name) for name in names if _DECIMAL.search(name)]
    pattern = re.compile("|".join([*dotted, _DECIMAL.pattern])) if dotted else _DECIMAL

    def replace_sign(match: re.Match[str]) -> str:
        integer, fraction = match.groups()
        return match[0] if integer is None else f"{integer}{texts.decimal}{fraction}"

    return [_block(block, partial(pattern.sub, replace_sign), keep) for block in blocks]


def with_decimals(text: str, texts: Texts) -> str:
    """Return a text with the decimal sign of the language."""
    if texts.decimal == ".":
        return text
    return _DECIMAL.sub(rf"\1{texts.decimal}\2", text)


def _block(block: Block, localise: Callable[[str], str], keep: Collection[str]) -> Block:
    def cell(value: str | Mark) -> str | Mark:
        return localise(value) if isinstance(value, str) else value

    match block:
        case Paragraph(text):
            return block if text in keep else replace(block, text=localise(text))
        case Pairs(rows):
            return Pairs(tuple((k, v if k in keep else localise(v)) for k, v in rows))
        case Table(columns, rows, right):
            titles = tuple(map(localise, columns))
            return Table(titles, tuple(tuple(map(cell, row)) for row in rows), right)
        case Listing(items):
            return replace(block, items=tuple(map(localise, items)))
        case Picture(caption=caption):
            return replace(block, caption=localise(caption))
        case Together(inner):
            return Together(tuple(_block(part, localise, keep) for part in inner))
    return block
