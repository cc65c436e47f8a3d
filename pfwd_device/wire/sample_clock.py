"""Sample indices from printed times: gaps, repeats, restarts and wrap-around of the clock."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CLOCK_PERIOD_US = 2.0**32
"""Period of a 32-bit clock, us: it wraps after 71.6 minutes."""
MAX_WRAP_STEP_US = 60e6
"""Longest time across a wrap of the clock, us. A time before the last one counts as wrapped if the
step across the wrap is shorter than this. A longer silence across a wrap counts as a restart. A
restart less than this before the wrap counts as a gap."""
MAX_GAP_US = 3600e6
"""Longest gap within a stream, us; a longer one starts a new stream, as no record lasts an hour."""
MAX_FIRST_GAP_STEPS = 100
"""Largest gap between the first two lines of a stream, steps. The second line confirms the time of
the first, which may lack its first digits if reading began in the middle of the line."""
MAX_OFF_GRID_STEPS, OFF_GRID_AFTER_SHIFT_STEPS = 0.4, 0.35
"""Deviation of a time from the grid of expected times that shifts the grid, and the deviation after
the shift, steps. So the grid follows a drift of the clock and ignores its jitter."""
N_STREAM_NUMBERS = 1 << 32


@dataclass(frozen=True, eq=False, slots=True)
class PlacedLines:
    """Stream and index of each line."""

    good: NDArray[np.bool_]
    """(n,), True if the line is a sample."""
    stream: NDArray[np.int64]
    """(n,), number of its stream."""
    index: NDArray[np.int64]
    """(n,), index in its stream."""
    clock_us: NDArray[np.int64]
    """(n,), time without wrap-around."""
    pending: bool
    """True if the last line cannot be judged yet; pass it again, before the next lines."""


class SampleClock:
    """Determines the index of each line from its time.

    The expected times form a grid with the step of the sampling rate; a line belongs to the nearest
    of them. A line that is not the next one is accepted only if the following line confirms it:
    one wrong digit costs one line, not the stream. The grid follows a slow drift, so errors do not
    add up.

    Parameters
    ----------
    sampling_rate : float, Hz
    first_stream : int
        Number of the first stream; each restart adds one.
    """

    def __init__(self, sampling_rate: float, first_stream: int = 0) -> None:
        self._steps_per_us = sampling_rate / 1e6
        self._stream = first_stream % N_STREAM_NUMBERS
        self._index = -1
        # The expected time of the last sample lies `_count` steps behind the anchor.
        self._anchor = math.nan
        self._count = 0
        self._wrapped_us = 0

    def place(self, times: NDArray[np.float64]) -> PlacedLines:
        """Return the place of each line.

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
        if not (np.abs(ahead - 1) <= MAX_OFF_GRID_STEPS).all():  # NaN before the first sample
            return self._place_each(times)
        index = np.arange(self._index + 1, self._index + 1 + count)
        self._index += count
        self._count += count
        return PlacedLines(
            good=np.ones(count, dtype=np.bool_),
            stream=np.full(count, self._stream, dtype=np.int64),
            index=index,
            clock_us=times.astype(np.int64) + self._wrapped_us,
            pending=False,
        )

    def _place_each(self, times: NDArray[np.float64]) -> PlacedLines:
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
            rows[:, at] = self._stream, self._index, int(time) + self._wrapped_us
        return PlacedLines(good, rows[0], rows[1], rows[2], pending)

    def _ahead(self, time: float) -> float:
        """Return the steps after the expected time of the last sample; NaN before the first."""
        return self._steps(self._anchor, self._count, time)

    def _steps(self, anchor: float, count: int, time: float) -> float:
        """Return the steps after the time `count` steps behind an anchor; negative: before it."""
        steps = (time - anchor) * self._steps_per_us - count
        if steps < -0.5 and anchor + count / self._steps_per_us < CLOCK_PERIOD_US:
            turned = steps + CLOCK_PERIOD_US * self._steps_per_us
            if turned < MAX_WRAP_STEP_US * self._steps_per_us:
                return turned
        return steps if steps <= MAX_GAP_US * self._steps_per_us else -math.inf

    def _accept(self, time: float, following: float) -> bool:
        """Accept or reject a line that is not one step after the last, by the following line."""
        ahead, beyond = self._ahead(time), self._ahead(following)
        between = self._steps(time, 0, following)
        if between > 0 and 1.5 <= ahead < beyond < 2.5:
            # One late line between two on time is not a gap followed by a repeat.
            self._go_on(time, 1, 0.0)
            return True
        next_ = 0.5 < between < 1.5
        if ahead > 0.5 and (next_ or between > 0.5):  # a gap, perhaps after a gap
            missing = round(ahead)
            self._go_on(time, missing, ahead - missing)
            return True
        # A restart, and not one wrong time between two right ones.
        if next_ or (not beyond > 0.5 and 0.5 < between <= MAX_FIRST_GAP_STEPS):
            self._begin(time)
            return True
        return False

    def _go_on(self, time: float, steps: int, off: float) -> None:
        """Accept a line of this stream that is `off` steps off the grid."""
        if (time - self._anchor) * self._steps_per_us < self._count - 0.5:
            self._wrapped_us += int(CLOCK_PERIOD_US)
            self._anchor -= CLOCK_PERIOD_US
        self._index += steps
        self._count += steps
        if abs(off) > MAX_OFF_GRID_STEPS:
            deviation = math.copysign(OFF_GRID_AFTER_SHIFT_STEPS, off)
            self._anchor = time - deviation / self._steps_per_us
            self._count = 0

    def _begin(self, time: float) -> None:
        """Accept the first line of a stream."""
        if not math.isnan(self._anchor):
            self._stream = (self._stream + 1) % N_STREAM_NUMBERS
        self._anchor = time
        self._count = self._index = self._wrapped_us = 0
