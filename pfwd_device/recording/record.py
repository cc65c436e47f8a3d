"""What is kept of one drop: the calibrated traces, the counts they come from, and what is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.drop import Drop


@dataclass(frozen=True, eq=False, slots=True)
class Rebound:
    """A later bounce of the same hammer, kept with the drop that it belongs to."""

    delay: float
    """From the trigger of the drop to the trigger of the rebound, s."""
    peak_load: float
    """N, above the load at rest."""
    first_sample: int
    """Index of the first sample in the stream of the instrument."""
    counts: NDArray[np.int32]
    """What the converter gave, (n, channels); read-only."""


@dataclass(frozen=True, eq=False, slots=True)
class DropRecord:
    """One drop as it is kept, whole: nothing else is needed to invert it anew."""

    point: str
    """Name of the test point; the drop's number counts within it."""
    drop: Drop
    """Calibrated, not response-corrected; NaN where samples are missing."""
    counts: NDArray[np.int32] | None = None
    """What the converter gave, (n, channels), 0 where samples are missing; None for an imported
    drop, which never had any. Channel order as in metadata["identity"]["channels"]."""
    declared: Mapping[str, Any] = field(default_factory=dict)
    """What was declared, with the keys of a trace file's header (plate_radius_m, ...)."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Everything else, as JSON knows it: identity, calibration, detection, missing samples, marks,
    checks, time_utc, software version, position, operator."""
    rebounds: tuple[Rebound, ...] = ()
    """Later bounces of the hammer, in order."""
