"""Encoding of the records of journals and captures, and a scan that tolerates any damage.

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

The header has its own CRC: it identifies a record whose payload is damaged, and after damage the
search for the next record reads 48 bytes for each candidate and no payload.
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
MAX_RECORD_PAYLOAD_BYTES = 64 * 2**20
"""Largest payload; a drop of 8 channels and 10 s at 50 kHz has 48 MB before compression."""

_SCAN_BYTES = 2**20
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
    """An undamaged record; a tuple, because a survey has many."""

    kind: int
    """Type, one of Kind; a later version may have more."""
    identity: bytes
    """Identity of the survey or capture, 16 bytes."""
    sequence: int
    """Number of the record."""
    offset: int
    """Position in its file, bytes."""
    length: int
    """Length of header and payload, bytes."""
    check: int
    """CRC-32 in the header, which covers the CRC-32 of the payload."""
    payload: bytes
    """Content."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that contains no record."""

    offset: int
    """Position, bytes."""
    length: int
    """Length, bytes."""
    at_end: bool
    """True if no record follows: an unfinished record, or a damaged one."""


def encode_frame(kind: int, identity: bytes, sequence: int, payload: bytes) -> bytes:
    """Return the bytes of a record.

    Raises
    ------
    RecordingError
        If the payload is too long.
    """
    if len(payload) > MAX_RECORD_PAYLOAD_BYTES:
        raise RecordingError(
            f"record {sequence}: expected at most {MAX_RECORD_PAYLOAD_BYTES} bytes, got "
            f"{len(payload)}; shorten the recording window"
        )
    crc = zlib.crc32(payload)
    header = HEADER.pack(MAGIC, len(payload), kind, identity, sequence, crc, 0)[:-4]
    return header + _CHECK.pack(zlib.crc32(header)) + payload


def scan_bytes(data: bytes) -> tuple[list[Frame], list[Damage]]:
    """Return the records and the damaged parts of any `data`; never raise."""
    frames: list[Frame] = []
    damage: list[Damage] = []
    for item in scan(io.BytesIO(data)):
        (frames if isinstance(item, Frame) else damage).append(item)  # type: ignore[arg-type]
    return frames, damage


def scan(stream: BinaryIO, size: int | None = None, start: int = 0) -> Iterator[Frame | Damage]:
    """Yield records and damaged parts in the order of the file, without gaps between them.

    At most one payload and 1 MiB are in memory. After damage the scan continues with the next
    magic.

    Parameters
    ----------
    stream : readable and seekable
    size : int, optional
        End of the scan; by default the present end of the file.
    start : int
        Begin of the scan.
    """
    if size is None:
        size = stream.seek(0, io.SEEK_END)
    position = bad = start
    # Crafted headers with long payloads would take time proportional to the square of the size.
    remaining_cost = 16 * size + 4 * MAX_RECORD_PAYLOAD_BYTES
    while position < size:
        frame, cost = _frame_at(stream, position, size)
        if frame is not None:
            if bad < position:
                yield Damage(bad, position - bad, False)
            yield frame
            position = bad = position + frame.length
            continue
        remaining_cost -= cost
        position = _next_magic(stream, position + 1, size) if remaining_cost > 0 else size
    if bad < size:
        yield Damage(bad, size - bad, True)


def read_frame(stream: BinaryIO, offset: int) -> Frame | None:
    """Return the record at `offset`; None if there is no undamaged one."""
    return _frame_at(stream, offset, stream.seek(0, io.SEEK_END))[0]


def _frame_at(stream: BinaryIO, offset: int, size: int) -> tuple[Frame | None, int]:
    """Return the record or None, and the number of bytes read in vain."""
    stream.seek(offset)
    head = stream.read(min(HEADER.size, size - offset))
    if len(head) < HEADER.size:
        return None, HEADER.size
    magic, length, kind, identity, sequence, crc, check = HEADER.unpack(head)
    if magic != MAGIC or zlib.crc32(head[:-4]) != check:
        return None, HEADER.size
    if length > MAX_RECORD_PAYLOAD_BYTES or offset + HEADER.size + length > size:
        return None, HEADER.size
    payload = stream.read(length)
    if len(payload) != length or zlib.crc32(payload) != crc:
        return None, HEADER.size + length
    return Frame(kind, identity, sequence, offset, HEADER.size + length, check, payload), 0


def _next_magic(stream: BinaryIO, position: int, size: int) -> int:
    """Return the position of the next magic from `position` on, or `size`."""
    overlap = len(MAGIC) - 1
    while position < size:
        stream.seek(position)
        chunk = stream.read(min(_SCAN_BYTES, size - position))
        if not chunk:  # the file has become shorter
            return size
        index = chunk.find(MAGIC)
        if index >= 0:
            return position + index
        if position + len(chunk) >= size:
            return size
        position += max(len(chunk) - overlap, 1)
    return size
