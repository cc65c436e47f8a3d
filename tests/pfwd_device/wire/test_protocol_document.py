"""The document, a second encoder written from it, and the program say the same, byte for byte."""

import dataclasses
import datetime
import re
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire import messages
from pfwd_device.wire.binary import BinaryDialect, BinaryInstrumentEnd, encode_message
from pfwd_device.wire.fields import pack_int24
from pfwd_plugins.quantities import Measurand
from tests.pfwd_device.wire import by_hand

JANUARY = datetime.date(2026, 1, 31)
IDENTITY = Identity(
    serial_number="PFWD-0001",
    model="Example",
    firmware="1.4.2",
    sampling_rate=10_000.0,
    adc_bits=24,
    adc_range=2.5,
    plate_radius=0.15,
    plate_mass=10.6,
    channels=(
        ChannelIdentity(
            name="load",
            quantity=Measurand.LOAD,
            sensitivity=1e-4,
            zero=0.05,
            shunt=5000.0,
            calibrated=JANUARY,
            due=datetime.date(2027, 1, 31),
        ),
        ChannelIdentity(
            name="centre",
            quantity=Measurand.VELOCITY,
            sensitivity=-28.8,
            natural_frequency=4.5,
            damping=0.56,
            calibrated=JANUARY,
        ),
    ),
    ring_samples=20_000,
    drop_samples=4000,
    drop_slots=4,
    lasting=True,
    streams=True,
)
COUNTS = np.array([[0, -1], [1000, -70000], [8388607, -8388608]], np.int32)
NAME = 0x1234ABCD, 300
TRIGGER = messages.Trigger(True, 0, 2622, 3, 200, 1000, 15_000)
# What the document says in words about each of its examples.
STATED: dict[str, Any] = {
    "Hello": messages.Hello(2, 2),
    "Configure": messages.Configure(20_000.0),
    "Start": messages.Start(),
    "Stop": messages.Stop(),
    "Shunt": messages.Shunt(True),
    "Identity": IDENTITY,
    "Samples": messages.SampleBlock(0x1234ABCD, 300, 1_030_000, COUNTS),
    "Status": messages.Status(1_500_000, 12.5, -3.25, 7, True, 2, 1),
    "Event": messages.Event(messages.EventKind.TRIGGER, 1_600_000, "button"),
    "Refusal": messages.Refusal(messages.RefusalCode.ARGUMENT, "sampling rate up to 10000 Hz"),
    "Arm": messages.Arm(TRIGGER),
    "Fetch": messages.Fetch(*NAME, 7, 1),
    "Acknowledge": messages.Acknowledge(*NAME),
    "Resend": messages.Resend(*NAME, 50),
    "Calibrate": messages.Calibrate(
        1, -27.9, 0.001, 4.6, 0.58, None, 20_260_131, serial_number="PFWD-0002"
    ),
    "Armed": messages.Armed(TRIGGER),
    "Offer": messages.DropOffer(
        *NAME, 1_029_900, 1, 3, 2, 40, zlib.crc32(pack_int24(COUNTS)), 10_000.0
    ),
    "Block": messages.DropBlock(*NAME, 0, pack_int24(COUNTS)),
    "Released": messages.Released(*NAME),
    "Gone": messages.SamplesGone(*NAME, 50),
}


def test_the_document_shows_every_message() -> None:
    text = by_hand.DOCUMENT.read_text(encoding="utf-8")
    assert re.findall(r"^### Example: (\w+)$", text, re.MULTILINE) == list(STATED)
    assert set(by_hand.EXAMPLES) == set(STATED)


@pytest.mark.parametrize("name", STATED)
def test_both_encoders_and_the_decoder_agree_with_the_document(name: str) -> None:
    type_, counter, payload = by_hand.EXAMPLES[name]
    packet, frame = by_hand.documented(name)
    assert by_hand.packet(type_, counter, payload) == packet
    assert by_hand.frame(type_, counter, payload) == frame
    assert encode_message(STATED[name], counter) == frame
    end = BinaryInstrumentEnd() if type_ < 0x80 else BinaryDialect()
    (message,) = end.feed(frame)
    assert type(message) is type(STATED[name])
    np.testing.assert_equal(dataclasses.asdict(message), dataclasses.asdict(STATED[name]))
    assert end.counters.frames_good == 1


def test_the_check_value_of_the_crc() -> None:
    text = by_hand.DOCUMENT.read_text(encoding="utf-8")
    assert "0xCBF43926" in text
    assert by_hand.crc32(b"123456789") == zlib.crc32(b"123456789") == 0xCBF43926


def test_the_examples_of_cobs() -> None:
    text = by_hand.DOCUMENT.read_text(encoding="utf-8")
    pairs = re.findall(r"^((?:[0-9A-F]{2} ?)+?) +->  ((?:[0-9A-F]{2} ?)+)$", text, re.MULTILINE)
    assert len(pairs) == 2
    for plain, encoded in pairs:
        assert by_hand.cobs(bytes.fromhex(plain)) == bytes.fromhex(encoded)
    run = bytes(range(1, 255))
    assert by_hand.cobs(run) == b"\xff" + run
    assert by_hand.cobs(run + b"\xff") == b"\xff" + run + b"\x02\xff"


@given(payload=st.binary(max_size=600) | st.integers(0, 1100).map(lambda n: b"\x05" * n))
def test_frames_of_the_second_encoder_are_read(payload: bytes) -> None:
    # The type is none that is known: only the framing is looked at.
    end = BinaryDialect()
    frame = by_hand.frame(0xC0, 513, payload)
    end.feed(frame)
    assert (end.counters.frames_good, end.counters.frames_unknown) == (1, 1)
    assert by_hand.uncobs(frame[:-1]) == by_hand.packet(0xC0, 513, payload)


def test_a_further_code_behind_a_full_run_is_accepted() -> None:
    # The last 254 bytes: length, text, one byte that is to be ignored, CRC; none may be zero.
    payload = by_hand.u(5, 2) + by_hand.txt("x" * 248)
    packets = (by_hand.packet(0x85, 0, payload + bytes([filler])) for filler in range(1, 256))
    encoded = by_hand.cobs(next(packet for packet in packets if 0 not in packet[-254:]))
    assert encoded[-255] == 255
    for frame in (encoded + b"\0", encoded + b"\x01\0"):
        assert BinaryDialect().feed(frame) == [messages.Refusal(5, "x" * 248)]


def test_limits_are_as_documented() -> None:
    assert len(by_hand.frame(0x81, 0, b"\x01" * 8000)) == 8039 + 1
    assert len(by_hand.samples(0, 0, 0, [[0] * 8] * 256)) == 24 + 6144
    minimal = dataclasses.replace(
        IDENTITY,
        serial_number="",
        model="",
        firmware="",
        channels=(ChannelIdentity("", Measurand.LOAD),),
    )
    assert len(by_hand.uncobs(encode_message(minimal, 0)[:-1])) == 108 + 7
