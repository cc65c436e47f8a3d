"""Reading of TOML files of unknown origin; a file that would take minutes to parse is refused."""

import os
import re
import tomllib
from typing import Any

from pfwd_device.errors import refusal

LARGEST_TOML = 1_000_000
"""Largest number of characters of a file, each of which takes some 2 us; headers, maps and setups
have a few thousand."""

MOST_KEY_PARTS = 16
"""Largest number of names joined by dots in a key. The time grows with the square of their number,
and 32,000 of them fit into a line. No file of this program has more than two."""

LONGEST_INTEGER = 64
"""Largest number of digits after 0x, 0o or 0b: the 64 bits of a TOML integer in binary."""

Path = str | os.PathLike[str]

# No group is possessive, because Python 3.11.0 to 3.11.4 does not match such groups correctly. The
# closing quotes are optional: otherwise an unclosed text is searched once for each quote in it.
_STRINGS = re.compile(
    r'"""[^\\"]*+(?:(?:\\.|"(?!""))[^\\"]*+)*(?:"{3,5})?'
    r"|'''[^']*+(?:'(?!'')[^']*+)*(?:'{3,5})?"
    r'|"[^\\"\n]*+(?:\\.[^\\"\n]*+)*"?'
    r"|'[^'\n]*+'"
    r"|#[^\n]*+",
    re.DOTALL,
)
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MOST_KEY_PARTS}}}")
_LONG_INTEGER = re.compile(rf"(?<!\w)0[xob]_?(?:[0-9a-fA-F]_?+){{{LONGEST_INTEGER + 1}}}")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text.

    Raises
    ------
    ValueError
        If the text is not TOML, or would take too long; the message states why.
    """
    if len(text) > LARGEST_TOML:
        raise ValueError(f"over {LARGEST_TOML} characters")
    # Quoted texts and comments are removed, because dots in them do not make keys.
    bare = _STRINGS.sub("_", text)
    if _LONG_KEY.search(bare):
        raise ValueError(f"a key of more than {MOST_KEY_PARTS} parts")
    if _LONG_INTEGER.search(bare):
        raise ValueError("a whole number of more than 64 bits")
    try:
        return tomllib.loads(text)
    except RecursionError as err:
        raise ValueError("too many nested brackets") from err


def read_toml_text(
    path: Path, error: type[Exception], max_length: int = LARGEST_TOML, *, where: str = ""
) -> str:
    """Read the text of a TOML file.

    Parameters
    ----------
    path : path of the file
    error : type of exception
        Class of the error to raise if the file cannot be read or is too long.
    max_length : int
        Largest number of characters.
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
    """Parse a TOML text.

    Parameters
    ----------
    text : str
    file : str
        Path of the file, for messages.
    error : type of exception
        Class of the error to raise if the text is not TOML.
    """
    try:
        return parse_toml(text)
    except ValueError as err:  # tomllib raises it also for very long numbers
        raise error(refusal(file, "TOML", str(err))) from err
