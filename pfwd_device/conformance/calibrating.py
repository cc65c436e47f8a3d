"""The calibration that an instrument keeps: stored, refused, given back as it was found.

What is stored for a try differs from what was found by the last bit of each number, so that a try
that is cut off leaves no other instrument behind.
"""

import math
from dataclasses import replace

from pfwd_device.conformance.keeping import OFF, version_2
from pfwd_device.conformance.storing import answer, calibration_of
from pfwd_device.conformance.talk import Failed, NotOffered, Talk, require
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import (
    Arm,
    Armed,
    Calibrate,
    Event,
    EventKind,
    Hello,
    Refusal,
    RefusalCode,
    SampleBlock,
    Shunt,
    Start,
    Status,
    Stop,
)

_NO_DAY = 20_260_231


def stores(talk: Talk) -> str:
    """P-40."""
    before, found = _found(talk)
    other = replace(
        found,
        sensitivity=math.nextafter(found.sensitivity, math.inf),
        zero=math.nextafter(found.zero, math.inf),
    )
    channel = replace(before.channels[0], sensitivity=other.sensitivity, zero=other.zero)
    expected = replace(before, channels=(channel, *before.channels[1:]))
    try:
        said = answer(talk, other)
        if isinstance(said, Refusal):
            raise Failed(f"expected an Identity, got Refusal ({said.code}): {said.text}")
        _require_same(said, expected, "Calibrate")
        wrongs = (
            replace(other, channel=len(before.channels)),
            replace(other, sensitivity=0.0),
            replace(other, sensitivity=math.nan),
            replace(other, zero=math.inf),
            replace(other, natural_frequency=4.5, damping=None),
            replace(other, shunt=-1.0),
            replace(other, calibrated=_NO_DAY),
            replace(other, serial_number="line\nfeed"),
        )
        for wrong in wrongs:
            refused = answer(talk, wrong)
            if not isinstance(refused, Refusal) or refused.code != RefusalCode.ARGUMENT:
                raise Failed(f"expected Refusal (argument) of {wrong}, got {talk.lately()}")
        _require_same(talk.answer(Hello(), Identity), expected, "what was refused")
    finally:
        answer(talk, found)
        after = talk.answer(Hello(), Identity)
    _require_same(after, before, "giving back what was found")
    return f"stored and given back, {len(wrongs)} wrong ones refused"


def not_while_busy(talk: Talk) -> str:
    """P-41, as far as it shows without a drop."""
    before, found = _found(talk)
    tried = []
    if before.streams:
        talk.answer(Start(), SampleBlock)
        _require_busy(talk, found, "samples are sent")
        talk.answer(Stop(), Status, lambda status: not status.sampling)
        tried.append("samples are sent")
    if any(channel.shunt is not None for channel in before.channels):
        talk.answer(Shunt(True), Event, lambda event: event.kind == EventKind.SHUNT_ON)
        try:
            _require_busy(talk, found, "the shunt is on")
        finally:
            talk.answer(Shunt(False), Event, lambda event: event.kind == EventKind.SHUNT_OFF)
        tried.append("the shunt is on")
    if not tried:
        raise NotOffered("it streams no samples and has no shunt")
    return f"refused while {' and while '.join(tried)}"


def _found(talk: Talk) -> tuple[Identity, Calibrate]:
    """What it is, at rest, and what it says of its first channel."""
    identity = version_2(talk)
    talk.answer(Stop(), Status, lambda status: not status.sampling)
    if identity.keeps_drops:
        talk.answer(Arm(OFF), Armed)
    found = calibration_of(identity, 0)
    said = answer(talk, replace(found, channel=255))
    if isinstance(said, Refusal) and said.code == RefusalCode.UNKNOWN:
        raise NotOffered(f"it keeps no calibration: {said.text}")
    return identity, found


def _require_busy(talk: Talk, found: Calibrate, when: str) -> None:
    said = answer(talk, found)  # what it has already: nothing changes, refused or not
    if not isinstance(said, Refusal) or said.code != RefusalCode.BUSY:
        came = f"Refusal ({said.code})" if isinstance(said, Refusal) else "an Identity"
        talk.say(Stop())
        raise Failed(f"expected Refusal (busy) of Calibrate while {when}, got {came}")


def _require_same(came: Identity, expected: Identity, after: str) -> None:
    pairs = zip(came.channels, expected.channels, strict=False)
    differ = next((f"{one}, not {other}" for one, other in pairs if one != other), "others")
    require(came == expected, f"expected an Identity with it after {after}, got {differ}")
