"""Detection of pulses in samples from which no drop is recorded, so that each can be reported.

A pulse is a load that rises and falls again within `REACH_QUANTA` groups of samples. It is measured
from the load around it, not from the load at rest. So a load that drifts, a person who steps onto
the plate and the calibration shunt are no pulses, and hide none. It ends where it is lower than a
fraction of the threshold.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.detection import PulseReason
from pfwd_device.acquisition.window import runs

REACH_QUANTA = 5
"""Number of groups of 10 ms before and after a group in which the load around a pulse is looked
for. So pulses up to 0.1 s long are measured in full, and reported 0.05 s after their peak."""


class UnrecordedPulse(NamedTuple):
    """Pulse that no record contains."""

    start: int
    """Index of its first sample in the stream."""
    end: int
    """Index after its last sample."""
    peak: float
    """Peak above the load around it, counts."""
    reason: PulseReason


class _Group(NamedTuple):
    indices: list[int]
    lower: NDArray[np.float64]
    """Load that the samples up to each index do not fall below for the time of confirmation."""
    upper: NDArray[np.float64]
    """Load that they do not exceed."""
    low: float
    """Smallest value of `upper`, counts."""
    reason: PulseReason


class PulseWatch:
    """Detector of the pulses in groups of samples that follow each other.

    Parameters
    ----------
    confirm : int
        Number of successive samples for which the load has to stay up; spikes are shorter.
    hysteresis : float
        Fraction of the threshold below which a pulse has ended, so that the next one can begin.
    """

    def __init__(self, confirm: int, hysteresis: float) -> None:
        self._confirm = confirm
        self._hysteresis = hysteresis
        self.begin()

    def begin(self, level: float = math.inf) -> None:
        """Begin with samples that do not follow the former ones.

        Parameters
        ----------
        level : float
            Load before the first sample, counts; infinite: not known.
        """
        self._groups: list[_Group] = []
        self._next = 0  # index of the next group to evaluate
        self._level = level
        self._tail = np.zeros(0)
        self._pulse: UnrecordedPulse | None = None

    def add(
        self, indices: list[int], load: NDArray[np.float64], reason: PulseReason, threshold: float
    ) -> Iterator[UnrecordedPulse]:
        """Add a group of samples; yield the pulses that are over.

        Parameters
        ----------
        indices : (n,) list of int
            Indices of its samples in the stream; missing samples are left out.
        load : (n,) ndarray of float, counts
            Load, positive in the direction of a pulse.
        reason : PulseReason
            Reason why a pulse in it is not recorded.
        threshold : float, counts
            Smallest peak to report.
        """
        load = np.concatenate([self._tail, load])
        self._tail = load[max(0, len(load) - self._confirm + 1) :]
        n_confirmed = len(load) - self._confirm + 1
        if n_confirmed < 1:
            return
        if not self._groups and math.isfinite(self._level):
            self._add_level(min(self._level, float(load[0])), reason)
        rows = [load[first : first + n_confirmed] for first in range(self._confirm)]
        lower, upper = np.minimum.reduce(rows), np.maximum.reduce(rows)
        self._groups.append(
            _Group(indices[-n_confirmed:], lower, upper, float(upper.min()), reason)
        )
        if self._next + REACH_QUANTA < len(self._groups):
            yield from self._evaluate(threshold)
            del self._groups[: max(0, self._next - REACH_QUANTA)]
            self._next = min(self._next, REACH_QUANTA)

    def _add_level(self, level: float, reason: PulseReason) -> None:
        """Add a load before or after the samples, with which they are compared."""
        self._groups.append(_Group([], np.zeros(0), np.zeros(0), level, reason))

    def finish(self, threshold: float, *, continues: bool) -> Iterator[UnrecordedPulse]:
        """Yield the remaining pulses.

        Parameters
        ----------
        threshold : float, counts
            Smallest peak to report.
        continues : bool
            True: further samples follow, which are not watched, so that a rise may not be over.
        """
        if self._groups:
            if continues:
                self._add_level(float(self._tail[-1]), self._groups[-1].reason)
            while self._next < len(self._groups):
                yield from self._evaluate(threshold)
            yield from self._end_pulse(threshold)
        self.begin()

    def _evaluate(self, threshold: float) -> Iterator[UnrecordedPulse]:
        """Compare the samples of the next group with the samples around them."""
        number, group = self._next, self._groups[self._next]
        self._next += 1
        before = self._groups[max(0, number - REACH_QUANTA) : number]
        after = self._groups[number + 1 : number + 1 + REACH_QUANTA]
        base = np.full(group.upper.size, -math.inf if before or after else math.inf)
        for side, step in ((before, 1), (after, -1)):
            if side:
                inside = np.minimum.accumulate(group.upper[::step])[::step]
                base = np.maximum(base, np.minimum(inside, min(each.low for each in side)))
        height = group.lower - base
        ends = self._hysteresis * threshold
        for first, length in runs(height > ends):
            if first:
                yield from self._end_pulse(threshold)
            start = group.indices[first] - self._confirm + 1
            last = group.indices[first + length - 1]
            pulse = self._pulse or UnrecordedPulse(start, last, 0.0, group.reason)
            peak = max(pulse.peak, float(height[first : first + length].max()))
            self._pulse = pulse._replace(end=last + 1, peak=peak)
        if not (height[-1:] > ends).any():
            yield from self._end_pulse(threshold)

    def _end_pulse(self, threshold: float) -> Iterator[UnrecordedPulse]:
        """Yield the present pulse, if any, because the load has fallen again."""
        pulse, self._pulse = self._pulse, None
        if pulse is not None and pulse.peak > threshold:
            yield pulse
