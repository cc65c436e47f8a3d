"""Targets of fuzzing: functions of bytes that fail when an invariant breaks, without a fuzzer.

Another reader of outside bytes joins with a function under `@target("group")`; the everyday tests
and `fuzz.py` find it in `TARGETS`.
"""

import struct
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.ascii_lines import MAX_LINE_BYTES, AsciiDialect
from pfwd_device.wire.binary import BinaryDialect, BinaryInstrumentEnd, encode_message
from pfwd_device.wire.framing import MAX_FRAME_BYTES, encode_frame
from pfwd_device.wire.identity_layout import pack_identity, read_identity
from pfwd_device.wire.messages import Refusal, SampleBlock
from pfwd_plugins.quantities import Measurand

Target = Callable[[bytes], None]
TARGETS: dict[str, dict[str, Target]] = {}
"""Targets by group and name."""


def target(group: str) -> Callable[[Target], Target]:
    """Enters a function into `TARGETS`."""

    def enter(function: Target) -> Target:
        TARGETS.setdefault(group, {})[function.__name__] = function
        return function

    return enter


IDENTITY = Identity(
    serial_number="7",
    model="lines",
    firmware="1",
    sampling_rate=10_000.0,
    adc_bits=16,
    adc_range=2.5,
    channels=(ChannelIdentity("load", Measurand.LOAD), ChannelIdentity("g0", Measurand.VELOCITY)),
)


def cuts(data: bytes) -> Iterator[bytes]:
    """Pieces whose lengths the data themselves choose."""
    at, seed = 0, len(data)
    while at < len(data):
        seed = (seed * 33 + data[at]) & 0xFFFF
        length = 1 + seed % 23 if seed & 1 else 1 + seed % 12_000
        yield data[at : at + length]
        at += length


def plain(messages: list[Any]) -> list[Any]:
    """Messages without the borders of blocks: each sample for itself."""
    flat: list[Any] = []
    for message in messages:
        if isinstance(message, SampleBlock):
            for at, counts in enumerate(message.counts.tolist()):
                place = message.stream, message.first_sample + at
                flat.append((*place, message.shunt, tuple(counts)))
        elif isinstance(message, Refusal):
            flat.append((int(message.code), message.text))  # a code may be an enum or not
        else:
            flat.append(repr(message))  # equal even if it holds NaN
    return flat


def check_stream(make: Callable[[], Any], data: bytes, max_stored: int) -> None:
    """Check that messages and counts do not depend on the division of bytes; bound the storage."""
    complete, divided = make(), make()
    expected = plain(complete.feed(data))
    messages: list[Any] = []
    for piece in cuts(data):
        messages += divided.feed(piece)
    assert plain(messages) == expected
    assert divided.counters == complete.counters
    counters = complete.counters
    assert counters.bytes_received == len(data)
    assert 0 <= counters.bytes_discarded <= len(data)
    counts = (counters.frames_good, counters.frames_damaged, counters.frames_unknown)
    assert min(*counts, counters.frames_lost) >= 0
    assert stored_bytes(complete) <= max_stored


def stored_bytes(end: Any) -> int:
    """Return the number of bytes that wait for more."""
    deframer = getattr(end, "_deframer", end)
    held = sum(line.size for line in getattr(end, "_held", []))
    return deframer._cutter.held + held


def framed(data: bytes, types: bytes) -> bytes:
    """Return the data as payloads of frames with valid CRCs, which fuzzers do not guess."""
    frames = []
    at = counter = 0
    while at + 2 < len(data):
        length = data[at + 1] | (data[at + 2] & 1) << 8
        payload = data[at + 3 : at + 3 + length]
        frames.append(encode_frame(types[data[at] % len(types)], counter, payload))
        at += 3 + length
        counter += 1 + (data[at - 1] == 7 if at <= len(data) else 0)
    return b"".join(frames)


@target("wire")
def binary_bytes(data: bytes) -> None:
    """The host's end, any bytes."""
    check_stream(BinaryDialect, data, MAX_FRAME_BYTES)


@target("wire")
def binary_payloads(data: bytes) -> None:
    """The host's end, any payloads; accepted messages survive encoding and decoding."""
    stream = framed(data, b"\x81\x82\x83\x84\x85\x86")
    check_stream(BinaryDialect, stream, MAX_FRAME_BYTES)
    for message in BinaryDialect().feed(stream):
        if isinstance(message, SampleBlock):
            assert message.counts.dtype == np.int32
            assert (np.abs(message.counts.astype(np.int64) + 0.5) < 1 << 23).all()
            if message.counts.size > 2048:
                continue  # several blocks joined
        elif any(len(text.encode()) > 255 for text in texts(message)):
            continue  # replacement characters are longer than what they replace
        frame = encode_message(message, 0)
        assert plain(BinaryDialect().feed(frame)) == plain([message])


@target("wire")
def instrument_bytes(data: bytes) -> None:
    """The instrument's end, any bytes."""
    check_stream(BinaryInstrumentEnd, data, MAX_FRAME_BYTES)


@target("wire")
def instrument_payloads(data: bytes) -> None:
    """The instrument's end, any payloads."""
    stream = framed(data, b"\x01\x02\x03\x04\x05\x06")
    check_stream(BinaryInstrumentEnd, stream, MAX_FRAME_BYTES)


@target("wire")
def ascii_bytes(data: bytes) -> None:
    """Lines, any bytes; both kinds of values."""
    check_stream(lambda: AsciiDialect(IDENTITY, [0, 1]), data, 2 * MAX_LINE_BYTES + 2)
    decimals = [0.5, 1e-6]
    make = lambda: AsciiDialect(IDENTITY, [1, 0], resolution=decimals)  # noqa: E731
    check_stream(make, data, 2 * MAX_LINE_BYTES + 2)


@target("wire")
def ascii_words(data: bytes) -> None:
    """Lines of typical pieces: each byte is a piece of a line, or a valid line."""
    pieces, time = [], 1000
    for byte in data[:3000]:
        if byte < 64:
            pieces.append(b"%d,%d,%d\n" % (time, byte, -byte))
        elif byte < 80:
            pieces.append(b"%d,%d.5,2,7\r\n" % (time, byte))
        else:
            pieces.append(_WORDS[byte % len(_WORDS)])
        time += 100
    ascii_bytes(b"".join(pieces))


_WORDS = [b"%d" % digit for digit in range(10)]
_WORDS += [b",", b",", b"\n", b"\n", b"\r\n", b".", b"-", b"+", b"e", b" ", b"\t", b"#", b"t_us,"]
_WORDS += [b"nan", b"inf", b"_", b"\0", b"\xd9\xa1", b" " * 500, b"9" * 14]


@target("wire")
def ascii_times(data: bytes) -> None:
    """Lines whose times jump as the data state."""
    time, lines = 1000, []
    for at, byte in enumerate(data[:2000]):
        jump = byte & 0x3F
        match byte >> 6:
            case 0:
                time += 100
            case 1:
                time += 60 + 2 * jump
            case 2:
                time += (-100 if jump & 1 else 100) * (jump >> 1)
            case _:
                time += (-1 if jump & 1 else 1) << (jump >> 1)
        time = max(0, time) if jump & 2 else time % 2**32
        lines.append(b"%d,%d,%d\n" % (time, at, -at))
    stream = b"".join(lines)
    check_stream(lambda: AsciiDialect(IDENTITY, [0, 1]), stream, 2 * MAX_LINE_BYTES + 2)
    last: tuple[int, int] = (0, -1)
    for message in AsciiDialect(IDENTITY, [0, 1]).feed(stream):
        if isinstance(message, SampleBlock):
            first = message.stream, message.first_sample
            assert first > last
            last = first[0], first[1] + len(message.counts) - 1
            # No sample is repeated or out of order.
            assert (np.diff(message.counts[:, 0]) > 0).all()


@target("wire")
def identity_payload(data: bytes) -> None:
    """Any bytes as an identity: it is read, refused or too short; an identity survives encoding."""
    try:
        identity = read_identity(data)
    except (struct.error, SetupError):
        return
    for text in texts(identity):
        assert len(text) <= 32
        assert all(letter.isprintable() or letter.isspace() for letter in text)
        assert len(text.splitlines()) <= 1
    repeated = read_identity(pack_identity(identity))
    assert repr(repeated) == repr(identity)


def texts(message: object) -> list[str]:
    """All texts of a message."""
    if isinstance(message, Identity):
        names = [channel.name for channel in message.channels]
        return [message.serial_number, message.model, message.firmware, *names]
    return [getattr(message, "text", "")]


def peak_memory(function: Target, data: bytes) -> int:
    """Return the peak memory of a call, bytes."""
    tracemalloc.start()
    try:
        function(data)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
