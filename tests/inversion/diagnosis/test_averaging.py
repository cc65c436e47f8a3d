"""The modulus over sets of effects that fit nearly alike, against mixtures written out here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from inversion.diagnosis.averaging import Averaged, average, deviation_of_modulus
from inversion.diagnosis.discrepancy import Discrepancy
from inversion.diagnosis.problem import Unknown
from inversion.effects import Effect
from inversion.fitting.parameters import Parameter
from tests.inversion.diagnosis.toys import Toy

RATIO = Parameter("modulus_ratio", "-", 0.1, 10.0, (1.0,), logarithmic=True)
# Of the unit value, which spans this much of the logarithm.
SPAN = math.log(100.0)
COUNTED = 60.0
A, B = Toy("a"), Toy("b")
RIG = Toy("c", replaces_ground=True)


@dataclass(eq=False)
class GivenSet:
    """A set of effects with what a fit of it said: the modulus, Pa, known so well (logarithm)."""

    score: float = 0.0
    modulus: float = 4e7
    deviation: float = 0.05
    effects: tuple[Effect, ...] = (A,)
    independent: float = COUNTED
    model_error: float = 0.0
    device: int = 1
    fit: Any = field(init=False)

    def __post_init__(self) -> None:
        problem = SimpleNamespace(device=[None] * self.device, own=[[Unknown(RATIO)]])
        covariance = np.diag([9.0] * self.device + [(self.deviation / SPAN) ** 2])
        known = Discrepancy(0.0, 0.0, self.independent, covariance)
        self.fit = SimpleNamespace(problem=problem, own=([0.4],), known=known, at_bound=list)

    @property
    def names(self) -> frozenset[str]:
        return frozenset(effect.name for effect in self.effects)


@pytest.fixture(autouse=True)
def given_discrepancies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Discrepancy, "of", lambda found: found.known)


def modulus_of(candidate: GivenSet) -> float:
    assert RIG not in candidate.effects, "a rig has no modulus"
    return candidate.modulus


def averaged(best: GivenSet, *others: GivenSet, counted: float = COUNTED) -> Averaged:
    sets: list[Any] = list(others)
    given: Any = best
    errors: Any = lambda candidate: candidate.model_error  # noqa: E731
    moduli: Any = modulus_of
    return average(given, sets, counted, moduli, errors)


def mixture(value: float, weighed: Sequence[tuple[float, GivenSet]]) -> float:
    """Share of a mixture of normal distributions of the logarithm below a modulus."""
    total = sum(weight for weight, _ in weighed)
    return sum(
        weight * norm.cdf(math.log(value / found.modulus) / found.deviation)
        for weight, found in weighed
    ) / total  # fmt: skip


def apart(delta: float, **changes: Any) -> GivenSet:
    """Another set, worse by so much, on another ground."""
    return GivenSet(**({"score": delta, "modulus": 8e7, "effects": (B,)} | changes))


# --- the interval --------------------------------------------------------------------------------


def test_of_one_set_it_is_that_of_its_normal_distribution() -> None:
    found = averaged(GivenSet())
    reach = norm.ppf(0.975) * 0.05
    assert np.log(np.array(found.interval) / 4e7) == pytest.approx([-reach, reach], rel=1e-5)
    assert found.deviation == pytest.approx(0.05)


def test_it_is_the_same_whatever_the_scores_count_from() -> None:
    first, second = (
        averaged(GivenSet(shift), apart(3.0 + shift)).interval for shift in (0.0, -500.0)
    )
    assert first == pytest.approx(second)


@pytest.mark.parametrize("delta", [0.0, 1.0, 4.0, 7.0])
def test_sets_are_weighed_by_half_the_difference_of_their_criteria(delta: float) -> None:
    best, other = GivenSet(), apart(delta, deviation=0.1)
    low, high = averaged(best, other).interval
    weighed = [(1.0, best), (math.exp(-delta / 2), other)]
    assert mixture(low, weighed) == pytest.approx(0.025, abs=1e-5)
    assert mixture(high, weighed) == pytest.approx(0.975, abs=1e-5)


def test_quantiles_of_two_that_lie_far_apart() -> None:
    """Half of each: 2.5 % of both are 5 % of the lower."""
    low, high = averaged(GivenSet(), apart(0.0, deviation=0.02)).interval
    assert math.log(low / 4e7) == pytest.approx(norm.ppf(0.05) * 0.05, rel=1e-4)
    assert math.log(high / 8e7) == pytest.approx(norm.ppf(0.95) * 0.02, rel=1e-4)


@pytest.mark.parametrize("independent", [15.0, 30.0])
def test_what_is_not_independent_counts_for_less(independent: float) -> None:
    best, other = GivenSet(independent=independent), apart(6.0)
    low, high = averaged(best, other).interval
    weighed = [(1.0, best), (math.exp(-3.0 * independent / COUNTED), other)]
    assert mixture(low, weighed) == pytest.approx(0.025, abs=1e-5)
    assert mixture(high, weighed) == pytest.approx(0.975, abs=1e-5)


def test_no_more_is_independent_than_the_criterion_counts() -> None:
    found = [averaged(GivenSet(independent=n), apart(6.0)).interval for n in (60.0, 600.0)]
    assert found[0] == pytest.approx(found[1])


def test_a_set_that_fits_better_weighs_no_more_than_the_best() -> None:
    """It was not taken, as it is not worth its parameters."""
    better, alike = (averaged(GivenSet(), apart(delta)).interval for delta in (-9.0, 0.0))
    assert better == pytest.approx(alike)


@pytest.mark.parametrize(("weight", "counts"), [(0.0205, True), (0.0195, False)])
def test_sets_of_less_than_a_fiftieth_do_not_count(weight: float, counts: bool) -> None:
    alone = averaged(GivenSet()).interval
    found = averaged(GivenSet(), apart(-2.0 * math.log(weight))).interval
    assert found[0] == pytest.approx(alone[0], rel=1e-2)
    assert (found[1] > 1.02 * alone[1]) == counts


def test_no_more_than_eight_count_the_heaviest_first() -> None:
    def of(count: int, *more: GivenSet) -> tuple[float, float]:
        near = [
            GivenSet(0.1 + 0.01 * i, 4e7 * (1.01 + 0.01 * i), effects=(B,)) for i in range(count)
        ]
        return averaged(GivenSet(), *more, *near).interval

    far = apart(1.0)
    assert of(7, far) == pytest.approx(of(7))
    assert of(6, far)[1] > 1.3 * of(6)[1]


def test_one_solution_counts_once_whatever_effects_it_has() -> None:
    """The same modulus by another set says nothing new of it."""
    other = apart(0.0)
    copies = [GivenSet(0.0, 4e7 * (1 + 4e-4 * i), effects=(A, B)) for i in (-2, -1, 0, 1, 2)]
    expected = averaged(GivenSet(), other).interval
    assert averaged(GivenSet(), *copies, other).interval == pytest.approx(expected)
    distinct = GivenSet(0.0, 4e7 * 1.002, effects=(A, B))
    assert averaged(GivenSet(), distinct, other).interval != pytest.approx(expected, rel=1e-4)


def test_the_best_is_not_counted_twice() -> None:
    best, other = GivenSet(), apart(2.0)
    assert averaged(best, best, other).interval == averaged(best, other).interval
    assert averaged(best, best, other).probabilities == averaged(best, other).probabilities


@pytest.mark.parametrize("error", [0.1, 0.3])
def test_the_models_own_error_is_one_of_95_percent(error: float) -> None:
    found = averaged(GivenSet(deviation=0.0, model_error=error))
    assert np.log(np.array(found.interval) / 4e7) == pytest.approx([-error, error], rel=1e-4)
    both = averaged(GivenSet(deviation=0.05, model_error=error))
    assert both.deviation == pytest.approx(math.hypot(0.05, error / norm.ppf(0.975)), rel=1e-4)


def test_each_set_has_its_own_deviation_and_error() -> None:
    best = GivenSet(deviation=0.01)
    other = apart(0.0, deviation=0.03, model_error=0.2)
    _, high = averaged(best, other).interval
    of_other = math.hypot(0.03, 0.2 / norm.ppf(0.975))
    assert math.log(high / 8e7) == pytest.approx(norm.ppf(0.95) * of_other, rel=1e-4)
    assert averaged(best, other).deviation == pytest.approx(0.01)


def test_a_modulus_that_is_known_exactly_has_an_interval() -> None:
    low, high = averaged(GivenSet(deviation=0.0)).interval
    assert (low, high) == pytest.approx((4e7, 4e7), rel=1e-6)
    assert low < high


# --- probabilities -------------------------------------------------------------------------------


def test_an_effect_is_as_probable_as_the_sets_that_have_it() -> None:
    best = GivenSet(effects=(A,))
    both = GivenSet(2.0, 5e7, effects=(A, B))
    none = GivenSet(4.0, 6e7, effects=())
    total = 1.0 + math.exp(-1.0) + math.exp(-2.0)
    assert averaged(best, both, none).probabilities == pytest.approx(
        {"a": (1.0 + math.exp(-1.0)) / total, "b": math.exp(-1.0) / total}
    )


def test_probabilities_are_tempered_as_the_modulus_is() -> None:
    best = GivenSet(effects=(A,), independent=COUNTED / 4)
    other = GivenSet(8.0, 5e7, effects=(B,))
    weight = math.exp(-1.0)
    assert averaged(best, other).probabilities["b"] == pytest.approx(weight / (1 + weight))


def test_a_set_counts_at_its_best_and_once() -> None:
    best = GivenSet(effects=(A,))
    ends = [GivenSet(delta, 5e7 + 1e6 * delta, effects=(B,)) for delta in (2.0, 3.0, 2.5)]
    weight = math.exp(-1.0)
    assert averaged(best, *ends).probabilities["b"] == pytest.approx(weight / (1 + weight))


def test_light_sets_count_for_probabilities_too() -> None:
    best, other = GivenSet(effects=(A,)), GivenSet(2 * math.log(1000.0), 5e7, effects=(B,))
    assert averaged(best, other).probabilities["b"] == pytest.approx(1e-3 / 1.001)


def test_a_rig_has_no_modulus_but_a_probability() -> None:
    rig = GivenSet(0.0, math.nan, effects=(RIG,))
    found = averaged(GivenSet(), rig)
    assert found.interval == averaged(GivenSet()).interval
    assert found.probabilities["c"] == pytest.approx(0.5)


# --- the deviation of a set ----------------------------------------------------------------------


def test_a_deviation_is_that_of_the_grounds_first_unknown() -> None:
    """Behind what belongs to the device, whose own deviation is another."""
    for device in (0, 1, 3):
        given: Any = GivenSet(deviation=0.07, device=device)
        assert deviation_of_modulus(given, given.fit.known) == pytest.approx(0.07)


@pytest.mark.parametrize("deviation", [50.0, math.inf, math.nan])
def test_what_is_not_known_is_told_as_a_factor_of_twenty(deviation: float) -> None:
    given: Any = GivenSet(deviation=deviation)
    assert deviation_of_modulus(given, given.fit.known) == 3.0
    given = GivenSet(deviation=2.9)
    assert deviation_of_modulus(given, given.fit.known) == pytest.approx(2.9)


def test_what_the_best_left_is_handed_on() -> None:
    best = GivenSet()
    assert averaged(best, apart(0.0)).discrepancy is best.fit.known


def test_what_would_go_on_past_its_bounds_does_not_count() -> None:
    best, other = GivenSet(), apart(0.0)
    assert averaged(best, other).interval != averaged(best).interval
    other.fit.at_bound = lambda: [Unknown(RATIO, B)]
    assert averaged(best, other).interval == pytest.approx(averaged(best).interval)
    # A bound of the ground's own is none of an effect.
    other.fit.at_bound = lambda: [Unknown(RATIO, None)]
    assert averaged(best, other).interval != averaged(best).interval
