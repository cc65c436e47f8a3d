"""The method on sums of squares with known optima."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.inference.levenberg_marquardt import minimise

Array = NDArray[np.float64]
ALL = np.ones(2, dtype=bool)
STARTS = np.array([[-1.2, 1.0], [1.5, 1.5], [0.0, -0.5]])


@dataclass
class Rosenbrock:
    """Sum of squares of 10 (y - x^2) and 1 - x, whose optimum is (1, 1)."""

    lower: Array
    upper: Array
    deviation: Array
    calls: int = 0

    @staticmethod
    def residuals(points: Array) -> Array:
        x, y = points.T
        return np.stack([10.0 * (y - x**2), 1.0 - x], axis=1)

    def costs(self, points: Array) -> Array:
        self.calls += len(points)
        return np.asarray(np.sum(self.residuals(points) ** 2, axis=1))

    def normals(self, points: Array) -> tuple[Array, Array]:
        slopes = np.array([[[-20.0 * x, 10.0], [-1.0, 0.0]] for x, _ in points])
        across = np.swapaxes(slopes, 1, 2)
        return across @ slopes, -(across @ self.residuals(points)[..., None])[..., 0]


def within(lower: float = -5.0, upper: float = 5.0) -> Rosenbrock:
    return Rosenbrock(np.full(2, lower), np.full(2, upper), np.ones(2))


def test_all_starting_points_lead_to_the_optimum() -> None:
    optima = minimise(within(), STARTS, 60, 1e-12, ALL)
    assert optima.points == pytest.approx(np.ones((3, 2)), abs=1e-5)
    assert optima.has_converged.all()


def test_a_batch_of_fits_equals_each_fit() -> None:
    together = minimise(within(), STARTS, 7, 1e-12, ALL)
    for start, point, cost in zip(STARTS, together.points, together.costs, strict=True):
        alone = minimise(within(), start[None], 7, 1e-12, ALL)
        assert alone.points[0] == pytest.approx(point, rel=1e-12)
        assert alone.costs[0] == pytest.approx(cost, rel=1e-9)


def test_an_optimum_outside_is_approached_along_the_bound() -> None:
    optimum = minimise(within(upper=0.5), STARTS[2:], 60, 1e-12, ALL)
    # On x = 0.5 the first residual vanishes at y = 0.25.
    assert optimum.points[0] == pytest.approx([0.5, 0.25], abs=1e-6)
    assert optimum.has_converged[0]


def test_a_fixed_unknown_does_not_move() -> None:
    optimum = minimise(within(), STARTS[:1], 60, 1e-12, np.array([False, True]))
    assert optimum.points[0] == pytest.approx([-1.2, 1.44])


def test_the_cost_never_rises_and_steps_end() -> None:
    costs = [minimise(within(), STARTS[:1], n, 0.0, ALL).costs[0] for n in range(8)]
    assert all(after <= before for before, after in itertools.pairwise(costs))
    assert not minimise(within(), STARTS[:1], 1, 0.0, ALL).has_converged[0]
    # At the optimum no trial is better: the fit ends after a few of them.
    objective = within()
    assert minimise(objective, np.ones((1, 2)), 60, 1e-12, ALL).has_converged[0]
    assert objective.calls <= 10


def test_a_step_is_limited_by_the_priors() -> None:
    tight = Rosenbrock(np.full(2, -99.0), np.full(2, 99.0), np.full(2, 1e-3))
    point = minimise(tight, STARTS[:1], 1, 0.0, ALL).points[0]
    assert np.max(np.abs(point - STARTS[0])) <= 2.5e-3 * (1 + 1e-9)
