"""Derivatives by central differences, against which those of the model are held."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inversion.search.least_squares import Linearise

Array = NDArray[Any]
BatchResidual = Callable[[Array], Array]

STEP = 1e-4


def by_differences(residual: BatchResidual, step: float = STEP) -> Linearise:
    """Residuals (m, n) of points (m, d) with differences (m, n, free) over twice the step."""

    def linearise(points: Array, free: Array) -> tuple[Array, Array]:
        count, size = points.shape
        moves = step * np.eye(size)[free]
        there = (points[:, None, :] + moves).reshape(-1, size)
        back = (points[:, None, :] - moves).reshape(-1, size)
        values = residual(np.concatenate([points, there, back]))
        slope = (values[count : -len(back)] - values[-len(back) :]) / (2.0 * step)
        return values[:count], np.swapaxes(slope.reshape(count, free.size, -1), 1, 2)

    return linearise
