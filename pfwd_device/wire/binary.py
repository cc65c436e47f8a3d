"""The binary protocol, version 1: messages as packets. Byte tables in docs/protocol.md."""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from pfwd_device.errors import ProtocolError, SetupError
from pfwd_device.identity import MOST_CHANNELS, Identity
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.fields import (
    BYTE,
    Reader,
    finite_or_none,
    or_nan,
    pack_int24,
    text,
    unpack_int24,
)
from pfwd_device.wire.framing import Deframer, Packet, encode_frame
from pfwd_device.wire.identity_layout import pack_identity, read_identity
from pfwd_device.wire.messages import (
    Configure,
    Event,
    Hello,
    HostMessage,
    InstrumentMessage,
    Message,
    Refusal,
    RefusalCode,
    SampleBlock,
    Shunt,
    Start,
    Status,
    Stop,
)

VERSION = 1
MAGIC = b"PFWD"
NO_CLOCK = 2**64 - 1
LAST_SAMPLE = 2**63 - 1
"""Higher indices are damaged: what counts samples further on has signed integers."""
MOST_SAMPLE_BYTES = 6144
"""Bytes of the samples in one block: 2048 values of 3 bytes."""

HELLO, CONFIGURE, START, STOP, SHUNT = 0x01, 0x02, 0x03, 0x04, 0x05
IDENTITY, SAMPLES, STATUS, EVENT, REFUSAL = 0x81, 0x82, 0x83, 0x84, 0x85

_HELLO = struct.Struct("<4sBB")
_RATE = struct.Struct("<d")
_SAMPLES = struct.Struct("<IQQBBH")
_STATUS = struct.Struct("<QffQB")
_EVENT = struct.Struct("<HQ")
_REFUSAL = struct.Struct("<H")
_SHUNT_ON = 1
_SAMPLING = 1


def encode_message(message: Message, counter: int) -> bytes:
    """The frame that carries a message, its closing zero included.

    Parameters
    ----------
    message : Message
    counter : int
        Counts the frames of the sender.

    Returns
    -------
    bytes

    Raises
    ------
    ProtocolError
        If the message holds more than its layout can.
    """
    try:
        type_, payload = _pack(message)
        return encode_frame(type_, counter, payload)
    except (struct.error, ValueError, OverflowError) as err:
        raise ProtocolError(f"{type(message).__name__}: {err}") from err


def _pack(message: Message) -> tuple[int, bytes]:
    match message:
        case SampleBlock():
            return SAMPLES, _pack_samples(message)
        case Status():
            battery, temperature = or_nan(message.battery_v), or_nan(message.temperature_c)
            flags = _SAMPLING if message.sampling else 0
            payload = _STATUS.pack(message.clock_us, battery, temperature, message.overruns, flags)
            return STATUS, payload
        case Event():
            return EVENT, _EVENT.pack(message.kind, message.clock_us) + text(message.text)
        case Refusal():
            return REFUSAL, _REFUSAL.pack(message.code) + text(message.text)
        case Identity():
            return IDENTITY, pack_identity(message)
        case Hello():
            return HELLO, _HELLO.pack(MAGIC, message.oldest_version, message.newest_version)
        case Configure():
            return CONFIGURE, _RATE.pack(message.sampling_rate)
        case Start():
            return START, b""
        case Stop():
            return STOP, b""
        case Shunt():
            return SHUNT, BYTE.pack(message.on)


def _pack_samples(block: SampleBlock) -> bytes:
    count, channels = block.counts.shape
    if not (count and 1 <= channels <= MOST_CHANNELS):
        raise ValueError(
            f"expected samples of 1 to {MOST_CHANNELS} channels, came {count}x{channels}"
        )
    if count * channels * 3 > MOST_SAMPLE_BYTES:
        raise ValueError(f"expected at most {MOST_SAMPLE_BYTES} bytes, came {count}x{channels}x3")
    clock = NO_CLOCK if block.clock_us is None else block.clock_us
    flags = _SHUNT_ON if block.shunt else 0
    head = _SAMPLES.pack(block.stream, block.first_sample, clock, flags, channels, count)
    return head + pack_int24(block.counts)


def _read_samples(payload: bytes) -> SampleBlock:
    reader = Reader(payload)
    stream, first, clock, flags, channels, count = reader.fields(_SAMPLES)
    data = reader.rest()
    length = 3 * channels * count
    if not (1 <= channels <= MOST_CHANNELS and 0 < length <= len(data)):
        raise ValueError(f"{len(data)} bytes for {count} samples of {channels} channels")
    if first > LAST_SAMPLE - count:
        raise ValueError(f"first sample {first}")
    counts = unpack_int24(data[:length]).reshape(count, channels)
    clock_us = None if clock == NO_CLOCK else clock
    return SampleBlock(stream, first, clock_us, counts, bool(flags & _SHUNT_ON))


def _read_status(payload: bytes) -> Status:
    clock, battery, temperature, overruns, flags = Reader(payload).fields(_STATUS)
    sampling = bool(flags & _SAMPLING)
    battery, temperature = finite_or_none(battery), finite_or_none(temperature)
    return Status(clock, battery, temperature, overruns, sampling)


def _read_event(payload: bytes) -> Event:
    reader = Reader(payload)
    kind, clock = reader.fields(_EVENT)
    return Event(kind, clock, reader.text())


def _read_refusal(payload: bytes) -> Refusal:
    reader = Reader(payload)
    (code,) = reader.fields(_REFUSAL)
    return Refusal(code, reader.text())


def _read_identity(payload: bytes) -> Identity | Refusal:
    try:
        return read_identity(payload)
    except SetupError as err:  # arrived whole: it is the instrument that talks nonsense
        return Refusal(RefusalCode.FAULT, str(err))


def _read_hello(payload: bytes) -> Hello:
    magic, oldest, newest = Reader(payload).fields(_HELLO)
    if magic != MAGIC:
        raise ValueError(f"greeting {magic!r}")
    return Hello(oldest, newest)


def _read_shunt(payload: bytes) -> Shunt:
    return Shunt(bool(Reader(payload).fields(BYTE)[0]))


_FROM_INSTRUMENT: dict[int, Callable[[bytes], InstrumentMessage]] = {
    IDENTITY: _read_identity,
    SAMPLES: _read_samples,
    STATUS: _read_status,
    EVENT: _read_event,
    REFUSAL: _read_refusal,
}
_FROM_HOST: dict[int, Callable[[bytes], HostMessage]] = {
    HELLO: _read_hello,
    CONFIGURE: lambda payload: Configure(*Reader(payload).fields(_RATE)),
    START: lambda payload: Start(),
    STOP: lambda payload: Stop(),
    SHUNT: _read_shunt,
}


class BinaryDialect:
    """The host's end of the binary protocol."""

    name = "pfwd"

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self._deframer = Deframer(self.counters)
        self._sent = 0

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Messages that are complete with these bytes; consecutive sample blocks as one."""
        packets = self._deframer.feed(data)
        return list(_joined(_read(packets, _FROM_INSTRUMENT, self.counters)))

    def encode(self, message: HostMessage) -> bytes:
        """The frame that carries a message, after a zero that ends whatever noise came before."""
        frame = encode_message(message, self._sent)
        self._sent += 1
        return b"\0" + frame

    def reset(self) -> None:
        """Forget a frame that has begun."""
        self._deframer.reset()


class BinaryInstrumentEnd:
    """The instrument's end of the binary protocol, for a simulated one."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self._deframer = Deframer(self.counters)

    def feed(self, data: bytes) -> list[HostMessage]:
        """What the host said."""
        return list(_read(self._deframer.feed(data), _FROM_HOST, self.counters))


def _read(
    packets: Iterable[Packet],
    readers: Mapping[int, Callable[[bytes], Any]],
    counters: LinkCounters,
) -> Iterator[Any]:
    for packet in packets:
        read = readers.get(packet.type)
        if read is None:
            counters.frames_unknown += 1
            continue
        try:
            yield read(packet.payload)
        except (struct.error, ValueError):  # the check was right, the content is not
            counters.frames_damaged += 1
            counters.frames_good -= 1


def _joined(messages: Iterable[InstrumentMessage]) -> Iterator[InstrumentMessage]:
    """Blocks that follow each other without a gap as one: fewer, larger arrays downstream."""
    run: list[SampleBlock] = []
    for message in messages:
        if run and not (isinstance(message, SampleBlock) and _follows(run[-1], message)):
            yield _join(run)
            run = []
        if isinstance(message, SampleBlock):
            run.append(message)
        else:
            yield message
    if run:
        yield _join(run)


def _follows(earlier: SampleBlock, later: SampleBlock) -> bool:
    return (
        later.stream == earlier.stream
        and later.shunt == earlier.shunt
        and later.counts.shape[1] == earlier.counts.shape[1]
        and later.first_sample == earlier.first_sample + len(earlier.counts)
    )


def _join(run: list[SampleBlock]) -> SampleBlock:
    if len(run) == 1:
        return run[0]
    first = run[0]
    counts = np.concatenate([block.counts for block in run])
    return SampleBlock(first.stream, first.first_sample, first.clock_us, counts, first.shunt)
