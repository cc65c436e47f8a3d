"""Memory of an instrument of version 2: last samples, unacknowledged drops, calibration."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError
from pfwd_device.identity import LONGEST_NAME, ChannelIdentity, Identity
from pfwd_device.wire.binary import MAX_SAMPLE_BYTES
from pfwd_device.wire.fields import day_of, pack_int24
from pfwd_device.wire.messages import (
    Calibrate,
    DropBlock,
    DropOffer,
    Fetch,
    Resend,
    SampleBlock,
    SamplesGone,
    Trigger,
)

DROP_BLOCK_BYTES = 240
"""Bytes of counts in a block of a drop; small, so that a damaged byte costs little."""
_N_FIRST_REST_SAMPLES = 64
"""Number of samples whose mean is the first load at rest."""
_REST_AVERAGING_SAMPLES = 1024.0
"""Number of samples over which the load at rest is averaged."""
MAX_BOUNCE_PEAK_RATIO = 0.7
"""Upper limit of a bounce's peak over that of the pulse before, by the protocol (Arm)."""
MAX_FLIGHT_TIME_S = 0.7
"""Longest time between a pulse and its bounce, s, by the protocol (Arm)."""
OLDEST_FIRST_OFFERS = 8
"""Number of offers of the oldest drop only. After that all drops are offered in turn, so that a
drop that the host cannot record does not block the others."""
DISARMED = Trigger(False, 0, 1, 1, 0, 1, 0)


class Ring:
    """Last samples of a run, with the state of the shunt.

    Parameters
    ----------
    length : int
        Number of samples.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """Begin a new run."""
        self._blocks.clear()

    def add(self, block: SampleBlock) -> None:
        """Add the next samples; there may be a gap before them."""
        self._blocks.append(block)
        end = block.first_sample + len(block.counts)
        while self._blocks and _end(self._blocks[0]) <= end - self._length:
            del self._blocks[0]

    def find_samples(self, request: Resend) -> list[SampleBlock | SamplesGone]:
        """Return the requested samples, and the parts that are gone, in order."""
        parts: list[SampleBlock | SamplesGone] = []
        position, end = request.first_sample, request.first_sample + request.count
        for block in self._blocks:
            low, high = max(position, block.first_sample), min(end, _end(block))
            if block.stream != request.stream or low >= high:
                continue
            if low > position:
                parts.append(SamplesGone(request.stream, position, low - position))
            first = low - block.first_sample
            counts = block.counts[first : high - block.first_sample]
            parts.append(replace(block, first_sample=low, counts=counts, clock_us=None))
            position = high
        if position < end:
            parts.append(SamplesGone(request.stream, position, end - position))
        return parts

    def part(self, first: int, end: int) -> NDArray[np.int32] | None:
        """Return the samples from `first` to before `end`; None if some are missing."""
        parts, position = [], first
        for block in self._blocks:
            if block.first_sample <= position < _end(block):
                parts.append(block.counts[position - block.first_sample : end - block.first_sample])
                position = min(end, _end(block))
        return np.concatenate(parts) if position == end and parts else None


def _end(block: SampleBlock) -> int:
    return block.first_sample + len(block.counts)


@dataclass(frozen=True, eq=False, slots=True)
class WaitingDrop:
    """Drop that waits until the host acknowledges it."""

    offer: DropOffer
    data: bytes

    def blocks(self, request: Fetch) -> list[DropBlock]:
        """Return the requested blocks that exist."""
        offer = self.offer
        size = 3 * offer.channels * offer.block_samples
        last = offer.blocks if request.blocks == 0 else request.first_block + request.blocks
        return [
            DropBlock(offer.stream, offer.first_sample, number, self.data[number * size :][:size])
            for number in range(request.first_block, min(last, offer.blocks))
        ]


class DropBuffer:
    """Detector of drops with a buffer for drops that wait.

    Parameters
    ----------
    slots : int
        Largest number of waiting drops; 0: drops are not buffered.
    shunt_counts : sequence of int
        Counts that the shunt adds to each channel.
    """

    def __init__(self, slots: int, shunt_counts: NDArray[np.int32]) -> None:
        self.trigger = DISARMED
        self.waiting: list[WaitingDrop] = []
        self.lost = 0
        """Number of drops for which there was no room."""
        self._slots, self._shunt_counts = slots, shunt_counts
        self._offers = 0
        self.begin()

    @property
    def busy(self) -> bool:
        """True while a drop begins, is being recorded or waits."""
        return bool(self.waiting) or self._hand is not None or self._candidate is not None

    def begin(self) -> None:
        """Begin a new run of the sampler."""
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
        """Lose the power: the drops stay, and their clock is no longer valid."""
        self.waiting = [
            replace(drop, offer=replace(drop.offer, earlier=True, clock_us=None))
            for drop in self.waiting
        ]
        self.lost = 0
        self.begin()

    def find(self, stream: int, first_sample: int) -> WaitingDrop | None:
        """Return the first drop of a name."""
        name = stream, first_sample
        matches = (drop for drop in self.waiting if _name(drop) == name)
        return next(matches, None)

    def release(self, stream: int, first_sample: int) -> None:
        """Remove an acknowledged drop, the one that `find` returns."""
        drop = self.find(stream, first_sample)
        if drop is not None:
            if drop is self.waiting[0]:
                self.offer_oldest()
            self.waiting = [waiting for waiting in self.waiting if waiting is not drop]

    def offer_oldest(self) -> None:
        """Restart the offers at the oldest drop."""
        self._offers = 0

    def next_offer(self) -> DropOffer | None:
        """Return the offer to send now; None: no drop waits."""
        if not self.waiting:
            return None
        turn = max(0, self._offers - OLDEST_FIRST_OFFERS + 1)
        self._offers += 1
        # Of several drops with one name only the oldest can be fetched.
        fetchable = {_name(drop): drop for drop in reversed(self.waiting)}
        oldest_first = [drop for drop in self.waiting if fetchable[_name(drop)] is drop]
        return oldest_first[turn % len(oldest_first)].offer

    def take(self, block: SampleBlock, ring: Ring, rate: float) -> bool:
        """Search samples that are in the ring already; return whether they complete a drop."""
        trigger = self.trigger
        if self._slots and (trigger.on or self._hand is not None):
            column = block.counts[:, trigger.channel].astype(float)
            if block.shunt:
                column = column - self._shunt_counts[trigger.channel]
            for at, value in enumerate(column.tolist()):
                self._track(value, block.first_sample + at, rate)
        if self._hand is None or _end(block) < self._hand + trigger.after:
            return False
        return self._store_drop(block, ring, rate)

    def _store_drop(self, block: SampleBlock, ring: Ring, rate: float) -> bool:
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
            DROP_BLOCK_BYTES // (3 * channels),
            zlib.crc32(data),
            rate,
            shunt=block.shunt,
        )
        self.waiting.append(WaitingDrop(offer, data))
        return True

    def _track(self, value: float, index: int, rate: float) -> None:
        if self._rest is None:
            self._early.append(value)
            if len(self._early) == _N_FIRST_REST_SAMPLES:
                self._rest, self._early = sum(self._early) / _N_FIRST_REST_SAMPLES, []
            return
        trigger = self.trigger
        deviation = abs(value - self._rest)
        if self._hand is not None:
            self._peak = max(self._peak, deviation)
            return
        if not trigger.on:
            return
        if deviation <= trigger.threshold / 2:
            # A candidate that lasted long enough was a bounce, which is over.
            if (
                self._candidate is not None and self._stayed >= trigger.confirm
            ):  # a bounce, and over
                self._pulse, self._peak = self._candidate, self._candidate_peak
            self._candidate = None
            self._calm += 1
            self._released = self._released or self._calm >= trigger.confirm
            self._rest += (value - self._rest) / _REST_AVERAGING_SAMPLES
            return
        self._calm = 0
        if not self._released:
            return
        if self._candidate is None:
            if deviation <= trigger.threshold:
                return
            self._candidate, self._candidate_peak, self._stayed = index, 0.0, 0
        self._candidate_peak = max(self._candidate_peak, deviation)
        self._stayed += 1
        if self._stayed >= trigger.confirm and not self._bounces(self._candidate, rate):
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


def _name(drop: WaitingDrop) -> tuple[int, int]:
    return drop.offer.stream, drop.offer.first_sample


def split_block(block: SampleBlock, max_samples: int) -> list[SampleBlock]:
    """Return a block in pieces of up to `max_samples` samples."""
    max_samples = min(max_samples, MAX_SAMPLE_BYTES // (3 * block.counts.shape[1]))
    return [
        replace(
            block,
            first_sample=block.first_sample + offset,
            counts=block.counts[offset : offset + max_samples],
            clock_us=block.clock_us if offset == 0 else None,
        )
        for offset in range(0, len(block.counts), max_samples)
    ]


@dataclass(frozen=True)
class StoredCalibration:
    """Calibration stored by the host, which replaces that of the scenario in the identity.

    It outlasts a reset. The samples do not depend on it.
    """

    channels: dict[int, Calibrate] = field(default_factory=dict)
    serial_number: str = ""

    def applied(self, identity: Identity) -> Identity:
        """Return the identity with the stored calibration."""
        channels = list(identity.channels)
        for number, stored in self.channels.items():
            channels[number] = _calibrated(channels[number], stored)
        serial = self.serial_number or identity.serial_number
        return replace(identity, channels=tuple(channels), serial_number=serial)

    def with_channel(self, request: Calibrate, identity: Identity) -> StoredCalibration:
        """Return the calibration with another channel; `SetupError` if it is invalid."""
        serial = request.serial_number
        sound = len(serial.encode()) <= LONGEST_NAME and serial.isascii() and serial.isprintable()
        if request.channel >= len(identity.channels) or not (sound or not serial):
            raise SetupError("channel or serial number")
        _calibrated(identity.channels[request.channel], request)
        return StoredCalibration(
            {**self.channels, request.channel: request}, serial or self.serial_number
        )


def _calibrated(channel: ChannelIdentity, stored: Calibrate) -> ChannelIdentity:
    try:
        calibrated, due = day_of(stored.calibrated), day_of(stored.due)
    except (ValueError, OverflowError) as err:
        raise SetupError(f"channel {channel.name!r}: no such day") from err
    return replace(
        channel,
        sensitivity=stored.sensitivity,
        zero=stored.zero,
        natural_frequency=stored.natural_frequency,
        damping=stored.damping,
        shunt=stored.shunt,
        calibrated=calibrated,
        due=due,
    )
