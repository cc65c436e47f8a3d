"""Selection of structures by a given log evidence: visited ones and the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import combinations
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion.effects import BY_NAME
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.selection import Selection
from inversion.inference.structures import Structure, candidate_structures
from tests.inversion.effects.drop_contexts import context

EMPTY: Structure = frozenset()
NO_KNOWLEDGE = InstrumentKnowledge()


SINGLE_DROP = SimpleNamespace(
    point=SimpleNamespace(drops=(SimpleNamespace(peak=np.ones(1)),)), last=0
)


class Toy(Selection):
    """A selection whose fits have a log evidence by a rule; counts them."""

    def __init__(
        self,
        evidence: Callable[[Structure], float],
        instrument: InstrumentKnowledge = NO_KNOWLEDGE,
        discrepancy: float = 1e-2,
        changes: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        drops: Any = (SimpleNamespace(context=context(count=1)),)
        point: Any = SimpleNamespace(drops=drops)
        super().__init__(point, [0], instrument)
        self._evidence = evidence
        self._discrepancy = SimpleNamespace(scale=discrepancy)
        self._changes = changes
        self.order: list[Structure] = []

    def _fit(self, structure: Structure, starting: Structure | None = None) -> Any:
        if structure in self._refused:
            return None
        if structure not in self.fits:
            moved = sum(self._changes.get(name, 1.0) for name in structure)
            evidence = self._evidence(structure)
            self.order.append(structure)
            fit: Any = SimpleNamespace(
                log_evidence=evidence,
                discrepancy=self._discrepancy,
                occam_factor=lambda effects: math.inf,
                predictions=(np.full((1, 1), moved),),
                model=SINGLE_DROP,
            )
            self.fits[structure] = fit
        return self.fits[structure]


def by_gains(gains: Mapping[str, float], else_: float = -5.0) -> Callable[[Structure], float]:
    """Return an evidence to which each effect adds its own part."""
    return lambda structure: sum(gains.get(name, else_) for name in structure)


def searched(*arguments: Any, **more: Any) -> Toy:
    """Return a toy after its search."""
    toy = Toy(*arguments, **more)
    toy.search()
    return toy


def test_effects_are_added_as_long_as_they_pay_for_their_odds() -> None:
    toy = searched(by_gains({"bedrock": 50.0, "sensor_lag": 20.0, "baseline_drift": 2.9}))
    assert toy.best == {"bedrock", "sensor_lag"}
    more = searched(by_gains({"bedrock": 50.0, "sensor_lag": 20.0, "baseline_drift": 3.1}))
    assert more.best == {"bedrock", "sensor_lag", "baseline_drift"}


@pytest.mark.parametrize(("change", "stays"), [(0.0031, True), (0.0029, False)])
@pytest.mark.parametrize("starting", [(), (frozenset({"bedrock", "sensor_lag"}),)])
def test_an_effect_that_changes_less_than_the_model_errs_is_refused(
    change: float, stays: bool, starting: tuple[Structure, ...]
) -> None:
    knowledge = InstrumentKnowledge(starting_structures=starting)
    gains = {"bedrock": 50.0, "sensor_lag": 20.0}
    toy = searched(by_gains(gains), knowledge, changes={"sensor_lag": change})
    assert toy.best == ({"bedrock", "sensor_lag"} if stays else {"bedrock"})


def test_superfluous_effects_of_a_candidate_are_removed() -> None:
    # Nothing pays alone: only a candidate of several effects leads there.
    pair = {"stress_dependence", "hysteretic_unloading"}

    def evidence(structure: Structure) -> float:
        return (200.0 if pair <= structure else 0.0) - 5.0 * len(structure)

    assert searched(evidence).best == pair


def test_candidates_without_a_fit_are_no_start_for_slow_grounds() -> None:
    """A record that hardly any structure fits has fewer fits than starts for slow grounds."""

    class FitsOneStructure(Toy):
        def _fit(self, structure: Structure, starting: Structure | None = None) -> Any:
            return (
                super()._fit(structure, starting) if starting is not None or not structure else None
            )

    selection = FitsOneStructure(lambda structure: -10.0 * len(structure))
    selection.search()
    assert selection.best == EMPTY


def test_candidates_are_not_fitted_to_a_small_discrepancy() -> None:
    toy = searched(by_gains({}), discrepancy=1e-3)
    assert toy.best == EMPTY
    assert all(len(structure) <= 1 for structure in toy.fits)
    everything = set(candidate_structures([context(count=1)]))
    assert not everything & set(toy.fits)


def test_an_effect_of_a_pair_is_exchanged() -> None:
    values = {
        frozenset({"bedrock"}): 40.0,
        frozenset({"bedrock", "sensor_lag"}): 50.0,
        frozenset({"sensor_lag", "baseline_drift"}): 60.0,
    }
    toy = searched(lambda structure: values.get(structure, 0.0), discrepancy=1e-3)
    assert toy.best == {"sensor_lag", "baseline_drift"}


def test_growth_with_depth_does_not_hide_the_effects_that_it_resembles() -> None:
    values = {
        frozenset({"modulus_gradient"}): 50.0,
        frozenset({"bedrock"}): 40.0,
        frozenset({"bedrock", "sensor_lag"}): 90.0,
    }
    toy = searched(lambda structure: values.get(structure, 0.0), discrepancy=1e-3)
    assert toy.best == {"bedrock", "sensor_lag"}
    values[frozenset({"modulus_gradient"})] = 100.0
    growing = searched(lambda structure: values.get(structure, 0.0), discrepancy=1e-3)
    assert growing.best == {"modulus_gradient"}


def test_effects_of_the_instrument_stay_and_absent_ones_are_not_tried() -> None:
    lag: Structure = frozenset({"sensor_lag"})
    knowledge = InstrumentKnowledge(effects=lag, absent=frozenset({"geophone_response"}))
    toy = searched(
        by_gains({"bedrock": 50.0, "geophone_response": 90.0, "sensor_lag": -9.0}), knowledge
    )
    assert toy.best == {"bedrock", "sensor_lag"}
    assert all(lag <= structure for structure in toy.fits)
    assert not any("geophone_response" in structure for structure in toy.fits)


def test_a_search_begins_at_the_structures_of_points_nearby() -> None:
    starting: Structure = frozenset({"bedrock", "sensor_lag"})
    toy = searched(
        by_gains({"bedrock": 50.0, "sensor_lag": 20.0}),
        InstrumentKnowledge(starting_structures=(starting,)),
    )
    assert toy.best == starting
    assert toy.order[:2] == [EMPTY, starting]
    assert max(map(len, toy.fits)) <= 3


def test_a_structure_is_fitted_once_and_has_no_excluding_pair() -> None:
    toy = searched(by_gains({"bedrock": 50.0, "permanent_set": 30.0, "sensor_lag": 20.0}, -1.0))
    assert len(toy.order) == len(set(toy.order))
    for structure in toy.fits:
        effects = [BY_NAME[name] for name in structure]
        assert not any(a.conflicts_with(b) for a, b in combinations(effects, 2))


def test_gains_are_differences_about_the_best_structure() -> None:
    toy = searched(by_gains({"bedrock": 50.0, "sensor_lag": 20.0, "baseline_drift": 1.0}))
    gains = toy.gains()
    assert gains["bedrock"] == pytest.approx(50.0)
    assert gains["baseline_drift"] == pytest.approx(1.0)
    assert gains["geophone_response"] == pytest.approx(-5.0)
    # What excludes one of the best was not fitted beside it.
    assert "spring_rig" not in gains


def test_weights_are_probabilities_over_that_of_the_best() -> None:
    toy = searched(by_gains({"bedrock": 5.0, "sensor_lag": 4.0}), discrepancy=1e-3)
    weights = toy.weights()
    best = toy.best
    assert best == {"bedrock", "sensor_lag"}
    assert weights[best] == 1.0
    # Each effect is -3 in odds.
    assert weights[frozenset({"bedrock"})] == pytest.approx(math.exp(-1.0))
    assert weights[EMPTY] == pytest.approx(math.exp(-3.0))
    assert toy.score(frozenset({"mains_hum", "layer"})) == -math.inf


def test_more_than_three_effects_of_a_point_are_overparameterised() -> None:
    three = {"bedrock": 50.0, "sensor_lag": 40.0, "baseline_drift": 30.0}
    assert not searched(by_gains(three)).is_overparameterised
    four = three | {"geophone_response": 20.0}
    assert searched(by_gains(four)).is_overparameterised
    # What the device is known to have does not count, and other points tell what is likely.
    shared = InstrumentKnowledge(effects=frozenset({"geophone_response"}))
    assert not searched(by_gains(four), shared).is_overparameterised
    variants: Any = (object(),)
    assert not searched(
        by_gains(four), InstrumentKnowledge(peer_points=variants)
    ).is_overparameterised
