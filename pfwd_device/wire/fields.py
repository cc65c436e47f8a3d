"""Fields of payloads: fixed structures, texts, days, optional numbers, 24-bit integers."""

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
    """Reads the fields of a payload one after the other.

    Bytes after the last field belong to a newer version and are ignored. A field that ends behind
    the payload raises `struct.error`.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._at = 0

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Return the fields of one structure."""
        values = layout.unpack_from(self._payload, self._at)
        self._at += layout.size
        return values

    def text(self, limit: int = MAX_TEXT_BYTES) -> str:
        """Return a text without control characters."""
        (length,) = self.fields(BYTE)
        start = self._at
        self._at += length
        if self._at > len(self._payload):
            raise struct.error(f"text of {length} bytes ends behind the payload")
        return clean(self._payload[start : self._at], limit)

    def rest(self) -> bytes:
        """Return the remaining bytes."""
        return self._payload[self._at :]


def text(value: str) -> bytes:
    """Return the length and the UTF-8 bytes of a text."""
    data = value.encode()
    if len(data) > MAX_TEXT_BYTES:
        raise ValueError(f"expected a text of at most {MAX_TEXT_BYTES} bytes, got {len(data)}")
    return BYTE.pack(len(data)) + data


def encode_optional(value: float | None) -> float:
    """Return an optional number as it is sent: NaN stands for None."""
    return math.nan if value is None else value


def decode_optional(value: float) -> float | None:
    """Return the inverse of `encode_optional`."""
    return None if math.isnan(value) else value


def decode_reading(value: float) -> float | None:
    """Return the inverse of `encode_optional` for a reading; None for infinity as well."""
    return value if math.isfinite(value) else None


def day(value: datetime.date | None) -> int:
    """Return a day as the decimal number yyyymmdd; 0 stands for None."""
    return 0 if value is None else value.year * 10_000 + value.month * 100 + value.day


def day_of(number: int) -> datetime.date | None:
    """Return the inverse of `day`; raise `ValueError` if there is no such day."""
    if number == 0:
        return None
    return datetime.date(number // 10_000, number // 100 % 100, number % 100)


def pack_int24(counts: NDArray[np.int32]) -> bytes:
    """Return integers as 3 bytes each, little-endian two's complement, in C order.

    Raises `ValueError` if one does not fit.
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
