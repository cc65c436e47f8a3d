"""Text from an instrument or a file, made harmless at the edge where it comes in."""

import unicodedata

LONGEST_TEXT = 64
"""Characters; names and serial numbers are shorter, and a screen has no room for more."""

_HARMFUL = frozenset(["Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"])
"""Controls, formats such as overrides of direction, what is no character, and separators of lines
and paragraphs."""


def clean(text: str | bytes, limit: int = LONGEST_TEXT) -> str:
    """Text of bounded length on one line without control characters, which become U+FFFD.

    Escape sequences could rename a terminal's window, overrides of the writing direction could
    make a line read as another.

    Parameters
    ----------
    text : str or bytes
        Bytes are read as UTF-8; what is none becomes U+FFFD.
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
    if text.isascii() and text.isprintable():  # nearly always
        return text[:limit]
    return harmless(unicodedata.normalize("NFC", text)[:limit])


def harmless(text: str) -> str:
    """The text with U+FFFD in place of each such character, at its full length.

    Examples
    --------
    >>> harmless("km 12\\x07")
    'km 12\N{REPLACEMENT CHARACTER}'
    """
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if unicodedata.category(letter) in _HARMFUL else letter
        for letter in text
    )
