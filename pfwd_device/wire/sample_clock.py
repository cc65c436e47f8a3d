"""Indices of samples from the times that an instrument prints with them.

The times reveal gaps, repeated lines, restarts of the instrument and the wrap-around of its clock.
A stream is a run of samples between two restarts.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CLOCK_PERIOD_US = 2.0**32
"""Period of a 32-bit clock, us: it wraps after 71.6 minutes."""
MAX_WRAP_STEP_US = 60e6
"""Longest step from one time to the next across a wrap of the clock, us. A time before the last one
counts as wrapped if the step is shorter than this, and otherwise as a restart."""
MAX_GAP_US = 3600e6
"""Longest gap within a stream, us; a longer one starts a new stream, as no drop lasts an hour."""
MAX_FIRST_GAP_STEPS = 100
"""Largest gap between the first two lines of a stream, in sampling steps. The second line confirms
the time of the first, whose first digits are missing if reading began in the middle of the line."""
MAX_OFF_GRID_STEPS, OFF_GRID_AFTER_SHIFT_STEPS = 0.4, 0.35
"""Deviation of a time from the grid of expected times above which the grid is shifted, and the
deviation after the shift, in sampling steps. The grid follows a drift of the clock, not its jitter.
"""
N_STREAM_NUMBERS = 1 << 32


@dataclass(frozen=True, eq=False, slots=True)
class PlacedLines:
    """Stream and sample index of each of n lines."""

    good: NDArray[np.bool_]
    """(n,), True if the line is a sample."""
    stream: NDArray[np.int64]
    """(n,), number of the stream to which the line belongs."""
    index: NDArray[np.int64]
    """(n,), index of the sample in its stream."""
    clock_us: NDArray[np.int64]
    """(n,), time without wrap-around."""
    pending: bool
    """True if the last line cannot be judged without the next one. The caller passes it to
    `SampleClock.place` again, before the next lines."""


class SampleClock:
    """Determines the sample index of each printed line from its time.

    The expected times form a grid with the step of the sampling rate; a line belongs to the nearest
    of them. A line that does not follow the last one by one step is accepted only if the line after
    it confirms it. So a wrong digit costs one line, not the stream. The grid follows a slow drift
    of the clock, so errors do not add up.

    Parameters
    ----------
    sampling_rate : float, Hz
    first_stream : int
        Number of the first stream (run of samples); each restart of the instrument adds one.
    """

    def __init__(self, sampling_rate: float, first_stream: int = 0) -> None:
        self._steps_per_us = sampling_rate / 1e6
        self._stream = first_stream % N_STREAM_NUMBERS
        self._index = -1
        # The expected time of the last sample lies `_count` steps after the anchor.
        self._anchor = math.nan
        self._count = 0
        self._wrapped_us = 0

    def place(self, times: NDArray[np.float64]) -> PlacedLines:
        """Return the stream and the sample index of each line.

        Parameters
        ----------
        times : (n,) ndarray of float, us
            Printed times, whole numbers below 2^53.

        Returns
        -------
        PlacedLines
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
                continue  # a repeated line
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
        """Return the sampling steps from the expected time of the last sample to a time.

        NaN before the first sample.
        """
        return self._steps(self._anchor, self._count, time)

    def _steps(self, anchor: float, count: int, time: float) -> float:
        """Return the sampling steps to `time` from the time `count` steps after `anchor`.

        A wrap of the clock is taken into account. The result is negative for an earlier time and
        -inf across a gap that is too long for one stream.
        """
        steps = (time - anchor) * self._steps_per_us - count
        if steps < -0.5 and anchor + count / self._steps_per_us < CLOCK_PERIOD_US:
            turned = steps + CLOCK_PERIOD_US * self._steps_per_us
            if turned < MAX_WRAP_STEP_US * self._steps_per_us:
                return turned
        return steps if steps <= MAX_GAP_US * self._steps_per_us else -math.inf

    def _accept(self, time: float, following: float) -> bool:
        """Return True if the following line confirms a line that does not follow by one step.

        An accepted line continues the stream after a gap or begins a new stream.
        """
        ahead, beyond = self._ahead(time), self._ahead(following)
        between = self._steps(time, 0, following)
        if between > 0 and 1.5 <= ahead < beyond < 2.5:
            # One late line between two punctual ones: without this case it would be taken for a
            # gap, and the next line for a repeat.
            self._go_on(time, 1, 0.0)
            return True
        next_ = 0.5 < between < 1.5
        if ahead > 0.5 and (next_ or between > 0.5):  # a gap, perhaps after a gap
            missing = round(ahead)
            self._go_on(time, missing, ahead - missing)
            return True
        # A restart; a single wrong time between two right ones does not pass this test.
        if next_ or (not beyond > 0.5 and 0.5 < between <= MAX_FIRST_GAP_STEPS):
            self._begin(time)
            return True
        return False

    def _go_on(self, time: float, steps: int, off: float) -> None:
        """Accept a line `steps` after the last one, which deviates by `off` steps from the grid."""
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
        """Begin a stream with a line of this time."""
        if not math.isnan(self._anchor):
            self._stream = (self._stream + 1) % N_STREAM_NUMBERS
        self._anchor = time
        self._count = self._index = self._wrapped_us = 0
