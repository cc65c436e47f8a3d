"""Detection of drops in the samples of an instrument.

The samples are processed in quanta: groups of a fixed number of samples that begin at fixed
indices. So the result does not depend on how the samples arrived. Between drops the load at rest is
estimated from the median of each quantum. A pulse begins where the load departs from its value at
rest by more than a threshold and stays away.

A pulse is a bounce (rebound) of the drop before it if three conditions hold: it follows another
pulse within `MAX_FLIGHT_TIME_S`, its peak is below `MAX_BOUNCE_PEAK_RATIO` of the peak of that
pulse, and it lies within the rebound window of the drop. Any other pulse is a drop. A pulse that
cannot be recorded, or whose kind is uncertain because samples are missing, is reported: all samples
outside of records are watched for pulses (`pulse_watch`), also those with the shunt on.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.detection import (
    MAX_BOUNCE_PEAK_RATIO,
    MAX_FLIGHT_TIME_S,
    AtRest,
    DetectionSettings,
    PulseReason,
    PulseReport,
    RawDrop,
    RawRebound,
    ReboundsOver,
)
from pfwd_device.acquisition.items import Gap, Samples
from pfwd_device.acquisition.pulse_watch import REACH_QUANTA, PulseWatch, UnrecordedPulse
from pfwd_device.acquisition.window import Window, runs
from pfwd_device.calibration import counts_per_unit, load_channel
from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity

QUANTA_PER_SECOND = 100
WARM_UP_QUANTA = 20
"""Number of quanta from which the load at rest is estimated first."""
REST_TRACKING_GAIN = 0.03
"""Fraction of the difference by which the estimate of the load at rest approaches the level of each
quantum. So the estimate follows a drift within 0.3 s and averages the noise."""
NEW_REST_AFTER_QUANTA = 100
"""Number of successive quanta with another load after which the load at rest is estimated again."""
STEADY_QUANTA = 10
"""Number of successive quanta with another load, but no pulse in any of them, after which this load
is that at rest, for example when a person stands on the plate."""
SECOND_PULSE = 0.5
PULSE_GAP = 0.25
"""A record has a second pulse if the load falls below this fraction of its peak and then rises
again above `SECOND_PULSE`, as in the screening of drops. A smaller one is a bounce or a knock."""
MIN_RECORD_SAMPLES = 16
"""Smallest number of samples in a record: fewer do not resolve a pulse."""
MIN_REVERSED_LOAD = 2.0
"""Ratio of upward to downward load from which the polarity is wrong, as in the screening."""
LONG_GAP_S = 1.0
"""Shortest gap after which the load at rest is estimated again, s."""

MIN_GAP_HIDING_PULSE_S = 6e-3
"""Shortest gap in the samples that may hide a pulse, s. A pulse of 15 ms and 570 N, whose bounce
could still exceed the default threshold of 400 N, is above the threshold for 7.5 ms."""
MIN_GAP_HIDING_PEAK_S = 2e-3
"""Shortest gap within a pulse by which its true peak may exceed the recorded one, s: the top 2 ms
of a half-sine of 15 ms lie within 2 % of the peak."""

DetectedItem = RawDrop | RawRebound | ReboundsOver | PulseReport


@dataclass(slots=True)
class _Trigger:
    """Start of a drop or rebound whose record is not yet complete."""

    index: int
    at_rest: AtRest
    threshold: float
    by_operator: bool = False
    may_bounce: bool = False
    """True if the pulse may be a bounce by its time, so that its peak decides."""
    reason: PulseReason | None = None


@dataclass(slots=True)
class _Last:
    """Latest drop, to which rebounds may belong."""

    trigger: int
    deadline: int
    pulse: int
    """Index of the trigger of the last pulse: the drop or its last bounce."""
    peak: float
    """Peak of that pulse, counts; for a bounce with missing samples the largest possible peak."""
    incomplete: bool
    """True if samples near the peak of the drop are missing, so that its peak may be higher."""
    recorded: bool = True
    """False if the shunt hid the drop, so that its bounces have no drop to belong to."""


class Detector:
    """Detector of drops in the samples of one instrument.

    Parameters
    ----------
    identity : Identity
        Description of the instrument: load channel, calibration, sampling rate and converter.
    settings : DetectionSettings or None
        None: the default settings.
    """

    def __init__(self, identity: Identity, settings: DetectionSettings | None = None) -> None:
        self.settings = settings = settings or DetectionSettings()
        rate = identity.sampling_rate
        self._channels = len(identity.channels)
        self._load = load_channel(identity)
        signed = counts_per_unit(identity.channels[self._load], identity)
        self._polarity = self._sign = math.copysign(1.0, signed)
        self._per_newton = per_newton = abs(signed)
        self._min_threshold = settings.threshold * per_newton
        self._full = 1 << (identity.adc_bits - 1)
        self._quantum = max(1, round(rate / QUANTA_PER_SECOND))
        self._confirm = max(2, round(settings.confirm * rate))
        self._before = round(settings.pre_trigger * rate)
        self._after = max(1, round(settings.post_trigger * rate))
        if self._before + self._after < MIN_RECORD_SAMPLES:
            raise SetupError(
                f"sampling rate: expected at least {MIN_RECORD_SAMPLES} samples in the "
                f"{settings.pre_trigger + settings.post_trigger:g} s of a record, got "
                f"{self._before + self._after} at {rate:g} Hz; sampling_rate_hz under [link] of "
                "the setup file requests another rate"
            )
        self._rebound_before = round(settings.rebound_pre_trigger * rate)
        self._rebound_after = max(1, round(settings.rebound_post_trigger * rate))
        self._rebound_window = round(settings.rebound_window * rate)
        # Includes the samples before a trigger that is confirmed only in the next quantum.
        self._retained = max(self._before, self._rebound_before) + self._confirm + 2 * self._quantum
        self._long_gap = round(LONG_GAP_S * rate)
        self._flight = round(MAX_FLIGHT_TIME_S * rate)
        self._hides_pulse = max(1, round(MIN_GAP_HIDING_PULSE_S * rate))
        self._hides_peak = max(1, round(MIN_GAP_HIDING_PEAK_S * rate))
        self._stream = 0
        self._begin(0)

    def _begin(self, first: int, at_rest: AtRest | None = None) -> None:
        self._window = Window(self._channels, first)
        self._scanned = first
        self._rest = at_rest
        self._frozen = at_rest is not None
        self._early: list[tuple[float, float]] = []
        watches = (PulseWatch(self._confirm, self.settings.hysteresis) for _ in range(2))
        self._watch, self._shunt_watch = watches
        self._watched_from = first
        """Index of the first sample after the last record."""
        self._holes: deque[tuple[int, int]] = deque()
        """(start, end) of the latest missing samples; a bounce of a pulse in them may follow. So it
        may be with the time before the first sample, except in the replay of a drop."""
        if at_rest is None:
            self._holes.append((first - self._flight, first))
        self._released = True
        self._off_rest = self._steady = 0
        self._open: _Trigger | None = None
        self._last: _Last | None = None
        self._operator_trigger: int | None = None

    @property
    def ready(self) -> bool:
        """True if the load at rest is known, so that drops can be detected."""
        return self._rest is not None

    @property
    def drop_load(self) -> float:
        """Present threshold, N above the load at rest: that of the settings, or more with noise."""
        if self._rest is None or not self._per_newton:
            return self.settings.threshold
        return self._threshold(self._rest) / self._per_newton

    @property
    def at_rest(self) -> AtRest | None:
        """Estimated level and noise of the load at rest, counts; None until they are known."""
        return self._rest

    @property
    def busy(self) -> bool:
        """True while a drop or rebound is being recorded."""
        return self._open is not None

    def begin(self, stream: int, first: int = 0, at_rest: AtRest | None = None) -> None:
        """Begin a new stream (run of samples) of the instrument, or the replay of a drop.

        Parameters
        ----------
        stream : int
            Number of the stream.
        first : int
            Index of the first sample that follows.
        at_rest : AtRest or None
            Recorded load at rest, for a replay: it is used up to the first drop, so that the same
            drop is detected. None: it is estimated from the samples.
        """
        self._stream = stream
        self._begin(first, at_rest)

    def trigger_by_operator(self, index: int | None = None) -> None:
        """Record a drop with a given sample as its time 0, independent of the load.

        The call has no effect while a drop is being recorded.

        Parameters
        ----------
        index : int or None
            Index of the sample in the stream; None: the next sample.
        """
        if self._open is None and self._operator_trigger is None:
            self._operator_trigger = self._window.end if index is None else index

    def feed(self, item: Samples | Gap) -> list[DetectedItem]:
        """Return the drops, rebounds and reports that further samples complete, in order.

        Parameters
        ----------
        item : Samples or Gap
            Samples, or a range of missing samples, that directly follow those of the last call.
        """
        if item.stream != self._stream:
            raise ValueError(f"expected samples of stream {self._stream}, got {item.stream}")
        if isinstance(item, Gap):
            start, end = self._window.end, self._window.end + item.length
            if self._holes and start - self._holes[-1][1] < self._confirm:
                start = self._holes.pop()[0]  # they almost touch
            self._holes.append((start, end))
            return list(self._skip(item.length))
        self._window.append(item.counts, shunt=item.shunt)
        return list(self._scan())

    def finish(self, reason: str) -> list[DetectedItem]:
        """End the stream and return the remaining drops, rebounds and reports.

        An incomplete drop is returned with the reason for the end in `RawDrop.cut_off`.

        Parameters
        ----------
        reason : str
            Reason for the end, recorded with an incomplete drop.
        """
        items: list[DetectedItem] = []
        if self._window.end > self._scanned:  # samples after the last complete quantum
            items += self._scan_quantum(self._scanned, self._window.end)
        items += self._end_watch()
        trigger = self._open
        if trigger is not None and trigger.may_bounce:
            assert self._last is not None
            peak = self._peak(trigger, self._rebound_after)
            if self._is_bounce(trigger, peak, self._last):
                items += self._watch_bounce(trigger, self._window.end, PulseReason.CUT_OFF)
                # Half a pulse may end just above the threshold.
                least = self.settings.hysteresis * trigger.threshold
                items += self._report_unrecorded(self._watch.finish(least, continues=False))
                trigger = None
            else:
                self._last = None
                items.append(ReboundsOver())
        if trigger is not None:
            items += self._records(trigger, cut_off=reason)
            items.append(ReboundsOver())
        elif self._last is not None:
            items.append(ReboundsOver())
        self.begin(self._stream, self._window.end)
        return items

    def _skip(self, length: int) -> Iterator[DetectedItem]:
        filled = min(length, self._retained + self._after + self._rebound_window)
        self._window.append_missing(filled)
        yield from self._scan()
        if length > filled:
            self._scanned = self._window.end + length - filled
            self._window = Window(self._channels, self._scanned)
        if length >= self._long_gap:
            yield from self._end_watch()
            self._rest, self._early, self._frozen = None, [], False

    def _missing(self, start: int, end: int) -> int:
        return sum(max(0, min(end, last) - max(start, first)) for first, last in self._holes)

    def _may_hide_pulse(self, start: int, end: int) -> bool:
        """Return True if missing samples between the two indices may hide a complete pulse."""
        return any(
            min(end, last) - max(start, first) >= self._hides_pulse for first, last in self._holes
        )

    def _scan(self) -> Iterator[DetectedItem]:
        quantum = self._quantum
        while True:
            end = (self._scanned // quantum + 1) * quantum
            if end > self._window.end:
                break
            yield from self._scan_quantum(self._scanned, end)
            self._scanned = end
        keep = self._scanned - self._retained
        if self._open is not None:
            keep = min(keep, self._open.index - self._retained)
        self._window.forget_before(keep)
        bounces_after = self._scanned - self._after - max(self._rebound_window, self._flight)
        while self._holes and self._holes[0][1] < bounces_after:
            self._holes.popleft()

    def _scan_quantum(self, start: int, end: int) -> Iterator[DetectedItem]:
        yield from self._complete(end)
        if self._open is not None:
            yield from self._watch_shunted(start, end)
        else:
            self._learn(start, end)
            reason = PulseReason.REST_CHANGING if self._released else PulseReason.NOT_RELEASED
            reason = PulseReason.REST_UNKNOWN if self._rest is None else reason
            self._open = self._find_trigger(end)
            yield from self._watch_unrecorded(start, end, reason)
            yield from self._watch_shunted(start, end)
            yield from self._classify_by_time(self._open)
            # A record may be shorter than a quantum.
            yield from self._complete(end)
        if self._last is not None and self._open is None and end >= self._last.deadline:
            self._last = None
            yield ReboundsOver()

    def _complete(self, end: int) -> Iterator[DetectedItem]:
        """Yield the drop or rebound whose record the samples before `end` complete."""
        trigger = self._open
        if trigger is None:
            return
        if trigger.may_bounce and end >= trigger.index + self._rebound_after:
            peak = self._peak(trigger, self._rebound_after)
            assert self._last is not None
            if self._is_bounce(trigger, peak, self._last):
                if self._last.recorded:
                    yield self._rebound(trigger, peak, self._last)
                    if trigger.reason is not None:
                        yield self._report(trigger.index, peak, trigger.reason)
                yield from self._stop_recording(trigger, self._rebound_after)
                if not self._last.recorded:
                    self._last.pulse, self._last.peak = trigger.index, peak
                    reason = PulseReason.BOUNCE_OF_SHUNTED
                    yield from self._watch_bounce(trigger, self._watched_from, reason)
                return
            # Too large for a bounce, so it is a drop.
            trigger.may_bounce = False
            trigger.reason = self._reason_to_report_drop(trigger, self._last)
            self._last = None
            yield ReboundsOver()
        if not trigger.may_bounce and end >= trigger.index + self._after:
            yield from self._records(trigger, cut_off=None)
            deadline = trigger.index + max(self._rebound_window, self._after)
            peak = self._peak(trigger, self._after)
            incomplete = self._is_incomplete(trigger)
            self._last = _Last(trigger.index, deadline, trigger.index, peak, incomplete)
            yield from self._stop_recording(trigger, self._after)
            self._frozen = False

    def _stop_recording(self, trigger: _Trigger, length: int) -> Iterator[DetectedItem]:
        """Watch again the samples that follow a record; report pulses with the shunt on in it."""
        self._open, self._released = None, False
        self._watched_from = trigger.index + length
        counts, missing = self._window.part(trigger.index, self._watched_from)
        load = counts[~missing, self._load] - trigger.at_rest.load
        yield from self._end_watch()
        if load.size:
            # A load cell of the wrong polarity: a load that is taken off falls as well, but stays.
            high, middle, low = np.percentile(self._polarity * load, (100, 50, 0))
            middle = min(middle, 0.0)  # and one that is put on does not fall below that at rest
            is_reversed = middle - low > MIN_REVERSED_LOAD * (high - middle)
            self._sign = -self._polarity if is_reversed else self._polarity
            # A pulse that begins within the record rises from the load after the pulse before it.
            load = self._sign * load
            fall = np.maximum.accumulate(load) - load
            ended = int((fall > self.settings.hysteresis * trigger.threshold).argmax())
            since = max(ended, load.size - REACH_QUANTA * self._quantum)
            self._watch.begin(self._sign * trigger.at_rest.load + float(load[since:].min()))

    def _classify_by_time(self, trigger: _Trigger | None) -> Iterator[DetectedItem]:
        """Decide from the time of a new pulse whether it may be a bounce of the last drop.

        If it cannot be one, yield the message that the last drop has no further rebounds.
        """
        if trigger is None or trigger.by_operator:
            return
        last = self._last
        if last is not None and trigger.index < last.deadline:
            trigger.may_bounce = trigger.index - last.pulse <= self._flight
            if not trigger.may_bounce and self._may_hide_pulse(last.pulse, trigger.index):
                trigger.may_bounce, trigger.reason = True, PulseReason.MAYBE_DROP
        if not trigger.may_bounce:
            trigger.reason = self._reason_to_report_drop(trigger, None)
            if last is not None:
                self._last = None
                yield ReboundsOver()

    def _is_bounce(self, trigger: _Trigger, peak: int, last: _Last) -> bool:
        """Return True if a pulse whose time allows a bounce is small enough for one."""
        # A late pulse is reported: it can only be a bounce of a bounce in the missing samples.
        bounces = 1 if trigger.reason is None else 2
        return peak < MAX_BOUNCE_PEAK_RATIO**bounces * last.peak

    def _reason_to_report_drop(self, trigger: _Trigger, last: _Last | None) -> PulseReason | None:
        """Return the reason to report a drop that may be a bounce; None if it is certainly none.

        It may be a bounce of `last`, whose peak is uncertain, or of a pulse in missing samples.
        """
        hidden = self._may_hide_pulse(trigger.index - self._flight, trigger.index)
        if hidden or (last is not None and last.incomplete):
            return PulseReason.MAYBE_BOUNCE
        return None

    def _is_incomplete(self, trigger: _Trigger) -> bool:
        """Return True if samples of a pulse are missing so that its true peak may be higher."""
        pulse = self._rebound_after
        return self._missing(trigger.index - pulse, trigger.index + pulse) >= self._hides_peak

    def _report(self, index: int, peak: float, reason: PulseReason) -> PulseReport:
        return PulseReport(self._stream, index, round(peak), reason)

    def _records(self, trigger: _Trigger, cut_off: str | None) -> Iterator[DetectedItem]:
        """Yield the record of a drop, and reports if it may be a bounce or has a second pulse."""
        yield self._record(trigger, cut_off)
        peak = self._peak(trigger, self._after)
        if trigger.reason is not None:
            yield self._report(trigger.index, peak, trigger.reason)
        counts, missing = self._window.part(trigger.index, trigger.index + self._after)
        away = np.abs(counts[:, self._load] - trigger.at_rest.load)
        is_high = away > max(SECOND_PULSE * peak, self._threshold(trigger.at_rest))
        # Samples between the two levels decide nothing.
        decided = np.flatnonzero((is_high | (away < PULSE_GAP * peak)) & ~missing)
        rises = decided[1:][is_high[decided[1:]] & ~is_high[decided[:-1]]]
        n_first = int(decided.size == 0 or not is_high[decided[0]])
        for rise in rises[n_first:]:
            second = float(away[rise : rise + self._rebound_after].max())
            yield self._report(trigger.index + int(rise), second, PulseReason.SAME_RECORD)

    def _watch_unrecorded(
        self, start: int, end: int, reason: PulseReason
    ) -> Iterator[DetectedItem]:
        """Yield reports of the pulses in samples that belong to no record."""
        if self._frozen:
            return
        counts, missing = self._window.part(start, end)
        missing[: max(0, self._watched_from - start)] = True
        if self._open is not None:
            missing[max(0, self._open.index - start) :] = True
        load = self._sign * counts[~missing, self._load].astype(float)
        indices = (start + np.flatnonzero(~missing)).tolist()
        threshold = self._watch_threshold
        yield from self._report_unrecorded(self._watch.add(indices, load, reason, threshold))
        if self._open is not None:
            yield from self._report_unrecorded(self._watch.finish(threshold, continues=True))

    def _watch_bounce(
        self, trigger: _Trigger, end: int, reason: PulseReason
    ) -> Iterator[DetectedItem]:
        """Watch the samples of a bounce that is not recorded; further pulses may be in them."""
        self._open, self._watched_from = None, trigger.index
        self._watch.begin(self._sign * trigger.at_rest.load)
        yield from self._watch_unrecorded(trigger.index, end, reason)
        self._watched_from = end

    def _watch_shunted(self, start: int, end: int) -> Iterator[DetectedItem]:
        """Yield reports of the pulses in samples with the calibration shunt on."""
        indices, counts = self._window.shunted(start, end)
        load = self._sign * counts[:, self._load].astype(float)
        watch, threshold = self._shunt_watch, self._watch_threshold
        pulses = watch.finish(threshold, continues=True)
        if indices:
            pulses = watch.add(indices, load, PulseReason.SHUNT_ON, threshold)
        yield from self._report_unrecorded(pulses)

    def _end_watch(self) -> Iterator[DetectedItem]:
        """Report the remaining pulses at the end of the samples."""
        for watch in (self._watch, self._shunt_watch):
            pulses = watch.finish(self._watch_threshold, continues=False)
            yield from self._report_unrecorded(pulses)

    @property
    def _watch_threshold(self) -> float:
        """Smallest peak of a pulse to report, counts above the load around it.

        The lowest of some hundred samples, with which a pulse is compared, lies below their level
        by more than twice the noise.
        """
        early = [noise for _, noise in self._early] or [0.0]
        rest = self._rest or AtRest(0.0, float(np.median(early)))
        return self._threshold(rest) + 2.0 * rest.noise

    def _report_unrecorded(self, pulses: Iterator[UnrecordedPulse]) -> Iterator[DetectedItem]:
        for pulse in pulses:
            if pulse.reason is PulseReason.SHUNT_ON:
                yield from self._expect_bounces(pulse)
            elif pulse.reason is not PulseReason.BOUNCE_OF_SHUNTED:
                # It is treated like missing samples: a following pulse may be its bounce.
                self._holes.append((pulse.start, max(pulse.end, pulse.start + self._hides_pulse)))
            yield self._report(pulse.start, pulse.peak, pulse.reason)

    def _expect_bounces(self, pulse: UnrecordedPulse) -> Iterator[DetectedItem]:
        """Begin the time in which pulses are bounces of one that the shunt has hidden."""
        if self._open is not None:
            return  # the pulse that is being recorded decides
        last, start, deadline = self._last, pulse.start, pulse.start + self._rebound_window
        if last is not None:
            soon = start < min(last.deadline, last.pulse + self._flight)
            if soon and pulse.peak < MAX_BOUNCE_PEAK_RATIO * last.peak:
                last.pulse, last.peak = start, pulse.peak
                return
            yield ReboundsOver()
        self._last = _Last(start, deadline, start, pulse.peak, incomplete=False, recorded=False)

    def _departure(self, first: int, last: int, rest: AtRest) -> NDArray[np.float64]:
        """Return the difference between load and rest, counts, without sign; 0 for missing samples.

        The samples are those from `first` to before `last`.
        """
        counts, missing = self._window.part(first, last)
        away: NDArray[np.float64] = np.abs(counts[:, self._load] - rest.load)
        away[missing] = 0.0
        return away

    def _peak(self, trigger: _Trigger, length: int) -> int:
        away = self._departure(trigger.index, trigger.index + length, trigger.at_rest)
        return round(float(away.max()))

    def _threshold(self, rest: AtRest) -> float:
        return max(self._min_threshold, self.settings.noise_factor * rest.noise)

    def _learn(self, start: int, end: int) -> None:
        """Update the estimate of the load at rest from a group of samples (quantum)."""
        if self._frozen:
            return
        counts, missing = self._window.part(start, end)
        load = counts[~missing, self._load].astype(float)
        if load.size < max(2, (end - start) // 2):
            return
        # This runs a hundred times each second, so median and root mean square use fast forms.
        level = float(np.partition(load, load.size // 2)[load.size // 2])
        steps = np.diff(load)
        noise = math.sqrt(float(steps @ steps) / (2 * steps.size))
        if self._rest is None:
            self._early.append((level, noise))
            if len(self._early) >= WARM_UP_QUANTA:
                levels, noises = np.median(self._early, axis=0)
                self._rest = AtRest(float(levels), float(noises))
                self._early = []
            return
        rest = self._rest
        quiet = self.settings.hysteresis * self._threshold(rest)
        if np.abs(load - rest.load).max() < quiet:
            self._off_rest = self._steady = 0
            self._rest = AtRest(
                rest.load + REST_TRACKING_GAIN * (level - rest.load),
                rest.noise + REST_TRACKING_GAIN * (noise - rest.noise),
            )
            return
        self._off_rest += 1
        self._steady = self._steady + 1 if np.abs(load - level).max() < quiet else 0
        if self._steady >= STEADY_QUANTA or self._off_rest >= NEW_REST_AFTER_QUANTA:
            self._rest = AtRest(level, rest.noise) if self._steady else None
            self._early, self._released = [], True
            self._off_rest = self._steady = 0

    def _find_trigger(self, end: int) -> _Trigger | None:
        """Return the first trigger that the samples before `end` confirm, or None."""
        if self._operator_trigger is not None and self._operator_trigger < end:
            rest = self._rest or AtRest(0.0, 0.0)
            trigger = _Trigger(self._operator_trigger, rest, 0.0, by_operator=True)
            self._operator_trigger = None
            self._last = None
            return trigger
        if self._frozen and self._operator_trigger is not None:
            return None  # in the replay of a drop no other drop may precede the operator's trigger
        if self._rest is None:
            return None
        rest = self._rest
        # Include the samples that the last call could not confirm.
        start = max(self._window.start, self._scanned - self._confirm + 1)
        away = self._departure(start, end, rest)
        threshold = self._threshold(rest)
        if self._released and float(away.max(initial=0.0)) <= threshold:
            return None
        is_below = _starts_of_rows(away < self.settings.hysteresis * threshold, self._confirm)
        is_above = _starts_of_rows(away > self.settings.hysteresis * threshold, self._confirm)
        starts = np.flatnonzero((away[: is_above.size] > threshold) & is_above)
        if not self._released:
            released = np.flatnonzero(is_below)
            if not released.size:
                return None
            self._released = True
            starts = starts[starts > released[0]]
        if not starts.size:
            return None
        return _Trigger(start + int(starts[0]), rest, threshold)

    def _record(self, trigger: _Trigger, cut_off: str | None) -> RawDrop:
        first = trigger.index - self._before
        counts, missing = self._window.part(first, trigger.index + self._after)
        over = (counts >= self._full - 1) | (counts <= -self._full)
        return RawDrop(
            stream=self._stream,
            first=first,
            trigger=self._before,
            counts=counts,
            missing=runs(missing),
            at_rest=trigger.at_rest,
            threshold=trigger.threshold,
            by_operator=trigger.by_operator,
            cut_off=cut_off,
            saturated=tuple(
                (channel, int(count)) for channel, count in enumerate(over.sum(axis=0)) if count
            ),
            may_bounce=trigger.reason is PulseReason.MAYBE_BOUNCE,
        )

    def _rebound(self, trigger: _Trigger, peak: int, last: _Last) -> RawRebound:
        first = trigger.index - self._rebound_before
        counts, _ = self._window.part(first, trigger.index + self._rebound_after)
        largest = MAX_BOUNCE_PEAK_RATIO * last.peak if self._is_incomplete(trigger) else 0.0
        last.pulse, last.peak = trigger.index, max(peak, largest)
        return RawRebound(self._stream, first, trigger.index, last.trigger, peak, counts)


def _starts_of_rows(flags: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """Return a mask, (n - length + 1,), of the positions where `length` true values begin."""
    if flags.size < length:
        return np.zeros(0, bool)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(flags, length).all(axis=-1))
