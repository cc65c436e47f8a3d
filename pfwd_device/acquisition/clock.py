"""The clock of the instrument against the clock of this computer."""

from dataclasses import dataclass

import numpy as np

JUMP = 0.5
"""s; a step of the clock by more is a jump, not a delay on the way."""
_BACKWARD = 0.2
"""s; blocks may overtake each other by less."""
_PATIENCE = 3.0
"""s; a message may be delayed by more than `JUMP`, but not all of them for so long."""
_FIRST_WIDTH = 0.5
"""s; width of a bin, doubled whenever there are too many."""
_MOST_BINS = 128
_BINS_FOR_SPEED = 8
_SPAN_FOR_DRIFT = 15.0
"""s; arrivals jitter by 1 ms, which is 70 ppm of so much at worst."""
_REAL_TIME = 0.01
"""A clock that is off by more runs at another speed on purpose."""


@dataclass(slots=True)
class _Bin:
    number: int
    host: float
    delay: float


class DeviceClock:
    r"""How fast the instrument's clock runs, from when its messages arrive.

    .. math:: d_i = t_i^\text{host} - t_i^\text{device}

    A message comes late, never early: the smallest delay within a short time is the best one, and
    the slope of these over time is the drift. The slope is the median over all pairs (Theil-Sen),
    so that a time of slow arrivals does not bend it. Memory is bounded: when there are many bins,
    neighbours are joined.
    """

    def __init__(self) -> None:
        self.jumps = 0
        """Steps of the instrument's clock by more than `JUMP`."""
        self.restart()

    def restart(self) -> None:
        """Forget the estimate: the instrument's clock begins anew. Jumps stay counted."""
        self._bins: list[_Bin] = []
        self._width = _FIRST_WIDTH
        self._latest: dict[str, float] = {}
        self._late_since: float | None = None
        self._slope: tuple[int, float | None] = (0, None)

    def add(self, device: float, host: float, kind: str = "") -> None:
        """Take in the arrival of a message.

        Parameters
        ----------
        device : float, s
            Clock of the instrument when the message was made.
        host : float, s
            Monotonic clock of this computer when it came.
        kind : str
            Messages of one kind come in order; others may have waited longer in the instrument.
        """
        if self._jumped(device, host, kind):
            self.jumps += 1
            self.restart()
        self._latest[kind] = max(device, self._latest.get(kind, device))
        delay = host - device
        number = int(host // self._width)
        if self._bins and self._bins[-1].number >= number:
            if delay < self._bins[-1].delay:
                self._bins[-1] = _Bin(self._bins[-1].number, host, delay)
        else:
            self._bins.append(_Bin(number, host, delay))
            if len(self._bins) > _MOST_BINS:
                self._join_neighbours()

    @property
    def speed(self) -> float | None:
        """Seconds of the instrument per second of this computer, about 1 unless it is simulated or
        replayed at another speed; None: not known yet."""
        slope = self._fitted()
        return None if slope is None else 1.0 - slope

    @property
    def is_real_time(self) -> bool | None:
        """Whether the instrument keeps pace with this computer; None: not known yet."""
        speed = self.speed
        return None if speed is None else abs(speed - 1.0) < _REAL_TIME

    @property
    def drift_ppm(self) -> float | None:
        """By how much the instrument's clock gains, parts per million; None: not known yet, or
        another speed rather than a drift."""
        if not self.is_real_time or self._bins[-1].host - self._bins[0].host < _SPAN_FOR_DRIFT:
            return None
        speed = self.speed
        return None if speed is None else (speed - 1.0) * 1e6

    def _jumped(self, device: float, host: float, kind: str) -> bool:
        if device < self._latest.get(kind, device) - _BACKWARD:
            return True
        if not self.is_real_time:
            return False  # it leaps all the time
        ahead = min(each.delay for each in self._bins[-_BINS_FOR_SPEED:]) - (host - device)
        if ahead > JUMP:
            return True
        if ahead > -JUMP:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = host
        return host - self._late_since > _PATIENCE

    def _fitted(self) -> float | None:
        """Slope of the delay, s per s; computed anew when a bin is complete."""
        count = len(self._bins) - 1  # the last one may still sink
        if count < _BINS_FOR_SPEED:
            return None
        key = self._bins[-1].number
        if self._slope[0] != key or self._slope[1] is None:
            host = np.array([each.host for each in self._bins[:count]])
            delay = np.array([each.delay for each in self._bins[:count]])
            # Near neighbours are mostly jitter.
            rows, columns = np.triu_indices(count, max(1, count // 3))
            slopes = (delay[columns] - delay[rows]) / (host[columns] - host[rows])
            self._slope = (key, float(np.median(slopes)))
        return self._slope[1]

    def _join_neighbours(self) -> None:
        self._width *= 2
        best: dict[int, _Bin] = {}
        for each in self._bins:
            number = int(each.host // self._width)
            if number not in best or each.delay < best[number].delay:
                best[number] = _Bin(number, each.host, each.delay)
        self._bins = [best[number] for number in sorted(best)]
        self._slope = (0, None)
