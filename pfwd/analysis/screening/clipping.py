"""Finds samples that were cut at the end of a converter's or an amplifier's range."""

import numpy as np
from numpy.typing import NDArray

SHORTEST_FLAT = 3
"""Samples; two equal samples at a peak are chance."""

STEEP_FLANK = 10.0
"""Fall beside a flat top, in steps of the quantisation. A parabola that rounding makes flat over n
samples falls by 6.5 steps at most within n/2 samples of the flat part (at n = 4); a clipped one
meets its level at an angle and falls by more, unless hardly more than a step was clipped off."""


def clipped_samples(values: NDArray[np.float64]) -> int:
    """Number of samples in the longest clipped top of a record, 0 when its top is natural.

    A flat stretch at either end of the record does not count: a sensor may rest there.

    Parameters
    ----------
    values : (n,) ndarray of float

    Returns
    -------
    int

    Examples
    --------
    >>> pulse = np.sin(np.linspace(0, np.pi, 100))
    >>> [clipped_samples(values) for values in (pulse, pulse.round(2), pulse.clip(max=0.9))]
    [0, 0, 28]
    """
    start, end = _longest_flat_top(values)
    length = end - start
    if length < SHORTEST_FLAT:
        return 0
    beside = min(length // 2, start, values.size - end)
    foot = max(values[start - beside : start].min(), values[end : end + beside].min())
    fall = values[start] - foot
    step = _quantisation(values[max(0, start - 2 * length) : end + 2 * length])
    return length if fall > STEEP_FLANK * step else 0


def _longest_flat_top(values: NDArray[np.float64]) -> tuple[int, int]:
    """First and past-the-last index of the longest run of the largest value inside the record."""
    at_top = np.concatenate([[False], values == values.max(), [False]])
    edges = np.flatnonzero(np.diff(at_top.astype(np.int8)))
    starts, ends = edges[::2], edges[1::2]
    inside = (starts > 0) & (ends < values.size)
    if not inside.any():
        return 0, 0
    starts, ends = starts[inside], ends[inside]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])


def _quantisation(values: NDArray[np.float64]) -> float:
    """Smallest step between different values."""
    return float(np.diff(np.unique(values)).min())
