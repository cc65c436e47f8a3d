"""Minima of a misfit in the unit cube, onto which the ranges of the parameters are scaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray

# Minima that are closer than this distance in the unit cube count as one.
_SAME_MINIMUM_DISTANCE = 0.02


@dataclass(frozen=True, eq=False)
class Minimum:
    """One minimum of the misfit.

    Parameters
    ----------
    point : (d,) ndarray of float in the unit cube
    cost : float, mean square of the weighted residuals
    """

    point: FloatArray
    cost: float


def distinct(
    points: FloatArray, cost: FloatArray, separation: float = _SAME_MINIMUM_DISTANCE
) -> NDArray[np.intp]:
    """Return the indices of the minima, best first, without those near a better one."""
    indices: list[int] = []
    for index in np.argsort(cost):
        distances = (np.max(np.abs(points[index] - points[better])) for better in indices)
        if all(distance > separation for distance in distances):
            indices.append(int(index))
    return np.array(indices, dtype=np.intp)


def distinct_minima(points: FloatArray, cost: FloatArray) -> list[Minimum]:
    """Return the distinct minima among points (k, d), best first."""
    return [Minimum(points[i].copy(), float(cost[i])) for i in distinct(points, cost)]
