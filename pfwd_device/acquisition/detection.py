"""What counts as a drop, what was seen of it, and the state that its detection began with."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """When a drop begins and how much of it is kept."""

    threshold: float = 400.0
    """Load above rest that starts a drop, N; raised to `noise_factor` times the noise."""
    noise_factor: float = 8.0
    """Least threshold over the root mean square of the load's noise."""
    hysteresis: float = 0.5
    """Part of the threshold below which the load counts as gone again."""
    confirm: float = 3e-4
    """How long the load has to stay above the threshold, s: an electric spike does not."""
    pre_trigger: float = 0.020
    """Kept before the trigger, s."""
    post_trigger: float = 0.100
    """Kept after it, s."""
    rebound_window: float = 1.5
    """A smaller pulse within this time after a drop or its last rebound is a bounce, s: no hand
    lifts and drops the weight again so fast."""
    rebound_pre_trigger: float = 0.005
    """Kept before a rebound, s."""
    rebound_post_trigger: float = 0.030
    """Kept after it, s."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 < value < 1e9:
                raise SetupError(f"detection: {field.name}: expected a number > 0, came {value}")
        if not self.hysteresis < 1:
            raise SetupError(f"detection: hysteresis: expected below 1, came {self.hysteresis}")
        longest = max(self.pre_trigger, self.post_trigger, self.rebound_window)
        if longest > 10:
            raise SetupError(f"detection: expected times up to 10 s, came {longest}")


@dataclass(frozen=True, slots=True)
class AtRest:
    """What the detector knows of the load at rest; given back to it, a replay finds the same."""

    load: float
    """Counts."""
    noise: float
    """Root mean square, counts."""


@dataclass(frozen=True, eq=False, slots=True)
class RawDrop:
    """The samples of one drop as they came."""

    stream: int
    """Number of the run of the sampler."""
    first: int
    """Index of the first sample within the stream."""
    trigger: int
    """Index of the sample at time 0 within the counts."""
    counts: NDArray[np.int32]
    """(n, channels); 0 where samples are missing."""
    missing: tuple[tuple[int, int], ...]
    """(start, length) of samples that never came, within the counts."""
    at_rest: AtRest
    """The load before the drop."""
    threshold: float
    """Counts above rest that triggered; 0 when the operator did."""
    by_operator: bool
    """Whether the operator triggered, not the load."""
    cut_off: str | None
    """Why the record ends before its time; None when it does not."""
    saturated: tuple[tuple[int, int], ...]
    """(channel, count) of samples at the end of the converter's range."""


@dataclass(frozen=True, eq=False, slots=True)
class RawRebound:
    """The samples of a later bounce of the same hammer."""

    stream: int
    """Number of the run of the sampler."""
    first: int
    """Index of the first sample within the stream."""
    trigger: int
    """Index of the sample that triggered, within the stream."""
    after: int
    """Index of the sample at time 0 of the drop that it belongs to, within the stream."""
    peak: int
    """Counts above rest."""
    counts: NDArray[np.int32]
    """(n, channels); 0 where samples are missing."""


@dataclass(frozen=True, slots=True)
class ReboundsOver:
    """No more rebounds will come for the last drop."""
