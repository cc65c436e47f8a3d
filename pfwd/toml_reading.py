"""Reads TOML of which nobody knows where it is from: what would take minutes is refused first."""

import re
import tomllib
from typing import Any

LARGEST_TOML = 1_000_000
"""Characters of a file; headers, maps and setups have a few thousand. Each takes some 2 us."""

MOST_KEY_PARTS = 16
"""Names with dots between them that make one key; the square of their number is what they cost, and
32,000 of them fit into a line. No file of this program has more than two."""

LONGEST_INTEGER = 64
"""Digits behind 0x, 0o or 0b: as many as the 64 bits of TOML have. Longer ones cannot be written
out again."""

_STRINGS = re.compile(
    r'"""(?:[^\\"]|\\.|"(?!""))*+"{3,5}'
    r"|'''(?:[^']|'(?!''))*+'{3,5}"
    r'|"(?:[^\\"\n]|\\.)*+"'
    r"|'[^'\n]*+'"
    r"|#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MOST_KEY_PARTS}}}")
_LONG_INTEGER = re.compile(rf"(?<!\w)0[xob]_?(?:[0-9a-fA-F]_?+){{{LONGEST_INTEGER + 1}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises
    ------
    ValueError
        If it is no TOML, or one that would take too long; the message says why.
    """
    if len(text) > LARGEST_TOML:
        raise ValueError(f"over {LARGEST_TOML} characters")
    # Dots within texts are no keys.
    bare = _STRINGS.sub("_", text)
    if _LONG_KEY.search(bare):
        raise ValueError(f"a key of more than {MOST_KEY_PARTS} parts")
    if _LONG_INTEGER.search(bare):
        raise ValueError("a whole number of more than 64 bits")
    try:
        return tomllib.loads(text)
    except RecursionError as err:
        raise ValueError("nesting without end") from err
