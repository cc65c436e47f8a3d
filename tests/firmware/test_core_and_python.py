"""The core and Python agree on random messages in both directions."""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity
from pfwd_device.wire.binary import BinaryDialect, encode_message
from pfwd_device.wire.fields import day
from pfwd_device.wire.framing import encode_frame
from pfwd_device.wire.messages import (
    DISARMED,
    Acknowledge,
    Arm,
    Calibrate,
    Configure,
    DropOffer,
    Fetch,
    Hello,
    HostMessage,
    Refusal,
    RefusalCode,
    Resend,
    SampleBlock,
    SamplesGone,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)
from simulators.instrument.memory import StoredCalibration
from tests.firmware.compiled import needs_compiler
from tests.firmware.stepping import Steps, build_steps
from tests.simulators.instrument_wire import of_kind

pytestmark = needs_compiler
U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
STORED_BYTES = 96
"""Bytes of a packet that the core stores, more than any message of the host has."""


@pytest.fixture(scope="module")
def program() -> tuple[str, bool]:
    return build_steps()


@pytest.fixture(scope="module")
def steps(program: tuple[str, bool]) -> Iterator[Steps]:
    with Steps(program[0]) as running:
        yield running


def test_it_runs_under_sanitizers(program: tuple[str, bool]) -> None:
    if not program[1]:
        pytest.skip("the compiler here has no address and undefined-behaviour sanitizers")


@SHARED
@given(
    type_=st.integers(0, 255),
    counter=U16,
    payload=st.binary(max_size=1024) | st.integers(0, 1024).map(lambda n: b"\x07" * n),
)
@example(type_=1, counter=1, payload=b"\x07" * 247)
@example(type_=0, counter=0, payload=b"")
def test_both_encoders_make_the_same_frame(
    steps: Steps, type_: int, counter: int, payload: bytes
) -> None:
    output = steps.step("E", struct.pack("<BH", type_, counter) + payload)
    assert output == encode_frame(type_, counter, payload)


@SHARED
@given(
    frames=st.lists(
        st.tuples(st.integers(0, 255), U16, st.binary(max_size=400), st.binary(max_size=9)),
        max_size=5,
    )
)
def test_the_core_reads_the_frames_of_python_and_ignores_noise(
    steps: Steps, frames: list[tuple[int, int, bytes, bytes]]
) -> None:
    data, expected = b"", b""
    for type_, counter, payload, noise in frames:
        data += encode_frame(type_, counter, payload) + noise.replace(b"\0", b"\1") + b"\0"
        packet = struct.pack("<BH", type_, counter) + payload
        packet += struct.pack("<I", zlib.crc32(packet))
        expected += struct.pack("<I", len(packet)) + packet[:STORED_BYTES]
    assert steps.step("D", data) == expected


@SHARED
@given(value=st.floats(width=64))
@example(value=10_000.0)
@example(value=5e-324)
@example(value=math.inf)
def test_rates_are_read_without_floating_point(steps: Steps, value: float) -> None:
    output = steps.step("N", struct.pack("<d", value))
    ok, milli = struct.unpack("<BQ", output[:9])
    if math.isfinite(value) and 1e-3 <= value < 2**32:
        assert ok
        assert abs(milli - value * 1000) <= max(1.0, value * 1e-8)
    elif not value > 0 or not value < 2**32:
        assert not ok


@SHARED
@given(value=st.integers(-(2**31), 2**31 - 1))
@example(value=0)
@example(value=-(2**31))
def test_numbers_are_written_without_floating_point(steps: Steps, value: int) -> None:
    output = steps.step("N", struct.pack("<Q", value & 0xFFFFFFFF))
    assert struct.unpack("<d", output[9:17])[0] == float(value & 0xFFFFFFFF)
    (single,) = struct.unpack("<f", output[17:21])
    assert single == pytest.approx(value / 1000, rel=2**-23, abs=0)


TRIGGERS = st.builds(
    Trigger,
    st.booleans(),
    st.integers(0, 3),
    st.sampled_from([0, 1, 400, 2000, 2**32 - 1]),
    st.sampled_from([0, 1, 3, 65535]),
    st.sampled_from([0, 20, 600, 2**32 - 1]),
    st.sampled_from([0, 1, 300, 600, 2**32 - 1]),
    st.sampled_from([0, 100, 2**32 - 1]),
)
POSITIVE = st.floats(0, exclude_min=True, allow_infinity=False)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
ANY_NUMBER = st.none() | st.floats() | st.sampled_from([0.0, -0.0, 5e-324, math.inf])
ANY_DAY = (
    st.sampled_from([0, 20240229, 20230229, 19000229, 20000229, 20261301, 20260431, 101, 10101])
    | st.dates().map(day)
    | U32
)
SOUND = st.builds(
    Calibrate,
    st.integers(0, 1),
    FINITE.filter(bool),
    FINITE,
    st.none() | POSITIVE,
    st.none(),
    st.none() | POSITIVE,
    st.dates().map(day),
    st.dates().map(day) | st.just(0),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=32),
).map(lambda c: replace(c, damping=c.natural_frequency))
CALIBRATIONS = SOUND | st.builds(
    Calibrate,
    st.integers(0, 3),
    st.floats(),
    st.floats(),
    ANY_NUMBER,
    ANY_NUMBER,
    ANY_NUMBER,
    ANY_DAY,
    ANY_DAY,
    st.text(max_size=40),
)
MESSAGES: st.SearchStrategy[HostMessage] = st.one_of(
    st.builds(Hello, st.integers(0, 3), st.integers(0, 3)),
    st.builds(Configure, st.sampled_from([1e3, 1e4, 5e4, 0.0, math.nan, 1e9])),
    st.builds(Start),
    st.builds(Stop),
    st.builds(Shunt, st.booleans()),
    st.builds(Arm, TRIGGERS),
    st.builds(Fetch, U32, U64, U16, U16),
    st.builds(Acknowledge, U32, U64),
    st.builds(Resend, U32, U64, U32),
    CALIBRATIONS,
)


@settings(SHARED, max_examples=60)
@given(
    script=st.lists(
        MESSAGES
        | st.sampled_from(["L", "P", "R"])
        | st.integers(1, 3_000_000)
        | st.binary(max_size=40),
        max_size=25,
    )
)
def test_the_core_responds_to_any_input_in_complete_frames(
    program: tuple[str, bool], script: list[HostMessage | str | int | bytes]
) -> None:
    dialect = BinaryDialect()
    with Steps(program[0]) as steps:
        output = steps.step("B", encode_message(Hello(), 0))
        for number, part in enumerate(script):
            if isinstance(part, str):
                dialect.reset()  # the link is lost
                dialect.feed(output)
                output = steps.step(part)
            elif isinstance(part, int):
                output += steps.step("T", struct.pack("<I", part))
            elif isinstance(part, bytes):
                output += steps.step("B", b"\0" + part + b"\0")
            else:
                output += steps.step("B", encode_message(part, number))
        output += steps.step("B", b"\0" + encode_message(Hello(), 0)) + steps.advance(0.005)
    messages = dialect.feed(output)
    assert any(isinstance(message, Identity) for message in messages)
    assert dialect.counters.frames_damaged == 0
    assert dialect.counters.frames_unknown == 0


@pytest.mark.parametrize("ended_by", [[Configure(1e3)], [Arm(DISARMED), Start()]])
def test_a_drop_whose_recording_is_stopped_counts_as_lost(
    program: tuple[str, bool], ended_by: list[HostMessage]
) -> None:
    trigger = Trigger(True, 0, 5000, 3, 100, 400, 100)
    dialect = BinaryDialect()
    with Steps(program[0]) as steps:
        output = steps.step("B", encode_message(Hello(), 0) + encode_message(Arm(trigger), 1))
        output += steps.advance(0.11)  # the drop falls after 0.1 s and is recorded for 0.04 s
        for number, message in enumerate(ended_by, start=2):
            output += steps.step("B", encode_message(message, number))
        messages = dialect.feed(output + steps.advance(0.5))
    statuses = of_kind(messages, Status)
    assert (statuses[-1].drops_waiting, statuses[-1].drops_lost) == (0, 1)
    assert not of_kind(messages, DropOffer)


def test_the_ring_sends_its_samples_again_and_reports_missing_ones(
    program: tuple[str, bool],
) -> None:
    dialect = BinaryDialect()
    with Steps(program[0]) as steps:
        output = steps.step("B", encode_message(Hello(), 0)) + steps.step(
            "B", encode_message(Start(), 1)
        )
        output += steps.advance(0.5)
        streamed = of_kind(dialect.feed(output), SampleBlock)
        newest = streamed[-1].first_sample + len(streamed[-1].counts)
        request = Resend(streamed[0].stream, 0, newest)
        response = dialect.feed(steps.step("B", encode_message(request, 2)) + steps.advance(0.01))
    (missing,) = of_kind(response, SamplesGone)
    resent = [b for b in of_kind(response, SampleBlock) if b.first_sample < newest]
    assert (missing.first_sample, missing.count) == (0, resent[0].first_sample)
    for block in resent:
        index = range(block.first_sample, block.first_sample + len(block.counts))
        assert block.counts[:, 1].tolist() == [at & 0x1FFFF for at in index]


def response_to(steps: Steps, message: HostMessage) -> Identity | Refusal:
    messages = BinaryDialect().feed(steps.step("B", b"\0" + encode_message(message, 0)))
    (response,) = [each for each in messages if isinstance(each, Identity | Refusal)]
    return response


def reset(steps: Steps) -> Identity:
    steps.step("R")
    identity = response_to(steps, Hello())
    assert isinstance(identity, Identity)
    return identity


@settings(SHARED, max_examples=50)
@given(calibrations=st.lists(CALIBRATIONS, min_size=1, max_size=6))
def test_the_core_accepts_the_calibrations_that_python_accepts(
    program: tuple[str, bool], calibrations: list[Calibrate]
) -> None:
    # The identity of the host decides, which is independent of the core.
    stored = StoredCalibration()
    with Steps(program[0]) as steps:
        compiled = reset(steps)
        for calibration in calibrations:
            response = response_to(steps, calibration)
            try:
                stored = stored.with_channel(calibration, compiled)
            except SetupError:
                assert isinstance(response, Refusal), (response, calibration)
                assert response.code == RefusalCode.ARGUMENT
            else:
                assert response == stored.applied(compiled)
        assert reset(steps) == stored.applied(compiled)


def test_a_calibration_is_stored_completely_or_not_at_all(program: tuple[str, bool]) -> None:
    first = Calibrate(0, 3e-4, 0.1, None, None, 5000.0, 20260101, 20270101, "A-1")
    second = Calibrate(1, -27.0, 0.2, 4.6, 0.58, None, 20260202, 20270202, "B-2")
    with Steps(program[0]) as steps:
        reset(steps)
        before = response_to(steps, first)
        assert isinstance(before, Identity)
        for size in range(448):  # the power fails after these bytes of the page
            steps.step("F", struct.pack("<H", size))
            refused = response_to(steps, second)
            assert refused == Refusal(RefusalCode.FAULT, "the store did not take it")
            assert response_to(steps, Hello()) == before
            steps.step("F", struct.pack("<H", 65535))
            assert reset(steps) == before, size
        after = response_to(steps, second)
        assert isinstance(after, Identity)
        assert (after.serial_number, after.channels[1].sensitivity) == ("B-2", -27.0)
        assert after.channels[0] == before.channels[0]
        assert reset(steps) == after


def test_no_calibration_is_stored_while_a_drop_is_recorded_or_stored(
    program: tuple[str, bool],
) -> None:
    calibration = Calibrate(0, 3e-4, 0.1)
    with Steps(program[0]) as steps:
        reset(steps)
        steps.step("B", encode_message(Arm(Trigger(True, 0, 5000, 3, 100, 400, 100)), 1))
        codes = []
        for _ in range(30):  # a drop falls after 0.1 s
            response = response_to(steps, calibration)
            codes.append(response.code if isinstance(response, Refusal) else 0)
            steps.advance(0.005)
    begins = codes.index(RefusalCode.BUSY)
    assert 18 <= begins <= 21
    assert codes == [0] * begins + [RefusalCode.BUSY] * (30 - begins)
