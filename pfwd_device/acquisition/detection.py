"""What counts as a drop, what was seen of it, and the state that its detection began with."""

import dataclasses
import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError

BOUNCE_OVER_PREVIOUS = 0.7
"""Peak load of a bounce over that of the pulse before it: below this. On a spring the peak grows
with the speed of the impact, and a weight that keeps 0.7 of its speed keeps half of its energy;
rubber buffers return less. Two drops from one height differ by less than a quarter."""

LONGEST_FLIGHT = 0.7
"""s; a bounce follows the pulse before it at most so much later. A weight from 1.2 m that leaves
with `BOUNCE_OVER_PREVIOUS` of its speed is in the air for 0.69 s. A hand that catches the weight,
lifts it and lets it go takes longer."""


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
    """Time after the trigger of a drop in which its bounces are looked for, s; no bounce prolongs
    it. A weight from 1 m that returns 0.6 of its speed each time comes to rest within 1.36 s."""
    rebound_pre_trigger: float = 0.005
    """Kept before a rebound, s."""
    rebound_post_trigger: float = 0.030
    """Kept after it, s."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 < value < 1e9:
                raise SetupError(f"detection: {field.name}: expected a number > 0, got {value}")
        if not self.hysteresis < 1:
            raise SetupError(f"detection: hysteresis: expected below 1, got {self.hysteresis}")
        longest = max(self.pre_trigger, self.post_trigger, self.rebound_window)
        if longest > 10:
            raise SetupError(f"detection: expected times up to 10 s, got {longest}")


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


class PulseDoubt(enum.StrEnum):
    """Reason why a pulse of the load is reported: what became of it, and why."""

    REST_UNKNOWN = "not recorded: the load at rest was not known yet"
    NOT_RELEASED = "not recorded: the load had not returned to rest since the pulse before"
    CUT_OFF = "not recorded: the samples ended before it could be told from a bounce"
    MAYBE_BOUNCE = "recorded as a drop, may be a bounce: samples before it are missing"
    MAYBE_DROP = "recorded as a bounce, may be a drop: samples before it are missing"


@dataclass(frozen=True, slots=True)
class PulseReport:
    """A pulse of the load that is neither a certain drop nor a certain bounce."""

    stream: int
    """Number of the run of the sampler."""
    trigger: int
    """Index of its first sample above the threshold, within the stream; for a pulse that is not
    recorded, of the part of the stream that holds it."""
    peak: int
    """Counts above the load before it."""
    doubt: PulseDoubt


@dataclass(frozen=True, slots=True)
class ReboundsOver:
    """No more rebounds will come for the last drop."""
