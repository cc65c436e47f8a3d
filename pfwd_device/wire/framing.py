"""Frames of the binary protocol: the packing of messages into a stream of bytes.

A packet carries one message: a type (1 byte), a counter (2 bytes), a payload, which is the content
of the message, and the CRC-32 of these (4 bytes), all little-endian. A frame is the packet encoded
by COBS (consistent overhead byte stuffing: Cheshire and Baker, 1999, IEEE/ACM Trans. Networking
7(2), 159-172), which removes all zero bytes, and one zero byte as its end. The CRC detects damage.
Damage destroys only the frames in which it lies, because a new frame starts after the next zero.
docs/protocol.md has the byte tables.
"""

import struct
import zlib
from typing import NamedTuple

from cobs import cobs

from pfwd_device.wire.dialect import LinkCounters

PACKET_HEAD = struct.Struct("<BH")
PACKET_CRC = struct.Struct("<I")
MIN_PACKET_BYTES = PACKET_HEAD.size + PACKET_CRC.size
MAX_FRAME_BYTES = 8192
"""Largest number of bytes between two zeros; a longer run is discarded as it arrives."""
MAX_PAYLOAD_BYTES = 8000
"""Largest payload; with head, CRC and the overhead of COBS it is below `MAX_FRAME_BYTES`."""
COUNTER_PERIOD = 1 << 16


class Cutter:
    """Splits a stream of bytes into frames or lines, at the byte that ends each of them.

    Parameters
    ----------
    end : bytes
        Byte that ends a frame or line.
    longest : int
        Largest number of bytes before the end byte. A longer frame is discarded while its bytes
        arrive, and counts as one damaged frame.
    counters : LinkCounters
        Counters of bytes and frames, which are updated.
    """

    def __init__(self, end: bytes, longest: int, counters: LinkCounters) -> None:
        self._end, self._longest, self._counters = end, longest, counters
        self._partial = b""
        self._overlong = False

    @property
    def held(self) -> int:
        """Number of bytes of the incomplete frame or line at the end of the received bytes."""
        return len(self._partial)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames or lines that these bytes complete, without their end bytes."""
        counters = self._counters
        counters.bytes_received += len(data)
        *pieces, rest = (self._partial + data).split(self._end)
        good = []
        for piece in pieces:
            if not self._overlong and len(piece) <= self._longest:
                good.append(piece)
                continue
            counters.frames_damaged += not self._overlong  # else it was counted with its start
            counters.bytes_discarded += len(piece) + 1
            self._overlong = False
        if len(rest) > self._longest and not self._overlong:
            self._overlong = True
            counters.frames_damaged += 1
        if self._overlong:
            counters.bytes_discarded += len(rest)
            rest = b""
        self._partial = rest
        return good

    def reset(self) -> None:
        """Discard an incomplete frame or line after the link was cut."""
        self._counters.bytes_discarded += len(self._partial)
        self._partial = b""
        self._overlong = False


class Packet(NamedTuple):
    """Content of an undamaged frame, which carries one message."""

    type: int
    """Number of the kind of message, 0 to 255."""
    counter: int
    """Number of the frame, counted by the sender modulo 65536."""
    payload: bytes
    """Content of the message."""


def encode_frame(type_: int, counter: int, payload: bytes) -> bytes:
    """Return the bytes of one frame, including its closing zero.

    Parameters
    ----------
    type_ : int, 0 to 255
        Number of the kind of message.
    counter : int
        Number of the frame, counted by the sender; it is sent modulo 65536.
    payload : bytes, up to `MAX_PAYLOAD_BYTES`
        Content of the message.

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        If the payload is too long.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"payload: expected at most {MAX_PAYLOAD_BYTES} bytes, got {len(payload)}")
    packet = PACKET_HEAD.pack(type_, counter % COUNTER_PERIOD) + payload
    return bytes(cobs.encode(packet + PACKET_CRC.pack(zlib.crc32(packet)))) + b"\0"


class Deframer:
    """Decodes a stream of bytes into packets; damaged frames are counted and skipped.

    Parameters
    ----------
    counters : LinkCounters
        Counters of bytes and frames, which are updated.
    """

    def __init__(self, counters: LinkCounters) -> None:
        self._counters = counters
        self._cutter = Cutter(b"\0", MAX_FRAME_BYTES, counters)
        self._expected: int | None = None

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets whose frames these bytes complete, in order."""
        counters = self._counters
        packets = []
        for frame in self._cutter.feed(data):
            if not frame:
                continue  # senders put an extra zero before a frame to end preceding noise
            packet = _open(frame)
            if packet is None:
                counters.frames_damaged += 1
                counters.bytes_discarded += len(frame) + 1
            else:
                counters.frames_good += 1
                self._count(packet.counter)
                packets.append(packet)
        return packets

    def reset(self) -> None:
        """Discard an incomplete frame after the link was cut.

        The next frame may have any number: no lost frames are counted before it.
        """
        self._cutter.reset()
        self._expected = None

    def _count(self, counter: int) -> None:
        if self._expected is not None:
            ahead = (counter - self._expected) % COUNTER_PERIOD
            # A larger step means a restarted counter or a repeated frame, not lost frames.
            if ahead < COUNTER_PERIOD // 2:
                self._counters.frames_lost += ahead
        self._expected = (counter + 1) % COUNTER_PERIOD


def _open(frame: bytes) -> Packet | None:
    """Return the packet of a frame; None if the frame is damaged."""
    try:
        packet = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    if len(packet) < MIN_PACKET_BYTES:
        return None
    body, check = packet[: -PACKET_CRC.size], packet[-PACKET_CRC.size :]
    if zlib.crc32(body) != PACKET_CRC.unpack(check)[0]:
        return None
    type_, counter = PACKET_HEAD.unpack_from(body)
    return Packet(type_, counter, bytes(body[PACKET_HEAD.size :]))
