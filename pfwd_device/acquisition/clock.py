"""Comparison of two clocks: of the instrument, of its samples, of this computer."""

from collections import deque
from dataclasses import dataclass

import numpy as np

JUMP_S = 0.5
"""Smallest step of the instrument's clock that counts as a jump; a smaller one counts as a delay of
the message, s."""
_MAX_REORDERING_S = 0.2
"""Largest decrease of the instrument's clock from one message to the next that counts as a change
of their order, s."""
_MAX_DELAYED_TIME_S = 3.0
"""Longest time for which all messages may be delayed by more than `JUMP_S`, s."""
_FIRST_BIN_WIDTH_S = 0.5
"""Initial width of a bin, s; it doubles whenever there are too many bins."""
_MAX_BINS = 128
_MIN_BINS_FOR_SPEED = 8
_MIN_SPAN_FOR_DRIFT_S = 15.0
"""Shortest time over which a drift is reported, s: the 1 ms of jitter of the arrivals is then at
most 70 ppm."""
_MAX_REAL_TIME_DEVIATION = 0.01
"""Largest relative deviation of a real clock; a larger one means that the instrument is simulated
or replayed at another speed."""


SMALLEST_LOSS_S = 0.03
"""Smallest loss of samples that is found by their delay, s; the smallest delays of an idle or busy
computer differ by less."""
_LOSS_PERIOD_S = 1.0
_LOSS_PERIODS, _LATE_PERIODS = 8, 3
"""Number of periods that are compared, and of those after a loss."""


@dataclass(slots=True)
class _Bin:
    """Message with the smallest delay within a period of the host's clock."""

    number: int
    """Number of the period."""
    host: float
    """Time of arrival, s."""
    delay: float
    """Time of arrival minus the clock of the instrument, s."""


class DeviceClock:
    r"""Estimator of the speed of the instrument's clock from the arrival times of messages.

    .. math:: d_i = t_i^\text{host} - t_i^\text{device}

    A message can be late but not early. So the smallest delay d of each period (bin) is the most
    accurate, and the slope of these delays over time is the drift. The slope is the median over
    pairs of bins (Theil-Sen), which a period of late arrivals does not distort. Neighbouring bins
    are joined when there are too many, so that memory is bounded.
    """

    def __init__(self) -> None:
        self.jumps = 0
        """Number of steps of the instrument's clock by more than `JUMP_S`."""
        self.restart()

    def restart(self) -> None:
        """Discard the estimate of the speed after a restart of the clock; keep the jump count."""
        self._bins: list[_Bin] = []
        self._width = _FIRST_BIN_WIDTH_S
        self._latest: dict[str, float] = {}
        self._late_since: float | None = None
        self._slope: tuple[int, float | None] = (0, None)

    def add(self, device: float, host: float, kind: str = "") -> None:
        """Add the arrival of a message.

        Parameters
        ----------
        device : float, s
            Clock of the instrument when the message was composed.
        host : float, s
            Monotonic clock of this computer at its arrival.
        kind : str
            Any name for the kind of message. Messages of one kind are expected in order, those of
            different kinds are not.
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
            if len(self._bins) > _MAX_BINS:
                self._join_neighbours()

    @property
    def speed(self) -> float | None:
        """Speed of the instrument's clock, s per s of this computer; None before an estimate.

        It is about 1 unless the instrument is simulated or replayed at another speed.
        """
        slope = self._fitted()
        return None if slope is None else 1.0 - slope

    @property
    def is_real_time(self) -> bool | None:
        """True if the instrument runs in real time; None before an estimate."""
        speed = self.speed
        return None if speed is None else abs(speed - 1.0) < _MAX_REAL_TIME_DEVIATION

    @property
    def drift_ppm(self) -> float | None:
        """Drift of the instrument's clock, parts per million, positive if it runs fast.

        None before an estimate, or if the clock does not run in real time.
        """
        if (
            not self.is_real_time
            or self._bins[-1].host - self._bins[0].host < _MIN_SPAN_FOR_DRIFT_S
        ):
            return None
        speed = self.speed
        return None if speed is None else (speed - 1.0) * 1e6

    @property
    def steady_deviation(self) -> float | None:
        """Relative excess of the speed over 1 that both halves of the time show; None before 15 s.

        It is that of the half with the smaller one, and 0 if the signs differ: a jump of a clock
        or a period of late arrivals distorts one half only.
        """
        bins = self._bins[:-1]
        middle = len(bins) // 2
        if middle < _MIN_BINS_FOR_SPEED or bins[-1].host - bins[0].host < _MIN_SPAN_FOR_DRIFT_S:
            return None
        first, second = -_slope_of(bins[:middle]), -_slope_of(bins[middle:])
        return min(first, second, key=abs) if first * second > 0 else 0.0

    def _jumped(self, device: float, host: float, kind: str) -> bool:
        if device < self._latest.get(kind, device) - _MAX_REORDERING_S:
            return True
        if not self.is_real_time:
            return False  # at another speed every step exceeds the limit
        ahead = min(each.delay for each in self._bins[-_MIN_BINS_FOR_SPEED:]) - (host - device)
        if ahead > JUMP_S:
            return True
        if ahead > -JUMP_S:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = host
        return host - self._late_since > _MAX_DELAYED_TIME_S

    def _fitted(self) -> float | None:
        """Return the slope of the delay over time, s per s; None while there are too few bins."""
        count = len(self._bins) - 1  # the delay of the last bin may still decrease
        if count < _MIN_BINS_FOR_SPEED:
            return None
        key = self._bins[-1].number
        if self._slope[0] != key or self._slope[1] is None:
            self._slope = (key, _slope_of(self._bins[:count]))
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


class LossWatch:
    """Finds lost samples of an instrument that neither counts nor times its samples.

    After a loss every sample arrives with the same additional delay, while a busy computer delays
    samples only for a while. So the smallest delays of successive periods are compared.
    """

    def __init__(self) -> None:
        self._smallest: deque[float] = deque(maxlen=_LOSS_PERIODS)
        """Smallest delay of each of the latest periods, s, the present one last."""
        self._period = -1

    def add(self, counted: float, host: float) -> float | None:
        """Add samples; return the time that was lost, s, once a loss is certain, else None.

        Parameters
        ----------
        counted : float, s
            Time by the number of samples.
        host : float, s
            Monotonic clock of this computer at the arrival of the last of them.
        """
        delay, period = host - counted, int(host // _LOSS_PERIOD_S)
        if period == self._period and self._smallest:
            self._smallest[-1] = min(self._smallest[-1], delay)
            return None
        full = len(self._smallest) == _LOSS_PERIODS
        earlier, late = list(self._smallest)[:-_LATE_PERIODS], list(self._smallest)[-_LATE_PERIODS:]
        self._period = period
        self._smallest.append(delay)
        if full:
            lost, growth = min(late) - max(earlier), max(earlier) - min(earlier)
            if lost > SMALLEST_LOSS_S + growth:  # a steady growth is a wrong sampling rate
                self._smallest.clear()
                return lost
        return None


def _slope_of(bins: list[_Bin]) -> float:
    """Return the median slope of the delay over time, s per s."""
    host = np.array([each.host for each in bins])
    delay = np.array([each.delay for each in bins])
    # Pairs of bins that are close to each other are omitted: their slope is mostly jitter.
    rows, columns = np.triu_indices(len(bins), max(1, len(bins) // 3))
    return float(np.median((delay[columns] - delay[rows]) / (host[columns] - host[rows])))
