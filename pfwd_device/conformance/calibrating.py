"""Tests of the calibration that an instrument stores: a new one, invalid ones, and its restoration.

The test values differ from the present ones in the last bit of each number, so that an interrupted
test leaves the instrument practically unchanged. Each test returns a short description of the
behaviour. It raises `Failed` if the requirement is not met, and `NotSupported` if the instrument
lacks the function.
"""

import math
from dataclasses import replace

from pfwd_device.conformance.instrument_link import Failed, InstrumentLink, NotSupported, require
from pfwd_device.conformance.stored_drops import DISARMED
from pfwd_device.conformance.storing import calibration_of, send_calibration
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

_INVALID_DAY = 20_260_231


def stores(link: InstrumentLink) -> str:
    """Test that a calibration can be stored and restored, and that invalid values are refused."""
    before, stored = _rest_and_calibration(link)
    changed = replace(
        stored,
        sensitivity=math.nextafter(stored.sensitivity, math.inf),
        zero=math.nextafter(stored.zero, math.inf),
    )
    channel = replace(before.channels[0], sensitivity=changed.sensitivity, zero=changed.zero)
    expected = replace(before, channels=(channel, *before.channels[1:]))
    try:
        response = send_calibration(link, changed)
        if isinstance(response, Refusal):
            raise Failed(f"expected an Identity, got Refusal ({response.code}): {response.text}")
        _require_equal(response, expected, "Calibrate")
        invalid_ones = (
            replace(changed, channel=len(before.channels)),
            replace(changed, sensitivity=0.0),
            replace(changed, sensitivity=math.nan),
            replace(changed, zero=math.inf),
            replace(changed, natural_frequency=4.5, damping=None),
            replace(changed, shunt=-1.0),
            replace(changed, calibrated=_INVALID_DAY),
            replace(changed, serial_number="line\nfeed"),
        )
        for invalid in invalid_ones:
            response = send_calibration(link, invalid)
            if not isinstance(response, Refusal) or response.code != RefusalCode.ARGUMENT:
                raise Failed(f"expected Refusal (argument) of {invalid}, got {link.latest_kinds()}")
        _require_equal(link.request(Hello(), Identity), expected, "refused calibrations")
    finally:
        send_calibration(link, stored)
        after = link.request(Hello(), Identity)
    _require_equal(after, before, "the restoration of the former calibration")
    return f"stored and restored, {len(invalid_ones)} invalid ones refused"


def not_while_busy(link: InstrumentLink) -> str:
    """Test that a calibration is refused while samples are sent and while the shunt is on.

    The refusal while a drop is recorded or stored is not tested, as it would need a drop.
    """
    before, stored = _rest_and_calibration(link)
    tried = []
    if before.streams:
        link.request(Start(), SampleBlock)
        _require_busy(link, stored, "samples are sent")
        link.request(Stop(), Status, lambda status: not status.sampling)
        tried.append("samples are sent")
    if any(channel.shunt is not None for channel in before.channels):
        link.request(Shunt(True), Event, lambda event: event.kind == EventKind.SHUNT_ON)
        try:
            _require_busy(link, stored, "the shunt is on")
        finally:
            link.request(Shunt(False), Event, lambda event: event.kind == EventKind.SHUNT_OFF)
        tried.append("the shunt is on")
    if not tried:
        raise NotSupported("the instrument streams no samples and has no shunt")
    return f"refused while {' and while '.join(tried)}"


def _rest_and_calibration(link: InstrumentLink) -> tuple[Identity, Calibrate]:
    """Stop and disarm the instrument; return its identity and the calibration of channel 0."""
    identity = link.request(Hello(), Identity)
    link.request(Stop(), Status, lambda status: not status.sampling)
    if identity.keeps_drops:
        link.request(Arm(DISARMED), Armed)
    stored = calibration_of(identity, 0)
    response = send_calibration(link, replace(stored, channel=255))
    if isinstance(response, Refusal) and response.code == RefusalCode.UNKNOWN:
        raise NotSupported(f"the instrument stores no calibration: {response.text}")
    return identity, stored


def _require_busy(link: InstrumentLink, stored: Calibrate, when: str) -> None:
    response = send_calibration(link, stored)  # the present values, so that nothing changes
    if not isinstance(response, Refusal) or response.code != RefusalCode.BUSY:
        actual = f"Refusal ({response.code})" if isinstance(response, Refusal) else "an Identity"
        link.send(Stop())
        raise Failed(f"expected Refusal (busy) of Calibrate while {when}, got {actual}")


def _require_equal(actual: Identity, expected: Identity, after: str) -> None:
    pairs = zip(actual.channels, expected.channels, strict=False)
    differ = next((f"{a} instead of {b}" for a, b in pairs if a != b), "a different Identity")
    require(actual == expected, f"expected the Identity as set after {after}, got {differ}")
