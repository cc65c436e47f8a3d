"""The ways out of a command: text that is safe to print, and messages."""

import os
import sys
import unicodedata


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
