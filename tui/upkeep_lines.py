"""What recovery and check of a survey found, as lines."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfwd.export.json_text import json_text
from tui.output import clean, counted, say


def show(record: Mapping[str, Any], remarks: Sequence[str], *, as_json: bool) -> int:
    """Print what was found; the exit status."""
    for remark in remarks:
        say(remark)
    if as_json:
        print(json_text(record), flush=True)
    else:
        print(
            f"{clean(record['survey'])}: "
            f"{counted(record['drops_acknowledged'], 'drop')} acknowledged, "
            f"{record['drops_published']} with a verified file, {record['recovered']} recovered"
        )
        for text in record["damaged"]:
            print(f"  DAMAGED: {clean(text)}")
        print("whole" if record["ok"] else "NOT whole", flush=True)
    return 0 if record["ok"] else 1
