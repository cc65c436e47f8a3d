"""One drop as the instrument recorded it: the load and one time history per sensor."""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

Quantity = Literal["velocity", "displacement"]


def nearest_first(offset: float) -> tuple[float, bool]:
    """Sorts sensors from the plate centre outward; at one distance the negative side comes last."""
    return abs(offset), offset < 0


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """The record of one sensor."""

    offset: float
    """Distance from the plate centre, m; 0 is the centre sensor, negative the other side of the
    plate: -0.3 and 0.3 are two sensors."""
    quantity: Quantity
    """What the sensor measured."""
    values: NDArray[np.float64]
    """Record, (n,), m/s or m, downward positive; read-only."""

    def __post_init__(self) -> None:
        # -0 is the centre, not another side: 0.0 takes the sign off it.
        object.__setattr__(self, "offset", self.offset + 0.0)
        object.__setattr__(self, "values", _read_only_vector(self.values, "values"))


@dataclass(frozen=True, slots=True)
class Peaks:
    """Peaks of a drop, offsets removed."""

    load: float
    """N."""
    displacements: tuple[tuple[float, float], ...]
    """Distance from the centre (m) and peak displacement (m) of each sensor, in their order."""

    @property
    def centre(self) -> float | None:
        """Of the sensor in the centre, m; None when there is none."""
        return next((peak for offset, peak in self.displacements if offset == 0), None)


@dataclass(frozen=True, eq=False, slots=True)
class Drop:
    """One fall of the weight, all channels on one time axis; or its peaks alone.

    A drop of which no more than peaks was recorded has no samples: nothing is made up.
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
    """As another program recorded them in place of traces; None: there are traces."""

    @classmethod
    def of_peaks(cls, number: int, peaks: Peaks) -> Self:
        """A drop without time histories."""
        none = np.empty(0)
        channels = tuple(Channel(offset, "displacement", none) for offset, _ in peaks.displacements)
        return cls(number, none, none, channels, peaks)

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
        # 0.0 takes the sign off -0, as in Channel.
        offsets = [offset + 0.0 for offset, _ in peaks.displacements]
        if self.time.size or offsets != [channel.offset for channel in self.channels]:
            raise ValueError(f"drop {self.number}: expected peaks of its sensors and no samples")
        if not np.isfinite(
            [peaks.load, *(peak for _, peak in peaks.displacements), *offsets]
        ).all():
            raise ValueError(f"drop {self.number}: expected finite peaks")

    @property
    def sampling_rate(self) -> float:
        """Samples per second, Hz, from the whole length of the time axis."""
        return float((self.time.size - 1) / (self.time[-1] - self.time[0]))

    def has_samples_of(self, other: Self) -> bool:
        """Whether two drops hold the same samples, bit for bit; never, where there are none."""
        pairs = [(self.time, other.time), (self.load, other.load)]
        if self.only_peaks is not None or len(self.channels) != len(other.channels):
            return False
        for mine, theirs in zip(self.channels, other.channels, strict=True):
            if (mine.offset, mine.quantity) != (theirs.offset, theirs.quantity):
                return False
            pairs.append((mine.values, theirs.values))
        return all(a.tobytes() == b.tobytes() for a, b in pairs)


def _read_only_vector(values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    # A copy: the caller's array neither changes the drop later nor is locked by it.
    vector = np.array(values, dtype=np.float64)
    if vector.ndim != 1:
        raise ValueError(f"{name}: expected one dimension, got shape {vector.shape}")
    vector.flags.writeable = False
    return vector
