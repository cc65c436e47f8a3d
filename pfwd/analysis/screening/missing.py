"""Drops with samples that never came: what is left of them, if it is enough."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd_device import Drop

NEEDED_BEFORE = 0.003
"""s before the trigger that have to be whole: the pulse begins before it, and an offset is told
from what precedes the pulse."""

NEEDED_AFTER = 0.050
"""s after the trigger that have to be whole: the longest pulses take 30 ms, and the ground's answer
to them is most of what the fit uses."""

ONLY_PEAKS = "peaks only: the file had no time history, which the dynamic inversion needs"
"""Why a drop without traces is not inverted."""


def whole_part(drop: Drop) -> tuple[Drop, str | None, Notice | None]:
    """The unbroken part of a drop around its trigger.

    Parameters
    ----------
    drop : Drop
        NaN where samples are missing.

    Returns
    -------
    drop : Drop
        Without missing samples, as far as there are enough around the trigger; otherwise as it was.
    reason : str or None
        Why it cannot be used.
    warning : Notice or None
        What was left out.
    """
    if drop.only_peaks is not None:
        return drop, ONLY_PEAKS, None
    values = np.array([drop.load, *(channel.values for channel in drop.channels)])
    gone: NDArray[np.bool_] = np.isnan(values).max(axis=0)
    if not gone.any():
        return drop, None, None
    count = int(gone.sum())
    first_missing = float(drop.time[int(np.argmax(gone))])
    middle = int(np.argmin(np.abs(drop.time)))
    before = np.flatnonzero(gone[: middle + 1])
    after = np.flatnonzero(gone[middle:])
    start = int(before[-1]) + 1 if before.size else 0
    end = middle + int(after[0]) if after.size else gone.size
    step = 1.0 / drop.sampling_rate
    # A record that is shorter by its settings is not damaged for that.
    first = max(-NEEDED_BEFORE, drop.time[0]) + step / 2
    last = min(NEEDED_AFTER, drop.time[-1]) - step / 2
    if end <= start or drop.time[start] > first or drop.time[end - 1] < last:
        return (
            drop,
            (
                f"damaged record: {count} of {gone.size} samples are missing, the first at "
                f"{first_missing * 1e3:.1f} ms; repeat the drop"
            ),
            None,
        )
    part = slice(start, end)
    whole = Drop(
        drop.number,
        drop.time[part],
        drop.load[part],
        tuple(dataclasses.replace(c, values=c.values[part]) for c in drop.channels),
    )
    numbers = {"missing": count, "samples": gone.size, "first_missing_s": first_missing}
    return whole, None, Notice("drop-incomplete", numbers)
