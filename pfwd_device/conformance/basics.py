"""Tests of the dialogue with an instrument: identity, versions, commands, shunt, invalid input.

Each test returns a short description of the behaviour. It raises `Failed` if the requirement is not
met, and `NotSupported` if the instrument lacks the function.
"""

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
from pfwd_device.wire.binary import HELLO, HELLO_MAGIC, START
from pfwd_device.wire.framing import encode_frame
from pfwd_device.wire.identity_layout import VERSION
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
"""Number of a kind of message that no version of the protocol has."""
MAX_SHUNT_TIME_S = 10.0
"""Time after which the calibration shunt must switch off by itself, s."""


def greeting(link: InstrumentLink) -> str:
    """Test that a request (Hello) is answered by the identity of the instrument within 1 s."""
    identity = link.request(Hello(), Identity)
    return f"{identity.model} {identity.serial_number}, version {identity.protocol_version}"


def versions(link: InstrumentLink) -> str:
    """Test that a host that supports only other versions of the protocol is refused."""
    link.request(Hello(1, 255), Identity)
    for oldest, newest in ((1, VERSION - 1), (250, 255)):
        link.send(Hello(oldest, newest))
        refusal = link.wait_for(Refusal, accept=lambda refusal: refusal.code == RefusalCode.VERSION)
        if refusal is None:
            raise Failed(
                f"expected Refusal (version) of Hello with versions {oldest} to {newest}, got "
                f"{link.latest_kinds()}"
            )
    link.request(Hello(), Identity)
    return f"version {VERSION}"


def same_identity(link: InstrumentLink) -> str:
    """Test that the identity of the instrument is complete, valid and the same each time."""
    for received in link.received:
        message = received.message
        if isinstance(message, Refusal) and message.code == RefusalCode.FAULT:
            raise Failed(f"Identity: {message.text}")
    first = link.request(Hello(), Identity)
    second = link.request(Hello(), Identity)
    require(first == second, "expected the same Identity twice, got two different ones")
    return f"{len(first.channels)} channels at {first.sampling_rate:g} Hz, {first.adc_bits} bits"


def configure(link: InstrumentLink) -> str:
    """Test that the instrument sets the possible sampling rate nearest to the requested one."""
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
    """Test that a sampling rate of NaN, 0 or below is refused."""
    link.request(Stop(), Status)
    for rate in (float("nan"), 0.0, -1000.0):
        link.send(Configure(rate))
        refusal = link.wait_for(Refusal)
        if refusal is None or refusal.code != RefusalCode.ARGUMENT:
            actual = link.latest_kinds() if refusal is None else f"code {refusal.code}"
            raise Failed(f"expected Refusal (argument) of {rate:g} Hz, got {actual}")
    return "refused"


def unknown(link: InstrumentLink) -> str:
    """Test that a message of an unknown kind is refused."""
    link.send_frame(_UNUSED_TYPE, b"what is this?")
    refusal = link.wait_for(Refusal)
    if refusal is None or refusal.code != RefusalCode.UNKNOWN:
        actual = link.latest_kinds() if refusal is None else f"code {refusal.code}"
        raise Failed(f"expected Refusal (unknown) of type 0x{_UNUSED_TYPE:02x}, got {actual}")
    return "refused"


def damaged(link: InstrumentLink) -> str:
    """Test that damaged frames are not answered, and that the next undamaged one is."""
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
        require(not responses, f"expected no response to damaged bytes, got {', '.join(responses)}")
        link.request(Hello(), Identity)
    return "noise is skipped"


def bytes_behind(link: InstrumentLink) -> str:
    """Test that bytes after the known fields of a message are ignored.

    Newer versions of the protocol append fields.
    """
    link.send_frame(HELLO, HELLO_MAGIC + bytes([VERSION, VERSION]) + b"said by a newer version")
    if link.wait_for(Identity) is None:
        raise Failed(f"expected an Identity for a longer Hello, got {link.latest_kinds()}")
    return "ignored"


def shunt(link: InstrumentLink) -> str:
    """Test that the calibration shunt can be switched, and that samples report its state."""
    identity = _with_shunt(link)
    for on, kind in ((True, EventKind.SHUNT_ON), (False, EventKind.SHUNT_OFF)):
        if identity.streams:
            link.send(Start())
            link.wait_for(SampleBlock)
        link.request(Shunt(on), Event, lambda event, kind=kind: event.kind == kind)  # type: ignore[misc]
        if identity.streams:
            flagged = link.wait_for(SampleBlock, accept=lambda block, on=on: block.shunt == on)  # type: ignore[misc]
            word = "with the flag of the shunt" if on else "without the flag of the shunt"
            require(flagged is not None, f"expected samples {word}, got none")
    link.request(Stop(), Status)
    return "switches, and samples report its state"


def shunt_by_itself(link: InstrumentLink) -> str:
    """Test that the calibration shunt switches off by itself after 10 s."""
    _with_shunt(link)
    link.request(Shunt(True), Event, lambda event: event.kind == EventKind.SHUNT_ON)
    off = link.wait_for(
        Event, MAX_SHUNT_TIME_S + 2, lambda event: event.kind == EventKind.SHUNT_OFF
    )
    if off is None:
        link.send(Shunt(False))
        raise Failed(
            f"expected the shunt to switch off after {MAX_SHUNT_TIME_S:g} s, got no report of it"
        )
    return "switches off"


def _with_shunt(link: InstrumentLink) -> Identity:
    identity = link.request(Hello(), Identity)
    if all(channel.shunt is None for channel in identity.channels):
        raise NotSupported("no channel has a shunt")
    return identity


def any_order(link: InstrumentLink) -> str:
    """Test that the instrument still responds after 60 commands in random order."""
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
        "expected the same instrument to respond after 60 commands in any order, got a response of "
        "another instrument",
    )
    link.request(Configure(identity.sampling_rate), Identity)
    return "60 commands in any order"


def new_link(link: InstrumentLink) -> str:
    """Test that the instrument responds after the link was closed and opened again.

    Its stream must continue, or a `Status` must report that it does not.
    """
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
        return "responds"
    received = link.receive(MAX_RESPONSE_TIME_S)
    continued = [block for block in blocks(received) if block.stream == stream]
    messages = [each.message for each in received]
    silent = any(isinstance(each, Status) and not each.sampling for each in messages)
    require(
        bool(continued) or silent,
        "expected the stream to continue or a Status that it has stopped, got neither",
    )
    link.request(Stop(), Status)
    return "the stream continues" if continued else "a Status reports that the stream has stopped"


def heartbeat(link: InstrumentLink) -> str:
    """Test that a `Status` arrives at least every 0.5 s, with and without sampling."""
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
