"""Plain host of the mock instrument: it reads messages by COBS and byte offsets only."""

import struct
from collections.abc import Iterable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from cobs import cobs

from pfwd_device.wire.binary import encode_message
from pfwd_device.wire.messages import HostMessage, Start
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.scenario import load_scenario

_T = TypeVar("_T")
IDENTITY, SAMPLES, STATUS, EVENT, REFUSAL = 0x81, 0x82, 0x83, 0x84, 0x85
BOOT, TRIGGER, LOW_BATTERY, END, SHUNT_ON, SHUNT_OFF = 1, 2, 3, 4, 5, 6


class Frame(NamedTuple):
    type: int
    counter: int
    payload: bytes


class Block(NamedTuple):
    stream: int
    first: int
    clock: int
    shunt: bool
    counts: Any

    @property
    def end(self) -> int:
        return self.first + len(self.counts)


def frames(data: bytes) -> list[Frame]:
    """Return all frames; their check sums are not compared."""
    assert data.endswith(b"\0") or not data
    packets = [cobs.decode(part) for part in data.split(b"\0") if part]
    return [Frame(p[0], int.from_bytes(p[1:3], "little"), bytes(p[3:-4])) for p in packets]


def block(frame: Frame) -> Block:
    stream, first, clock, flags, channels, count = struct.unpack("<IQQBBH", frame.payload[:24])
    data = np.frombuffer(frame.payload[24:], np.uint8).reshape(count, channels, 3).astype(np.int64)
    counts = data @ [1, 256, 65_536]
    return Block(
        stream, first, clock, bool(flags & 1), np.where(counts < 2**23, counts, counts - 2**24)
    )


def blocks(data: bytes) -> list[Block]:
    return [block(frame) for frame in frames(data) if frame.type == SAMPLES]


def events(data: bytes) -> list[tuple[int, int, str]]:
    """Return kind, clock (us) and text of each event."""
    return [
        (*struct.unpack("<HQ", f.payload[:10]), f.payload[11:].decode())
        for f in frames(data)
        if f.type == EVENT
    ]


def statuses(data: bytes) -> list[tuple[int, float, float, int, int]]:
    """Return clock, battery, temperature, overruns and flags of each status."""
    return [struct.unpack("<QffQB", f.payload[:25]) for f in frames(data) if f.type == STATUS]


def refusals(data: bytes) -> list[int]:
    return [struct.unpack("<H", f.payload[:2])[0] for f in frames(data) if f.type == REFUSAL]


def of_kind(messages: Iterable[object], kind: type[_T]) -> list[_T]:
    """Return the messages of a kind."""
    return [message for message in messages if isinstance(message, kind)]


def drain(instrument: PortlessInstrument) -> bytes:
    data = bytes(instrument.output)
    instrument.sent(len(data))
    return data


def send(instrument: PortlessInstrument, *messages: HostMessage) -> bytes:
    instrument.receive(b"".join(b"\0" + encode_message(message, 0) for message in messages))
    return drain(instrument)


def record(tables: Any = "default", seconds: float = 0.1, **options: Any) -> bytes:
    """Return the output of an instrument in a time after its start."""
    instrument = started(tables, **options)
    instrument.advance(seconds)
    return drain(instrument)


def started(tables: Any = "default", **options: Any) -> PortlessInstrument:
    """Return an instrument that samples and whose output has not been read."""
    instrument = PortlessInstrument(load_scenario(tables), **options)
    instrument.connect()
    instrument.receive(b"\0" + encode_message(Start(), 0))
    return instrument
