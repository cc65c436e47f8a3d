"""Evidence between structures: rock of simulated ground is preferred, absent rock is not."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest

from inversion import SurrogateLibrary, invert
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.catalogue import BY_NAME
from inversion.inference.diagnose import fit_drops_of_selection
from inversion.inference.instrument import choose_structure
from inversion.inference.modulus import equivalent_modulus, ground_of
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge
from inversion.inference.posterior import PointFit
from inversion.inference.selection import Selection
from inversion.inference.structures import (
    Ranking,
    Structure,
    candidate_structures,
    effects_of,
    fit_briefly,
)
from simulators.drop import PrescribedLoad, simulate_drop
from simulators.mesh import Plate, SoilProfile
from tests.inversion.effects.drop_contexts import context
from tests.inversion.simulated_drops import BEFORE, RADIUS, point_of, recorded, uniform_ground

MODULUS, DEPTH = 50e6, 0.9
ALWAYS = frozenset({"sensor_lag", "plate_inertia"})


def point(depth: float) -> PointRecords:
    return point_of(recorded(uniform_ground(MODULUS, depth)))


@pytest.mark.parametrize("depth", [DEPTH, 2.0, np.inf])
def test_rock_is_preferred_where_it_is(depth: float) -> None:
    library = SurrogateLibrary()
    records = Point(point(depth), library)
    fits = {
        rock: fit_briefly(records, ALWAYS | ({"bedrock"} if rock else set()), 0, {})
        for rock in (False, True)
    }
    with_rock, without = fits[True], fits[False]
    gain = with_rock.log_evidence - without.log_evidence
    if math.isinf(depth):
        # It explains nothing more, and costs its prior.
        assert gain < 1.0
        return
    assert gain > 10.0
    assert with_rock.by_key["bedrock", "depth", None] == pytest.approx(1.0 / depth, rel=0.02)
    assert ground_of(with_rock).modulus == pytest.approx(MODULUS, rel=0.02)


def test_the_equivalent_half_space_deflects_as_much_in_finite_elements() -> None:
    depth = DEPTH
    records = point(depth)
    fit = fit_briefly(Point(records, SurrogateLibrary()), ALWAYS | {"bedrock"}, 0, {})
    modulus, deviation = equivalent_modulus(fit)
    ground, _ = fit.model.ground_and_effects(fit.values, 0)
    relaxation = ground.viscosity / ground.modulus
    load = PrescribedLoad(records.records[0].time[BEFORE:], records.records[0].load[BEFORE:])

    def peak(modulus: float, viscosity: float, density: float, depth: float) -> float:
        simulated = SoilProfile.uniform(modulus, viscosity, density, 0.35, depth)
        drop = simulate_drop(simulated, Plate(RADIUS), load, duration=0.03, time_step=2e-4)
        return float(drop.plate_displacement.max())

    equivalent = math.exp(modulus)
    half_space = peak(equivalent, equivalent * relaxation, ground.density, math.inf)
    assert half_space == pytest.approx(peak(MODULUS, 5e4, 1900.0, depth), rel=0.005)
    assert equivalent > 1.02 * MODULUS
    assert 0.0 < deviation < 0.02
    inverted = invert(records.records[0])
    assert inverted.equivalent_modulus_pa == pytest.approx(equivalent, rel=0.005)
    assert inverted.modulus_depth_m == (0.0, inverted.bedrock_depth_m)


def test_the_evidence_of_all_points_decides_among_common_structures() -> None:
    rock, empty, layer = frozenset({"bedrock"}), frozenset[str](), frozenset({"layer"})
    rankings = [Ranking({empty: 10.0, rock: 8.0, layer: 99.0}), Ranking({empty: 3.0, rock: 9.0})]
    assert choose_structure(rankings, no_fit) == rock
    assert choose_structure(rankings[:1], no_fit) == layer


def no_fit(place: int, structure: Structure) -> float | None:
    raise AssertionError("every structure is fitted")


@pytest.mark.parametrize("evidence", [1.0, None])
def test_a_structure_that_no_point_fitted_is_not_chosen_for_its_bounds(
    evidence: float | None,
) -> None:
    rock, empty, layer = frozenset({"bedrock"}), frozenset[str](), frozenset({"layer"})
    rankings = [Ranking({rock: 10.0, empty: 2.0}, {layer: 9.0})]
    rankings.append(Ranking({empty: 10.0}, {rock: 8.0, layer: 9.5}))
    fitted: list[tuple[int, Structure]] = []

    def fit(place: int, structure: Structure) -> float | None:
        fitted.append((place, structure))
        return 7.0 if structure == rock else evidence

    # The layer has the largest sum of bounds, but is worse than the others where it is fitted.
    assert choose_structure(rankings, fit) == rock
    assert fitted == [(0, layer), (1, layer), (1, rock)]
    assert [layer in ranking.bounds for ranking in rankings] == [False, False]


@pytest.mark.parametrize(
    ("offsets", "some", "absent"),
    [
        ([0.0], {"spring_rig", "rebound", "carrier_resonance"}, {"layer", "modulus_gradient"}),
        ([0.0, 0.6], {"layer", "modulus_gradient"}, {"spring_rig"}),
    ],
)
def test_candidates_are_what_the_sensors_can_show(
    offsets: list[float], some: set[str], absent: set[str]
) -> None:
    candidates = candidate_structures([context(offsets=np.array(offsets))])
    names = set().union(*candidates)
    assert some | {"bedrock", "modulus_gradient_root"} <= names
    assert not absent & names
    for structure in candidates:
        assert structure >= ALWAYS or "spring_rig" in structure
        assert not any(a.conflicts_with(b) for a, b in permutations(effects_of(structure), 2))


def test_priors_of_peers_move_the_start() -> None:
    records = Point(point(DEPTH), SurrogateLibrary())
    model = PointModel(records, effects_of(ALWAYS), [0])
    place = model.keys.index(("sensor_lag", "delay", None))
    assert model.start[place] == 0.0
    model.apply_priors({("sensor_lag", "delay", None): (2e-4, 1e-5)})
    assert model.start[place] == 2e-4
    assert model.deviation[place] == 1e-5
    # Without records the cost is the distance from the priors.
    cost = PointFit(model).cost(model.mean + 2.0 * model.deviation, [], [])
    assert cost == pytest.approx(4.0 * model.mean.size)


def test_a_structure_whose_fit_of_all_drops_is_implausible_is_not_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    simulated = Point(point(DEPTH), SurrogateLibrary())
    knowledge = InstrumentKnowledge(effects=ALWAYS, starting_structures=(frozenset({"bedrock"}),))
    selection = Selection(simulated, [0], knowledge)
    for structure in (ALWAYS, ALWAYS | {"bedrock"}):
        assert selection._fit(structure) is not None
    assert selection.best == ALWAYS | {"bedrock"}
    fit, _ = fit_drops_of_selection(simulated, selection, knowledge)
    assert ground_of(fit).modulus == pytest.approx(MODULUS, rel=0.02)
    # Plausible in the selection, but no longer in the final fit.
    monkeypatch.setattr(type(BY_NAME["bedrock"]), "is_sound", lambda *_: False)
    fit, _ = fit_drops_of_selection(simulated, selection, knowledge)
    assert {effect.name for effect in fit.model.effects} == ALWAYS
    assert selection.best == ALWAYS
    # Without an alternative the last fit is returned.
    alone = Selection(simulated, [0], knowledge)
    alone.fits[ALWAYS] = fit
    monkeypatch.setattr(type(BY_NAME["sensor_lag"]), "is_sound", lambda *_: False)
    assert fit_drops_of_selection(simulated, alone, knowledge)[0].model.effects == fit.model.effects
