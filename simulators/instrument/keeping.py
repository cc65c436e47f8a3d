"""What an instrument of version 2 keeps: its last samples, and drops until they are safe."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfwd_device.wire.binary import MAX_SAMPLE_BYTES
from pfwd_device.wire.fields import pack_int24
from pfwd_device.wire.messages import (
    DropBlock,
    DropOffer,
    Fetch,
    Resend,
    SampleBlock,
    SamplesGone,
    Trigger,
)

BLOCK_BYTES = 240
"""Of counts in a block of a drop: a damaged byte costs little."""
_LEARNT_FROM = 64
"""Samples from which the load at rest is known."""
_FOLLOWS = 1024.0
"""The load at rest goes this part of the way to each sample."""
MAX_BOUNCE_PEAK_RATIO = 0.7
"""Peak of a bounce over that of the pulse before it: below this, by the protocol (Arm)."""
MAX_FLIGHT_TIME_S = 0.7
"""s; a bounce follows the pulse before it at most so much later, by the protocol (Arm)."""
PATIENT_OFFERS = 8
"""Offers of the oldest drop alone; later ones take turns, so that a drop that the host cannot
record does not block those behind it."""
DISARMED = Trigger(False, 0, 1, 1, 0, 1, 0)


class Ring:
    """The last samples of a run, with whether the shunt was on.

    Parameters
    ----------
    length : int
        Samples.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """A new run."""
        self._blocks.clear()

    def add(self, block: SampleBlock) -> None:
        """The samples that follow; what the instrument threw away lies before them."""
        self._blocks.append(block)
        end = block.first_sample + len(block.counts)
        while self._blocks and _end(self._blocks[0]) <= end - self._length:
            del self._blocks[0]

    def again(self, wanted: Resend) -> list[SampleBlock | SamplesGone]:
        """What is asked for, or that it is gone, in order."""
        found: list[SampleBlock | SamplesGone] = []
        position, end = wanted.first_sample, wanted.first_sample + wanted.count
        for block in self._blocks:
            low, high = max(position, block.first_sample), min(end, _end(block))
            if block.stream != wanted.stream or low >= high:
                continue
            if low > position:
                found.append(SamplesGone(wanted.stream, position, low - position))
            first = low - block.first_sample
            counts = block.counts[first : high - block.first_sample]
            found.append(replace(block, first_sample=low, counts=counts, clock_us=None))
            position = high
        if position < end:
            found.append(SamplesGone(wanted.stream, position, end - position))
        return found

    def part(self, first: int, end: int) -> NDArray[np.int32] | None:
        """Samples from `first` to before `end`; None when they are not all there."""
        parts, position = [], first
        for block in self._blocks:
            if block.first_sample <= position < _end(block):
                parts.append(block.counts[position - block.first_sample : end - block.first_sample])
                position = min(end, _end(block))
        return np.concatenate(parts) if position == end and parts else None


def _end(block: SampleBlock) -> int:
    return block.first_sample + len(block.counts)


@dataclass(frozen=True, eq=False, slots=True)
class Kept:
    """A drop that waits."""

    offer: DropOffer
    data: bytes

    def blocks(self, wanted: Fetch) -> list[DropBlock]:
        """The blocks that are asked for; none when there are none."""
        offer = self.offer
        size = 3 * offer.channels * offer.block_samples
        last = offer.blocks if wanted.blocks == 0 else wanted.first_block + wanted.blocks
        return [
            DropBlock(offer.stream, offer.first_sample, number, self.data[number * size :][:size])
            for number in range(wanted.first_block, min(last, offer.blocks))
        ]


class Keeper:
    """Finds drops and keeps them.

    Parameters
    ----------
    slots : int
        Drops that may wait; 0: it keeps none.
    shunt_counts : sequence of int
        What the shunt adds to each channel.
    """

    def __init__(self, slots: int, shunt_counts: NDArray[np.int32]) -> None:
        self.trigger = DISARMED
        self.waiting: list[Kept] = []
        self.lost = 0
        """Drops for which there was no room."""
        self._slots, self._shunt_counts = slots, shunt_counts
        self._offers = 0
        self.begin()

    @property
    def busy(self) -> bool:
        """Whether a drop begins, is in hand or waits."""
        return bool(self.waiting) or self._hand is not None or self._candidate is not None

    def begin(self) -> None:
        """A new run of the sampler."""
        self._rest: float | None = None
        self._early: list[float] = []
        self._candidate: int | None = None
        self._stayed = self._calm = 0
        self._released = True
        self._hand: int | None = None
        self._last: int | None = None
        self._pulse, self._peak = 0, 0.0
        """Trigger and peak of the last drop, or of the last bounce after it."""
        self._candidate_peak = 0.0

    def switched_off(self) -> None:
        """The power went: the drops stay, their clock is another one."""
        self.waiting = [
            replace(kept, offer=replace(kept.offer, earlier=True, clock_us=None))
            for kept in self.waiting
        ]
        self.lost = 0
        self.begin()

    def find(self, stream: int, first_sample: int) -> Kept | None:
        """The drop of a name."""
        name = stream, first_sample
        found = (kept for kept in self.waiting if _name(kept) == name)
        return next(found, None)

    def release(self, stream: int, first_sample: int) -> None:
        """It is acknowledged: the one that `find` gives, and no other of its name."""
        kept = self.find(stream, first_sample)
        if kept is not None:
            if kept is self.waiting[0]:
                self.offer_oldest()
            self.waiting = [other for other in self.waiting if other is not kept]

    def offer_oldest(self) -> None:
        """Begin the Offers with the oldest drop."""
        self._offers = 0

    def next_offer(self) -> DropOffer | None:
        """The Offer to send now; None: no drop waits."""
        if not self.waiting:
            return None
        turn = max(0, self._offers - PATIENT_OFFERS + 1)
        self._offers += 1
        # Only the oldest of a name can be fetched.
        fetchable = {_name(kept): kept for kept in reversed(self.waiting)}
        oldest_first = [kept for kept in self.waiting if fetchable[_name(kept)] is kept]
        return oldest_first[turn % len(oldest_first)].offer

    def take(self, block: SampleBlock, ring: Ring, rate: float) -> bool:
        """Look at samples that are in the ring already; whether a drop is whole with them."""
        set_ = self.trigger
        if self._slots and (set_.on or self._hand is not None):
            column = block.counts[:, set_.channel].astype(float)
            if block.shunt:
                column = column - self._shunt_counts[set_.channel]
            for at, value in enumerate(column.tolist()):
                self._look(value, block.first_sample + at, rate)
        if self._hand is None or _end(block) < self._hand + set_.after:
            return False
        return self._keep(block, ring, rate)

    def _keep(self, block: SampleBlock, ring: Ring, rate: float) -> bool:
        trigger, self._hand = self._hand, None
        assert trigger is not None
        self._last, self._released, self._calm = trigger, False, 0
        first, end = max(0, trigger - self.trigger.before), trigger + self.trigger.after
        counts = ring.part(first, end)
        if counts is None or len(self.waiting) >= self._slots:
            self.lost += 1
            return False
        data = pack_int24(counts)
        clock = None
        if block.clock_us is not None:
            clock = max(0, block.clock_us - round((block.first_sample - trigger) / rate * 1e6))
        channels = counts.shape[1]
        offer = DropOffer(
            block.stream,
            first,
            clock,
            trigger - first,
            len(counts),
            channels,
            BLOCK_BYTES // (3 * channels),
            zlib.crc32(data),
            rate,
            shunt=block.shunt,
        )
        self.waiting.append(Kept(offer, data))
        return True

    def _look(self, value: float, index: int, rate: float) -> None:
        if self._rest is None:
            self._early.append(value)
            if len(self._early) == _LEARNT_FROM:
                self._rest, self._early = sum(self._early) / _LEARNT_FROM, []
            return
        set_ = self.trigger
        away = abs(value - self._rest)
        if self._hand is not None:
            self._peak = max(self._peak, away)
            return
        if not set_.on:
            return
        if away <= set_.threshold / 2:
            if self._candidate is not None and self._stayed >= set_.confirm:  # a bounce, and over
                self._pulse, self._peak = self._candidate, self._candidate_peak
            self._candidate = None
            self._calm += 1
            self._released = self._released or self._calm >= set_.confirm
            self._rest += (value - self._rest) / _FOLLOWS
            return
        self._calm = 0
        if not self._released:
            return
        if self._candidate is None:
            if away <= set_.threshold:
                return
            self._candidate, self._candidate_peak, self._stayed = index, 0.0, 0
        self._candidate_peak = max(self._candidate_peak, away)
        self._stayed += 1
        if self._stayed >= set_.confirm and not self._bounces(self._candidate, rate):
            self._hand = self._pulse = self._candidate
            self._candidate, self._peak = None, self._candidate_peak

    def _bounces(self, candidate: int, rate: float) -> bool:
        """Return whether the pulse, by its time and its peak so far, is a bounce of the last
        drop."""
        return (
            self._last is not None
            and candidate - self._last < self.trigger.hold_off
            and candidate - self._pulse <= MAX_FLIGHT_TIME_S * rate
            and self._candidate_peak < MAX_BOUNCE_PEAK_RATIO * self._peak
        )


def _name(kept: Kept) -> tuple[int, int]:
    return kept.offer.stream, kept.offer.first_sample


def cut(block: SampleBlock, most: int) -> list[SampleBlock]:
    """A block in pieces of up to so many samples."""
    most = min(most, MAX_SAMPLE_BYTES // (3 * block.counts.shape[1]))
    return [
        replace(
            block,
            first_sample=block.first_sample + at,
            counts=block.counts[at : at + most],
            clock_us=block.clock_us if at == 0 else None,
        )
        for at in range(0, len(block.counts), most)
    ]
