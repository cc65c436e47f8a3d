"""Drops that the instrument keeps: found, offered, fetched, acknowledged."""

import time
import zlib
from collections.abc import Callable

import numpy as np

from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.conformance.talk import ANSWER_TIME, Failed, NotOffered, Talk, blocks, require
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

THRESHOLD = 400.0
"""N."""
BEFORE, AFTER, HOLD_OFF = 0.02, 0.1, 1.5
"""s."""
OFF = Trigger(False, 0, 1, 1, 0, 1, 0)


def version_2(talk: Talk) -> Identity:
    """The identity of an instrument of version 2."""
    identity = talk.answer(Hello(), Identity)
    if identity.protocol_version < 2:
        raise NotOffered("it speaks version 1")
    return identity


def _keeping(talk: Talk) -> Identity:
    identity = version_2(talk)
    if not identity.keeps_drops:
        raise NotOffered("it keeps no drops")
    return identity


def trigger_of(identity: Identity) -> Trigger:
    """A trigger at 400 N, at a fiftieth of the range where there is no load cell."""
    rate = identity.sampling_rate
    highest = (1 << (identity.adc_bits - 1)) - 1
    try:
        channel = load_channel(identity)
        per_newton = abs(counts_per_unit(identity.channels[channel], identity))
        threshold = min(highest, max(1, round(THRESHOLD * per_newton)))
    except SetupError:
        channel, threshold = 0, highest // 50 + 1
    return Trigger(
        True,
        channel,
        threshold,
        max(2, round(3e-4 * rate)),
        round(BEFORE * rate),
        round(AFTER * rate),
        round(HOLD_OFF * rate),
    )


def waiting(talk: Talk) -> str:
    """P-24."""
    version_2(talk)
    status = talk.answer(Stop(), Status)
    require(
        status.drops_waiting is not None,
        "expected the drops that wait in a Status of version 2, got one of version 1",
    )
    return f"{status.drops_waiting} wait"


def arms(talk: Talk) -> str:
    """P-25."""
    identity = _keeping(talk)
    wanted = trigger_of(identity)
    set_ = talk.answer(Arm(wanted), Armed).trigger
    require(
        (set_.on, set_.channel, set_.threshold) == (True, wanted.channel, wanted.threshold),
        f"expected channel {wanted.channel} and {wanted.threshold} counts, got {set_}",
    )
    require(
        set_.before + set_.after <= identity.drop_samples,
        f"expected at most {identity.drop_samples} samples, got {set_.before} + {set_.after}",
    )
    for wrong in (
        Trigger(True, len(identity.channels), 100, 2, 10, 100, 0),
        Trigger(True, 0, 0, 2, 10, 100, 0),
        Trigger(True, 0, 100, 2, 10, 0, 0),
    ):
        talk.say(Arm(wrong))
        said = talk.until(Refusal)
        if said is None or said.code != RefusalCode.ARGUMENT:
            raise Failed(f"expected Refusal (argument) of {wrong}, got {talk.lately()}")
    talk.answer(Arm(OFF), Armed, lambda armed: not armed.trigger.on)
    return f"{set_.before} samples before and {set_.after} after the trigger"


def run_goes_on(talk: Talk) -> str:
    """P-26."""
    identity = _keeping(talk)
    if not identity.streams:
        raise NotOffered("it keeps drops and streams no samples")
    talk.answer(Arm(trigger_of(identity)), Armed)
    first = talk.answer(Start(), SampleBlock)
    talk.answer(Stop(), Status, lambda status: not status.sampling)
    talk.listen(0.3)
    other = talk.answer(Start(), SampleBlock)
    talk.answer(Stop(), Status)
    require(
        first.stream == other.stream and other.first_sample > first.first_sample,
        "expected the same run to go on while armed, got another",
    )
    return "goes on"


class BufferedDropCheck:
    """One drop that falls during the test, and what is tried with it.

    Parameters
    ----------
    wait : float, s
        How long to wait for one to fall.
    announce : callable
        Told that one should fall now.
    """

    def __init__(self, wait: float, announce: Callable[[str], None]) -> None:
        self._wait, self._announce = wait, announce
        self._armed: Trigger | None = None
        self._offer: DropOffer | None = None
        self._identity: Identity | None = None
        self._data: dict[int, bytes] = {}
        self._reason = "no drop fell"

    def offered(self, talk: Talk) -> str:
        """P-27."""
        identity = self._identity = _keeping(talk)
        self._armed = talk.answer(Arm(trigger_of(identity)), Armed).trigger
        if identity.streams:
            talk.answer(Start(), SampleBlock)
        self._announce(f"let the weight fall once within {self._wait:g} s")
        began = time.monotonic()
        offer = talk.until(DropOffer, self._wait)
        if offer is None:
            self._reason = f"no drop fell within {self._wait:g} s"
            raise NotOffered(self._reason)
        self._offer = offer
        took = time.monotonic() - began
        talk.answer(Arm(OFF), Armed, lambda armed: not armed.trigger.on)
        again = talk.until(DropOffer, 2 * ANSWER_TIME)
        if again is None:
            raise Failed("expected the Offer again while the drop waits, got none")
        if identity.streams:
            talk.answer(Stop(), Status)
        return f"{offer.samples} samples after {took:.1f} s"

    def cut(self, talk: Talk) -> str:
        """P-28."""
        offer = self._need()
        armed = self._armed
        assert armed is not None
        expected = armed.before, armed.before + armed.after
        require(
            (offer.trigger, offer.samples) == expected,
            f"expected {expected[0]} samples before the trigger of {expected[1]}, got "
            f"{offer.trigger} of {offer.samples}",
        )
        counts = self._counts(talk)[:, armed.channel].astype(float)
        rest = float(np.median(counts[: max(1, offer.trigger)]))
        at, before = abs(counts[offer.trigger] - rest), abs(counts[offer.trigger - 1] - rest)
        # Its own rest differs from this one by its noise.
        require(
            at > 0.9 * armed.threshold and (offer.trigger < 2 or before < 1.1 * armed.threshold),
            f"expected the first sample beyond {armed.threshold} counts at the trigger, got "
            f"{before:g} before it and {at:g} at it",
        )
        return f"{offer.trigger} before, {offer.samples - offer.trigger} from the trigger on"

    def whole(self, talk: Talk) -> str:
        """P-29."""
        offer = self._need()
        counts = self._counts(talk)
        return f"{offer.blocks} blocks, {len(counts)} samples"

    def again(self, talk: Talk) -> str:
        """P-30."""
        offer = self._need()
        self._counts(talk)
        first = offer.blocks // 3
        count = min(3, offer.blocks - first)
        found = self._fetch(talk, first, count)
        for number in range(first, first + count):
            require(number in found, f"expected block {number} again, got none")
            require(
                found[number] == self._data[number],
                f"expected the same bytes in block {number} again, got others",
            )
        return f"blocks {first} to {first + count - 1}"

    def nothing_there(self, talk: Talk) -> str:
        """P-31."""
        _keeping(talk)
        cases = [Fetch(0xDEAD, 1 << 60)]
        if self._offer is not None:
            cases.append(Fetch(self._offer.stream, self._offer.first_sample, 65535, 1))
        for wrong in cases:
            talk.say(wrong)
            said = talk.until(Refusal)
            if said is None or said.code != RefusalCode.ARGUMENT:
                raise Failed(f"expected Refusal (argument) of {wrong}, got {talk.lately()}")
        return "refused"

    def kept(self, talk: Talk) -> str:
        """P-32."""
        offer = self._need()
        self._counts(talk)  # to have sent it is no reason to forget it
        for what in ("Hello", "a new link"):
            if what != "Hello":
                talk.open()
            since = len(talk.heard)
            talk.answer(Hello(), Identity)
            talk.listen(ANSWER_TIME)
            offers = [each.message for each in talk.heard[since:]]
            same = [
                other for other in offers if isinstance(other, DropOffer) and self._is_it(other)
            ]
            require(bool(same), f"expected the same Offer after {what}, got none")
            require(same[0].crc == offer.crc, f"expected the same drop after {what}, got another")
        status = talk.status()
        require(
            status is not None and bool(status.drops_waiting),
            "expected a Status that counts the drop that waits, got 0",
        )
        return "over Hello and a new link"

    def acknowledged(self, talk: Talk) -> str:
        """P-33."""
        offer = self._need()
        for _ in range(2):
            talk.answer(
                Acknowledge(offer.stream, offer.first_sample),
                Released,
                lambda said: (said.stream, said.first_sample) == (offer.stream, offer.first_sample),
            )
        talk.listen(0.2)
        since = len(talk.heard)
        talk.answer(Hello(), Identity)
        talk.listen(1.5)
        later = [each.message for each in talk.heard[since:]]
        offers = [said for said in later if isinstance(said, DropOffer) and self._is_it(said)]
        require(not offers, "expected no Offer of a drop that was acknowledged, got one")
        return "let go of"

    def _is_it(self, offer: DropOffer) -> bool:
        mine = self._need()
        return (offer.stream, offer.first_sample) == (mine.stream, mine.first_sample)

    def _need(self) -> DropOffer:
        if self._offer is None:
            raise NotOffered(self._reason)
        return self._offer

    def _counts(self, talk: Talk) -> np.ndarray:
        """The whole drop; fetched when it is needed first."""
        offer = self._need()
        for _ in range(8):  # a link may damage some blocks each time
            missing = [number for number in range(offer.blocks) if number not in self._data]
            if not missing:
                break
            self._data |= self._fetch(talk, missing[0], offer.blocks - missing[0])
        missing = [number for number in range(offer.blocks) if number not in self._data]
        require(
            not missing, f"expected blocks 0 to {offer.blocks - 1}, {len(missing)} did not come"
        )
        data = b"".join(self._data[number] for number in range(offer.blocks))
        require(zlib.crc32(data) == offer.crc, "expected the CRC of the Offer, got another")
        return unpack_int24(data).reshape(offer.samples, offer.channels)

    def _fetch(self, talk: Talk, first: int, count: int) -> dict[int, bytes]:
        offer = self._need()
        since = len(talk.heard)
        talk.say(Fetch(offer.stream, offer.first_sample, first, count))
        quiet = 0
        while quiet < 4:  # 0.4 s without a block
            before = len(talk.heard)
            new = [each.message for each in talk.listen(0.1)]
            quiet = 0 if any(isinstance(each, DropBlock) for each in new) else quiet + 1
            if before - since > 100_000:
                break
        found: dict[int, bytes] = {}
        for each in talk.heard[since:]:
            block = each.message
            if not isinstance(block, DropBlock):
                continue
            left = offer.samples - block.number * offer.block_samples
            length = 3 * offer.channels * min(offer.block_samples, left)
            require(
                first <= block.number < first + count,
                f"expected blocks {first} to {first + count - 1}, got {block.number}",
            )
            require(
                len(block.data) == length,
                f"expected {length} bytes in block {block.number}, got {len(block.data)}",
            )
            found[block.number] = block.data
        return found


def spoken_to_in_version_1(talk: Talk) -> str:
    """P-37."""
    version_2(talk)
    old = talk.answer(Hello(1, 1), Identity, lambda said: said.protocol_version == 1)
    since = len(talk.heard)
    talk.say(Arm(OFF))
    said = talk.until(Refusal)
    heard = talk.listen(1.0)
    talk.answer(Hello(), Identity)
    require(
        said is not None and said.code == RefusalCode.UNKNOWN,
        "expected Refusal (unknown) of Arm in version 1, got something else",
    )
    newer = [
        type(each.message).__name__
        for each in talk.heard[since : since + len(heard)]
        if isinstance(each.message, DropOffer | Armed)
        or (isinstance(each.message, Status) and each.message.drops_waiting is not None)
    ]
    require(not newer, f"expected nothing of version 2, got {', '.join(dict.fromkeys(newer))}")
    require(not blocks(heard) or old.streams, "expected no samples, got some")
    return "nothing of version 2"
