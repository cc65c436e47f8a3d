"""Tables: of drops with results as ``table`` (CSV, RFC 4180), ``jsonl`` and ``parquet``, of points
with verdicts as ``points`` (CSV).

Each function ``write_...`` takes an `Order` and a path and returns one sentence for each omission.
"""

import csv
import os
from typing import Any

from pfwd.errors import OptionError, how_to_install, refusal
from pfwd.export.columns import DROP_COLUMNS, POINT_COLUMNS
from pfwd.export.json_text import json_text
from pfwd.export.output import new_file, new_text_file
from pfwd.export.rows import Order, point_rows

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n")
"""Characters with which a text begins that a spreadsheet would evaluate as a formula."""


def write_table(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the rows of all drops as CSV; discarded drops are marked."""
    with new_text_file(path, force=order.force, newline="") as stream:  # `csv` ends the lines
        writer = csv.writer(stream, delimiter=order.delimiter)
        writer.writerow(column.name for column in DROP_COLUMNS)
        for row in order.rows:
            writer.writerow(cell(row.values[column.name], order.decimal) for column in DROP_COLUMNS)
    return []


def write_points(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the rows of all points as CSV; discarded points are marked."""
    with new_text_file(path, force=order.force, newline="") as stream:
        writer = csv.writer(stream, delimiter=order.delimiter)
        writer.writerow([column.name for column in POINT_COLUMNS])
        for row in point_rows(order):
            writer.writerow([cell(value, order.decimal) for value in row.values()])
    return []


def write_jsonl(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write each drop with its complete result as one line of JSON; discarded drops are marked."""
    with new_text_file(path, force=order.force) as stream:
        for row in order.rows:
            result = None if row.drop.last_result is None else row.drop.last_result.to_json()
            more = {"declared": row.drop.declared or {}, "result": result}
            stream.write(json_text({**row.json_values, **more}) + "\n")
    return []


def write_parquet(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the rows of all drops as Parquet, with types, units and meanings of the columns.

    Raises
    ------
    OptionError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as err:
        hint = f"{how_to_install('parquet')}, or another format"
        expected = "the package pyarrow"
        raise OptionError(refusal("--format parquet", expected, "none", hint)) from err
    kinds: dict[str, Any] = {
        "text": pyarrow.string(),
        "time": pyarrow.string(),
        "whole": pyarrow.int64(),
        "number": pyarrow.float64(),
        "flag": pyarrow.bool_(),
        "texts": pyarrow.list_(pyarrow.string()),
    }
    fields = [
        pyarrow.field(column.name, kinds[column.kind], metadata={"meaning": column.meaning})
        for column in DROP_COLUMNS
    ]
    rows = order.rows
    columns = [[row.values[column.name] for row in rows] for column in DROP_COLUMNS]
    table = pyarrow.table(columns, schema=pyarrow.schema(fields))
    with new_file(path, force=order.force) as draft:
        parquet.write_table(table, draft)
    return []


def cell(value: Any, decimal: str = ".") -> str:
    """Return a value as the text of a cell.

    A text that a spreadsheet would evaluate as a formula gets an apostrophe in front.

    Examples
    --------
    >>> cell(-1.5), cell("-1.5"), cell(None), cell(True), cell(["a", "=b"]), cell(1.5, ",")
    ('-1.5', "'-1.5", '', 'true', 'a; =b', '1,5')
    """
    if type(value) is float:  # most values: faster than the cases below
        return repr(value).replace(".", decimal)
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value).replace(".", decimal)
        case list() | tuple():
            return cell("; ".join(map(str, value)))
    text = str(value)
    # Some spreadsheets skip blanks before a formula.
    return f"'{text}" if text.lstrip(" ").startswith(FORMULA_STARTS) else text
