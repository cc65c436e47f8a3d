"""``jsonl``: one JSON object a drop, with the whole result as ``pfwd invert --json`` prints it."""

import os

from pfwd_survey.exporting.json_text import json_text
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write all drops, discarded ones marked."""
    with (
        new_file(path, force=order.force) as draft,
        open(draft, "w", encoding="utf-8", newline="\n") as stream,
    ):
        for row in order.rows:
            result = None if row.result is None else row.result.to_json()
            more = {"declared": row.declared or {}, "result": result}
            stream.write(json_text({**row.values, **more}) + "\n")
    return []
