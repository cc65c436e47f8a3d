"""The bounded trust region, against scipy's own and against closed forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize

from inversion.diagnosis.trust_region import Tolerances, _secant, least_squares

Array = NDArray[np.float64]
Pair = tuple[Callable[[Array], Array], Callable[[Array], Array]]
EVALUATIONS = 60


def valley(where: Array) -> Pair:
    """Rosenbrock's curved valley with its end at a place of the plane, seen from 0 to 1."""

    def residual(x: Array) -> Array:
        u, v = x - where + 0.5
        return np.array([30.0 * (v - u**2 - 0.25), 1.0 - 2.0 * u])

    def jacobian(x: Array) -> Array:
        return np.array([[-60.0 * (x[0] - where[0] + 0.5), 30.0], [-2.0, 0.0]])

    return residual, jacobian


def decay(rates: Array, beyond: float) -> Pair:
    """Two exponentials; what lies beyond a wall when `beyond` is not 0."""
    time = np.linspace(0.0, 3.0, 40)
    rng = np.random.default_rng(5)

    def model(x: Array) -> Array:
        found: Array = x[0] * np.exp(-6.0 * x[1] * time) + x[2] * np.exp(-x[3] * time)
        return found

    seen = model(np.concatenate([rates, [beyond]])) + 0.01 * rng.standard_normal(40)

    def jacobian(x: Array) -> Array:
        fast, slow = np.exp(-6.0 * x[1] * time), np.exp(-x[3] * time)
        return np.stack([fast, -6.0 * x[0] * time * fast, slow, -x[2] * time * slow], axis=1)

    return (lambda x: model(x) - seen), jacobian


def straight(seed: int, reach: float) -> Pair:
    """Straight lines whose minimum lies outside the box in some unknowns."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((25, 8)) * np.geomspace(1.0, 30.0, 8)
    right = matrix @ (0.5 + reach * rng.standard_normal(8)) + 0.1 * rng.standard_normal(25)
    return (lambda x: matrix @ x - right), (lambda x: matrix)


PROBLEMS: dict[str, tuple[Pair, Array]] = {
    "valley": (valley(np.array([0.7, 0.6])), np.array([0.15, 0.9])),
    "valley beyond the wall": (valley(np.array([1.2, 0.6])), np.array([0.15, 0.9])),
    "decay": (decay(np.array([0.5, 0.6, 0.4]), 0.3), np.full(4, 0.5)),
    "decay to the wall": (decay(np.array([0.5, 0.6, 0.4]), -0.3), np.full(4, 0.5)),
    "decay from the wall": (decay(np.array([0.5, 0.6, 0.4]), 0.3), np.full(4, 2e-3)),
    **{
        f"lines {seed} {reach}": (straight(seed, reach), np.full(8, 0.4))
        for seed in range(4)
        for reach in (0.1, 0.5, 2.0)
    },
}


@pytest.mark.parametrize("evaluations", [2, 5, 12, EVALUATIONS])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_way_is_that_of_scipy(name: str, evaluations: int) -> None:
    (residual, jacobian), start = PROBLEMS[name]
    theirs = optimize.least_squares(
        residual,
        start,
        jacobian,
        bounds=(0.0, 1.0),
        ftol=1e-8,
        xtol=1e-8,
        gtol=1e-8,
        max_nfev=evaluations,
    )
    ours = least_squares(residual, lambda x, _: jacobian(x), start, evaluations, Tolerances())
    assert ours.place == pytest.approx(theirs.x, abs=1e-6)
    assert ours.cost == pytest.approx(2.0 * theirs.cost, rel=1e-6, abs=1e-12)
    assert abs(ours.evaluations - theirs.nfev) <= (1 if evaluations == EVALUATIONS else 0)
    assert np.all((ours.place > 0.0) & (ours.place < 1.0))
    assert ours.residual == pytest.approx(residual(ours.place))


@pytest.mark.parametrize("name", PROBLEMS)
def test_secants_lead_to_the_same_end_with_fewer_derivatives(name: str) -> None:
    (residual, jacobian), start = PROBLEMS[name]
    asked = []

    def counted(x: Array, there: Array) -> Array:
        asked.append(x)
        return jacobian(x)

    plain = least_squares(residual, counted, start, EVALUATIONS)
    many = len(asked)
    asked.clear()
    found = least_squares(residual, counted, start, EVALUATIONS, secants=3)
    assert found.cost == pytest.approx(plain.cost, rel=1e-5, abs=1e-12)
    assert len(asked) < many


def test_a_secant_explains_the_step_and_keeps_what_does_not_count_away() -> None:
    rng = np.random.default_rng(8)
    slopes = rng.standard_normal((6, 4))
    slopes[:3, 1] = 0.0
    slopes[5] = 0.0
    step, change = rng.standard_normal(4), rng.standard_normal(6)
    found = _secant(slopes, step, change)
    assert found[:5] @ step == pytest.approx(change[:5])
    assert not found[:3, 1].any()
    assert not found[5].any()
    # No farther from the old one than it has to be: along the step alone.
    way = step[[0, 2, 3]]
    assert np.linalg.norm(np.cross(found[0, [0, 2, 3]] - slopes[0, [0, 2, 3]], way)) < 1e-12
    assert slopes[0, 0] != found[0, 0]


def test_an_unknown_that_nothing_feels_stays_and_holds_up_nothing() -> None:
    residual, jacobian = straight(1, 0.1)

    def wider(x: Array, _: Array) -> Array:
        return np.column_stack([jacobian(x[1:]), np.zeros(25)])[:, [8, *range(8)]]

    start = np.full(9, 0.4)
    start[0] = 0.123
    found = least_squares(lambda x: residual(x[1:]), wider, start, EVALUATIONS)
    alone = least_squares(residual, lambda x, _: jacobian(x), start[1:], EVALUATIONS)
    assert found.place[0] == 0.123
    assert found.place[1:] == pytest.approx(alone.place, abs=1e-7)
    assert found.evaluations == alone.evaluations


def test_where_there_is_no_residual_the_region_shrinks() -> None:
    """Beyond 0.6 the model has no value."""
    scale = np.array([1.0, 3.0])

    def residual(x: Array) -> Array:
        found: Array = (x - 0.55) * scale if x.max() < 0.6 else np.full(2, np.nan)
        return np.asarray(found + 0.3 * found**2)

    def jacobian(x: Array, there: Array) -> Array:
        return np.diag(scale * (1.0 + 0.6 * (x - 0.55) * scale))

    found = least_squares(residual, jacobian, np.array([0.02, 0.03]), EVALUATIONS)
    assert found.place == pytest.approx([0.55, 0.55], abs=1e-6)


def test_at_its_end_no_derivatives_are_asked_for() -> None:
    (residual, jacobian), start = PROBLEMS["valley"]
    asked = []

    def counted(x: Array, there: Array) -> Array:
        assert there == pytest.approx(residual(x))
        asked.append(x)
        return jacobian(x)

    found = least_squares(residual, counted, start, 4)
    assert found.evaluations == 4
    assert len(asked) <= 3
    assert found.place.tobytes() not in [x.tobytes() for x in asked]


def test_nothing_to_gain_ends_at_once() -> None:
    start = np.full(3, 0.5)
    found = least_squares(lambda x: np.ones(4), lambda x, _: np.zeros((4, 3)), start, EVALUATIONS)
    assert found.place == pytest.approx(start)
    assert found.evaluations == 1
