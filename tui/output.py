"""The ways out of a command: lines for machines, lines for people, and messages."""

import json
import math
import os
import sys
import unicodedata
from collections.abc import Mapping
from typing import Any


def clean(text: object) -> str:
    """Text from a file or an instrument, safe to print: control characters become U+FFFD.

    Escape sequences could otherwise move the cursor or rename the window, and overrides of the
    writing direction could make a line read as another, as could separators of lines and
    paragraphs.

    Examples
    --------
    >>> clean("km 12 \\x1b[31mred")
    'km 12 \N{REPLACEMENT CHARACTER}[31mred'
    """
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if _moves(unicodedata.category(letter)) else letter
        for letter in str(text)
    )


def _moves(category: str) -> bool:
    return category[0] == "C" or category in ("Zl", "Zp")


def json_line(record: Mapping[str, Any]) -> str:
    """One JSON object on one line, NaN and infinity as null.

    Parameters
    ----------
    record : mapping
        Values that JSON knows, numpy scalars and arrays, and mappings and sequences of these.

    Returns
    -------
    str
        ASCII.

    Examples
    --------
    >>> json_line({"modulus_pa": 4e7, "modulus_sd_pa": float("nan")})
    '{"modulus_pa": 40000000.0, "modulus_sd_pa": null}'
    """
    return json.dumps(_plain(record), allow_nan=False)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy, which this module need not import for it
        value = value.tolist()
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {str(key): _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
    return value


def say(message: object) -> None:
    """Print a message to standard error, where it does not mix with results."""
    print(clean(f"pfwd: {message}"), file=sys.stderr, flush=True)


def on_terminal() -> bool:
    """Whether there is a terminal that a screen can fill: keys come from it, and all is shown.

    A server that shows terminal programs in a browser is one; it names the driver to be used.
    """
    if os.environ.get("TEXTUAL_DRIVER"):
        return True
    return all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))
