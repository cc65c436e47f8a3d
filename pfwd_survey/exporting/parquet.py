"""``parquet``: the table of results with its types, units and meanings; needs pyarrow."""

import os
from typing import Any

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.exporting.columns import COLUMNS
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the rows of all drops, discarded ones marked.

    Raises
    ------
    OptionError
        If pyarrow is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as err:
        hint = "python -m pip install pyarrow, or another format"
        expected = "the package pyarrow"
        raise OptionError(refusal("--format parquet", expected, "none", hint)) from err
    kinds: dict[str, Any] = {
        "text": pyarrow.string(),
        "whole": pyarrow.int64(),
        "number": pyarrow.float64(),
        "flag": pyarrow.bool_(),
        "texts": pyarrow.list_(pyarrow.string()),
    }
    fields = [
        pyarrow.field(one.name, kinds[one.kind], metadata={"meaning": one.meaning})
        for one in COLUMNS
    ]
    rows = order.rows
    columns = [[row.values[one.name] for row in rows] for one in COLUMNS]
    table = pyarrow.table(columns, schema=pyarrow.schema(fields))
    with new_file(path, force=order.force) as draft:
        parquet.write_table(table, draft)
    return []
