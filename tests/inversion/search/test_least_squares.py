"""Bounded least squares on problems whose solution is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from inversion.search.least_squares import BatchFit, fit_batch
from tests.inversion.differences import BatchResidual, by_differences

Array = NDArray[Any]


def fit(residual: BatchResidual, begin: Array, *arguments: Any, **options: Any) -> BatchFit:
    """The fit of a residual whose derivatives are differences."""
    return fit_batch(by_differences(residual), begin, *arguments, **options)


def linear(matrix: Array, right: Array) -> BatchResidual:
    """Residuals A x - b of many x."""
    return lambda points: points @ matrix.T - right


def linear_problem(seed: int, size: int = 3) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((20, size)), rng.standard_normal(20)


def starts(count: int, size: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).random((count, size))


@pytest.mark.parametrize("seed", range(5))
def test_linear_problem_with_its_solution_inside(seed: int) -> None:
    matrix, noise = linear_problem(seed)
    inside = np.array([0.3, 0.7, 0.45])
    # Noise that no x explains: orthogonal to the columns.
    noise -= matrix @ np.linalg.lstsq(matrix, noise, rcond=None)[0]
    found = fit(linear(matrix, matrix @ inside + noise), starts(4, 3))
    assert found.points == pytest.approx(np.tile(inside, (4, 1)), abs=1e-4)
    assert found.cost == pytest.approx(np.full(4, np.mean(noise**2)), rel=1e-6)
    assert np.all(found.converged)


@pytest.mark.parametrize("seed", range(8))
def test_linear_problem_with_bounds(seed: int) -> None:
    matrix, right = linear_problem(seed)
    exact = lsq_linear(matrix, right, (0.0, 1.0), tol=1e-14)
    found = fit(linear(matrix, right), starts(4, 3))
    assert np.all((found.points >= 0) & (found.points <= 1))
    assert np.min(found.cost) == pytest.approx(2 * exact.cost / 20, rel=1e-6)
    assert found.points[found.best] == pytest.approx(exact.x, abs=2e-3)


def test_at_least_some_of_the_bounds_were_active() -> None:
    problems = [linear_problem(seed) for seed in range(8)]
    solutions = [lsq_linear(matrix, right, (0.0, 1.0)).x for matrix, right in problems]
    assert sum(np.any((x < 1e-6) | (x > 1 - 1e-6)) for x in solutions) >= 4


def rosenbrock(points: Array) -> Array:
    """Rosenbrock's valley in the box: minimum 0 at (0.75, 0.75)."""
    x, y = 4 * points[:, 0] - 2, 4 * points[:, 1] - 2
    return np.stack([10 * (y - x**2), 1 - x], axis=1)


def test_curved_valley() -> None:
    found = fit(rosenbrock, starts(6, 2), iterations=60)
    assert found.points == pytest.approx(np.full((6, 2), 0.75), abs=1e-3)
    assert np.max(found.cost) < 1e-6
    assert np.all(found.converged)


def test_too_few_iterations_are_no_convergence() -> None:
    found = fit(rosenbrock, np.array([[0.2, 0.9]]), iterations=2)
    assert not found.converged[0]
    assert found.cost[0] > 1e-4


def decay(points: Array) -> Array:
    """Residuals of A exp(-k t) against A = 0.6, k = 8 * 0.25."""
    time = np.linspace(0, 2, 40)
    found = points[:, :1] * np.exp(-8 * points[:, 1:] * time)
    return np.asarray(found - 0.6 * np.exp(-2 * time))


def test_exponential_decay_from_far_away() -> None:
    found = fit(decay, np.array([[0.05, 0.95], [0.95, 0.05], [1.0, 1.0], [0.5, 0.3]]))
    assert found.points == pytest.approx(np.tile([0.6, 0.25], (4, 1)), abs=1e-4)


def two_minima(points: Array) -> Array:
    """Residual with minima at 0.2 (0.01) and 0.8 (0)."""
    x = points[:, 0]
    return np.stack([8 * (x - 0.2) * (x - 0.8), 0.1 * (x - 0.8) / 0.6], axis=1)


def test_starts_end_in_their_own_minimum_and_the_lower_is_best() -> None:
    found = fit(two_minima, np.array([[0.1], [0.95], [0.25]]))
    assert found.points[:, 0] == pytest.approx([0.2, 0.8, 0.2], abs=0.01)
    assert found.best == 1


@pytest.mark.parametrize("frozen", [0, 1, 2])
def test_frozen_column_keeps_its_start(frozen: int) -> None:
    matrix, right = linear_problem(3)
    right = matrix @ np.array([0.4, 0.5, 0.6]) + 0.01 * right
    begin = np.full((3, 3), 0.5)
    begin[:, frozen] = [0.1, 0.35, 0.9]
    found = fit(linear(matrix, right), begin, frozen=frozen)
    assert np.array_equal(found.points[:, frozen], begin[:, frozen])
    free = [column for column in range(3) if column != frozen]
    for point in found.points:
        left = right - matrix[:, frozen] * point[frozen]
        exact = lsq_linear(matrix[:, free], left, (0.0, 1.0), tol=1e-14)
        assert point[free] == pytest.approx(exact.x, abs=2e-3)


def test_parameter_without_influence_stays() -> None:
    def blind(points: Array) -> Array:
        return np.stack([points[:, 0] - 0.3, 2 * points[:, 0] - 0.6], axis=1)

    found = fit(blind, np.array([[0.9, 0.123], [0.1, 0.987]]))
    assert found.points[:, 0] == pytest.approx([0.3, 0.3], abs=1e-6)
    assert found.points[:, 1] == pytest.approx([0.123, 0.987], abs=1e-9)


def test_misfit_never_rises() -> None:
    begin = starts(20, 2, seed=5)
    before = np.mean(rosenbrock(begin) ** 2, axis=1)
    for iterations in (1, 3, 10):
        assert np.all(fit(rosenbrock, begin, iterations).cost <= before)


def test_starts_outside_are_pulled_in() -> None:
    found = fit(decay, np.array([[-0.5, 1.5]]))
    assert found.points[0] == pytest.approx([0.6, 0.25], abs=1e-4)


def test_model_is_asked_in_the_box_alone_and_every_solve_is_counted() -> None:
    asked: list[Array] = []
    differences = by_differences(decay)

    def watched(points: Array, free: Array) -> tuple[Array, Array]:
        asked.append(points.copy())
        return differences(points, free)

    begin = starts(5, 2)
    keep = begin.copy()
    found = fit_batch(watched, begin)
    points = np.concatenate(asked)
    assert np.array_equal(begin, keep)
    assert np.all((points >= 0) & (points <= 1))
    assert found.solves == points.shape[0]
