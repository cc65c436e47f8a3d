"""Reads TOML of which nobody knows where it is from: what would take minutes is refused first."""

import os
import re
import tomllib
from typing import Any

from pfwd_device.errors import refusal

LARGEST_TOML = 1_000_000
"""Characters of a file; headers, maps and setups have a few thousand. Each takes some 2 us."""

MOST_KEY_PARTS = 16
"""Names with dots between them that make one key; the square of their number is what they cost, and
32,000 of them fit into a line. No file of this program has more than two."""

LONGEST_INTEGER = 64
"""Digits behind 0x, 0o or 0b: as many as the 64 bits of TOML have. Longer ones cannot be written
out again."""

Path = str | os.PathLike[str]

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


def read_toml_text(
    path: Path, error: type[Exception], max_length: int = LARGEST_TOML, *, where: str = ""
) -> str:
    """Return the text of a TOML file that a user names.

    Parameters
    ----------
    path : path of the file
    error : type of exception
        Class of the errors that are raised.
    max_length : int
        Characters; a longer file is refused.
    where : str
        Option and file, for messages; empty: the file.
    """
    file = where or os.fspath(path)
    try:
        with open(path, encoding="utf-8-sig") as stream:
            text = stream.read(max_length + 1)
    except OSError as err:
        raise error(refusal(file, "a readable TOML file", err.strerror or str(err))) from err
    except UnicodeDecodeError as err:
        raise error(refusal(file, "UTF-8 text", "other bytes")) from err
    if len(text) > max_length:
        raise error(refusal(file, f"at most {max_length} characters", "more"))
    return text


def parse_user_toml(text: str, file: str, error: type[Exception]) -> dict[str, Any]:
    """Return the tables of a TOML text; the error names the file."""
    try:
        return parse_toml(text)
    except ValueError as err:  # also numbers without end
        raise error(refusal(file, "TOML", str(err))) from err
