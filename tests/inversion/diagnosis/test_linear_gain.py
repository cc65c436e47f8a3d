"""What an effect could take to first order, where straight lines make first order exact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.linear_gain import Tangent
from inversion.diagnosis.problem import Point, Problem
from inversion.effects import DropContext, Effect
from inversion.effects.base import Values
from inversion.fitting.parameters import Parameter
from tests.inversion.diagnosis.toys import (
    GROUND,
    NOISE,
    SAMPLES,
    Toy,
    direction,
    toy_point,
)
from tests.inversion.synthetic import Array


def at(problem: Problem, value: float = 0.5) -> Fit:
    """As if a fit had ended there."""
    device, own = np.full(len(problem.device), value), np.full(len(problem.own[0]), value)
    return Fit(problem, device, (own,), np.nan, problem.independent, np.zeros((0, 0)))


def fitted(point: Point, effects: Sequence[Effect]) -> Fit:
    problem = Problem([point], effects)
    return fit(problem, *starts(problem))


def starts(problem: Problem) -> tuple[Array, list[Array]]:
    """Values at which every effect shows."""
    device = np.array([u.parameter.unit_value(u.parameter.starts[0]) for u in problem.device])
    own = np.array([u.parameter.unit_value(u.parameter.starts[0]) for u in problem.own[0]])
    return device, [own]


def left(
    point: Point, smaller: Sequence[Effect], effect: Effect, *, by_drop: bool = False
) -> Array:
    """What a straight line to a start of one effect more leaves of each drop, beside a fit."""
    beside = fitted(point, smaller)
    problem = Problem([point], (*smaller, effect))
    device, (own,) = starts(problem)
    known = len(beside.own[0])
    own[:known] = beside.own[0]
    device[: len(beside.device)] = beside.device
    return Tangent.of(beside).left(problem, device, own, by_drop)


A, B = Toy("a"), Toy("b")


@pytest.mark.parametrize("scope", ["point", "device"])
def test_the_gain_of_a_straight_line_is_what_a_fit_reaches(scope: str) -> None:
    beside = 0.6 * direction("a") + 0.5 * direction("b") + 0.3 * GROUND + 0.2 * NOISE
    effect = Toy("c", beside, scope=scope)
    point = toy_point({"a": 30.0, "b": 20.0}, rest=1.5)
    found = left(point, (A,), effect)
    assert found.shape == (1,)
    assert found[0] == pytest.approx(fitted(point, (A, effect)).cost, rel=1e-4)
    # It is a gain, and not all of it.
    assert 10.0 < found[0] < 0.9 * fitted(point, (A,)).cost


@pytest.mark.parametrize("along", [direction("a"), GROUND, direction("a") - 3.0 * GROUND])
def test_a_direction_that_the_unknowns_have_gains_nothing(along: Array) -> None:
    point = toy_point({"a": 30.0, "b": 20.0})
    beside = fitted(point, (A,))
    found = left(point, (A,), Toy("c", along))
    assert found[0] == pytest.approx(beside.cost, rel=1e-6)


@pytest.mark.parametrize("new", [0.05, 1e-3])
def test_a_direction_that_the_unknowns_nearly_have_gains_by_what_is_new(new: float) -> None:
    point = toy_point({"a": 30.0, "b": 20.0})
    along = np.sqrt(1.0 - new**2) * direction("a") + new * direction("b")
    assert left(point, (A,), Toy("c", along))[0] == pytest.approx(SAMPLES, rel=1e-3)


def test_what_the_residual_does_not_have_gains_nothing() -> None:
    point = toy_point({"a": 30.0})
    assert left(point, (A,), B)[0] == pytest.approx(fitted(point, (A,)).cost, rel=1e-6)


def test_the_unknowns_may_follow_where_no_fit_has_ended() -> None:
    """At a ground that is not the best one the rest is that of the best, with the effect."""
    point = toy_point({"b": 20.0})
    away = at(Problem([point], (A,)), 0.3)
    problem = Problem([point], (A, B))
    own = np.append(away.own[0], B.parameters[0].unit_value(10.0))
    found = Tangent.of(away).left(problem, away.device, own, by_drop=False)
    assert found[0] == pytest.approx(SAMPLES, rel=1e-3)


def test_an_effect_of_single_drops_goes_its_own_way_in_each() -> None:
    effect = Toy("b", scope="drop")
    point = toy_point({"b": 20.0}, {"b": -10.0})
    each = left(point, (), effect, by_drop=True)
    assert each == pytest.approx([SAMPLES, SAMPLES], rel=1e-3)
    assert each.sum() == pytest.approx(fitted(point, (effect,)).cost, rel=1e-3)
    together = left(point, (), effect)
    # One amount for both: their mean, 5, leaves 15 of each.
    assert together == pytest.approx([SAMPLES + 15.0**2] * 2, rel=1e-3)
    assert together.sum() == pytest.approx(fitted(point, (B,)).cost, rel=1e-3)


def test_a_drop_where_the_effect_does_nothing_is_left_as_it_was() -> None:
    class First(Toy):
        scope = "drop"

        def acts_on(self, drop: DropContext) -> bool:
            return drop.index == 0

    point = toy_point({"b": 20.0}, {"b": 20.0})
    found = left(point, (), First("b"), by_drop=True)
    assert found == pytest.approx([SAMPLES, SAMPLES + 400.0], rel=1e-3)


def test_priors_are_no_part_of_it() -> None:
    held = Toy("a", parameters=(Parameter("size", "-", -100.0, 100.0, (10.0,), prior=(0.0, 1.0)),))
    point = toy_point({"a": 30.0, "b": 20.0})
    plain, weighed = (Problem([point], (held,), prior_weight=weight) for weight in (0.0, 5.0))
    device, own = starts(plain)
    problem = Problem([point], (held, B), prior_weight=5.0)
    larger = np.append(own[0], B.parameters[0].unit_value(10.0))
    found = [
        Tangent.of(Fit(p, device, tuple(own), 0.0, 1.0, np.zeros((0, 0)))).left(
            problem, device, larger, by_drop=False
        )[0]
        for p in (plain, weighed)
    ]
    assert found[0] == pytest.approx(SAMPLES, rel=1e-3)
    assert found[1] == pytest.approx(found[0])


def test_unknowns_that_change_nothing_are_no_direction() -> None:
    still = Toy("a", 0.0 * GROUND)
    point = toy_point({"b": 20.0})
    tangent = Tangent.of(at(Problem([point], (still,))))
    assert tangent.basis.shape == (SAMPLES, 1)
    assert left(point, (still,), B)[0] == pytest.approx(SAMPLES, rel=1e-3)
    assert left(point, (), still)[0] == pytest.approx(SAMPLES + 400.0, rel=1e-3)


def test_a_prediction_without_a_value_gains_nothing() -> None:
    class Broken(Toy):
        def record(self, record: Array, values: Values, drop: DropContext) -> Array:
            return np.full_like(record, np.nan)

    point = toy_point({"b": 20.0})
    assert left(point, (), Broken("c"))[0] == pytest.approx(SAMPLES + 400.0, rel=1e-6)


def test_samples_of_each_drop_stand_one_after_the_other() -> None:
    point = toy_point({}, {}, {})
    tangent = Tangent.of(at(Problem([point], ())))
    assert tangent.rows == tuple(slice(SAMPLES * i, SAMPLES * (i + 1)) for i in range(3))
    assert tangent.residual.size == 3 * SAMPLES
    assert tangent.basis.T @ tangent.basis == pytest.approx(np.eye(tangent.basis.shape[1]))
