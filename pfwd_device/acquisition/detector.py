"""Finds the drops in the stream of samples.

The stream is looked at in quanta of a fixed number of samples that begin at fixed indices, so that
what is found does not depend on how the samples arrived. Between drops the load at rest follows
the median of each quantum; a drop begins where the load has left it by the threshold and stays
away; a smaller pulse soon after is a bounce of the hammer and is kept with its drop.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.detection import (
    AtRest,
    DetectionSettings,
    RawDrop,
    RawRebound,
    ReboundsOver,
)
from pfwd_device.acquisition.items import Gap, Samples
from pfwd_device.acquisition.window import Window, runs
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity

QUANTA_PER_SECOND = 100
WARM_UP = 20
"""Quanta after which the load at rest is known."""
FOLLOWS = 0.03
"""Part of the way that the load at rest goes towards each quantum: it follows a drift within 0.3 s
and is not moved by noise."""
STUCK = 100
"""Quanta off rest after which the new level is rest: something stands on the plate now."""
FEWEST_SAMPLES = 16
"""In a record; fewer tell nothing of a pulse."""
LONG_GAP = 1.0
"""s; after so long without samples the load at rest is found anew."""

Found = RawDrop | RawRebound | ReboundsOver


@dataclass(slots=True)
class _Trigger:
    """A drop or a rebound whose record is not complete yet."""

    index: int
    at_rest: AtRest
    threshold: float
    by_operator: bool = False


@dataclass(slots=True)
class _Last:
    """The drop that rebounds may still belong to."""

    trigger: int
    peak: int
    deadline: int


class Detector:
    """Turns samples into drops.

    Parameters
    ----------
    identity : Identity
        Tells the load channel, its calibration, the sampling rate and the range of the converter.
    settings : DetectionSettings
    """

    def __init__(self, identity: Identity, settings: DetectionSettings | None = None) -> None:
        self.settings = settings = settings or DetectionSettings()
        rate = identity.sampling_rate
        self._channels = len(identity.channels)
        self._load = load_channel(identity)
        per_newton = abs(counts_per_unit(identity.channels[self._load], identity))
        self._per_newton = per_newton
        self._least = settings.threshold * per_newton
        self._full = 1 << (identity.adc_bits - 1)
        self._quantum = max(1, round(rate / QUANTA_PER_SECOND))
        self._confirm = max(2, round(settings.confirm * rate))
        self._before = round(settings.pre_trigger * rate)
        self._after = max(1, round(settings.post_trigger * rate))
        if self._before + self._after < FEWEST_SAMPLES:
            raise SetupError(
                f"sampling rate: expected at least {FEWEST_SAMPLES} samples in the "
                f"{settings.pre_trigger + settings.post_trigger:g} s of a record, came "
                f"{self._before + self._after} at {rate:g} Hz; sampling_rate_hz under [link] of "
                "the setup file asks for another rate"
            )
        self._rebound_before = round(settings.rebound_pre_trigger * rate)
        self._rebound_after = max(1, round(settings.rebound_post_trigger * rate))
        self._rebound_window = round(settings.rebound_window * rate)
        # Back to before a trigger that is confirmed only in the next quantum.
        self._kept = max(self._before, self._rebound_before) + self._confirm + 2 * self._quantum
        self._long_gap = round(LONG_GAP * rate)
        self._stream = 0
        self._begin(0)

    def _begin(self, first: int, at_rest: AtRest | None = None) -> None:
        self._window = Window(self._channels, first)
        self._scanned = first
        self._rest = at_rest
        self._frozen = at_rest is not None
        self._early: list[tuple[float, float]] = []
        self._released = True
        self._off_rest = 0
        self._open: _Trigger | None = None
        self._last: _Last | None = None
        self._asked: int | None = None

    @property
    def ready(self) -> bool:
        """Whether a drop would be found now: the load at rest is known."""
        return self._rest is not None

    @property
    def drop_load(self) -> float:
        """Load above rest that starts a drop now, N: as set, or raised by the noise."""
        if self._rest is None or not self._per_newton:
            return self.settings.threshold
        return self._threshold(self._rest) / self._per_newton

    @property
    def at_rest(self) -> AtRest | None:
        """The load at rest, None until it is known."""
        return self._rest

    @property
    def busy(self) -> bool:
        """Whether a drop has begun whose record is not complete yet."""
        return self._open is not None

    def begin(self, stream: int, first: int = 0, at_rest: AtRest | None = None) -> None:
        """A new run of the sampler, or a recorded drop with the rest that its detection had.

        With `at_rest` given nothing is learnt before the drop, so that a replay finds the same.
        """
        self._stream = stream
        self._begin(first, at_rest)

    def trigger_by_operator(self, index: int | None = None) -> None:
        """Record a drop from here on, or from the sample with this index, whatever the load does.

        Does nothing while a drop is being recorded.
        """
        if self._open is None and self._asked is None:
            self._asked = self._window.end if index is None else index

    def feed(self, item: Samples | Gap) -> list[Found]:
        """Drops and rebounds that are complete with these samples, in order."""
        if item.stream != self._stream:
            raise ValueError(f"expected samples of stream {self._stream}, came {item.stream}")
        if isinstance(item, Gap):
            return list(self._skip(item.length))
        if item.shunt:  # no measurement
            return list(self._skip(len(item.counts)))
        self._window.append(item.counts)
        return list(self._scan())

    def finish(self, reason: str) -> list[Found]:
        """No more samples come: what is left of a drop in hand, marked as cut off.

        Parameters
        ----------
        reason : str
            Why, for the mark.
        """
        found: list[Found] = []
        trigger = self._open
        if trigger is not None and self._last is not None and self._is_rebound(trigger):
            # Larger than what came before: that was a knock, this is the drop.
            if self._peak(trigger, self._rebound_after) > self._last.peak:
                found.append(ReboundsOver())
            else:
                trigger = None
        if trigger is not None:
            found.append(self._record(trigger, cut_off=reason))
        if self._last is not None or found:
            found.append(ReboundsOver())
        self.begin(self._stream, self._window.end)
        return found

    def _skip(self, length: int) -> Iterator[Found]:
        filled = min(length, self._kept + self._after + self._rebound_window)
        self._window.append_missing(filled)
        yield from self._scan()
        if length > filled:
            self._jump(length - filled)
        if length >= self._long_gap:
            self._rest, self._early, self._frozen = None, [], False

    def _jump(self, length: int) -> None:
        end = self._window.end + length
        self._window = Window(self._channels, end)
        self._scanned = end

    def _scan(self) -> Iterator[Found]:
        quantum = self._quantum
        while True:
            end = (self._scanned // quantum + 1) * quantum
            if end > self._window.end:
                break
            yield from self._scan_quantum(self._scanned, end)
            self._scanned = end
        keep = self._scanned - self._kept
        if self._open is not None:
            keep = min(keep, self._open.index - self._kept)
        self._window.forget_before(keep)

    def _scan_quantum(self, start: int, end: int) -> Iterator[Found]:
        yield from self._complete(end)
        if self._open is None:
            self._learn(start, end)
            self._open = self._find_trigger(end)
            # A record may be shorter than a quantum.
            yield from self._complete(end)
        if self._last is not None and self._open is None and end >= self._last.deadline:
            self._last = None
            yield ReboundsOver()

    def _complete(self, end: int) -> Iterator[Found]:
        """Hands on the record that is complete with the samples before `end`."""
        trigger = self._open
        if trigger is None:
            return
        if self._is_rebound(trigger) and end >= trigger.index + self._rebound_after:
            peak = self._peak(trigger, self._rebound_after)
            assert self._last is not None
            if peak <= self._last.peak:
                yield self._rebound(trigger, peak, self._last)
                self._open, self._released = None, False
                return
            # Larger than what came before: that was a knock, this is the drop.
            self._last = None
            yield ReboundsOver()
        if not self._is_rebound(trigger) and end >= trigger.index + self._after:
            yield self._record(trigger, cut_off=None)
            self._last = _Last(
                trigger.index,
                self._peak(trigger, self._after),
                trigger.index + max(self._rebound_window, self._after),
            )
            self._open, self._released, self._frozen = None, False, False

    def _is_rebound(self, trigger: _Trigger) -> bool:
        return self._last is not None and not trigger.by_operator

    def _departure(self, first: int, last: int, rest: AtRest) -> NDArray[np.float64]:
        """Distance of the load from rest, counts; 0 where samples are missing."""
        counts, gone = self._window.part(first, last)
        away: NDArray[np.float64] = np.abs(counts[:, self._load] - rest.load)
        away[gone] = 0.0
        return away

    def _peak(self, trigger: _Trigger, length: int) -> int:
        away = self._departure(trigger.index, trigger.index + length, trigger.at_rest)
        return round(float(away.max()))

    def _threshold(self, rest: AtRest) -> float:
        return max(self._least, self.settings.noise_factor * rest.noise)

    def _learn(self, start: int, end: int) -> None:
        """Follow the load at rest."""
        if self._frozen:
            return
        counts, gone = self._window.part(start, end)
        load = counts[~gone, self._load].astype(float)
        if load.size < max(2, (end - start) // 2):
            return
        # Quantum after quantum all day: the plain forms of median and root mean square.
        level = float(np.partition(load, load.size // 2)[load.size // 2])
        steps = np.diff(load)
        noise = math.sqrt(float(steps @ steps) / (2 * steps.size))
        if self._rest is None:
            self._early.append((level, noise))
            if len(self._early) >= WARM_UP:
                levels, noises = np.median(self._early, axis=0)
                self._rest = AtRest(float(levels), float(noises))
                self._early = []
            return
        rest = self._rest
        quiet = self.settings.hysteresis * self._threshold(rest)
        if np.abs(load - rest.load).max() < quiet:
            self._off_rest = 0
            self._rest = AtRest(
                rest.load + FOLLOWS * (level - rest.load),
                rest.noise + FOLLOWS * (noise - rest.noise),
            )
            return
        self._off_rest += 1
        if self._off_rest >= STUCK:
            self._rest, self._early = None, []
            self._off_rest, self._released = 0, True

    def _find_trigger(self, end: int) -> _Trigger | None:
        """The first sample that starts a drop, among those that can be confirmed before `end`."""
        if self._asked is not None and self._asked < end:
            rest = self._rest or AtRest(0.0, 0.0)
            trigger = _Trigger(self._asked, rest, 0.0, by_operator=True)
            self._asked = None
            self._last = None
            return trigger
        if self._frozen and self._asked is not None:
            return None  # in a replay it is known that nothing goes before the operator
        found = self._rest
        if found is None:
            return None
        rest = found
        # From where the last look could not confirm.
        start = max(self._window.start, self._scanned - self._confirm + 1)
        away = self._departure(start, end, rest)
        threshold = self._threshold(rest)
        if self._released and float(away.max(initial=0.0)) <= threshold:
            return None
        gone_again = _rows(away < self.settings.hysteresis * threshold, self._confirm)
        stays = _rows(away > self.settings.hysteresis * threshold, self._confirm)
        starts = np.flatnonzero((away[: stays.size] > threshold) & stays)
        if not self._released:
            released = np.flatnonzero(gone_again)
            if not released.size:
                return None
            self._released = True
            starts = starts[starts > released[0]]
        if not starts.size:
            return None
        return _Trigger(start + int(starts[0]), rest, threshold)

    def _record(self, trigger: _Trigger, cut_off: str | None) -> RawDrop:
        first = trigger.index - self._before
        counts, gone = self._window.part(first, trigger.index + self._after)
        over = (counts >= self._full - 1) | (counts <= -self._full)
        return RawDrop(
            stream=self._stream,
            first=first,
            trigger=self._before,
            counts=counts,
            missing=runs(gone),
            at_rest=trigger.at_rest,
            threshold=trigger.threshold,
            by_operator=trigger.by_operator,
            cut_off=cut_off,
            saturated=tuple(
                (channel, int(count)) for channel, count in enumerate(over.sum(axis=0)) if count
            ),
        )

    def _rebound(self, trigger: _Trigger, peak: int, last: _Last) -> RawRebound:
        first = trigger.index - self._rebound_before
        counts, _ = self._window.part(first, trigger.index + self._rebound_after)
        last.deadline = trigger.index + self._rebound_window
        return RawRebound(self._stream, first, trigger.index, last.trigger, peak, counts)


def _rows(flags: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """Where `length` true values in a row begin, (n - length + 1,)."""
    if flags.size < length:
        return np.zeros(0, bool)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(flags, length).all(axis=-1))
