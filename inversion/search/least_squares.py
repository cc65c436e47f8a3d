"""Bounded least squares from several starts at once, by Levenberg and Marquardt's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray

# Function of points (m, d) of the unit cube and of the columns that are fitted; it returns weighted
# residuals (m, n) and their derivatives (m, n, free).
Linearise = Callable[[FloatArray, NDArray[np.intp]], tuple[FloatArray, FloatArray]]

_LARGEST_DAMPING = 1e9
# A step that lowers the misfit by less than this fraction ends the fit.
_MIN_RELATIVE_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class BatchFit:
    """Results of least squares from several starting points.

    Parameters
    ----------
    points : (k, d) ndarray of float in the unit cube
    cost : (k,) ndarray of float, mean square of the weighted residuals
    converged : (k,) ndarray of bool
    solves : int, number of evaluations of the model
    """

    points: FloatArray
    cost: FloatArray
    converged: FloatArray
    solves: int

    @property
    def best(self) -> int:
        """Index of the result with the lowest cost."""
        return int(np.argmin(self.cost))


def fit_batch(
    linearise: Linearise,
    starts: FloatArray,
    iterations: int = 25,
    tolerance: float = 1e-8,
    frozen: int | None = None,
) -> BatchFit:
    """Minimise the mean square of residuals in the unit cube, from several starts at once.

    A parameter on a bound whose gradient points outward is fixed there for the step. A fit has
    converged when a step moves it by less than ``tolerance`` of the unit interval, or cannot be
    improved. The derivatives are computed with every trial, which costs less than a second call
    after a success.

    Parameters
    ----------
    linearise : Linearise
    starts : (k, d) ndarray of float
    iterations : int, number of trial steps of each fit, including rejected ones
    tolerance : float
    frozen : int, optional, column that stays at its starting value (for a profile)

    Returns
    -------
    BatchFit
    """
    points = np.clip(np.array(starts, dtype=float), 0.0, 1.0)
    count, size = points.shape
    damping = np.full(count, 1e-3)
    has_converged = np.zeros(count, dtype=bool)
    free = np.array([column for column in range(size) if column != frozen])
    values, slope = linearise(points, free)
    cost = np.mean(values**2, axis=1)
    solves = count
    for _ in range(iterations):
        active = np.flatnonzero(~has_converged)
        if active.size == 0:
            break
        proposed = points[active].copy()
        proposed[:, free] = _step(proposed[:, free], values[active], slope[active], damping[active])
        new_values, new_slope = linearise(proposed, free)
        solves += active.size
        new_cost = np.mean(new_values**2, axis=1)
        better = new_cost < cost[active]
        moved = np.max(np.abs(proposed - points[active]), axis=1)
        gain = 1.0 - new_cost / cost[active]
        has_converged[active] |= (moved < tolerance) | (better & (gain < _MIN_RELATIVE_GAIN))
        chosen = active[better]
        points[chosen], values[chosen] = proposed[better], new_values[better]
        slope[chosen], cost[chosen] = new_slope[better], new_cost[better]
        damping[chosen] = np.maximum(damping[chosen] * 0.2, 1e-12)
        damping[active[~better]] *= 8.0
        has_converged |= damping > _LARGEST_DAMPING
    return BatchFit(points, cost, has_converged, solves)


def _step(
    points: FloatArray, values: FloatArray, slope: FloatArray, damping: FloatArray
) -> FloatArray:
    across = np.swapaxes(slope, 1, 2)
    gradient = (across @ values[:, :, None])[:, :, 0]
    system = across @ slope
    held = ((points <= 0.0) & (gradient > 0.0)) | ((points >= 1.0) & (gradient < 0.0))
    places = np.arange(points.shape[1])
    diagonal = system[:, places, places]
    # Marquardt's scaling with a floor, so that a parameter without influence does not move.
    floor = 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
    system[:, places, places] += damping[:, None] * diagonal + floor
    if held.any():
        free = ~held
        system *= free[:, :, None] & free[:, None, :]
        system[:, places, places] += held
        gradient *= free
    move = -np.linalg.solve(system, gradient[:, :, None])[:, :, 0]
    result: FloatArray = np.clip(points + np.clip(move, -0.3, 0.3), 0.0, 1.0)
    return result
