"""Cleaning of text from an instrument or a file before it is stored or shown."""

import unicodedata

LONGEST_TEXT = 64
"""Default limit, characters; names and serial numbers are shorter."""

_HARMFUL = frozenset(["Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"])
"""Unicode categories: controls, formats such as overrides of the writing direction, code points
without a character, separators of lines and paragraphs."""


def clean(text: str | bytes, limit: int = LONGEST_TEXT) -> str:
    """Return one line of text of bounded length, with U+FFFD in place of control characters.

    Escape sequences could rename a terminal's window, overrides of the writing direction could
    make a line read as another.

    Parameters
    ----------
    text : str or bytes
        Bytes are decoded as UTF-8; invalid ones become U+FFFD.
    limit : int
        Longest result, characters.

    Examples
    --------
    >>> clean(b"PFWD-7\\x1b[31m")
    'PFWD-7\N{REPLACEMENT CHARACTER}[31m'
    """
    if isinstance(text, bytes):
        text = text[: 16 * limit].decode("utf-8", "replace")
    text = text[: 4 * limit]
    if text.isascii() and text.isprintable():  # the usual case needs no search
        return text[:limit]
    return harmless(unicodedata.normalize("NFC", text)[:limit])


def harmless(text: str) -> str:
    """Return the text at its full length, with U+FFFD in place of each harmful character.

    Examples
    --------
    >>> harmless("km 12\\x07")
    'km 12\N{REPLACEMENT CHARACTER}'
    """
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if unicodedata.category(letter) in _HARMFUL else letter
        for letter in text
    )
