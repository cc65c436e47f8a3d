"""Detection of pulses in samples from which no drop is recorded, so that each can be reported.

A pulse is a load that rises and falls again within `REACH_QUANTA` groups of samples. It is measured
from the load around it, not from the load at rest. So a load that drifts, a person who steps onto
the plate and the calibration shunt are no pulses, and hide none.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfwd_device.acquisition.detection import PulseReason

REACH_QUANTA = 5
"""Number of groups of 10 ms before and after a group in which the load around a pulse is looked
for. So pulses up to 0.1 s long are measured in full, and reported 0.05 s after their peak."""


@dataclass(frozen=True, slots=True)
class UnrecordedPulse:
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

    def begin(self, level: float | None = None) -> None:
        """Begin with samples that do not follow the former ones.

        Parameters
        ----------
        level : float, optional
            Load before the first sample, counts; None: that of the first sample.
        """
        self._level = level
        self._groups: list[_Group] = []
        self._next = 0  # index of the next group to evaluate
        self._tail = np.zeros(0)
        self._pulse: UnrecordedPulse | None = None

    def add(
        self,
        start: int,
        end: int,
        load: NDArray[np.float64],
        reason: PulseReason,
        threshold: float,
    ) -> Iterator[UnrecordedPulse]:
        """Add the samples present between two indices; yield the pulses that are over.

        Parameters
        ----------
        start, end : int
            Indices of the group.
        load : (n,) ndarray of float, counts
            Its samples, positive in the direction of a pulse.
        reason : PulseReason
            Reason why a pulse in it is not recorded.
        threshold : float, counts
            Smallest peak to report.
        """
        if not load.size:
            return
        if not self._groups:
            level = float(load[0]) if self._level is None else min(self._level, float(load[0]))
            self._groups.append(_Group(start, start, level, -math.inf, reason))
        load = np.concatenate([self._tail, load])
        self._tail = load[len(load) - self._confirm + 1 :] if len(load) >= self._confirm else load
        if len(load) < self._confirm:
            return
        runs = np.lib.stride_tricks.sliding_window_view(load, self._confirm)
        low, high = float(runs.max(axis=1).min()), float(runs.min(axis=1).max())
        self._groups.append(_Group(start, end, low, high, reason))
        if self._next + REACH_QUANTA < len(self._groups):
            yield from self._evaluate(threshold)
            del self._groups[: max(0, self._next - REACH_QUANTA)]
            self._next = min(self._next, REACH_QUANTA)

    def finish(self, threshold: float, level: float | None = None) -> Iterator[UnrecordedPulse]:
        """Yield the remaining pulses, because the samples that follow are not watched.

        Afterwards the watch begins anew; see `add` and `begin` for the parameters.
        """
        if self._groups and self._tail.size:
            last, value = self._groups[-1], float(self._tail[-1])
            self._groups.append(_Group(last.end, last.end, value, -math.inf, last.reason))
            while self._next < len(self._groups):
                yield from self._evaluate(threshold)
        self.begin(level)

    def _evaluate(self, threshold: float) -> Iterator[UnrecordedPulse]:
        """Compare the next group with the groups around it."""
        number, group, pulse = self._next, self._groups[self._next], self._pulse
        self._next += 1
        before = self._groups[max(0, number - REACH_QUANTA) : number]
        after = self._groups[number + 1 : number + 1 + REACH_QUANTA]
        around = [min(each.low for each in side) for side in (before, after) if side]
        peak = group.high - max(around, default=group.high)
        if peak > threshold and pulse is None:
            self._pulse = UnrecordedPulse(group.start, group.end, peak, group.reason)
        elif peak > threshold and pulse is not None:
            peak = max(pulse.peak, peak)
            self._pulse = UnrecordedPulse(pulse.start, group.end, peak, pulse.reason)
        elif pulse is not None:
            self._pulse = None
            yield pulse
