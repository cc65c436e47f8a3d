"""Frames on a byte stream: COBS, so that a zero ends each, and CRC-32, so that damage is seen.

A packet is a type (1 byte), a counter (2 bytes), a payload and the CRC-32 of these (4 bytes), all
little-endian; on the wire it is COBS-encoded and followed by one zero byte. Cheshire and Baker
(1999), IEEE/ACM Trans. Networking 7(2), 159-172. Any damage costs the frames that it touches: the
next zero is the start of the next frame. Byte tables in docs/protocol.md.
"""

import struct
import zlib
from typing import NamedTuple

from cobs import cobs

from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.pieces import Cutter

HEAD = struct.Struct("<BH")
CHECK = struct.Struct("<I")
SHORTEST_PACKET = HEAD.size + CHECK.size
LONGEST_FRAME = 8192
"""Bytes between two zeros; a longer run is no frame and is thrown away as it comes."""
LONGEST_PAYLOAD = 8000
"""Bytes; with head, check and the overhead of COBS it stays below `LONGEST_FRAME`."""
COUNTER_PERIOD = 1 << 16


class Packet(NamedTuple):
    """What one frame carries."""

    type: int
    counter: int
    payload: bytes


def encode_frame(type_: int, counter: int, payload: bytes) -> bytes:
    """The bytes of one frame, the closing zero included.

    Parameters
    ----------
    type_ : int, 0 to 255
    counter : int
        Counts the frames of the sender; taken modulo 65536.
    payload : bytes, up to `LONGEST_PAYLOAD`

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        If the payload is too long.
    """
    if len(payload) > LONGEST_PAYLOAD:
        raise ValueError(f"payload: expected at most {LONGEST_PAYLOAD} bytes, got {len(payload)}")
    packet = HEAD.pack(type_, counter % COUNTER_PERIOD) + payload
    return bytes(cobs.encode(packet + CHECK.pack(zlib.crc32(packet)))) + b"\0"


class Deframer:
    """Cuts a byte stream into packets; what is damaged is counted and passed over.

    Parameters
    ----------
    counters : LinkCounters
        Where bytes and frames are counted.
    """

    def __init__(self, counters: LinkCounters) -> None:
        self._counters = counters
        self._cutter = Cutter(b"\0", LONGEST_FRAME, counters)
        self._expected: int | None = None

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that are complete with these bytes."""
        counters = self._counters
        packets = []
        for frame in self._cutter.feed(data):
            if not frame:
                continue  # an extra zero is the sender's way to end whatever came before
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
        """Forget a frame that has begun, and which number comes next: the link was cut."""
        self._cutter.reset()
        self._expected = None

    def _count(self, counter: int) -> None:
        if self._expected is not None:
            ahead = (counter - self._expected) % COUNTER_PERIOD
            if ahead < COUNTER_PERIOD // 2:  # else it counts anew after a reset, or repeats
                self._counters.frames_lost += ahead
        self._expected = (counter + 1) % COUNTER_PERIOD


def _open(frame: bytes) -> Packet | None:
    """The packet in a frame, None when it is damaged."""
    try:
        packet = cobs.decode(frame)
    except cobs.DecodeError:
        return None
    if len(packet) < SHORTEST_PACKET:
        return None
    body, check = packet[: -CHECK.size], packet[-CHECK.size :]
    if zlib.crc32(body) != CHECK.unpack(check)[0]:
        return None
    type_, counter = HEAD.unpack_from(body)
    return Packet(type_, counter, bytes(body[HEAD.size :]))
