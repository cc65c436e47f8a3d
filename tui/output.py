"""The ways out of a command: text that is safe to print, and messages."""

import codecs
import os
import shlex
import subprocess
import sys
import unicodedata
from typing import TextIO

_ALONE = "±µμνηρσλπ²³°×·•…–—−≥≤→√₀✓✗█"
_SPELT = (
    *("+-", "u", "u", "nu", "eta", "rho", "sigma", "lambda", "pi", "2", "3", "deg", "x", "-", "*"),
    *("...", "-", "-", "-", ">=", "<=", "->", "sqrt", "0", "ok", "x", "#"),
)
SPELLED = {
    **dict(zip(_ALONE, _SPELT, strict=True)),
    "\N{NO-BREAK SPACE}": " ",
    "\N{REPLACEMENT CHARACTER}": "_",
}
"""What stands for a sign that a console's encoding lacks; a question mark would say nothing."""

SPELLING = "pfwd-spelled"
"""Name of the way of `SPELLED` among those of Python's codecs."""


def spelled(text: str, stream: TextIO | None = None) -> str:
    """A text with the signs that its stream cannot show spelled out.

    For tables, which have to know how wide a text becomes; elsewhere the stream does it itself.

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
    # Of other writings the code at least, by which names stay apart.
    parts = [
        SPELLED.get(letter) or letter.encode("ascii", "backslashreplace").decode("ascii")
        for letter in letters
    ]
    return "".join(parts), error.end


codecs.register_error(SPELLING, _spell)


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
    text = str(text)
    if text.isascii() and text.isprintable():  # nearly always
        return text
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if _moves(unicodedata.category(letter)) else letter
        for letter in text
    )


def _moves(category: str) -> bool:
    return category[0] == "C" or category in ("Zl", "Zp")


def counted(number: int, what: str) -> str:
    """So many of something.

    Examples
    --------
    >>> counted(1, "point"), counted(2, "drop")
    ('1 point', '2 drops')
    """
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def say(message: object) -> None:
    """Print a message to standard error, where it does not mix with results."""
    print(clean(f"pfwd: {message}"), file=sys.stderr, flush=True)


def next_commands(survey: str | os.PathLike[str]) -> tuple[str, str]:
    """Return the commands that open a recorded survey and report it, to be copied as they are."""
    path = os.fspath(survey)
    quoted = subprocess.list2cmdline([path]) if os.name == "nt" else shlex.quote(path)
    return f"pfwd open {quoted}", f"pfwd report {quoted} -o report.html"


def on_terminal() -> bool:
    """Whether there is a terminal that a screen can fill: keys come from it, and all is shown.

    A server that shows terminal programs in a browser is one; it names the driver to be used.
    """
    if os.environ.get("TEXTUAL_DRIVER"):
        return True
    return all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))
