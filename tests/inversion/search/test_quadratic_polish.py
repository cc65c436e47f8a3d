"""The polish by quadratic models."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.search.quadratic_polish import bounded_newton_step, iteration_cost, polish
from tests.inversion.search.objectives import Objective, seeds, sphere


def rotation(seed: int, size: int = 3) -> FloatArray:
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((size, size)))[0]


@pytest.mark.parametrize("power", [1.0, 0.5], ids=["bowl", "cone"])
@pytest.mark.parametrize("condition", [1.0, 1e6])
def test_polish_solves_bowls_and_cones_of_any_condition(power: float, condition: float) -> None:
    turn, place = rotation(2), np.array([0.4, 0.6, 0.3])
    curvature = condition ** np.array([0.0, 0.5, 1.0])

    def objective(points: FloatArray) -> FloatArray:
        return (((points - place) @ turn) ** 2 @ curvature) ** power

    best, misfit, used = polish(objective, place + 0.05, np.zeros(3), np.ones(3), 120)
    assert misfit < 1e-6
    assert used <= 120
    np.testing.assert_allclose(best, place, atol=1e-4)


def test_polish_follows_a_curved_valley() -> None:
    def rosenbrock(points: FloatArray) -> FloatArray:
        x, y = points.T
        return 100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2

    start = np.array([-0.5, 0.25])
    _, misfit, _ = polish(rosenbrock, start, np.full(2, -2.0), np.full(2, 2.0), 500)
    assert misfit < 1e-12


def test_polish_ends_on_a_bound() -> None:
    turn = rotation(4)

    def objective(points: FloatArray) -> FloatArray:
        z = points - np.array([0.0, 0.5, 0.5])
        return (z @ turn) ** 2 @ np.array([1.0, 10.0, 100.0]) + 20.0 * z[:, 0]

    best, misfit, _ = polish(objective, np.array([0.05, 0.45, 0.55]), np.zeros(3), np.ones(3), 100)
    assert misfit < 1e-12
    assert best[0] == 0.0


def test_polish_stops_when_the_minimum_is_found() -> None:
    start = np.full(3, 0.2)
    _, misfit, used = polish(sphere, start, -np.ones(3), np.ones(3), 100_000)
    assert misfit < 1e-20
    assert used < 300


@given(seed=seeds, evaluations=st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_polish_keeps_bounds_and_budget_and_never_worsens(seed: int, evaluations: int) -> None:
    rng = np.random.default_rng(seed)
    slope, start = rng.standard_normal(3), rng.random(3)
    rows: list[FloatArray] = []

    def objective(points: FloatArray) -> FloatArray:
        rows.append(points.copy())
        return np.sin(9.0 * points).sum(axis=1) + points @ slope

    best, misfit, used = polish(objective, start, np.zeros(3), np.ones(3), evaluations)
    evaluated = np.concatenate(rows)
    assert len(evaluated) == used <= evaluations
    assert (evaluated >= 0.0).all()
    assert (evaluated <= 1.0).all()
    assert misfit <= objective(start[None])[0]
    assert objective(best[None])[0] == pytest.approx(misfit)


def test_polish_survives_a_region_that_cannot_be_evaluated() -> None:
    def objective(points: FloatArray) -> FloatArray:
        return np.where(points[:, 0] > 0.49, np.inf, sphere(points - 0.45))

    _, misfit, _ = polish(objective, np.full(3, 0.48), np.zeros(3), np.ones(3), 400)
    assert misfit < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_polish_survives_what_no_quadratic_describes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place, turn = rng.random(3), rotation(seed)
    weights = 10.0 ** rng.uniform(-12.0, 12.0, 3)
    nasty: list[Objective] = [
        lambda points: np.abs(points - place) @ weights,
        lambda points: np.sqrt(((points - place) @ turn) ** 2 @ weights),
        lambda points: np.floor(9.0 * points).sum(axis=1),
        lambda points: np.sign(points[:, 0] - place[0]) * 1e300,
        lambda points: 1e15 + sphere(points - place),
        lambda points: np.where(np.floor(50.0 * points).sum(axis=1) % 3 == 0, np.inf, 1.0),
        lambda points: sphere(points - place) + 0.01 * rng.random(len(points)),
    ]
    for objective in nasty:
        best, misfit, used = polish(objective, rng.random(3), np.zeros(3), np.ones(3), 2000)
        assert np.isfinite(best).all()
        assert not np.isnan(misfit)
        assert used <= 2000


def test_polish_of_a_constant_ends_at_once() -> None:
    _, misfit, used = polish(
        lambda points: np.ones(len(points)), np.full(2, 0.5), np.zeros(2), np.ones(2), 1000
    )
    assert misfit == 1.0
    assert used <= 1 + iteration_cost(2)


def test_polish_raises_on_a_wrong_shape_and_without_evaluations() -> None:
    bounds = np.zeros(3), np.ones(3)
    with pytest.raises(ModelError, match="one number per row"):
        polish(lambda points: points, np.full(3, 0.5), *bounds, 50)
    with pytest.raises(ModelError, match="at least one evaluation, got 0"):
        polish(sphere, np.full(3, 0.5), *bounds, 0)


@given(seed=seeds)
def test_bounded_newton_step_is_the_minimum_of_the_model_in_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((2, 2))
    hessian = root @ root.T + 0.1 * np.eye(2)
    gradient, point = rng.standard_normal(2), rng.random(2)
    step = bounded_newton_step(gradient[None], hessian[None], point[None])[0]
    end = point + step
    assert (end >= -1e-9).all()
    assert (end <= 1.0 + 1e-9).all()
    # Downhill, and no better along any single gene that is free.
    height = gradient @ step + 0.5 * step @ hessian @ step
    assert height <= 1e-12
    slope = gradient + hessian @ step
    inside = (end > 1e-6) & (end < 1.0 - 1e-6)
    np.testing.assert_allclose(slope[inside], 0.0, atol=1e-6)
