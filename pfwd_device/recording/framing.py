"""Encoding of the records of journals and raw captures, and a search that tolerates any damage.

The journal contains all data of a survey; a raw capture contains the bytes of a link. A record is a
header of 48 bytes and a payload; all numbers are little-endian:

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

The payload is the content of the record. The header has a CRC of its own for two reasons: it
identifies a record whose payload is damaged, and after damage the search for the next record reads
only the 48 bytes of each candidate.
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
"""Largest payload, bytes; a drop of 8 channels and 10 s at 50 kHz has 48 MB before compression."""

_SCAN_BYTES = 2**20
_CHECK = struct.Struct("<I")


class RecordKind(IntEnum):
    """Kind of a record in a journal, or in a capture (the last two)."""

    SURVEY = 1
    """Time and program of the creation of the survey."""
    POINT = 2
    """Test point with its declarations."""
    DROP = 3
    """Drop with its traces."""
    REBOUND = 4
    """Rebound of a drop."""
    EDIT = 5
    """Later change by the user, such as a note."""
    EVENT = 6
    """Event such as a gap, a reconnection or a recovery."""
    CHECK = 7
    """Check of the zero or the span of a channel."""
    FILE = 8
    """File of a drop, a result or a capture, with its checksum."""
    CLOSE = 9
    """Regular end of a program that wrote the survey."""
    CAPTURE = 32
    """Header of a capture."""
    BYTES = 33
    """Bytes from or to the instrument."""


class Frame(NamedTuple):
    """Undamaged record of a journal or capture, with its position in the file."""

    kind: int
    """One of `RecordKind`, or a number of a later version."""
    identity: bytes
    """Identity of the survey or capture, 16 bytes."""
    sequence: int
    """Sequence number of the record, from 1."""
    offset: int
    """Position in its file, bytes."""
    length: int
    """Length of header and payload, bytes."""
    check: int
    """CRC-32 in the header, which covers the CRC-32 of the payload."""
    payload: bytes
    """Content of the record."""


@dataclass(frozen=True, slots=True)
class Damage:
    """Part of a journal or capture that contains no valid record."""

    offset: int
    """Position, bytes."""
    length: int
    """Length, bytes."""
    at_end: bool
    """True if no record follows, so that it may be an unfinished record."""


def encode_frame(kind: int, identity: bytes, sequence: int, payload: bytes) -> bytes:
    """Return the bytes of a record: header and payload.

    Parameters
    ----------
    kind : int
        One of `RecordKind`.
    identity : bytes
        Identity of the survey or capture, 16 bytes.
    sequence : int
        Sequence number of the record, from 1.
    payload : bytes
        Content of the record.

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


def scan(stream: BinaryIO, size: int | None = None, start: int = 0) -> Iterator[Frame | Damage]:
    """Yield the records and the damaged parts of a journal or capture, in the order of the file.

    Records and damaged parts together cover the file. After damage the search continues at the
    next magic, the 8 bytes with which a header begins. At most one payload and 1 MiB are in memory.

    Parameters
    ----------
    stream : readable and seekable
        Open file.
    size : int, optional
        End of the search, bytes; by default the present end of the file.
    start : int
        Position at which the search begins, bytes.
    """
    if size is None:
        size = stream.seek(0, io.SEEK_END)
    position = bad = start
    # A limit on the bytes that are read without finding a record. A file with many crafted headers
    # of long payloads would otherwise take a time proportional to the square of its size.
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
    """Return the record at a position of a file; None if there is no undamaged record."""
    return _frame_at(stream, offset, stream.seek(0, io.SEEK_END))[0]


def _frame_at(stream: BinaryIO, offset: int, size: int) -> tuple[Frame | None, int]:
    """Return the record at `offset` and 0, or None and the number of bytes read without success."""
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
    """Return the position of the next magic from `position` on; `size` if there is none."""
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
