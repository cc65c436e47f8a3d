"""The fields that payloads are made of: fixed structures, texts, days, optional numbers, int24."""

import datetime
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.text import clean

BYTE = struct.Struct("<B")
LONGEST_TEXT = 255
"""Bytes of a text: its length is one byte."""


class Reader:
    """Takes fields off the front of a payload.

    What follows the last field that is asked for is a newer version's and is left alone. A field
    that ends behind the payload raises `struct.error`.
    """

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self._at = 0

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        """The fields of one structure."""
        values = layout.unpack_from(self._payload, self._at)
        self._at += layout.size
        return values

    def text(self, limit: int = LONGEST_TEXT) -> str:
        """A text, cleaned: whatever came, it can be shown."""
        (length,) = self.fields(BYTE)
        start = self._at
        self._at += length
        if self._at > len(self._payload):
            raise struct.error(f"text of {length} bytes ends behind the payload")
        return clean(self._payload[start : self._at], limit)

    def rest(self) -> bytes:
        """All that is left."""
        return self._payload[self._at :]


def text(value: str) -> bytes:
    """Length and UTF-8 bytes."""
    data = value.encode()
    if len(data) > LONGEST_TEXT:
        raise ValueError(f"expected a text of at most {LONGEST_TEXT} bytes, got {len(data)}")
    return BYTE.pack(len(data)) + data


def or_nan(value: float | None) -> float:
    """NaN on the wire: not said."""
    return math.nan if value is None else value


def or_none(value: float) -> float | None:
    """The inverse of `or_nan`."""
    return None if math.isnan(value) else value


def finite_or_none(value: float) -> float | None:
    """The inverse of `or_nan` for what is only shown: infinity is no reading either."""
    return value if math.isfinite(value) else None


def day(value: datetime.date | None) -> int:
    """A day as the decimal number yyyymmdd; 0: not said."""
    return 0 if value is None else value.year * 10_000 + value.month * 100 + value.day


def day_of(number: int) -> datetime.date | None:
    """The inverse of `day`; `ValueError` when there is no such day."""
    if number == 0:
        return None
    return datetime.date(number // 10_000, number // 100 % 100, number % 100)


def pack_int24(counts: NDArray[np.int32]) -> bytes:
    """Integers as 3 bytes each, little-endian two's complement, in C order; `ValueError` when one
    does not fit."""
    if counts.size and not (counts.min() >= -(1 << 23) and counts.max() < 1 << 23):
        raise ValueError(f"expected counts of 24 bits, got {counts.min()} to {counts.max()}")
    wide = np.ascontiguousarray(counts, dtype="<i4").view(np.uint8).reshape(-1, 4)
    return wide[:, :3].tobytes()


def unpack_int24(data: bytes) -> NDArray[np.int32]:
    """Integers (n,) from 3 bytes each, little-endian two's complement."""
    wide = np.zeros((len(data) // 3, 4), np.uint8)
    wide[:, 1:] = np.frombuffer(data, np.uint8).reshape(-1, 3)
    return np.asarray(wide.reshape(-1).view("<i4") >> 8, dtype=np.int32)
