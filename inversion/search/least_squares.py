"""Bounded least squares from several starts at once (Levenberg-Marquardt on a batch model)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
# (m, d) points of the unit box -> (m, n) weighted residuals.
BatchResidual = Callable[[FloatArray], FloatArray]

_DIFFERENCE = 1e-4
_LARGEST_DAMPING = 1e9
# A step that lowers the misfit by less than this fraction ends the fit.
_LEAST_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class BatchFit:
    """Where each start ended.

    Parameters
    ----------
    points : (k, d) ndarray of float in the unit box
    cost : (k,) ndarray of float, mean square of the weighted residuals
    converged : (k,) ndarray of bool
    solves : int, forward solves used
    """

    points: FloatArray
    cost: FloatArray
    converged: FloatArray
    solves: int

    @property
    def best(self) -> int:
        """Index of the start that ended lowest."""
        return int(np.argmin(self.cost))


def jacobian(residual: BatchResidual, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (n,) and their derivatives (n, d) at one point (d,), by central differences."""
    size = point.size
    step = _DIFFERENCE * np.eye(size)
    values = residual(np.concatenate([point[None], point + step, point - step]))
    slope = (values[1 : size + 1] - values[size + 1 :]) / (2.0 * _DIFFERENCE)
    return values[0], slope.T


def fit_batch(
    residual: BatchResidual,
    starts: FloatArray,
    iterations: int = 25,
    tolerance: float = 1e-8,
    frozen: int | None = None,
) -> BatchFit:
    """Levenberg-Marquardt within the unit box, all starts advanced together.

    A parameter on a bound whose gradient points outward is held there for the step.  A start has
    converged when a step moves it by less than ``tolerance`` of the box or cannot be improved.

    Parameters
    ----------
    residual : BatchResidual
        Must be defined a little (1e-4) outside of the box.
    starts : (k, d) ndarray of float
    frozen : int, optional, column that keeps its start (for a profile)
    """
    points = np.clip(np.array(starts, dtype=float), 0.0, 1.0)
    count, size = points.shape
    damping = np.full(count, 1e-3)
    done = np.zeros(count, dtype=bool)
    free = np.array([column for column in range(size) if column != frozen])
    values = residual(points)
    cost = np.mean(values**2, axis=1)
    solves = count
    for _ in range(iterations):
        active = np.flatnonzero(~done)
        if active.size == 0:
            break
        slope = _slopes(residual, points[active], values[active], free)
        solves += active.size * free.size
        for _ in range(6):
            proposed = points[active].copy()
            proposed[:, free] = _step(
                points[active][:, free], values[active], slope, damping[active]
            )
            new_values = residual(proposed)
            solves += active.size
            new_cost = np.mean(new_values**2, axis=1)
            better = new_cost < cost[active]
            moved = np.max(np.abs(proposed - points[active]), axis=1)
            gain = 1.0 - new_cost / cost[active]
            chosen = active[better]
            done[active] |= (moved < tolerance) | (better & (gain < _LEAST_GAIN))
            points[chosen], values[chosen] = proposed[better], new_values[better]
            cost[chosen] = new_cost[better]
            damping[chosen] = np.maximum(damping[chosen] * 0.2, 1e-12)
            damping[active[~better]] *= 8.0
            done |= damping > _LARGEST_DAMPING
            if np.all(better):
                break
            keep = ~better
            active, slope = active[keep], slope[keep]
    return BatchFit(points, cost, done, solves)


def _slopes(
    residual: BatchResidual, points: FloatArray, values: FloatArray, free: NDArray[np.intp]
) -> FloatArray:
    """One-sided differences towards the middle of the box, (k, n, free)."""
    count, size = points.shape
    sign = np.where(points > 0.5, -1.0, 1.0)[:, free]
    moves = _DIFFERENCE * sign[:, :, None] * np.eye(size)[free]
    moved = residual((points[:, None, :] + moves).reshape(-1, size))
    slope = (moved.reshape(count, free.size, -1) - values[:, None, :]) / (
        _DIFFERENCE * sign[:, :, None]
    )
    return np.swapaxes(slope, 1, 2)


def _step(
    points: FloatArray, values: FloatArray, slope: FloatArray, damping: FloatArray
) -> FloatArray:
    gradient = np.einsum("knd,kn->kd", slope, values)
    normal = np.swapaxes(slope, 1, 2) @ slope
    held = ((points <= 0.0) & (gradient > 0.0)) | ((points >= 1.0) & (gradient < 0.0))
    diagonal = np.einsum("kdd->kd", normal)
    # Marquardt's scaling with a floor, so that a parameter without influence stays where it is.
    floor = 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
    system = normal.copy()
    size = points.shape[1]
    system[:, np.arange(size), np.arange(size)] += damping[:, None] * diagonal + floor
    free = ~held
    system *= free[:, :, None] & free[:, None, :]
    system[:, np.arange(size), np.arange(size)] += held
    move = -np.linalg.solve(system, (gradient * free)[:, :, None])[:, :, 0]
    result: FloatArray = np.clip(points + np.clip(move, -0.3, 0.3), 0.0, 1.0)
    return result
