"""Detection of pulses in samples from which no drop is recorded, so that each can be reported.

A pulse is a load that rises and falls again within `REACH_QUANTA` groups of samples. It is measured
from the load around it, not from the load at rest. So a load that drifts, a person who steps onto
the plate and the calibration shunt are no pulses, and hide none.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.detection import PulseReason

REACH_QUANTA = 5
"""Number of groups of 10 ms before and after a group in which the load around a pulse is looked
for. So pulses up to 0.1 s long are measured in full, and reported 0.05 s after their peak."""


class UnrecordedPulse(NamedTuple):
    """Pulse that no record contains."""

    start: int
    """Index of the first group of samples that contains it."""
    end: int
    """Index after the last group."""
    peak: float
    """Peak above the load around it, counts."""
    reason: PulseReason


class _Group(NamedTuple):
    start: int
    end: int
    low: float
    high: float
    reason: PulseReason


class PulseWatch:
    """Detector of the pulses in groups of samples that follow each other.

    Parameters
    ----------
    confirm : int
        Number of successive samples for which the load has to stay up; spikes are shorter.
    """

    def __init__(self, confirm: int) -> None:
        self._confirm = confirm
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
        self, group: range, load: NDArray[np.float64], reason: PulseReason, threshold: float
    ) -> Iterator[UnrecordedPulse]:
        """Add a group of samples; yield the pulses that are over.

        Parameters
        ----------
        group : range
            Indices of the group in the stream.
        load : (n,) ndarray of float, counts
            Those of its samples that are present, positive in the direction of a pulse.
        reason : PulseReason
            Reason why a pulse in it is not recorded.
        threshold : float, counts
            Smallest peak to report.
        """
        load = np.concatenate([self._tail, load])
        self._tail = load[max(0, len(load) - self._confirm + 1) :]
        if len(load) < self._confirm:
            return
        if not self._groups and math.isfinite(self._level):
            level = min(self._level, float(load[0]))
            self._groups.append(_Group(group.start, group.start, level, -math.inf, reason))
        runs = np.lib.stride_tricks.sliding_window_view(load, self._confirm)
        low, high = float(runs.max(axis=1).min()), float(runs.min(axis=1).max())
        self._groups.append(_Group(group.start, group.stop, low, high, reason))
        if self._next + REACH_QUANTA < len(self._groups):
            yield from self._evaluate(threshold)
            del self._groups[: max(0, self._next - REACH_QUANTA)]
            self._next = min(self._next, REACH_QUANTA)

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
            last = self._groups[-1]
            level = float(self._tail[-1]) if continues else math.inf
            self._groups.append(_Group(last.end, last.end, level, -math.inf, last.reason))
            while self._next < len(self._groups):
                yield from self._evaluate(threshold)
        self.begin()

    def _evaluate(self, threshold: float) -> Iterator[UnrecordedPulse]:
        """Compare the next group with the groups around it."""
        number, group, pulse = self._next, self._groups[self._next], self._pulse
        self._next += 1
        before = self._groups[max(0, number - REACH_QUANTA) : number]
        after = self._groups[number + 1 : number + 1 + REACH_QUANTA]
        lows = [min((each.low for each in side), default=math.inf) for side in (before, after)]
        peak = group.high - max((low for low in lows if math.isfinite(low)), default=group.high)
        if peak > threshold:
            first = pulse or UnrecordedPulse(group.start, group.end, peak, group.reason)
            self._pulse = first._replace(end=group.end, peak=max(first.peak, peak))
        elif pulse is not None:
            self._pulse = None
            yield pulse
