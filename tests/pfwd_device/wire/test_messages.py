"""Messages: round trips at the extremes, what is refused, what a newer instrument may send."""

import dataclasses
import math
import string
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_device.errors import ProtocolError
from pfwd_device.identity import FASTEST_SAMPLING, ChannelIdentity, Identity
from pfwd_device.text import clean
from pfwd_device.wire import messages
from pfwd_device.wire.binary import BinaryDialect, BinaryInstrumentEnd, encode_message
from pfwd_device.wire.fields import pack_int24, unpack_int24
from pfwd_plugins.quantities import Measurand
from tests.pfwd_device.wire import by_hand
from tests.pfwd_device.wire.test_protocol_document import STATED

U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
LONG = st.text(max_size=60).map(lambda value: clean(value, 60))
NAME = st.text(string.printable + "äµ日本🦀", max_size=32).map(lambda value: clean(value, 32))
POSITIVE = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
DAYS = st.none() | st.dates()


def maybe(values: st.SearchStrategy[float]) -> st.SearchStrategy[float | None]:
    return st.none() | values


_CHANNEL = {
    "name": NAME, "quantity": st.sampled_from(Measurand), "offset": FINITE,
    "sensitivity": FINITE.filter(bool), "zero": FINITE, "shunt": maybe(POSITIVE),
    "calibrated": DAYS, "due": DAYS,
}  # fmt: skip
_RESPONSE = {"natural_frequency": POSITIVE, "damping": POSITIVE}
CHANNELS = st.builds(ChannelIdentity, **_CHANNEL)
CHANNELS |= st.builds(ChannelIdentity, **_CHANNEL, **_RESPONSE)
IDENTITIES = st.builds(
    Identity, NAME, NAME, NAME, st.floats(0, FASTEST_SAMPLING, exclude_min=True),
    st.integers(8, 24), POSITIVE, st.lists(CHANNELS, min_size=1, max_size=8).map(tuple),
    plate_radius=maybe(POSITIVE), plate_mass=maybe(st.floats(0, allow_infinity=False)),
    centre_sensor=st.sampled_from(["plate", "ground"]), real_time=st.booleans(),
)  # fmt: skip


SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)
TRIGGERS = st.builds(messages.Trigger, st.booleans(), st.integers(0, 255), U32, U16, U32, U32, U32)
FROM_INSTRUMENT = st.one_of(
    IDENTITIES,
    st.builds(messages.Event, U16, U64, LONG),
    st.builds(messages.Refusal, U16, LONG),
    st.builds(messages.Status, U64, maybe(SINGLE), maybe(SINGLE), U64, st.booleans(), U16, U32),
    st.builds(messages.Armed, TRIGGERS),
    st.builds(messages.Released, U32, U64),
    st.builds(messages.SamplesGone, U32, U64, U32),
)
BYTES = st.integers(0, 255)
NUMBER = st.floats(allow_nan=False)
CALIBRATIONS = st.builds(
    messages.Calibrate,
    BYTES,
    NUMBER,
    NUMBER,
    maybe(NUMBER),
    maybe(NUMBER),
    maybe(NUMBER),
    U32,
    U32,
    LONG,
)
FROM_HOST = st.one_of(
    st.builds(messages.Hello, BYTES, BYTES),
    st.builds(messages.Configure, st.floats(allow_nan=False)),
    st.builds(messages.Shunt, st.booleans()),
    st.sampled_from([messages.Start(), messages.Stop()]),
    st.builds(messages.Arm, TRIGGERS),
    st.builds(messages.Fetch, U32, U64, U16, U16),
    st.builds(messages.Acknowledge, U32, U64),
    st.builds(messages.Resend, U32, U64, U32),
    CALIBRATIONS,
)


@given(message=FROM_INSTRUMENT, counter=st.integers(0, 2**40))
def test_messages_of_the_instrument_arrive(message: messages.Message, counter: int) -> None:
    assert BinaryDialect().feed(encode_message(message, counter)) == [message]


@given(message=FROM_HOST)
def test_messages_of_the_host_arrive(message: Any) -> None:
    end, dialect = BinaryInstrumentEnd(), BinaryDialect()
    assert end.feed(dialect.encode(message) + dialect.encode(messages.Stop())) == [
        message,
        messages.Stop(),
    ]
    assert end.counters.frames_lost == 0


EDGES = [-(2**23), -(2**23) + 1, -65537, -65536, -257, -256, -255, -1, 0, 1, 255, 256, 2**23 - 1]


@given(
    st.integers(1, 8),
    st.lists(st.sampled_from(EDGES) | st.integers(-(2**23), 2**23 - 1), min_size=8, max_size=80),
    U32,
    st.integers(0, 2**62),
    st.none() | st.integers(0, 2**64 - 2),
    st.booleans(),
)
def test_samples_arrive(
    width: int, values: list[int], stream: int, first: int, clock: int | None, shunt: bool
) -> None:
    counts = np.array(values[: len(values) // width * width], np.int32).reshape(-1, width)
    block = messages.SampleBlock(stream, first, clock, counts, shunt)
    (received,) = BinaryDialect().feed(encode_message(block, 0))
    assert (received.stream, received.first_sample, received.clock_us) == (stream, first, clock)
    assert received.shunt is shunt
    assert received.counts.dtype == np.int32
    np.testing.assert_array_equal(received.counts, counts)


def test_int24_is_twos_complement() -> None:
    counts = np.array(EDGES, np.int32)
    data = b"".join(value.to_bytes(3, "little", signed=True) for value in EDGES)
    assert pack_int24(counts) == data
    np.testing.assert_array_equal(unpack_int24(data), counts)
    assert pack_int24(counts[::-2]) == pack_int24(counts[::-2].copy())  # not contiguous
    assert unpack_int24(b"").shape == (0,)


def test_consecutive_blocks_are_joined() -> None:
    block = STATED["Samples"]
    narrow = {"stream": 5, "shunt": True, "counts": block.counts[:, :1]}
    steps: list[dict[str, Any]] = [
        {},
        {"first_sample": 303},  # follows
        {"first_sample": 307},  # a gap of one
        {"first_sample": 310, "shunt": True},
        {"first_sample": 313, "shunt": True, "stream": 5},
        {"first_sample": 316, **narrow},
        {"first_sample": 318, **narrow},  # overlaps
    ]
    blocks = [dataclasses.replace(block, **step) for step in steps]
    data = b"".join(encode_message(block, at) for at, block in enumerate(blocks))
    received = BinaryDialect().feed(data)
    assert [len(block.counts) for block in received if isinstance(block, messages.SampleBlock)] == [
        6
    ] + [3] * 5
    assert received[0].clock_us == block.clock_us  # type: ignore[union-attr]
    data = b"".join(
        encode_message(message, 0)
        for message in (block, STATED["Status"], dataclasses.replace(block, first_sample=303))
    )
    kinds = [type(message) for message in BinaryDialect().feed(data)]
    assert kinds == [messages.SampleBlock, messages.Status, messages.SampleBlock]  # the order stays


def block_of(counts: Any, **fields: Any) -> messages.SampleBlock:
    return messages.SampleBlock(
        **{"stream": 1, "first_sample": 0, "clock_us": 0, "counts": counts, **fields}
    )


@pytest.mark.parametrize(
    ("message", "match"),
    [
        (block_of(np.zeros((2049, 1), np.int32)), "SampleBlock: expected at most 6144 bytes"),
        (block_of(np.zeros((0, 2), np.int32)), "SampleBlock: expected samples of 1 to 8 channels"),
        (block_of(np.zeros((1, 9), np.int32)), "samples of 1 to 8 channels, got 1x9"),
        (block_of(np.full((1, 1), 2**23, np.int32)), "24 bits, got 8388608 to 8388608"),
        (block_of(np.full((1, 1), -(2**23) - 1, np.int32)), "24 bits, got -8388609"),
        (block_of(np.zeros((1, 1), np.int32), stream=-1), "SampleBlock"),
        (messages.Status(0, 1e300, None, 0, False), "Status: float too large"),
        (messages.Status(-1, None, None, 0, False), "Status"),
        (messages.Event(70_000, 0), "Event"),
        (messages.Event(1, 0, "é" * 128), "Event: expected a text of at most 255 bytes, got 256"),
        (messages.Refusal(1, "\ud800"), "Refusal"),
        (messages.Hello(1, 256), "Hello"),
    ],
)
def test_a_message_that_does_not_fit_is_refused(message: messages.Message, match: str) -> None:
    with pytest.raises(ProtocolError, match=match):
        encode_message(message, 0)


@pytest.mark.parametrize("name", sorted(set(by_hand.EXAMPLES) - {"Block"}))  # as long as its counts
def test_bytes_of_a_newer_version_behind_the_fields_are_ignored(name: str) -> None:
    type_, counter, payload = by_hand.EXAMPLES[name]
    end = BinaryInstrumentEnd() if type_ < 0x80 else BinaryDialect()
    (message,) = end.feed(by_hand.frame(type_, counter, payload + b"\1\0\3 more"))
    if name == "Samples":
        np.testing.assert_array_equal(message.counts, by_hand.ROWS)
    else:
        assert message == STATED[name]


@pytest.mark.parametrize("name", sorted(set(by_hand.EXAMPLES) - {"Block"}))
def test_every_payload_that_is_too_short_is_damaged(name: str) -> None:
    type_, counter, payload = by_hand.EXAMPLES[name]
    for length in range(len(payload)):
        end = BinaryInstrumentEnd() if type_ < 0x80 else BinaryDialect()
        assert end.feed(by_hand.frame(type_, counter, payload[:length])) == []
        assert (end.counters.frames_good, end.counters.frames_damaged) == (0, 1)


def test_a_block_holds_complete_counts() -> None:
    _, counter, payload = by_hand.EXAMPLES["Block"]
    for length in range(len(payload)):
        messages = BinaryDialect().feed(by_hand.frame(0x88, counter, payload[:length]))
        assert len(messages) == (length > 14 and (length - 14) % 3 == 0)


@pytest.mark.parametrize(
    ("type_", "payload"),
    [
        (0x82, by_hand.samples(1, 0, 0, [[0] * 9])),
        (0x82, by_hand.samples(1, 0, 0, [[]])),
        (0x82, by_hand.samples(1, 2**63, 0, [[1]])),
        (0x82, by_hand.samples(1, 0, 0, [[1]])[:22] + b"\0\0"),
        (0x01, b"PFWE\1\1"),
        (0x87, by_hand.OFFER[:-8] + by_hand.f64(0.0)),
    ],
)
def test_nonsense_with_a_right_check_is_damaged(type_: int, payload: bytes) -> None:
    end = BinaryInstrumentEnd() if type_ < 0x80 else BinaryDialect()
    assert end.feed(by_hand.frame(type_, 0, payload)) == []
    assert end.counters.frames_damaged == 1


def test_unknown_types_are_counted_and_passed_over() -> None:
    dialect = BinaryDialect()
    refusal_frame = by_hand.frame(0x85, 2, by_hand.u(5, 2) + by_hand.txt("no"))
    data = by_hand.frame(0x90, 0, b"new") + by_hand.frame(0x01, 1, b"PFWD\1\1") + refusal_frame
    assert dialect.feed(data) == [messages.Refusal(5, "no")]
    assert (dialect.counters.frames_unknown, dialect.counters.frames_good) == (2, 3)


def test_unknown_flags_roles_and_seats_do_no_harm() -> None:
    payload = by_hand.IDENTITY
    seat = payload.index(by_hand.LOAD) - 2
    changed = bytearray(payload)
    changed[seat] = 7
    changed[seat + 2 + 5] = 99  # the role of the first channel
    (identity,) = BinaryDialect().feed(by_hand.frame(0x81, 0, bytes(changed)))
    assert identity.centre_sensor == "plate"
    assert [channel.quantity for channel in identity.channels] == ["voltage", "velocity"]
    (block,) = BinaryDialect().feed(by_hand.frame(0x82, 0, by_hand.samples(1, 0, 0, [[1]], 0xFE)))
    assert not block.shunt


def test_a_missing_clock_and_missing_readings_are_empty() -> None:
    (block,) = BinaryDialect().feed(by_hand.frame(0x82, 0, by_hand.samples(1, 0, 2**64 - 1, [[1]])))
    assert block.clock_us is None
    payload = by_hand.u(1, 8) + by_hand.f32(math.inf) + by_hand.f32(math.nan) + by_hand.u(0, 15)
    assert BinaryDialect().feed(by_hand.frame(0x83, 0, payload)) == [
        messages.Status(1, None, None, 0, False, 0, 0)
    ]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (by_hand.f64(10_000.0), by_hand.f64(math.nan), "identity of 'PFWD-0001': .*sampling_rate"),
        (by_hand.f64(0.56), by_hand.f64(math.nan), "channel 'centre': .*damping together"),
        (by_hand.u(20270131, 4), by_hand.u(20270230, 4), "channel 'load': due: .*got 20270230"),
        (by_hand.u(20270131, 4), by_hand.u(2**32 - 1, 4), "yyyymmdd or 0, got 4294967295"),
    ],
)
def test_an_impossible_identity_has_its_fault(old: bytes, new: bytes, match: str) -> None:
    assert by_hand.IDENTITY.count(old) == 1
    payload = by_hand.IDENTITY.replace(old, new)
    (refusal,) = BinaryDialect().feed(by_hand.frame(0x81, 0, payload))
    assert refusal.code == messages.RefusalCode.FAULT
    with pytest.raises(ValueError, match=match):
        raise ValueError(refusal.text)


def test_hostile_texts_come_out_harmless() -> None:
    hostile = "\x1b]0;owned\x07"
    event = by_hand.u(1, 2) + by_hand.u(0, 8) + by_hand.txt(hostile)
    identity = by_hand.IDENTITY.replace(by_hand.txt("PFWD-0001"), by_hand.txt(hostile))
    frames = by_hand.frame(0x84, 0, event) + by_hand.frame(0x81, 1, identity)
    event_received, identity_received = BinaryDialect().feed(frames)
    for text in (event_received.text, identity_received.serial_number):
        assert text.isprintable()
        assert "\N{REPLACEMENT CHARACTER}" in text


def test_the_host_ends_a_frame_of_noise() -> None:
    end = BinaryInstrumentEnd()
    assert end.feed(b"\x55\x66" + BinaryDialect().encode(messages.Start())) == [messages.Start()]
    assert end.counters.frames_damaged == 1
