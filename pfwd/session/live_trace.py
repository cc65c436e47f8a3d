"""Last seconds of load and velocity, reduced to the points that a screen can show.

The samples of each short interval are reduced to their smallest and largest value, so that a narrow
peak stays visible.
"""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd.session.events import LiveSamples
from pfwd_device.calibration import load_channel, sensor_channels, to_si
from pfwd_plugins.quantities import Measurand

ENVELOPE_INTERVAL = 0.01
"""Length of an interval, s: shorter than a pulse, and short enough that the window has more
intervals than a terminal has columns."""

WINDOW = 5.0
"""Length of the displayed trace, s."""

RECENT = 3
"""Number of last intervals in which `last_peak` searches."""


@dataclass(frozen=True, eq=False, slots=True)
class Envelope:
    """Smallest and largest values of consecutive intervals, the oldest first."""

    interval: float
    """Length of an interval, s."""
    load: NDArray[np.float64]
    """Smallest and largest load, (n, 2), N."""
    velocity: NDArray[np.float64]
    """Smallest and largest value of the first sensor, (n, 2), SI unit of `quantity`."""
    samples: int
    """Number of samples received since the start of the session."""
    quantity: Measurand
    """Quantity of the first sensor."""


class LiveTrace:
    """Buffer between the thread that receives samples and the thread that draws them.

    Parameters
    ----------
    window : float, s
        Length of the trace that is kept.
    """

    def __init__(self, window: float = WINDOW) -> None:
        self._lock = threading.Lock()
        self._length = max(1, round(window / ENVELOPE_INTERVAL))
        self._samples = 0
        self._quantity = Measurand.VELOCITY
        self._clear()

    def _clear(self) -> None:
        self._rows: NDArray[np.float64] = np.empty((0, 4))
        self._open: int | None = None
        self._stream: int | None = None

    def clear(self) -> None:
        """Remove all samples, because the connection was lost."""
        with self._lock:
            self._clear()

    def feed(self, event: LiveSamples) -> None:
        """Append samples; those of a new sampling run start a new trace."""
        samples, identity = event.samples, event.identity
        if samples.shunt or not len(samples.counts):  # with the shunt on there is no real load
            return
        load, sensor = load_channel(identity), sensor_channels(identity)[0]
        step = max(1, round(ENVELOPE_INTERVAL * identity.sampling_rate))
        index = (samples.first + np.arange(len(samples.counts))) // step
        starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        rows = np.empty((len(starts), 4))
        for place, channel in ((0, load), (2, sensor)):
            values = to_si(samples.counts[:, channel], identity.channels[channel], identity)
            rows[:, place] = np.minimum.reduceat(values, starts)
            rows[:, place + 1] = np.maximum.reduceat(values, starts)
        first = int(index[0])
        with self._lock:
            self._samples += len(samples.counts)
            self._quantity = identity.channels[sensor].quantity
            if samples.stream != self._stream:
                self._clear()
                self._stream = samples.stream
            if self._open == first and len(self._rows):
                last = self._rows[-1]
                last[0::2] = np.minimum(last[0::2], rows[0, 0::2])
                last[1::2] = np.maximum(last[1::2], rows[0, 1::2])
                rows = rows[1:]
            self._rows = np.concatenate([self._rows, rows])[-self._length :]
            self._open = int(index[-1])

    def envelope(self) -> Envelope:
        """Return the last `window` seconds as smallest and largest values of short intervals."""
        with self._lock:
            rows = self._rows.copy()
            samples, quantity = self._samples, self._quantity
        return Envelope(ENVELOPE_INTERVAL, rows[:, 0:2], rows[:, 2:4], samples, quantity)

    @property
    def samples(self) -> int:
        """Number of samples received since the start of the session."""
        return self._samples

    def last_peak(self) -> float:
        """Return the largest load of the last intervals above the median of the trace, N."""
        with self._lock:
            if len(self._rows) < 2:
                return 0.0
            rest = float(np.median(self._rows[:, 0]))
            return float(self._rows[-RECENT:, 1].max()) - rest
