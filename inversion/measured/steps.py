"""Does a record step where no motion could?

Samples that were lost on the way, or a range that was switched, leave a step between two samples
that the ones around it do not announce.  Around each place a cubic with a step is fitted to as many
samples on either side; the step counts over what the fit leaves, and no less than before the pulse.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from inversion.arrays import FloatArray

PLAIN_MOTION, PLAIN_LOAD = 8.0, 25.0
"""Deviations that a step has. Real sensors show 6 at most; loads, where a buffer meets the plate,
15, and 44 where a tenth of them is added within."""
# Samples on either side.
_SIDE = 7
_TIMES = (np.arange(2 * _SIDE) - _SIDE + 0.5) / _SIDE
_SHAPES = np.column_stack([_TIMES**power for power in range(4)] + [(_TIMES > 0.0).astype(float)])
_FITTED: FloatArray = np.linalg.pinv(_SHAPES)
_LEFT: FloatArray = np.eye(2 * _SIDE) - _SHAPES @ _FITTED
_DEVIATION = float(np.sqrt(np.linalg.inv(_SHAPES.T @ _SHAPES)[-1, -1]))


def find_step(values: FloatArray, first: int, end: int, plain: float = PLAIN_MOTION) -> int | None:
    """The first sample after the plainest step between two places; None where there is none.

    Parameters
    ----------
    values : (n,) ndarray of float
    first, end : int, where the pulse begins, before which nothing moves, and where the search ends
    plain : float, deviations from which on it is a step
    """
    if values.size < 2 * _SIDE:
        return None
    windows = sliding_window_view(values, 2 * _SIDE)
    left = np.sqrt(np.sum((windows @ _LEFT) ** 2, axis=1) / (2 * _SIDE - _SHAPES.shape[1]))
    before = left[: max(first - 2 * _SIDE, 0)]
    usual = float(np.median(before if before.size >= _SIDE else left))
    scale = _DEVIATION * np.maximum(np.maximum(left, usual), 1e-300)
    sizes = np.abs(windows @ _FITTED[-1]) / scale
    places = np.arange(_SIDE, _SIDE + sizes.size)
    sizes[(places < first) | (places >= end)] = 0.0
    largest = int(np.argmax(sizes))
    return int(places[largest]) if sizes[largest] > plain else None
