"""Lines for people or for machines."""

import json
from collections.abc import Mapping
from typing import Any


class Reporter:
    """Prints records as aligned text, or with ``--json`` as one object a line."""

    def __init__(self, arguments: list[str]) -> None:
        self.as_json = "--json" in arguments

    def title(self, text: str) -> None:
        """A heading, for people only."""
        if not self.as_json:
            print(f"\n{text}\n{'-' * len(text)}", flush=True)

    def record(self, **values: Any) -> None:
        """One record; floats get four significant digits for people."""
        if self.as_json:
            print(json.dumps(_plain(values)), flush=True)
        else:
            print("  ".join(f"{key} {_short(value)}" for key, value in values.items()), flush=True)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value.item() if hasattr(value, "item") else value for key, value in values.items()}
