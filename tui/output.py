"""Output of commands: messages, and texts that are safe to print."""

import codecs
import contextlib
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
"""Replacements of characters that the encoding of a console lacks; otherwise a question mark would
be printed."""

SPELLING = "pfwd-spelled"
"""Name under which Python's codecs know the replacement by `SPELLED`."""


def spelled(text: str, stream: TextIO | None = None) -> str:
    """Return a text with replacements for the characters that a stream cannot show.

    Tables need it, because a replacement may have another width. For other texts the stream does
    it.

    Parameters
    ----------
    text : str
    stream : TextIO, optional
        None: standard output.
    """
    encoding = (stream or sys.stdout).encoding or "ascii"
    return text.encode(encoding, SPELLING).decode(encoding)


def _spell(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    # Other characters are replaced by their number, so that names stay distinct.
    parts = [
        SPELLED.get(letter) or letter.encode("ascii", "backslashreplace").decode("ascii")
        for letter in letters
    ]
    return "".join(parts), error.end


codecs.register_error(SPELLING, _spell)

_SPELLED_CODE_PAGE = "pfwd_spelled_"
_SPELLED_LETTERS = str.maketrans(SPELLED)


def _find_code_page(name: str) -> codecs.CodecInfo | None:
    """Return the codec of a code page in which all signs of `SPELLED` are replaced."""
    if not name.startswith(_SPELLED_CODE_PAGE):
        return None
    page = codecs.lookup(name.removeprefix(_SPELLED_CODE_PAGE))

    class Encoder(codecs.IncrementalEncoder):
        def encode(self, text: str, final: bool = False) -> bytes:
            return page.encode(text.translate(_SPELLED_LETTERS), self.errors)[0]

    return codecs.CodecInfo(
        lambda text, errors="strict": page.encode(text.translate(_SPELLED_LETTERS), errors),
        page.decode,
        incrementalencoder=Encoder,
        incrementaldecoder=page.incrementaldecoder,
        name=name,
    )


codecs.register(_find_code_page)


def spell_signs(stream: TextIO) -> None:
    """Have a stream replace characters that its encoding lacks; otherwise printing them would fail.

    To a pipe or a file of Windows all signs are replaced. Their bytes are those of one code page,
    and the program that reads them may use another one: PowerShell that of the console.
    """
    with contextlib.suppress(AttributeError):  # a stream of a test, or none without a console
        encoding = stream.encoding
        if (
            os.name == "nt"
            and not stream.isatty()
            and not encoding.startswith(("utf", _SPELLED_CODE_PAGE))
        ):
            encoding = _SPELLED_CODE_PAGE + encoding
        stream.reconfigure(encoding=encoding, errors=SPELLING)  # type: ignore[attr-defined]


def clean(text: object) -> str:
    r"""Return a text from a file or an instrument with control characters replaced by U+FFFD.

    Escape sequences could otherwise move the cursor or rename the window, and overrides of the
    writing direction or separators of lines and paragraphs could change how a line reads.

    Examples
    --------
    >>> print(ascii(clean("km 12 \x1b[31mred")))
    'km 12 \ufffd[31mred'
    """
    text = str(text)
    if text.isascii() and text.isprintable():  # most texts: faster than the check below
        return text
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if _moves(unicodedata.category(letter)) else letter
        for letter in text
    )


def _moves(category: str) -> bool:
    return category[0] == "C" or category in ("Zl", "Zp")


def counted(number: int, noun: str) -> str:
    """Return a number with its noun in the singular or plural.

    Examples
    --------
    >>> counted(1, "point"), counted(2, "drop")
    ('1 point', '2 drops')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def say(message: object) -> None:
    """Print a message to standard error, so that it is not mixed with results."""
    print(clean(f"pfwd: {message}"), file=sys.stderr, flush=True)


def quoted(path: str) -> str:
    """Return a path as one word for the shell of this computer."""
    return subprocess.list2cmdline([path]) if os.name == "nt" else shlex.quote(path)


def next_commands(survey: str | os.PathLike[str]) -> tuple[str, str]:
    """Return the commands that show a survey and write its report, quoted for the shell."""
    path = quoted(os.fspath(survey))
    return f"pfwd open {path}", f"pfwd report {path} -o report.html"


def on_terminal() -> bool:
    """Return whether a screen can be shown, because input and output are a terminal.

    A server that shows terminal programs in a browser counts as a terminal; it sets TEXTUAL_DRIVER.
    """
    if os.environ.get("TEXTUAL_DRIVER"):
        return True
    return all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr))
