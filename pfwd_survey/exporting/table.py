"""``table``: one line a drop with its result, as CSV (RFC 4180, UTF-8)."""

import csv
import os
from typing import Any

from pfwd_survey.exporting.columns import COLUMNS
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""A spreadsheet takes text that begins so for a formula, and runs it."""


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the rows of all drops, discarded ones marked."""
    names = [column.name for column in COLUMNS]
    with (
        new_file(path, force=order.force) as draft,
        # newline: the writer ends lines itself, on every system alike
        open(draft, "w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(names)
        for row in order.rows:
            writer.writerow([cell(row.values[name]) for name in names])
    return []


def cell(value: Any) -> str:
    """A value as the text of a cell; text that a spreadsheet would run begins with an apostrophe.

    Examples
    --------
    >>> cell(-1.5), cell("-1.5"), cell(None), cell(True), cell(["a", "=b"])
    ('-1.5', "'-1.5", '', 'true', 'a; =b')
    """
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case list() | tuple():
            return cell("; ".join(map(str, value)))
    text = str(value)
    # Blanks before the sign do not stop every spreadsheet.
    return f"'{text}" if text.lstrip(" ").startswith(FORMULA) else text
