"""Encoding of the messages of the binary protocol as bytes of packets.

docs/protocol.md has the byte tables.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from pfwd_device.errors import ProtocolError, SetupError
from pfwd_device.identity import FASTEST_SAMPLING, MAX_CHANNELS, Identity
from pfwd_device.wire.dialect import LinkCounters
from pfwd_device.wire.fields import (
    BYTE,
    Reader,
    decode_optional,
    decode_reading,
    encode_optional,
    pack_int24,
    text,
    unpack_int24,
)
from pfwd_device.wire.framing import Deframer, Packet, encode_frame
from pfwd_device.wire.identity_layout import pack_identity, read_identity
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Armed,
    Calibrate,
    Configure,
    DropBlock,
    DropOffer,
    Event,
    Fetch,
    Hello,
    HostMessage,
    InstrumentMessage,
    Message,
    Refusal,
    RefusalCode,
    Released,
    Resend,
    SampleBlock,
    SamplesGone,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)

HELLO_MAGIC = b"PFWD"
NO_CLOCK = 2**64 - 1
MAX_SAMPLE_INDEX = 2**63 - 1
"""Largest sample index; a higher one is damage, because indices are stored as signed integers."""
MAX_SAMPLE_BYTES = 6144
"""Largest size of the samples in one block: 2048 values of 3 bytes."""
MAX_DROP_SAMPLES = 10 * int(FASTEST_SAMPLING)
"""Longest drop: ten seconds, the limit of a setup file."""
MAX_DROP_BLOCKS = 65535

HELLO, CONFIGURE, START, STOP, SHUNT = 0x01, 0x02, 0x03, 0x04, 0x05
ARM, FETCH, ACKNOWLEDGE, RESEND, CALIBRATE = 0x06, 0x07, 0x08, 0x09, 0x0A
IDENTITY, SAMPLES, STATUS, EVENT, REFUSAL = 0x81, 0x82, 0x83, 0x84, 0x85
ARMED, OFFER, BLOCK, RELEASED, GONE = 0x86, 0x87, 0x88, 0x89, 0x8A

_HELLO = struct.Struct("<4sBB")
_RATE = struct.Struct("<d")
_SAMPLES = struct.Struct("<IQQBBH")
_STATUS = struct.Struct("<QffQBHI")
_TRIGGER = struct.Struct("<BBIHIII")
_FETCH = struct.Struct("<IQHH")
_DROP_NAME = struct.Struct("<IQ")
"""Stream and index of the first sample, which identify a drop."""
_RANGE = struct.Struct("<IQI")
_CALIBRATE = struct.Struct("<BdddddII")
_OFFER = struct.Struct("<IQQIIBBHId")
_BLOCK = struct.Struct("<IQH")
_OFFER_FLAGS = ("shunt", "by_operator", "earlier")
_EVENT = struct.Struct("<HQ")
_REFUSAL = struct.Struct("<H")
_SHUNT_ON = 1
_SAMPLING = 1


def encode_message(message: Message, counter: int) -> bytes:
    """Return the bytes of the frame that carries a message, including its closing zero.

    Parameters
    ----------
    message : Message
    counter : int
        Number of the frame, counted by the sender; it is sent modulo 65536.

    Returns
    -------
    bytes

    Raises
    ------
    ProtocolError
        If a value does not fit into the layout of the message.
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
            battery, temperature = (
                encode_optional(message.battery_v),
                encode_optional(message.temperature_c),
            )
            flags = _SAMPLING if message.sampling else 0
            drops = message.drops_waiting or 0, message.drops_lost or 0
            return STATUS, _STATUS.pack(
                message.clock_us, battery, temperature, message.overruns, flags, *drops
            )
        case Event():
            return EVENT, _EVENT.pack(message.kind, message.clock_us) + text(message.text)
        case Refusal():
            return REFUSAL, _REFUSAL.pack(message.code) + text(message.text)
        case Identity():
            return IDENTITY, pack_identity(message)
        case Hello():
            return HELLO, _HELLO.pack(HELLO_MAGIC, message.oldest_version, message.newest_version)
        case Configure():
            return CONFIGURE, _RATE.pack(message.sampling_rate)
        case Start():
            return START, b""
        case Stop():
            return STOP, b""
        case Shunt():
            return SHUNT, BYTE.pack(message.on)
        case Arm():
            return ARM, _pack_trigger(message.trigger)
        case Armed():
            return ARMED, _pack_trigger(message.trigger)
        case Fetch(stream, first, block, blocks):
            return FETCH, _FETCH.pack(stream, first, block, blocks)
        case Acknowledge(stream, first):
            return ACKNOWLEDGE, _DROP_NAME.pack(stream, first)
        case Released(stream, first):
            return RELEASED, _DROP_NAME.pack(stream, first)
        case Resend(stream, first, count):
            return RESEND, _RANGE.pack(stream, first, count)
        case SamplesGone(stream, first, count):
            return GONE, _RANGE.pack(stream, first, count)
        case Calibrate():
            return CALIBRATE, _pack_calibrate(message)
        case DropBlock(stream, first, number, data):
            return BLOCK, _BLOCK.pack(stream, first, number) + data
        case DropOffer():
            return OFFER, _pack_offer(message)


def _pack_trigger(trigger: Trigger) -> bytes:
    return _TRIGGER.pack(
        trigger.on,
        trigger.channel,
        trigger.threshold,
        trigger.confirm,
        trigger.before,
        trigger.after,
        trigger.hold_off,
    )


def _pack_calibrate(message: Calibrate) -> bytes:
    values = _CALIBRATE.pack(
        message.channel,
        message.sensitivity,
        message.zero,
        encode_optional(message.natural_frequency),
        encode_optional(message.damping),
        encode_optional(message.shunt),
        message.calibrated,
        message.due,
    )
    return values + text(message.serial_number)


def _pack_offer(offer: DropOffer) -> bytes:
    flags = sum(getattr(offer, name) << bit for bit, name in enumerate(_OFFER_FLAGS))
    return _OFFER.pack(
        offer.stream,
        offer.first_sample,
        NO_CLOCK if offer.clock_us is None else offer.clock_us,
        offer.trigger,
        offer.samples,
        offer.channels,
        flags,
        offer.block_samples,
        offer.crc,
        offer.sampling_rate,
    )


def _pack_samples(block: SampleBlock) -> bytes:
    count, channels = block.counts.shape
    if not (count and 1 <= channels <= MAX_CHANNELS):
        raise ValueError(
            f"expected samples of 1 to {MAX_CHANNELS} channels, got {count}x{channels}"
        )
    if count * channels * 3 > MAX_SAMPLE_BYTES:
        raise ValueError(f"expected at most {MAX_SAMPLE_BYTES} bytes, got {count}x{channels}x3")
    clock = NO_CLOCK if block.clock_us is None else block.clock_us
    flags = _SHUNT_ON if block.shunt else 0
    head = _SAMPLES.pack(block.stream, block.first_sample, clock, flags, channels, count)
    return head + pack_int24(block.counts)


def _read_samples(payload: bytes) -> SampleBlock:
    reader = Reader(payload)
    stream, first, clock, flags, channels, count = reader.fields(_SAMPLES)
    data = reader.rest()
    length = 3 * channels * count
    if not (1 <= channels <= MAX_CHANNELS and 0 < length <= len(data)):
        raise ValueError(f"{len(data)} bytes for {count} samples of {channels} channels")
    if first > MAX_SAMPLE_INDEX - count:
        raise ValueError(f"first sample {first}")
    counts = unpack_int24(data[:length]).reshape(count, channels)
    clock_us = None if clock == NO_CLOCK else clock
    return SampleBlock(stream, first, clock_us, counts, bool(flags & _SHUNT_ON))


def _read_status(payload: bytes) -> Status:
    reader = Reader(payload)
    clock, battery, temperature, overruns, flags, *drops = reader.fields(_STATUS)
    sampling = bool(flags & _SAMPLING)
    battery, temperature = decode_reading(battery), decode_reading(temperature)
    return Status(clock, battery, temperature, overruns, sampling, *drops)


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
    except SetupError as err:  # the CRC is right, so the instrument itself sent the invalid value
        return Refusal(RefusalCode.FAULT, str(err))


def _read_hello(payload: bytes) -> Hello:
    magic, oldest, newest = Reader(payload).fields(_HELLO)
    if magic != HELLO_MAGIC:
        raise ValueError(f"greeting {magic!r}")
    return Hello(oldest, newest)


def _read_trigger(payload: bytes) -> Trigger:
    on, *settings = Reader(payload).fields(_TRIGGER)
    return Trigger(bool(on), *settings)


def _read_calibrate(payload: bytes) -> Calibrate:
    reader = Reader(payload)
    channel, sensitivity, zero, *settings, calibrated, due = reader.fields(_CALIBRATE)
    frequency, damping, shunt = map(decode_optional, settings)
    return Calibrate(
        channel, sensitivity, zero, frequency, damping, shunt, calibrated, due, reader.text()
    )


def _read_offer(payload: bytes) -> DropOffer:
    stream, first, clock, trigger, samples, channels, flags, block, crc, rate = Reader(
        payload
    ).fields(_OFFER)
    sound = (
        1 <= channels <= MAX_CHANNELS
        and 1 <= samples <= MAX_DROP_SAMPLES
        and trigger <= samples
        and block >= 1
        and -(-samples // block) <= MAX_DROP_BLOCKS
        and first <= MAX_SAMPLE_INDEX - samples
        and 0 < rate <= FASTEST_SAMPLING
    )
    if not sound:
        raise ValueError(f"a drop of {samples} samples of {channels} channels in blocks of {block}")
    flagged = {name: bool(flags >> bit & 1) for bit, name in enumerate(_OFFER_FLAGS)}
    clock_us = None if clock == NO_CLOCK else clock
    return DropOffer(
        stream, first, clock_us, trigger, samples, channels, block, crc, rate, **flagged
    )


def _read_block(payload: bytes) -> DropBlock:
    reader = Reader(payload)
    stream, first, number = reader.fields(_BLOCK)
    data = reader.rest()
    if not data or len(data) % 3:
        raise ValueError(f"a block of {len(data)} bytes of counts")
    return DropBlock(stream, first, number, data)


_FROM_INSTRUMENT: dict[int, Callable[[bytes], InstrumentMessage]] = {
    IDENTITY: _read_identity,
    SAMPLES: _read_samples,
    STATUS: _read_status,
    EVENT: _read_event,
    REFUSAL: _read_refusal,
    ARMED: lambda payload: Armed(_read_trigger(payload)),
    OFFER: _read_offer,
    BLOCK: _read_block,
    RELEASED: lambda payload: Released(*Reader(payload).fields(_DROP_NAME)),
    GONE: lambda payload: SamplesGone(*Reader(payload).fields(_RANGE)),
}
_FROM_HOST: dict[int, Callable[[bytes], HostMessage]] = {
    HELLO: _read_hello,
    CONFIGURE: lambda payload: Configure(*Reader(payload).fields(_RATE)),
    START: lambda payload: Start(),
    STOP: lambda payload: Stop(),
    SHUNT: lambda payload: Shunt(bool(Reader(payload).fields(BYTE)[0])),
    ARM: lambda payload: Arm(_read_trigger(payload)),
    FETCH: lambda payload: Fetch(*Reader(payload).fields(_FETCH)),
    ACKNOWLEDGE: lambda payload: Acknowledge(*Reader(payload).fields(_DROP_NAME)),
    RESEND: lambda payload: Resend(*Reader(payload).fields(_RANGE)),
    CALIBRATE: _read_calibrate,
}


class BinaryDialect:
    """Decoder and encoder of the binary protocol for the computer that reads an instrument."""

    name = "pfwd"
    counts_samples = True
    outgoing = b""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self._deframer = Deframer(self.counters)
        self._sent = 0

    def feed(self, data: bytes) -> list[InstrumentMessage]:
        """Return the messages of the instrument that these bytes complete, in order.

        Sample blocks that follow each other without a gap are joined to one.
        """
        packets = self._deframer.feed(data)
        return list(_joined(_read(packets, _FROM_INSTRUMENT, self.counters)))

    def encode(self, message: HostMessage) -> bytes:
        """Return the bytes of a message to the instrument.

        They begin with a zero, so that noise on the line before them is a frame of its own.
        """
        frame = encode_message(message, self._sent)
        self._sent += 1
        return b"\0" + frame

    def reset(self) -> None:
        """Discard an incomplete frame after the link was cut."""
        self._deframer.reset()


class BinaryInstrumentEnd:
    """Decoder of the binary protocol for a simulated instrument."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self._deframer = Deframer(self.counters)

    def feed(self, data: bytes) -> list[HostMessage]:
        """Return the messages of the host that these bytes complete, in order."""
        return list(_read(self._deframer.feed(data), _FROM_HOST, self.counters))


def read_from_instrument(
    packets: Iterable[Packet], counters: LinkCounters
) -> Iterator[InstrumentMessage]:
    """Yield the message of each packet from an instrument; sample blocks are not joined.

    Parameters
    ----------
    packets : iterable of Packet
    counters : LinkCounters
        Counters of unknown and damaged frames, which are updated.
    """
    return _read(packets, _FROM_INSTRUMENT, counters)


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
        except (struct.error, ValueError):  # the CRC is right, the content is not
            counters.frames_damaged += 1
            counters.frames_good -= 1


def _joined(messages: Iterable[InstrumentMessage]) -> Iterator[InstrumentMessage]:
    """Yield the messages with consecutive sample blocks joined.

    Fewer and larger arrays take less time to process.
    """
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
