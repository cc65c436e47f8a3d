"""Data of one drop: the time histories of the load cell and of each sensor of motion."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pfwd_plugins.quantities import Measurand, motion


def nearest_first(offset: float) -> tuple[float, bool]:
    """Return the sort key that orders sensors from the plate centre outward.

    Of two sensors at the same distance the one with the negative offset is the later.

    Parameters
    ----------
    offset : float, m
        Position of the sensor; see `Channel.offset`.
    """
    return abs(offset), offset < 0


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """Time history of one sensor of motion."""

    offset: float
    """Distance from the plate centre, m; 0 is the centre sensor, negative the other side of the
    plate: -0.3 and 0.3 are two sensors."""
    quantity: Measurand
    """Measured quantity; its name is accepted."""
    values: NDArray[np.float64]
    """Record, (n,), m/s or m, downward positive; read-only."""

    def __post_init__(self) -> None:
        # Adding 0.0 turns -0.0 into 0.0: both are the centre.
        object.__setattr__(self, "offset", self.offset + 0.0)
        object.__setattr__(self, "quantity", motion(self.quantity))
        object.__setattr__(self, "values", _read_only_vector(self.values, "values"))


@dataclass(frozen=True, slots=True)
class Peaks:
    """Peak load and peak displacements of a drop, each relative to the value at rest."""

    load: float
    """Peak load, N."""
    displacements: tuple[tuple[float, float], ...]
    """Distance from the centre (m) and peak displacement (m) of each sensor, in their order."""

    @property
    def centre(self) -> float | None:
        """Peak displacement of the centre sensor, m; None without such a sensor."""
        return next((peak for offset, peak in self.displacements if offset == 0), None)


@dataclass(frozen=True, eq=False, slots=True)
class Drop:
    """One impact of the falling weight, with all channels on one time axis.

    A drop of which another program stored only the peaks has no samples; see `only_peaks`.
    """

    number: int
    """Number of the drop within its test point, from 1."""
    time: NDArray[np.float64]
    """Time, (n,), s, uniform steps; 0 is the trigger, negative before it; read-only."""
    load: NDArray[np.float64]
    """Force of the load cell, (n,), N, downward positive; read-only."""
    channels: tuple[Channel, ...]
    """The sensors, each with n values."""
    only_peaks: Peaks | None = None
    """Peaks that another program recorded in place of traces; None for a drop with traces."""

    @classmethod
    def of_peaks(cls, number: int, peaks: Peaks) -> Self:
        """Return a drop that has peaks and no time histories.

        Parameters
        ----------
        number : int
            Number of the drop within its test point, from 1.
        peaks : Peaks
        """
        no_samples = np.empty(0)
        channels = tuple(
            Channel(offset, Measurand.DISPLACEMENT, no_samples) for offset, _ in peaks.displacements
        )
        return cls(number, no_samples, no_samples, channels, peaks)

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _read_only_vector(self.time, "time"))
        object.__setattr__(self, "load", _read_only_vector(self.load, "load"))
        if self.only_peaks is not None:
            self._check_peaks(self.only_peaks)
        elif self.time.size < 2:
            raise ValueError(
                f"drop {self.number}: expected at least 2 samples, got {self.time.size}"
            )
        lengths = [self.load.size, *(channel.values.size for channel in self.channels)]
        if any(length != self.time.size for length in lengths):
            raise ValueError(
                f"drop {self.number}: expected {self.time.size} samples as in the time axis in the "
                f"load and every channel, got {lengths}"
            )

    def _check_peaks(self, peaks: Peaks) -> None:
        # Adding 0.0 turns -0.0 into 0.0, as in Channel.
        offsets = [offset + 0.0 for offset, _ in peaks.displacements]
        if self.time.size or offsets != [channel.offset for channel in self.channels]:
            raise ValueError(
                f"drop {self.number}: expected peaks at the offsets of its channels and no "
                f"samples, got offsets {offsets} and {self.time.size} samples"
            )
        if not np.isfinite(
            [peaks.load, *(peak for _, peak in peaks.displacements), *offsets]
        ).all():
            raise ValueError(f"drop {self.number}: expected finite peaks, got {peaks}")

    @property
    def sampling_rate(self) -> float:
        """Mean sampling rate over the time axis, Hz."""
        return float((self.time.size - 1) / (self.time[-1] - self.time[0]))

    def has_samples_of(self, drop: Self) -> bool:
        """Return True if both drops have the same samples, bit for bit; False without samples."""
        pairs = [(self.time, drop.time), (self.load, drop.load)]
        if self.only_peaks is not None or len(self.channels) != len(drop.channels):
            return False
        for mine, theirs in zip(self.channels, drop.channels, strict=True):
            if (mine.offset, mine.quantity) != (theirs.offset, theirs.quantity):
                return False
            pairs.append((mine.values, theirs.values))
        return all(a.tobytes() == b.tobytes() for a, b in pairs)


def _read_only_vector(values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    # A copy: a later change of the caller's array does not reach the drop, and it stays writable.
    vector = np.array(values, dtype=np.float64)
    if vector.ndim != 1:
        raise ValueError(f"{name}: expected one dimension, got shape {vector.shape}")
    vector.flags.writeable = False
    return vector
