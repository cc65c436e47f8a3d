"""Levenberg and Marquardt's method between bounds, from one or several starting points at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray

# Initial damping, its factor of change, largest number of trial steps, and the longest step in
# standard deviations of the priors.
_DAMPING, _DAMPING_FACTOR, _MAX_TRIALS = 1e-2, 6.0, 7
_MAX_STEP_DEVIATIONS = 2.5
BOUND_TOLERANCE = 1e-9
"""An unknown that is nearer to a bound than this is on it."""


class Objective(Protocol):
    """Sum of squares to be minimised, as a function of k unknowns."""

    @property
    def lower(self) -> FloatArray:
        """Lower bounds, (k,)."""

    @property
    def upper(self) -> FloatArray:
        """Upper bounds, (k,)."""

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of the priors, (k,), the unit of the steps."""

    def costs(self, points: FloatArray) -> FloatArray:
        """Return the sums of squares, (m,), at points (m, k)."""

    def normals(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J^T J (m, k, k) and the descents -J^T r (m, k) at points (m, k)."""


@dataclass(frozen=True, eq=False)
class Optima:
    """Results of the method.

    Parameters
    ----------
    points : (m, k) ndarray of float
    costs : (m,) ndarray of float
    has_converged : (m,) ndarray of bool
    """

    points: FloatArray
    costs: FloatArray
    has_converged: NDArray[np.bool_]


def minimise(
    objective: Objective,
    starts: FloatArray,
    iterations: int,
    tolerance: float,
    movable: NDArray[np.bool_],
) -> Optima:
    """Return the optima that starting points (m, k) lead to.

    Parameters
    ----------
    objective : Objective
    starts : (m, k) ndarray of float
    iterations : int, largest number of accepted steps
    tolerance : float, relative decrease of the cost at which to stop
    movable : (k,) ndarray of bool, False: the unknown stays at its start
    """
    points = np.array(starts, dtype=float)
    count, size = points.shape
    costs = objective.costs(points)
    normals, descents = np.zeros((count, size, size)), np.zeros((count, size))
    damping = np.full(count, _DAMPING)
    steps, failures = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    has_converged = np.zeros(count, dtype=bool)
    has_moved = np.ones(count, dtype=bool)
    while True:
        active = np.flatnonzero(~has_converged & (steps < iterations))
        if active.size == 0:
            break
        moved = active[has_moved[active]]
        if moved.size:
            normals[moved], descents[moved] = objective.normals(points[moved])
            has_moved[moved] = False
        trials = _trials(
            objective, points[active], normals[active], descents[active], damping[active], movable
        )
        new_costs = objective.costs(trials)
        is_better = new_costs < costs[active]
        better, failed = active[is_better], active[~is_better]
        gains = 1.0 - new_costs[is_better] / costs[better]
        points[better], costs[better] = trials[is_better], new_costs[is_better]
        steps[better], failures[better], has_moved[better] = steps[better] + 1, 0, True
        damping[better] = np.maximum(damping[better] / _DAMPING_FACTOR, 1e-7)
        has_converged[better] = gains < tolerance
        failures[failed] += 1
        damping[failed] = np.maximum(damping[failed], 1e-4) * _DAMPING_FACTOR
        has_converged[failed] = failures[failed] == _MAX_TRIALS
    return Optima(points, costs, has_converged)


def _trials(
    objective: Objective,
    points: FloatArray,
    normals: FloatArray,
    descents: FloatArray,
    damping: FloatArray,
    movable: NDArray[np.bool_],
) -> FloatArray:
    """Return points (m, k) after a step; unknowns on bounds stay if the descent points outward."""
    lower, upper = objective.lower, objective.upper
    on_lower = (points <= lower + BOUND_TOLERANCE) & (descents < 0.0)
    on_upper = (points >= upper - BOUND_TOLERANCE) & (descents > 0.0)
    free = movable & ~on_lower & ~on_upper
    steps = np.zeros_like(points)
    for mask in {row.tobytes(): row for row in free}.values():
        rows, columns = np.flatnonzero((free == mask).all(axis=1)), np.flatnonzero(mask)
        damped = normals[np.ix_(rows, columns, columns)]
        places = np.arange(columns.size)
        damped[:, places, places] += damping[rows, None] * damped[:, places, places]
        right = descents[np.ix_(rows, columns)]
        steps[np.ix_(rows, columns)] = np.linalg.solve(damped, right[..., None])[..., 0]
    longest = np.max(np.abs(steps) / objective.deviation, axis=1, initial=0.0)
    steps *= np.minimum(1.0, _MAX_STEP_DEVIATIONS / np.maximum(longest, 1e-9))[:, None]
    return np.asarray(np.clip(points + steps, lower, upper))
