"""Tests of greeting, versions, commands, shunt, and invalid input."""

import random
from collections.abc import Callable

import numpy as np

from pfwd_device.conformance.instrument_link import (
    MAX_RESPONSE_TIME_S,
    Failed,
    InstrumentLink,
    NotSupported,
    blocks,
    require,
)
from pfwd_device.identity import Identity
from pfwd_device.wire.binary import HELLO, HELLO_MAGIC, START, VERSION
from pfwd_device.wire.framing import encode_frame
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Configure,
    Event,
    EventKind,
    Fetch,
    Hello,
    HostMessage,
    Refusal,
    RefusalCode,
    Resend,
    SampleBlock,
    Shunt,
    Start,
    Status,
    Stop,
    Trigger,
)

_UNUSED_TYPE = 0x7E
"""Type of frame without a message in any version."""
MAX_SHUNT_TIME_S = 10.0
"""Time after which the shunt must switch off by itself, s."""


def greeting(link: InstrumentLink) -> str:
    """Test requirement P-3."""
    identity = link.request(Hello(), Identity)
    return f"{identity.model} {identity.serial_number}, version {identity.protocol_version}"


def versions(link: InstrumentLink) -> str:
    """Test requirement P-4."""
    agreed = link.request(Hello(1, 255), Identity).protocol_version
    require(agreed >= 1, f"expected a version from 1 on, got {agreed}")
    link.send(Hello(250, 255))
    refusal = link.wait_for(Refusal, accept=lambda refusal: refusal.code == RefusalCode.VERSION)
    if refusal is None:
        raise Failed(f"expected Refusal (version) of Hello (250 to 255), got {link.latest_kinds()}")
    lowest = link.request(Hello(1, 1), Identity).protocol_version
    require(lowest == 1, f"expected version 1 for a host that speaks 1 alone, got {lowest}")
    link.request(Hello(), Identity)
    return f"up to version {agreed}"


def same_identity(link: InstrumentLink) -> str:
    """Test requirement P-5."""
    for received in link.received:
        message = received.message
        if isinstance(message, Refusal) and message.code == RefusalCode.FAULT:
            raise Failed(f"Identity: {message.text}")
    first = link.request(Hello(), Identity)
    second = link.request(Hello(), Identity)
    require(first == second, "expected the same Identity twice, got two that differ")
    return f"{len(first.channels)} channels at {first.sampling_rate:g} Hz, {first.adc_bits} bits"


def configure(link: InstrumentLink) -> str:
    """Test requirement P-6."""
    identity = link.request(Hello(), Identity)
    link.request(Stop(), Status)
    present_rate = identity.sampling_rate
    nearly = link.request(Configure(present_rate * 1.0001), Identity).sampling_rate
    require(
        abs(nearly / present_rate - 1) < 0.01,
        f"expected the nearest rate to {present_rate * 1.0001:g} Hz, got {nearly:g} Hz",
    )
    repeated = link.request(Hello(), Identity).sampling_rate
    require(repeated == nearly, f"expected {nearly:g} Hz after it was set, got {repeated:g} Hz")
    lowest = link.request(Configure(1e-3), Identity).sampling_rate
    highest = link.request(Configure(50_000.0), Identity).sampling_rate
    back = link.request(Configure(present_rate), Identity).sampling_rate
    require(back == present_rate, f"expected {present_rate:g} Hz again, got {back:g} Hz")
    require(
        lowest <= present_rate <= highest,
        f"expected {lowest:g} <= {present_rate:g} <= {highest:g} Hz",
    )
    return f"{lowest:g} to {highest:g} Hz"


def wrong_rates(link: InstrumentLink) -> str:
    """Test requirement P-7."""
    link.request(Stop(), Status)
    for rate in (float("nan"), 0.0, -1000.0):
        link.send(Configure(rate))
        refusal = link.wait_for(Refusal)
        if refusal is None or refusal.code != RefusalCode.ARGUMENT:
            actual = link.latest_kinds() if refusal is None else f"code {refusal.code}"
            raise Failed(f"expected Refusal (argument) of {rate:g} Hz, got {actual}")
    return "refused"


def unknown(link: InstrumentLink) -> str:
    """Test requirement P-17."""
    link.send_frame(_UNUSED_TYPE, b"what is this?")
    refusal = link.wait_for(Refusal)
    if refusal is None or refusal.code != RefusalCode.UNKNOWN:
        actual = link.latest_kinds() if refusal is None else f"code {refusal.code}"
        raise Failed(f"expected Refusal (unknown) of type 0x{_UNUSED_TYPE:02x}, got {actual}")
    return "refused"


def damaged(link: InstrumentLink) -> str:
    """Test requirement P-18."""
    link.request(Stop(), Status)
    link.receive(0.3)
    generator = random.Random(18)
    # A damaged Start, then noise, shorter and longer than any frame.
    frame = bytearray(encode_frame(START, 0, b"behind"))
    frame[len(frame) // 2] ^= 0x10
    for noise in (bytes(frame), generator.randbytes(300), b"\x55" * 10_000 + b"\0"):
        before = len(link.received)
        link.send_bytes(b"\0" + noise + b"\0")
        link.receive(0.4)
        responses = [
            type(received.message).__name__
            for received in link.received[before:]
            if isinstance(received.message, Identity | SampleBlock | Refusal)
        ]
        require(not responses, f"expected no answer to damaged bytes, got {', '.join(responses)}")
        link.request(Hello(), Identity)
    return "noise is skipped"


def bytes_behind(link: InstrumentLink) -> str:
    """Test requirement P-19."""
    link.send_frame(HELLO, HELLO_MAGIC + bytes([1, VERSION]) + b"said by a newer version")
    if link.wait_for(Identity) is None:
        raise Failed(f"expected an Identity for a longer Hello, got {link.latest_kinds()}")
    return "ignored"


def shunt(link: InstrumentLink) -> str:
    """Test requirement P-20."""
    identity = _with_shunt(link)
    for on, kind in ((True, EventKind.SHUNT_ON), (False, EventKind.SHUNT_OFF)):
        if identity.streams:
            link.send(Start())
            link.wait_for(SampleBlock)
        link.request(Shunt(on), Event, lambda event, kind=kind: event.kind == kind)  # type: ignore[misc]
        if identity.streams:
            flagged = link.wait_for(SampleBlock, accept=lambda block, on=on: block.shunt == on)  # type: ignore[misc]
            word = "with the flag of the shunt" if on else "without it"
            require(flagged is not None, f"expected samples {word}, got none")
    link.request(Stop(), Status)
    return "switches, and samples carry its flag"


def shunt_by_itself(link: InstrumentLink) -> str:
    """Test requirement P-21."""
    _with_shunt(link)
    link.request(Shunt(True), Event, lambda event: event.kind == EventKind.SHUNT_ON)
    off = link.wait_for(
        Event, MAX_SHUNT_TIME_S + 2, lambda event: event.kind == EventKind.SHUNT_OFF
    )
    if off is None:
        link.send(Shunt(False))
        raise Failed(f"expected the shunt to go off after {MAX_SHUNT_TIME_S:g} s, got nothing")
    return "goes off"


def _with_shunt(link: InstrumentLink) -> Identity:
    identity = link.request(Hello(), Identity)
    if all(channel.shunt is None for channel in identity.channels):
        raise NotSupported("no channel has a shunt")
    return identity


def any_order(link: InstrumentLink) -> str:
    """Test requirement P-22."""
    identity = link.request(Hello(), Identity)
    generator = random.Random(22)
    wrong = Trigger(True, 200, 0, 0, 0, 0, 0)
    right = Trigger(True, 0, (1 << (identity.adc_bits - 1)) - 1, 2, 10, 100, 1000)
    commands: list[Callable[[], HostMessage]] = [
        Hello,
        lambda: Hello(9, 3),
        Start,
        Stop,
        lambda: Configure(generator.choice([identity.sampling_rate, float("nan"), 1e300])),
        lambda: Shunt(generator.random() < 0.3),
        lambda: Arm(generator.choice([wrong, right])),
        lambda: Fetch(generator.randrange(1 << 32), generator.randrange(1 << 64), 9, 9),
        lambda: Acknowledge(generator.randrange(1 << 32), generator.randrange(1 << 64)),
        lambda: Resend(generator.randrange(1 << 32), generator.randrange(1 << 64), 1),
    ]
    for _ in range(60):
        link.send(generator.choice(commands)())
        if generator.random() < 0.1:
            link.send_bytes(generator.randbytes(40))
        link.receive(generator.choice([0.0, 0.0, 0.01, 0.05]))
    after = link.request(Hello(), Identity)
    link.send(Shunt(False), Arm(Trigger(False, 0, 1, 1, 0, 1, 0)))
    stopped = link.request(Stop(), Status, lambda status: not status.sampling)
    require(
        after.serial_number == identity.serial_number and not stopped.sampling,
        "expected it to answer after 60 commands in any order, got another instrument",
    )
    link.request(Configure(identity.sampling_rate), Identity)
    return "60 commands in any order"


def new_link(link: InstrumentLink) -> str:
    """Test requirement P-23."""
    identity = link.request(Hello(), Identity)
    stream = None
    if identity.streams:
        block = link.request(Start(), SampleBlock)
        stream = block.stream
    link.open()
    repeated = link.request(Hello(), Identity)
    require(
        repeated.serial_number == identity.serial_number,
        f"expected {identity.serial_number} again, got {repeated.serial_number}",
    )
    if stream is None:
        return "answers"
    received = link.receive(MAX_RESPONSE_TIME_S)
    continued = [block for block in blocks(received) if block.stream == stream]
    messages = [each.message for each in received]
    silent = any(isinstance(each, Status) and not each.sampling for each in messages)
    require(
        bool(continued) or silent,
        "expected the stream to continue or a Status that it has stopped, got neither",
    )
    link.request(Stop(), Status)
    return "continues" if continued else "has stopped, and reports it"


def heartbeat(link: InstrumentLink) -> str:
    """Test requirement P-15."""
    identity = link.request(Hello(), Identity)
    longest = 0.0
    for sampling in (False, True) if identity.streams else (False,):
        link.request(Start() if sampling else Stop(), SampleBlock if sampling else Status)
        times = [each.at for each in link.receive(2.5) if isinstance(each.message, Status)]
        require(len(times) >= 4, f"expected a Status every 0.5 s, got {len(times)} within 2.5 s")
        longest = max(longest, float(np.diff(times).max()))
    link.request(Stop(), Status)
    require(longest <= 0.7, f"expected a Status every 0.5 s, got one after {longest:.2f} s")
    return f"every {longest:.2f} s at the latest"
