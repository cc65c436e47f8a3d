"""Complete record of one drop: calibrated traces, raw counts, declarations and metadata."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.drop import Drop
from pfwd_device.errors import RecordingError
from pfwd_device.text import LONGEST_TEXT, clean

COPY_OF = "copy_of"
"""Key of a drop's metadata: point and number of the drop of another point with the same samples."""


@dataclass(frozen=True, eq=False, slots=True)
class ReboundRecord:
    """Rebound of a drop: a later impact of the weight after it bounced off the plate."""

    delay: float
    """Time from the trigger of the drop to the trigger of the rebound, s."""
    peak_load: float
    """Peak load above the load at rest, N."""
    first_sample: int
    """Index of the first sample in the stream of the instrument."""
    counts: NDArray[np.int32]
    """Raw counts of the converter, (n, channels); read-only."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "counts", _read_only_counts(self.counts, "rebound"))


@dataclass(frozen=True, eq=False, slots=True)
class DropRecord:
    """Complete record of one drop, which suffices to repeat the analysis."""

    point: str
    """Name of the test point; the drop's number counts within it."""
    drop: Drop
    """Calibrated traces, not corrected for the response of geophones; NaN for missing samples."""
    counts: NDArray[np.int32] | None = None
    """Raw counts of the converter, (n, channels), 0 where samples are missing; None for an imported
    drop, which never had any. Channel order as in metadata["identity"]["channels"]."""
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Declared values, with the keys of a trace file's header (plate_radius_m, ...)."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """All other facts as JSON values: identity, calibration, detection, missing samples, marks,
    checks, time_utc, software version, position, operator."""
    rebounds: tuple[ReboundRecord, ...] = ()
    """Later bounces of the weight, in order."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", point_name(self.point))
        if self.counts is not None:
            counts = _read_only_counts(self.counts, f"drop {self.point}/{self.drop.number}")
            object.__setattr__(self, "counts", counts)
        object.__setattr__(self, "rebounds", tuple(self.rebounds))


def point_name(name: str) -> str:
    """Return the name of a test point without control characters, leading and trailing blanks.

    Raises
    ------
    RecordingError
        If the name is then empty or longer than 64 characters.
    """
    text = clean(name, limit=4 * LONGEST_TEXT).strip()
    if not text or len(text) > LONGEST_TEXT:
        raise RecordingError(
            f"name of a test point: expected 1 to {LONGEST_TEXT} characters, got {len(text)}"
        )
    return text


def _read_only_counts(values: NDArray[np.int32], where: str) -> NDArray[np.int32]:
    array_like = np.asarray(values)
    if array_like.ndim != 2 or array_like.dtype.kind not in "iu":
        raise RecordingError(
            f"{where}: expected counts as integers, (n, channels), got {array_like.dtype} of shape "
            f"{array_like.shape}"
        )
    counts = np.array(array_like, dtype=np.int32)
    if array_like.dtype != counts.dtype and not np.array_equal(counts, array_like):
        raise RecordingError(f"{where}: expected counts of 32 bits, got larger numbers")
    counts.flags.writeable = False
    return counts
