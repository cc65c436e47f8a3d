"""Greeting, versions, commands, shunt, and what is done about nonsense."""

import random
from collections.abc import Callable

import numpy as np

from pfwd_device.conformance.talk import ANSWER_TIME, Failed, NotOffered, Talk, blocks, require
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

_UNKNOWN_TYPE = 0x7E
"""No message of any version so far."""
SHUNT_LIMIT = 10.0
"""s after which the shunt goes off by itself."""


def greeting(talk: Talk) -> str:
    """P-3."""
    identity = talk.answer(Hello(), Identity)
    return f"{identity.model} {identity.serial_number}, version {identity.protocol_version}"


def versions(talk: Talk) -> str:
    """P-4."""
    agreed = talk.answer(Hello(1, 255), Identity).protocol_version
    require(agreed >= 1, f"expected a version from 1 on, got {agreed}")
    talk.say(Hello(250, 255))
    refusal = talk.until(Refusal, which=lambda said: said.code == RefusalCode.VERSION)
    if refusal is None:
        raise Failed(f"expected Refusal (version) of Hello (250 to 255), got {talk.lately()}")
    lowest = talk.answer(Hello(1, 1), Identity).protocol_version
    require(lowest == 1, f"expected version 1 for a host that speaks 1 alone, got {lowest}")
    talk.answer(Hello(), Identity)
    return f"speaks up to {agreed}"


def same_identity(talk: Talk) -> str:
    """P-5."""
    for heard in talk.heard:
        message = heard.message
        if isinstance(message, Refusal) and message.code == RefusalCode.FAULT:
            raise Failed(f"Identity: {message.text}")
    first = talk.answer(Hello(), Identity)
    other = talk.answer(Hello(), Identity)
    require(first == other, "expected the same Identity twice, got two that differ")
    return f"{len(first.channels)} channels at {first.sampling_rate:g} Hz, {first.adc_bits} bits"


def configure(talk: Talk) -> str:
    """P-6."""
    identity = talk.answer(Hello(), Identity)
    talk.answer(Stop(), Status)
    wanted = identity.sampling_rate
    nearly = talk.answer(Configure(wanted * 1.0001), Identity).sampling_rate
    require(
        abs(nearly / wanted - 1) < 0.01,
        f"expected the nearest rate to {wanted * 1.0001:g} Hz, got {nearly:g} Hz",
    )
    again = talk.answer(Hello(), Identity).sampling_rate
    require(again == nearly, f"expected {nearly:g} Hz after it was set, got {again:g} Hz")
    lowest = talk.answer(Configure(1e-3), Identity).sampling_rate
    highest = talk.answer(Configure(50_000.0), Identity).sampling_rate
    back = talk.answer(Configure(wanted), Identity).sampling_rate
    require(back == wanted, f"expected {wanted:g} Hz again, got {back:g} Hz")
    require(lowest <= wanted <= highest, f"expected {lowest:g} <= {wanted:g} <= {highest:g} Hz")
    return f"{lowest:g} to {highest:g} Hz"


def wrong_rates(talk: Talk) -> str:
    """P-7."""
    talk.answer(Stop(), Status)
    for rate in (float("nan"), 0.0, -1000.0):
        talk.say(Configure(rate))
        said = talk.until(Refusal)
        if said is None or said.code != RefusalCode.ARGUMENT:
            came = talk.lately() if said is None else f"code {said.code}"
            raise Failed(f"expected Refusal (argument) of {rate:g} Hz, got {came}")
    return "refused"


def unknown(talk: Talk) -> str:
    """P-17."""
    talk.say_frame(_UNKNOWN_TYPE, b"what is this?")
    said = talk.until(Refusal)
    if said is None or said.code != RefusalCode.UNKNOWN:
        came = talk.lately() if said is None else f"code {said.code}"
        raise Failed(f"expected Refusal (unknown) of type 0x{_UNKNOWN_TYPE:02x}, got {came}")
    return "refused"


def damaged(talk: Talk) -> str:
    """P-18."""
    talk.answer(Stop(), Status)
    talk.listen(0.3)
    generator = random.Random(18)
    # A damaged Start, then noise, shorter and longer than any frame.
    frame = bytearray(encode_frame(START, 0, b"behind"))
    frame[len(frame) // 2] ^= 0x10
    for noise in (bytes(frame), generator.randbytes(300), b"\x55" * 10_000 + b"\0"):
        before = len(talk.heard)
        talk.say_bytes(b"\0" + noise + b"\0")
        talk.listen(0.4)
        said = [
            heard.message
            for heard in talk.heard[before:]
            if not isinstance(heard.message, Status | Event)
        ]
        others = [type(message).__name__ for message in said if _is_an_answer(message)]
        require(not others, f"expected no answer to damaged bytes, got {', '.join(others)}")
        talk.answer(Hello(), Identity)
    return "noise is passed over"


def _is_an_answer(message: object) -> bool:
    return isinstance(message, Identity | SampleBlock | Refusal)


def bytes_behind(talk: Talk) -> str:
    """P-19."""
    talk.say_frame(HELLO, HELLO_MAGIC + bytes([1, VERSION]) + b"said by a newer version")
    if talk.until(Identity) is None:
        raise Failed(f"expected an Identity for a longer Hello, got {talk.lately()}")
    return "ignored"


def shunt(talk: Talk) -> str:
    """P-20."""
    identity = _with_shunt(talk)
    for on, kind in ((True, EventKind.SHUNT_ON), (False, EventKind.SHUNT_OFF)):
        if identity.streams:
            talk.say(Start())
            talk.until(SampleBlock)
        talk.answer(Shunt(on), Event, lambda event, kind=kind: event.kind == kind)  # type: ignore[misc]
        if identity.streams:
            flagged = talk.until(SampleBlock, which=lambda block, on=on: block.shunt == on)  # type: ignore[misc]
            word = "with the flag of the shunt" if on else "without it"
            require(flagged is not None, f"expected samples {word}, got none")
    talk.answer(Stop(), Status)
    return "switches, and samples tell"


def shunt_by_itself(talk: Talk) -> str:
    """P-21."""
    _with_shunt(talk)
    talk.answer(Shunt(True), Event, lambda event: event.kind == EventKind.SHUNT_ON)
    off = talk.until(Event, SHUNT_LIMIT + 2, lambda event: event.kind == EventKind.SHUNT_OFF)
    if off is None:
        talk.say(Shunt(False))
        raise Failed(f"expected the shunt to go off after {SHUNT_LIMIT:g} s, got nothing")
    return "goes off"


def _with_shunt(talk: Talk) -> Identity:
    identity = talk.answer(Hello(), Identity)
    if all(channel.shunt is None for channel in identity.channels):
        raise NotOffered("no channel has a shunt")
    return identity


def any_order(talk: Talk) -> str:
    """P-22."""
    identity = talk.answer(Hello(), Identity)
    generator = random.Random(22)
    wrong = Trigger(True, 200, 0, 0, 0, 0, 0)
    right = Trigger(True, 0, (1 << (identity.adc_bits - 1)) - 1, 2, 10, 100, 1000)
    said: list[Callable[[], HostMessage]] = [
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
        talk.say(generator.choice(said)())
        if generator.random() < 0.1:
            talk.say_bytes(generator.randbytes(40))
        talk.listen(generator.choice([0.0, 0.0, 0.01, 0.05]))
    after = talk.answer(Hello(), Identity)
    talk.say(Shunt(False), Arm(Trigger(False, 0, 1, 1, 0, 1, 0)))
    stopped = talk.answer(Stop(), Status, lambda status: not status.sampling)
    require(
        after.serial_number == identity.serial_number and not stopped.sampling,
        "expected it to answer after 60 commands in any order, got another instrument",
    )
    talk.answer(Configure(identity.sampling_rate), Identity)
    return "60 commands in any order"


def new_link(talk: Talk) -> str:
    """P-23."""
    identity = talk.answer(Hello(), Identity)
    stream = None
    if identity.streams:
        block = talk.answer(Start(), SampleBlock)
        stream = block.stream
    talk.open()
    again = talk.answer(Hello(), Identity)
    require(
        again.serial_number == identity.serial_number,
        f"expected {identity.serial_number} again, got {again.serial_number}",
    )
    if stream is None:
        return "answers"
    heard = talk.listen(ANSWER_TIME)
    going_on = [block for block in blocks(heard) if block.stream == stream]
    silent = any(isinstance(each.message, Status) and not each.message.sampling for each in heard)
    require(
        bool(going_on) or silent,
        "expected the stream to go on or a Status that says that it does not, got neither",
    )
    talk.answer(Stop(), Status)
    return "goes on" if going_on else "has stopped, and says so"


def heartbeat(talk: Talk) -> str:
    """P-15."""
    identity = talk.answer(Hello(), Identity)
    longest = 0.0
    for sampling in (False, True) if identity.streams else (False,):
        talk.answer(Start() if sampling else Stop(), SampleBlock if sampling else Status)
        times = [heard.at for heard in talk.listen(2.5) if isinstance(heard.message, Status)]
        require(len(times) >= 4, f"expected a Status every 0.5 s, got {len(times)} within 2.5 s")
        longest = max(longest, float(np.diff(times).max()))
    talk.answer(Stop(), Status)
    require(longest <= 0.7, f"expected a Status every 0.5 s, got one after {longest:.2f} s")
    return f"every {longest:.2f} s at the latest"
