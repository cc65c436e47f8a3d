"""Tests of the drops that an instrument detects and stores itself.

`Arm` switches the detection on; the instrument announces a stored drop by an Offer, sends its
samples in blocks on `Fetch`, and deletes it on `Acknowledge`. Each test returns a short description
of the behaviour. It raises `Failed` if the requirement is not met, and `NotSupported` if the
instrument lacks the function.
"""

import time
import zlib
from collections.abc import Callable

import numpy as np

from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.conformance.instrument_link import (
    MAX_RESPONSE_TIME_S,
    Failed,
    InstrumentLink,
    NotSupported,
    require,
)
from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity
from pfwd_device.wire.fields import unpack_int24
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Armed,
    DropBlock,
    DropOffer,
    Fetch,
    Hello,
    Refusal,
    RefusalCode,
    Released,
    SampleBlock,
    Start,
    Status,
    Stop,
    Trigger,
)

THRESHOLD_N = 400.0
PRE_TRIGGER_S, POST_TRIGGER_S, HOLD_OFF_S = 0.02, 0.1, 1.5
DISARMED = Trigger(False, 0, 1, 1, 0, 1, 0)


def _storing_identity(link: InstrumentLink) -> Identity:
    identity = link.request(Hello(), Identity)
    if not identity.keeps_drops:
        raise NotSupported("the instrument stores no drops")
    return identity


def trigger_of(identity: Identity) -> Trigger:
    """Return settings of the drop detection of an instrument, for the test.

    The threshold is 400 N, or 1/50 of the converter's range for an instrument without a load cell.
    """
    rate = identity.sampling_rate
    highest = (1 << (identity.adc_bits - 1)) - 1
    try:
        channel = load_channel(identity)
        per_newton = abs(counts_per_unit(identity.channels[channel], identity))
        threshold = min(highest, max(1, round(THRESHOLD_N * per_newton)))
    except SetupError:
        channel, threshold = 0, highest // 50 + 1
    return Trigger(
        True,
        channel,
        threshold,
        max(2, round(3e-4 * rate)),
        round(PRE_TRIGGER_S * rate),
        round(POST_TRIGGER_S * rate),
        round(HOLD_OFF_S * rate),
    )


def waiting(link: InstrumentLink) -> str:
    """Test that a `Status` contains the number of stored drops."""
    link.request(Hello(), Identity)
    status = link.request(Stop(), Status)
    return f"{status.drops_waiting} drops stored"


def arms(link: InstrumentLink) -> str:
    """Test that `Arm` is answered by the settings in force, and invalid settings are refused."""
    identity = _storing_identity(link)
    requested = trigger_of(identity)
    in_force = link.request(Arm(requested), Armed).trigger
    require(
        in_force.on
        and (in_force.channel, in_force.threshold) == (requested.channel, requested.threshold),
        f"expected channel {requested.channel} and {requested.threshold} counts, got {in_force}",
    )
    samples = in_force.before, in_force.after
    require(
        sum(samples) <= identity.drop_samples,
        f"expected at most {identity.drop_samples} samples, got {samples[0]} + {samples[1]}",
    )
    for invalid in (
        Trigger(True, len(identity.channels), 100, 2, 10, 100, 0),
        Trigger(True, 0, 0, 2, 10, 100, 0),
        Trigger(True, 0, 100, 2, 10, 0, 0),
    ):
        link.send(Arm(invalid))
        refusal = link.wait_for(Refusal)
        if refusal is None or refusal.code != RefusalCode.ARGUMENT:
            raise Failed(f"expected Refusal (argument) of {invalid}, got {link.latest_kinds()}")
    link.request(Arm(DISARMED), Armed, lambda armed: not armed.trigger.on)
    return f"{samples[0]} samples before and {samples[1]} after the trigger"


def run_goes_on(link: InstrumentLink) -> str:
    """Test that `Start` and `Stop` do not begin a new stream while drop detection is on."""
    identity = _storing_identity(link)
    if not identity.streams:
        raise NotSupported("the instrument stores drops and sends no samples")
    link.request(Arm(trigger_of(identity)), Armed)
    first = link.request(Start(), SampleBlock)
    link.request(Stop(), Status, lambda status: not status.sampling)
    link.receive(0.3)
    second = link.request(Start(), SampleBlock)
    link.request(Stop(), Status)
    require(
        first.stream == second.stream and second.first_sample > first.first_sample,
        "expected the same stream to continue while armed, got another stream",
    )
    return "the stream continues"


class BufferedDropCheck:
    """Tests of one stored drop, which the operator makes during the first test (`offered`).

    Parameters
    ----------
    wait : float, s
        Longest wait for the drop.
    announce : callable
        Function that receives the request to the operator as a text.
    """

    def __init__(self, wait: float, announce: Callable[[str], None]) -> None:
        self._wait, self._announce = wait, announce
        self._armed: Trigger | None = None
        self._offer: DropOffer | None = None
        self._identity: Identity | None = None
        self._data: dict[int, bytes] = {}
        self._reason = "no drop fell"

    def offered(self, link: InstrumentLink) -> str:
        """Test that a drop is announced when it is complete, and again while it is stored."""
        identity = self._identity = _storing_identity(link)
        self._armed = link.request(Arm(trigger_of(identity)), Armed).trigger
        if identity.streams:
            link.request(Start(), SampleBlock)
        self._announce(f"let the weight fall once within {self._wait:g} s")
        began = time.monotonic()
        offer = link.wait_for(DropOffer, self._wait)
        if offer is None:
            self._reason = f"no drop fell within {self._wait:g} s"
            raise NotSupported(self._reason)
        self._offer = offer
        took = time.monotonic() - began
        link.request(Arm(DISARMED), Armed, lambda armed: not armed.trigger.on)
        repeated = link.wait_for(DropOffer, 2 * MAX_RESPONSE_TIME_S)
        if repeated is None:
            raise Failed("expected the Offer again while the drop is stored, got none")
        if identity.streams:
            link.request(Stop(), Status)
        return f"{offer.samples} samples after {took:.1f} s"

    def cut(self, link: InstrumentLink) -> str:
        """Test that the drop has the agreed numbers of samples before and after the trigger."""
        offer = self._need()
        armed = self._armed
        assert armed is not None
        expected = armed.before, armed.before + armed.after
        require(
            (offer.trigger, offer.samples) == expected,
            f"expected {expected[0]} samples before the trigger of {expected[1]}, got "
            f"{offer.trigger} of {offer.samples}",
        )
        counts = self._counts(link)[:, armed.channel].astype(float)
        rest = float(np.median(counts[: max(1, offer.trigger)]))
        at, before = abs(counts[offer.trigger] - rest), abs(counts[offer.trigger - 1] - rest)
        # The instrument's estimate of the load at rest differs from this one by the noise.
        require(
            at > 0.9 * armed.threshold and (offer.trigger < 2 or before < 1.1 * armed.threshold),
            f"expected the first sample beyond {armed.threshold} counts at the trigger, got "
            f"{before:g} before it and {at:g} at it",
        )
        return f"{offer.trigger} before, {offer.samples - offer.trigger} from the trigger on"

    def complete(self, link: InstrumentLink) -> str:
        """Test that the blocks of the drop have the announced numbers, lengths and CRC."""
        offer = self._need()
        counts = self._counts(link)
        return f"{offer.blocks} blocks, {len(counts)} samples"

    def repeated(self, link: InstrumentLink) -> str:
        """Test that some blocks of the drop can be fetched again with the same bytes."""
        offer = self._need()
        self._counts(link)
        first = offer.blocks // 3
        count = min(3, offer.blocks - first)
        received_blocks = self._fetch(link, first, count)
        for number in range(first, first + count):
            require(number in received_blocks, f"expected block {number} again, got none")
            require(
                received_blocks[number] == self._data[number],
                f"expected the same bytes in block {number} again, got different bytes",
            )
        return f"blocks {first} to {first + count - 1}"

    def unknown_drop(self, link: InstrumentLink) -> str:
        """Test that a request for an unknown drop or block is refused."""
        _storing_identity(link)
        cases = [Fetch(0xDEAD, 1 << 60)]
        if self._offer is not None:
            cases.append(Fetch(self._offer.stream, self._offer.first_sample, 65535, 1))
        for invalid in cases:
            link.send(invalid)
            refusal = link.wait_for(Refusal)
            if refusal is None or refusal.code != RefusalCode.ARGUMENT:
                raise Failed(f"expected Refusal (argument) of {invalid}, got {link.latest_kinds()}")
        return "refused"

    def stays_stored(self, link: InstrumentLink) -> str:
        """Test that the drop stays stored until it is acknowledged.

        It must be announced again after `Hello` and over a new link.
        """
        offer = self._need()
        self._counts(link)  # a fetched drop must not be deleted
        for event in ("Hello", "a new link"):
            if event != "Hello":
                link.open()
            since = len(link.received)
            link.request(Hello(), Identity)
            link.receive(MAX_RESPONSE_TIME_S)
            same = self._offers_since(link, since)
            require(bool(same), f"expected the same Offer after {event}, got none")
            require(
                same[0].crc == offer.crc,
                f"expected the same drop after {event}, got one with another CRC",
            )
        status = link.latest_status()
        require(
            status is not None and bool(status.drops_waiting),
            "expected a Status that counts the stored drop, got 0 stored drops",
        )
        return "after Hello and over a new link"

    def acknowledged(self, link: InstrumentLink) -> str:
        """Test that each `Acknowledge` is answered, and the drop is no longer announced."""
        offer = self._need()
        name = offer.stream, offer.first_sample
        for _ in range(2):
            link.request(
                Acknowledge(*name), Released, lambda each: (each.stream, each.first_sample) == name
            )
        link.receive(0.2)
        since = len(link.received)
        link.request(Hello(), Identity)
        link.receive(1.5)
        offers = self._offers_since(link, since)
        require(not offers, "expected no Offer of an acknowledged drop, got such an Offer")
        return "released"

    def _offers_since(self, link: InstrumentLink, since: int) -> list[DropOffer]:
        drop = self._need()
        messages = (each.message for each in link.received[since:])
        return [
            message
            for message in messages
            if isinstance(message, DropOffer)
            and (message.stream, message.first_sample) == (drop.stream, drop.first_sample)
        ]

    def _need(self) -> DropOffer:
        if self._offer is None:
            raise NotSupported(self._reason)
        return self._offer

    def _counts(self, link: InstrumentLink) -> np.ndarray:
        """Return the samples of the drop in counts, (n, channels); the first call fetches them."""
        offer = self._need()
        for _ in range(8):  # a link may damage some blocks each time
            missing = [number for number in range(offer.blocks) if number not in self._data]
            if not missing:
                break
            self._data |= self._fetch(link, missing[0], offer.blocks - missing[0])
        missing = [number for number in range(offer.blocks) if number not in self._data]
        require(
            not missing,
            f"expected blocks 0 to {offer.blocks - 1}, {len(missing)} of them were not received",
        )
        data = b"".join(self._data[number] for number in range(offer.blocks))
        require(zlib.crc32(data) == offer.crc, "expected the CRC of the Offer, got another CRC")
        return unpack_int24(data).reshape(offer.samples, offer.channels)

    def _fetch(self, link: InstrumentLink, first: int, count: int) -> dict[int, bytes]:
        offer = self._need()
        since = len(link.received)
        link.send(Fetch(offer.stream, offer.first_sample, first, count))
        quiet = 0
        while quiet < 4:  # until 0.4 s pass without a block
            before = len(link.received)
            new = [each.message for each in link.receive(0.1)]
            quiet = 0 if any(isinstance(each, DropBlock) for each in new) else quiet + 1
            if before - since > 100_000:
                break
        received_blocks: dict[int, bytes] = {}
        for each in link.received[since:]:
            block = each.message
            if not isinstance(block, DropBlock):
                continue
            remaining = offer.samples - block.number * offer.block_samples
            length = 3 * offer.channels * min(offer.block_samples, remaining)
            require(
                first <= block.number < first + count,
                f"expected blocks {first} to {first + count - 1}, got {block.number}",
            )
            require(
                len(block.data) == length,
                f"expected {length} bytes in block {block.number}, got {len(block.data)}",
            )
            received_blocks[block.number] = block.data
        return received_blocks
