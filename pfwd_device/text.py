"""Cleaning of text from an instrument or a file before it is stored or shown."""

import unicodedata

LONGEST_TEXT = 64
"""Default limit of `clean`, characters; names and serial numbers are shorter."""

_HARMFUL = frozenset(["Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"])
"""Unicode categories that are replaced: control characters, format characters such as overrides
of the writing direction, code points without a character, line and paragraph separators."""


def clean(text: str | bytes, limit: int = LONGEST_TEXT) -> str:
    """Return one line of text of bounded length, with U+FFFD in place of control characters.

    Escape sequences could change the state of a terminal. Overrides of the writing direction could
    make a text read as another one.

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
    """Return the text with U+FFFD in place of control characters, at its full length.

    Unlike `clean` it does not shorten the text. The replaced categories are those of `_HARMFUL`.

    Examples
    --------
    >>> harmless("km 12\\x07")
    'km 12\N{REPLACEMENT CHARACTER}'
    """
    return "".join(
        "\N{REPLACEMENT CHARACTER}" if unicodedata.category(letter) in _HARMFUL else letter
        for letter in text
    )
