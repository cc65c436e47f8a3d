"""Encoding of the fields of a payload, the content of a message of the binary protocol.

The fields are fixed structures, texts, dates, optional numbers and 24-bit integers.
"""

import datetime
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.text import clean

BYTE = struct.Struct("<B")
MAX_TEXT_BYTES = 255
"""Longest text: its length is one byte."""


class Reader:
    """Reads the fields of a payload, the content of a message, one after the other.

    Bytes after the last field belong to a newer version of the protocol and may be left unread. A
    field that extends beyond the end of the payload raises `struct.error`.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._at = 0

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the next values, which have the given layout."""
        values = layout.unpack_from(self._payload, self._at)
        self._at += layout.size
        return values

    def text(self, limit: int = MAX_TEXT_BYTES) -> str:
        """Return the next text, with U+FFFD in place of control characters.

        Parameters
        ----------
        limit : int
            Longest result, characters; the remainder is skipped.
        """
        (length,) = self.fields(BYTE)
        start = self._at
        self._at += length
        if self._at > len(self._payload):
            raise struct.error(f"text of {length} bytes extends beyond the end of the payload")
        return clean(self._payload[start : self._at], limit)

    def rest(self) -> bytes:
        """Return the bytes that were not read yet."""
        return self._payload[self._at :]


def text(value: str) -> bytes:
    """Return the encoding of a text: its length as one byte, and its UTF-8 bytes.

    Raises
    ------
    ValueError
        If the text has more than `MAX_TEXT_BYTES` bytes.
    """
    data = value.encode()
    if len(data) > MAX_TEXT_BYTES:
        raise ValueError(f"expected a text of at most {MAX_TEXT_BYTES} bytes, got {len(data)}")
    return BYTE.pack(len(data)) + data


def encode_optional(value: float | None) -> float:
    """Return a number unchanged, and NaN, which the protocol sends in its place, for None."""
    return math.nan if value is None else value


def decode_optional(value: float) -> float | None:
    """Return a received number; None for NaN, which stands for an undeclared value."""
    return None if math.isnan(value) else value


def decode_reading(value: float) -> float | None:
    """Return a received measurement such as a temperature; None if it is NaN or infinite."""
    return value if math.isfinite(value) else None


def day(value: datetime.date | None) -> int:
    """Return a date as the decimal number yyyymmdd, and 0 for None."""
    return 0 if value is None else value.year * 10_000 + value.month * 100 + value.day


def day_of(number: int) -> datetime.date | None:
    """Return the date of a decimal number yyyymmdd, and None for 0.

    Raises
    ------
    ValueError
        If the calendar has no such date.
    """
    if number == 0:
        return None
    return datetime.date(number // 10_000, number // 100 % 100, number % 100)


def pack_int24(counts: NDArray[np.int32]) -> bytes:
    """Return integers as bytes: 3 each, little-endian two's complement, in C order.

    Raises
    ------
    ValueError
        If an integer does not fit into 24 bits.
    """
    if counts.size and not (counts.min() >= -(1 << 23) and counts.max() < 1 << 23):
        raise ValueError(f"expected counts of 24 bits, got {counts.min()} to {counts.max()}")
    wide = np.ascontiguousarray(counts, dtype="<i4").view(np.uint8).reshape(-1, 4)
    return wide[:, :3].tobytes()


def unpack_int24(data: bytes) -> NDArray[np.int32]:
    """Return integers, (n,), from 3 bytes each, little-endian two's complement."""
    wide = np.zeros((len(data) // 3, 4), np.uint8)
    wide[:, 1:] = np.frombuffer(data, np.uint8).reshape(-1, 3)
    return np.asarray(wide.reshape(-1).view("<i4") >> 8, dtype=np.int32)
