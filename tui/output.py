"""Output of commands: text that is safe to print, and messages."""

import codecs
import os
import shlex
import subprocess
import sys
import unicodedata
from typing import TextIO

_REPLACED_SIGNS = "±µμνηρσλπ²³°×·•…–—−≥≤→√₀✓✗█"
_SPELT = (
    *("+-", "u", "u", "nu", "eta", "rho", "sigma", "lambda", "pi", "2", "3", "deg", "x", "-", "*"),
    *("...", "-", "-", "-", ">=", "<=", "->", "sqrt", "0", "ok", "x", "#"),
)
SPELLED = {
    **dict(zip(_REPLACED_SIGNS, _SPELT, strict=True)),
    "\N{NO-BREAK SPACE}": " ",
    "\N{REPLACEMENT CHARACTER}": "_",
}
"""Replacement of signs that a console's encoding lacks; a question mark would lose them."""

SPELLING = "pfwd-spelled"
"""Name of the error handler of Python's codecs that writes `SPELLED`."""


def spelled(text: str, stream: TextIO | None = None) -> str:
    """Return a text with the signs replaced that its stream cannot show.

    Tables need it, because the width of a text may change; elsewhere the stream does the same.

    Parameters
    ----------
    text : str
    stream : TextIO, optional
        Standard output by default.
    """
    encoding = (stream or sys.stdout).encoding or "ascii"
    return text.encode(encoding, SPELLING).decode(encoding)


def _spell(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    # Letters of other scripts become their code, so that names stay distinct.
    parts = [
        SPELLED.get(letter) or letter.encode("ascii", "backslashreplace").decode("ascii")
        for letter in letters
    ]
    return "".join(parts), error.end


codecs.register_error(SPELLING, _spell)


def clean(text: object) -> str:
    """Return text from a file or an instrument, safe to print: control characters are U+FFFD.

    Escape sequences could otherwise move the cursor or rename the window, and overrides of the
    writing direction or separators of lines and paragraphs could make a line read as another.

    Examples
    --------
    >>> clean("km 12 \\x1b[31mred")
    'km 12 \N{REPLACEMENT CHARACTER}[31mred'
    """
    text = str(text)
    if text.isascii() and text.isprintable():  # nearly always
        return text
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if _moves(unicodedata.category(letter)) else letter
        for letter in text
    )


def _moves(category: str) -> bool:
    return category[0] == "C" or category in ("Zl", "Zp")


def counted(number: int, noun: str) -> str:
    """Return a number with a noun in the singular or plural.

    Examples
    --------
    >>> counted(1, "point"), counted(2, "drop")
    ('1 point', '2 drops')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def say(message: object) -> None:
    """Print a message to standard error, where it does not mix with results."""
    print(clean(f"pfwd: {message}"), file=sys.stderr, flush=True)


def next_commands(survey: str | os.PathLike[str]) -> tuple[str, str]:
    """Return the commands that open a recorded survey and report it, to be copied as they are."""
    path = os.fspath(survey)
    quoted = subprocess.list2cmdline([path]) if os.name == "nt" else shlex.quote(path)
    return f"pfwd open {quoted}", f"pfwd report {quoted} -o report.html"


def on_terminal() -> bool:
    """Return whether a screen can be shown: input and output are a terminal.

    A server that shows terminal programs in a browser counts; it names the driver to use.
    """
    if os.environ.get("TEXTUAL_DRIVER"):
        return True
    return all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))
