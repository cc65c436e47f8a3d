"""Memory of a simulated instrument: latest samples (ring), stored drops, stored calibration.

An instrument with version 2 of the protocol has them. The ring allows the host to request samples
again. A drop is stored until the host acknowledges that it is safe on the disk.
"""

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
    DISARMED,
    Calibrate,
    DropBlock,
    DropOffer,
    Fetch,
    Resend,
    SampleBlock,
    SamplesGone,
)

DROP_BLOCK_BYTES = 240
"""Bytes of samples in a block of a drop; few, so that a damaged byte costs few samples."""
_N_FIRST_REST_SAMPLES = 64
"""Number of samples whose mean is the first estimate of the load at rest."""
_REST_AVERAGING_SAMPLES = 1024.0
"""Time constant of the average that estimates the load at rest, samples."""
MAX_BOUNCE_PEAK_RATIO = 0.7
"""Largest peak load of a bounce, relative to the pulse before it; prescribed by the protocol."""
MAX_FLIGHT_TIME_S = 0.7
"""Longest time between a pulse and its bounce, s; prescribed by the protocol."""
OLDEST_FIRST_OFFERS = 8
"""Number of announcements (offers) of only the oldest drop. After them all drops are offered in
turn, so that a drop that the host cannot record does not block the others."""


class Ring:
    """Buffer of the latest samples of a stream, which the host can request again.

    Parameters
    ----------
    length : int
        Number of samples that it stores.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._blocks: list[SampleBlock] = []

    def begin(self) -> None:
        """Discard the samples at the begin of a new stream."""
        self._blocks.clear()

    def add(self, block: SampleBlock) -> None:
        """Add the next samples, which may follow a gap."""
        self._blocks.append(block)
        end = block.first_sample + len(block.counts)
        while self._blocks and _end(self._blocks[0]) <= end - self._length:
            del self._blocks[0]

    def find_samples(self, request: Resend) -> list[SampleBlock | SamplesGone]:
        """Return requested samples, and reports of those that are not available, in order."""
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
        """Return the samples from index `first` to before `end`, in counts, (n, channels).

        None if some of them are missing.
        """
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
    """Drop in the memory of the instrument, which waits until the host acknowledges it."""

    offer: DropOffer
    """Description of the drop that is announced to the host."""
    data: bytes
    """Samples as they are sent, 3 bytes for each count."""

    def blocks(self, request: Fetch) -> list[DropBlock]:
        """Return the requested blocks of the drop, as far as they exist."""
        offer = self.offer
        size = 3 * offer.channels * offer.block_samples
        last = offer.blocks if request.blocks == 0 else request.first_block + request.blocks
        return [
            DropBlock(offer.stream, offer.first_sample, number, self.data[number * size :][:size])
            for number in range(request.first_block, min(last, offer.blocks))
        ]


class DropBuffer:
    """Drop detection of the simulated instrument, with a memory for drops.

    Parameters
    ----------
    slots : int
        Largest number of stored drops; 0: drops are not detected.
    shunt_counts : (channels,) ndarray of int
        Counts that the calibration shunt adds to each channel.
    """

    def __init__(self, slots: int, shunt_counts: NDArray[np.int32]) -> None:
        self.trigger = DISARMED
        self.waiting: list[WaitingDrop] = []
        self.lost = 0
        """Number of drops for which there was no room, or whose recording was ended."""
        self._slots, self._shunt_counts = slots, shunt_counts
        self._offers = 0
        self._hand: int | None = None
        self.begin()

    @property
    def busy(self) -> bool:
        """True while a drop begins, is being recorded or is stored."""
        return bool(self.waiting) or self._hand is not None or self._candidate is not None

    def begin(self) -> None:
        """Reset the detection at the begin of a new stream of samples."""
        self._rest: float | None = None
        self._early: list[float] = []
        self._candidate: int | None = None
        self._stayed = self._calm = 0
        self._released = True
        self.lost += self._hand is not None
        self._hand = None
        self._last: int | None = None
        self._pulse, self._peak = 0, 0.0
        """Trigger and peak of the last drop, or of the last bounce after it."""
        self._candidate_peak = 0.0

    def switched_off(self) -> None:
        """Simulate a loss of power: the drops remain, but their times are unknown from then on."""
        self.waiting = [
            replace(drop, offer=replace(drop.offer, earlier=True, clock_us=None))
            for drop in self.waiting
        ]
        self.begin()
        self.lost = 0

    def find(self, stream: int, first_sample: int) -> WaitingDrop | None:
        """Return the oldest stored drop with a stream and an index of its first sample, or None."""
        name = stream, first_sample
        matches = (drop for drop in self.waiting if _name(drop) == name)
        return next(matches, None)

    def release(self, stream: int, first_sample: int) -> None:
        """Delete the drop that `find` returns, because the host has acknowledged it."""
        drop = self.find(stream, first_sample)
        if drop is not None:
            if drop is self.waiting[0]:
                self.offer_oldest()
            self.waiting = [waiting for waiting in self.waiting if waiting is not drop]

    def offer_oldest(self) -> None:
        """Begin the announcements with the oldest drop again."""
        self._offers = 0

    def next_offer(self) -> DropOffer | None:
        """Return the announcement of a drop to send now; None if no drop is stored."""
        if not self.waiting:
            return None
        turn = max(0, self._offers - OLDEST_FIRST_OFFERS + 1)
        self._offers += 1
        # The host can only fetch the oldest of several drops with the same stream and index.
        fetchable = {_name(drop): drop for drop in reversed(self.waiting)}
        oldest_first = [drop for drop in self.waiting if fetchable[_name(drop)] is drop]
        return oldest_first[turn % len(oldest_first)].offer

    def take(self, block: SampleBlock, ring: Ring, rate: float) -> bool:
        """Search samples for drops and store a complete one; return True if a drop was stored.

        Parameters
        ----------
        block : SampleBlock
            Samples, which the ring contains already.
        ring : Ring
            Latest samples.
        rate : float, Hz
            Sampling rate.
        """
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
            # A candidate that lasted long enough and is no drop was a bounce, which has ended.
            if self._candidate is not None and self._stayed >= trigger.confirm:
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
        """Return True if a pulse is a bounce of the last drop by its time and its peak so far."""
        return (
            self._last is not None
            and candidate - self._last < self.trigger.hold_off
            and candidate - self._pulse <= MAX_FLIGHT_TIME_S * rate
            and self._candidate_peak < MAX_BOUNCE_PEAK_RATIO * self._peak
        )


def _name(drop: WaitingDrop) -> tuple[int, int]:
    return drop.offer.stream, drop.offer.first_sample


def split_block(block: SampleBlock, max_samples: int) -> list[SampleBlock]:
    """Return the samples of a block as blocks of up to `max_samples` samples."""
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
    """Calibration that the host has stored in the instrument, in its permanent memory.

    It replaces the calibration of the scenario in the identity that the instrument reports. The
    samples do not depend on it.
    """

    channels: dict[int, Calibrate] = field(default_factory=dict)
    """Stored calibrations by index of the channel."""
    serial_number: str = ""
    """Stored serial number; empty: that of the scenario."""

    def applied(self, identity: Identity) -> Identity:
        """Return the identity with the stored calibration in place of its own."""
        channels = list(identity.channels)
        for number, stored in self.channels.items():
            channels[number] = _calibrated(channels[number], stored)
        serial = self.serial_number or identity.serial_number
        return replace(identity, channels=tuple(channels), serial_number=serial)

    def with_channel(self, request: Calibrate, identity: Identity) -> StoredCalibration:
        """Return the stored calibrations with that of a further channel.

        Parameters
        ----------
        request : Calibrate
            Command of the host.
        identity : Identity
            Present identity of the instrument.

        Raises
        ------
        SetupError
            If the requested calibration is invalid.
        """
        serial = request.serial_number
        sound = len(serial.encode()) <= LONGEST_NAME and serial.isascii() and serial.isprintable()
        if request.channel >= len(identity.channels) or not (sound or not serial):
            raise SetupError("calibration: expected a channel and a serial number in range")
        _calibrated(identity.channels[request.channel], request)
        return StoredCalibration(
            {**self.channels, request.channel: request}, serial or self.serial_number
        )


def _calibrated(channel: ChannelIdentity, stored: Calibrate) -> ChannelIdentity:
    try:
        calibrated, due = day_of(stored.calibrated), day_of(stored.due)
    except (ValueError, OverflowError) as err:
        raise SetupError(f"channel {channel.name!r}: expected days as yyyymmdd") from err
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
