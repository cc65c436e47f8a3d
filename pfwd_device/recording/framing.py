"""Records of the journal and of captures as bytes, and their scan, which survives any damage.

A record is a header of 48 bytes and a payload; all numbers are little-endian:

====== ===== =========================================================
offset bytes meaning
====== ===== =========================================================
0      8     magic, ``89 50 46 57 44 4A 0D 0A``
8      4     length of the payload, at most 64 MiB
12     4     type of the record
16     16    identity of the survey or capture
32     8     sequence number, from 1
40     4     CRC-32 of the payload
44     4     CRC-32 of the header's first 44 bytes
====== ===== =========================================================

The header has a CRC of its own, so that a damaged payload still tells which record is lost, and so
that a search for the next record after damage costs 48 bytes a candidate and not a whole payload.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import BinaryIO, NamedTuple

from pfwd_device.errors import RecordingError

MAGIC = b"\x89PFWDJ\r\n"
HEADER = struct.Struct("<8sII16sQII")
LARGEST_PAYLOAD = 64 * 2**20
"""Bytes; a drop of 8 channels and 10 s at 50 kHz is 48 MB before compression."""

_CHUNK = 2**20
_CHECK = struct.Struct("<I")


class Kind(IntEnum):
    """Types of record."""

    SURVEY = 1
    POINT = 2
    DROP = 3
    REBOUND = 4
    EDIT = 5
    EVENT = 6
    CHECK = 7
    FILE = 8
    CLOSE = 9
    CAPTURE = 32
    BYTES = 33


class Frame(NamedTuple):
    """A record that is whole; a tuple, because a survey has many."""

    kind: int
    """One of Kind; a later version may have more."""
    identity: bytes
    """Of the survey, 16 bytes."""
    sequence: int
    """Number of the record."""
    offset: int
    """Where it begins in its file, bytes."""
    length: int
    """Header and payload, bytes."""
    check: int
    """CRC-32 in the header, which covers the CRC-32 of the payload."""
    payload: bytes
    """What it holds."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A stretch of a file that is no record."""

    offset: int
    """Where it begins, bytes."""
    length: int
    """Bytes."""
    at_end: bool
    """Nothing whole follows: a record that was not finished, or a damaged one."""


def encode_frame(kind: int, identity: bytes, sequence: int, payload: bytes) -> bytes:
    """The record as bytes.

    Raises
    ------
    RecordingError
        If the payload is longer than a record may be.
    """
    if len(payload) > LARGEST_PAYLOAD:
        raise RecordingError(
            f"record {sequence}: expected at most {LARGEST_PAYLOAD} bytes, got {len(payload)}; "
            "shorten the recording window"
        )
    crc = zlib.crc32(payload)
    header = HEADER.pack(MAGIC, len(payload), kind, identity, sequence, crc, 0)[:-4]
    return header + _CHECK.pack(zlib.crc32(header)) + payload


def scan_bytes(data: bytes) -> tuple[list[Frame], list[Damage]]:
    """The records and the damaged stretches of `data`, whatever it is; never raises."""
    frames: list[Frame] = []
    damage: list[Damage] = []
    for found in scan(io.BytesIO(data)):
        (frames if isinstance(found, Frame) else damage).append(found)  # type: ignore[arg-type]
    return frames, damage


def scan(stream: BinaryIO, size: int | None = None, start: int = 0) -> Iterator[Frame | Damage]:
    """Records and damaged stretches in the order of the file, without gaps between them.

    At most one payload and 1 MiB are in memory. After damage the scan goes on with the next
    magic, wherever it is.

    Parameters
    ----------
    stream : readable and seekable
    size : int, optional
        Bytes to look at; by default up to the end as it is now.
    start : int
        Where to begin.
    """
    if size is None:
        size = stream.seek(0, io.SEEK_END)
    position = bad = start
    # Crafted headers, each promising a long payload, would cost the square of the file's size.
    patience = 16 * size + 4 * LARGEST_PAYLOAD
    while position < size:
        frame, cost = _frame_at(stream, position, size)
        if frame is not None:
            if bad < position:
                yield Damage(bad, position - bad, False)
            yield frame
            position = bad = position + frame.length
            continue
        patience -= cost
        position = _next_magic(stream, position + 1, size) if patience > 0 else size
    if bad < size:
        yield Damage(bad, size - bad, True)


def read_frame(stream: BinaryIO, offset: int) -> Frame | None:
    """The record at `offset`, or None when there is no whole one."""
    return _frame_at(stream, offset, stream.seek(0, io.SEEK_END))[0]


def _frame_at(stream: BinaryIO, offset: int, size: int) -> tuple[Frame | None, int]:
    """The record, and how many bytes were looked at in vain."""
    stream.seek(offset)
    head = stream.read(min(HEADER.size, size - offset))
    if len(head) < HEADER.size:
        return None, HEADER.size
    magic, length, kind, identity, sequence, crc, check = HEADER.unpack(head)
    if magic != MAGIC or zlib.crc32(head[:-4]) != check:
        return None, HEADER.size
    if length > LARGEST_PAYLOAD or offset + HEADER.size + length > size:
        return None, HEADER.size
    payload = stream.read(length)
    if len(payload) != length or zlib.crc32(payload) != crc:
        return None, HEADER.size + length
    return Frame(kind, identity, sequence, offset, HEADER.size + length, check, payload), 0


def _next_magic(stream: BinaryIO, position: int, size: int) -> int:
    """Where the next magic begins at or after `position`, or `size`."""
    overlap = len(MAGIC) - 1
    while position < size:
        stream.seek(position)
        chunk = stream.read(min(_CHUNK, size - position))
        if not chunk:  # the file has become shorter
            return size
        found = chunk.find(MAGIC)
        if found >= 0:
            return position + found
        if position + len(chunk) >= size:
            return size
        position += max(len(chunk) - overlap, 1)
    return size
