"""Settings of the drop detection, and its results: drops, rebounds and reports.

A pulse is a time in which the load departs from its value at rest. A drop is the first impact of
the weight; a rebound or bounce is a later impact of the same fall, after the weight was thrown back
up. Samples are counted within a stream, a run of samples from a start or reset of the instrument to
the next. Counts are the integers that the converter of the instrument returns.
"""

import dataclasses
import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd_device.errors import SetupError

MAX_BOUNCE_PEAK_RATIO = 0.7
"""Largest peak load of a bounce, relative to the peak load of the pulse before it. On a spring the
peak load is proportional to the speed of the impact. A weight with 0.7 of its speed has half of its
energy, and rubber buffers return less. Two drops from one height differ by less than a quarter."""

MAX_FLIGHT_TIME_S = 0.7
"""Longest time between a pulse and its bounce, s. A weight that falls from 1.2 m and leaves with
`MAX_BOUNCE_PEAK_RATIO` of its speed is in the air for 0.69 s. Catching the weight by hand, lifting
and releasing it takes longer."""


@dataclass(frozen=True, slots=True)
class DetectionSettings:
    """Settings of the drop detection: the load that starts a drop, and the length of records."""

    threshold: float = 400.0
    """Load above rest that starts a drop, N; at least `noise_factor` times the noise."""
    noise_factor: float = 8.0
    """Smallest threshold, relative to the root mean square of the load's noise."""
    hysteresis: float = 0.5
    """Fraction of the threshold below which a pulse has ended, so that the next one can begin."""
    confirm: float = 3e-4
    """Time for which the load has to exceed the threshold, s: longer than an electric spike."""
    pre_trigger: float = 0.020
    """Length of the record before the trigger, s."""
    post_trigger: float = 0.100
    """Length of the record after the trigger, s."""
    rebound_window: float = 1.5
    """Time after the trigger of a drop in which its bounces are detected, s; no bounce extends it.
    A weight from 1 m that keeps 0.6 of its speed at each bounce is at rest after 1.36 s."""
    rebound_pre_trigger: float = 0.008
    """Length of the record of a rebound before its trigger, s: half a pulse of 15 ms. If the load
    at rest changes, the trigger may lie in the fall of the pulse; its peak is then recorded too."""
    rebound_post_trigger: float = 0.030
    """Length of the record of a rebound after its trigger, s."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 < value < 1e9:
                raise SetupError(f"detection: {field.name}: expected a number > 0, got {value}")
        if not self.hysteresis < 1:
            raise SetupError(f"detection: hysteresis: expected below 1, got {self.hysteresis}")
        longest = max(self.pre_trigger, self.post_trigger, self.rebound_window)
        if longest > 10:
            raise SetupError(
                "detection: expected pre_trigger, post_trigger and rebound_window up to 10 s, got "
                f"{longest}"
            )


@dataclass(frozen=True, slots=True)
class AtRest:
    """Level and noise of the load while nothing moves, as the detector estimated them.

    They are recorded with each drop. A replay that starts with them detects the same drop.
    """

    load: float
    """Level, counts."""
    noise: float
    """Root mean square of the noise, counts."""


@dataclass(frozen=True, eq=False, slots=True)
class RawDrop:
    """Record of one drop in counts of the converter, before calibration."""

    stream: int
    """Number of the stream."""
    first: int
    """Index of the first sample within the stream."""
    trigger: int
    """Index of the sample at time 0 within the counts."""
    counts: NDArray[np.int32]
    """Counts, (n, channels); 0 where samples are missing."""
    missing: tuple[tuple[int, int], ...]
    """(start, length) of missing samples within the counts."""
    at_rest: AtRest
    """Load at rest before the drop."""
    threshold: float
    """Threshold of the trigger, counts above rest; 0 if the operator triggered."""
    by_operator: bool
    """True if the operator triggered, not the load."""
    cut_off: str | None
    """Reason why the record is too short; None for a complete record."""
    saturated: tuple[tuple[int, int], ...]
    """(channel, count) of samples at the end of the converter's range."""
    may_bounce: bool = False
    """True if it may be a bounce of a pulse that was before the samples or among missing ones."""


@dataclass(frozen=True, eq=False, slots=True)
class RawRebound:
    """Record of a bounce of the weight after a drop, in counts of the converter."""

    stream: int
    """Number of the stream."""
    first: int
    """Index of the first sample within the stream."""
    trigger: int
    """Index of the sample that triggered, within the stream."""
    after: int
    """Index of the sample at time 0 of its drop, within the stream."""
    peak: int
    """Peak load, counts above rest."""
    counts: NDArray[np.int32]
    """Counts, (n, channels); 0 where samples are missing."""


class PulseReason(enum.StrEnum):
    """Reason why a pulse of the load is reported; the value is the text for the operator."""

    SHUNT_ON = "not recorded: the calibration shunt was on"
    BOUNCE_OF_SHUNTED = "not recorded: bounce of the pulse for which the calibration shunt was on"
    REST_UNKNOWN = "not recorded: the load at rest was not known yet"
    REST_CHANGING = "not recorded: the load at rest was changing"
    NOT_RELEASED = "not recorded: the load had not returned to rest since the pulse before"
    SAME_RECORD = "not recorded as a drop of its own: it is in the record of the pulse before it"
    CUT_OFF = "not recorded: the samples ended before it could be distinguished from a bounce"
    MAYBE_BOUNCE = "recorded as a drop, may be a bounce: samples before it are missing"
    MAYBE_DROP = "recorded as a bounce, may be a drop: samples before it are missing"


@dataclass(frozen=True, slots=True)
class PulseReport:
    """Report to the operator of a pulse that was not recorded, or whose kind is uncertain."""

    stream: int
    """Number of the stream."""
    trigger: int
    """Index of its first sample above the threshold, within the stream; for a pulse that is not
    recorded, above the fraction `DetectionSettings.hysteresis` of it."""
    peak: int
    """Peak, counts above the load before it."""
    reason: PulseReason


@dataclass(frozen=True, slots=True)
class ReboundsOver:
    """Message that no further rebound of the last drop will be detected."""
