"""Sample indices from the times that an instrument prints: gaps, repeats, restarts, wrap-around."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WRAP_US = 2.0**32
"""A clock of 32 bits begins anew after 71.6 minutes."""
WRAP_REACH_US = 60e6
"""A clock that is behind is taken to have wrapped if it is ahead by less than this, so; a longer
silence across a wrap looks like a restart. An instrument that restarts less than this before its
clock would have wrapped looks like a gap."""
LONGEST_GAP_US = 3600e6
"""What is missing for longer begins a new stream: no record goes on after an hour."""
FIRST_REACH = 100
"""Steps within which the second line of a stream confirms the first, whose time may have lost its
first digits: reading began in the middle of the line."""
TOLERANCE, PULLED = 0.4, 0.35
"""Steps. A time this far off the grid of expected times moves the grid until it is so far off: the
grid follows a clock that drifts, and ignores one that merely jitters."""
STREAMS = 1 << 32


@dataclass(frozen=True, eq=False, slots=True)
class Placed:
    """Where the lines belong."""

    good: NDArray[np.bool_]
    """(n,), whether the line is a sample."""
    stream: NDArray[np.int64]
    """(n,), number of its stream."""
    index: NDArray[np.int64]
    """(n,), index in its stream."""
    clock_us: NDArray[np.int64]
    """(n,), time without wrap-around."""
    pending: bool
    """The last line cannot be judged yet and is to be given again, before the next ones."""


class SampleClock:
    """Finds the index of each line from its time.

    The expected times form a grid with the step of the sampling rate; a line belongs to the nearest
    of them. One that is not the next is believed when the line after it agrees: one wrong digit
    costs one line, not the stream. The grid follows a slow drift, so errors do not add up.

    Parameters
    ----------
    sampling_rate : float, Hz
    first_stream : int
        Number of the first stream; each restart adds one.
    """

    def __init__(self, sampling_rate: float, first_stream: int = 0) -> None:
        self._steps_per_us = sampling_rate / 1e6
        self._stream = first_stream % STREAMS
        self._index = -1
        # The expected time of the last sample lies `_count` steps behind the anchor.
        self._anchor = math.nan
        self._count = 0
        self._turned = 0

    def place(self, times: NDArray[np.float64]) -> Placed:
        """Judge lines.

        Parameters
        ----------
        times : (n,) ndarray of float, us
            Whole numbers below 2^53.

        Returns
        -------
        Placed
        """
        count = times.size
        ahead = (times - self._anchor) * self._steps_per_us - (self._count + np.arange(count))
        if not (np.abs(ahead - 1) <= TOLERANCE).all():  # or there is no last one: NaN
            return self._place_each(times)
        index = np.arange(self._index + 1, self._index + 1 + count)
        self._index += count
        self._count += count
        return Placed(
            good=np.ones(count, dtype=np.bool_),
            stream=np.full(count, self._stream, dtype=np.int64),
            index=index,
            clock_us=times.astype(np.int64) + self._turned,
            pending=False,
        )

    def _place_each(self, times: NDArray[np.float64]) -> Placed:
        values: list[float] = times.tolist()
        good = np.zeros(len(values), dtype=np.bool_)
        rows = np.zeros((3, len(values)), dtype=np.int64)
        pending = False
        for at, time in enumerate(values):
            ahead = self._ahead(time)
            if abs(ahead) <= 0.5:
                continue  # a repeat
            if 0.5 < ahead < 1.5:
                self._go_on(time, 1, ahead - 1)
            elif at + 1 == len(values):
                pending = True
                break
            elif not self._accept(time, values[at + 1]):
                continue
            good[at] = True
            rows[:, at] = self._stream, self._index, int(time) + self._turned
        return Placed(good, rows[0], rows[1], rows[2], pending)

    def _ahead(self, time: float) -> float:
        """Steps after the expected time of the last sample; NaN when there is none."""
        return self._steps(self._anchor, self._count, time)

    def _steps(self, anchor: float, count: int, time: float) -> float:
        """Steps after a time that lies some steps behind an anchor; negative: not after it."""
        steps = (time - anchor) * self._steps_per_us - count
        if steps < -0.5 and anchor + count / self._steps_per_us < WRAP_US:
            turned = steps + WRAP_US * self._steps_per_us
            if turned < WRAP_REACH_US * self._steps_per_us:
                return turned
        return steps if steps <= LONGEST_GAP_US * self._steps_per_us else -math.inf

    def _accept(self, time: float, following: float) -> bool:
        """Judge a line that is not one step after the last by the line after it."""
        ahead, beyond = self._ahead(time), self._ahead(following)
        between = self._steps(time, 0, following)
        if between > 0 and 1.5 <= ahead < beyond < 2.5:
            # One late line between punctual ones is not a gap and a repeat.
            self._go_on(time, 1, 0.0)
            return True
        next_ = 0.5 < between < 1.5
        if ahead > 0.5 and (next_ or between > 0.5):  # a gap, perhaps after a gap
            missing = round(ahead)
            self._go_on(time, missing, ahead - missing)
            return True
        # Not one wrong time between two right ones.
        if next_ or (not beyond > 0.5 and 0.5 < between <= FIRST_REACH):
            self._begin(time)
            return True
        return False

    def _go_on(self, time: float, steps: int, off: float) -> None:
        """Take a line of this stream, so far off the grid."""
        if (time - self._anchor) * self._steps_per_us < self._count - 0.5:
            self._turned += int(WRAP_US)
            self._anchor -= WRAP_US
        self._index += steps
        self._count += steps
        if abs(off) > TOLERANCE:
            self._anchor = time - math.copysign(PULLED, off) / self._steps_per_us
            self._count = 0

    def _begin(self, time: float) -> None:
        """Take the first line of a stream."""
        if not math.isnan(self._anchor):
            self._stream = (self._stream + 1) % STREAMS
        self._anchor = time
        self._count = self._index = self._turned = 0
