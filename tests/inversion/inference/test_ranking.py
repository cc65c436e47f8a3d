"""The ranking by bounds chooses the structure that a ranking of all structures chooses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext
from inversion.inference import structures
from inversion.inference.instrument import (
    choose_structure,
    rank_at_point,
    structure_evidence,
)
from inversion.inference.posterior import Posterior
from inversion.inference.structures import (
    Structure,
    candidate_structures,
    fit_briefly,
    fit_richest_first,
    rank_structures,
)
from pfwd.analysis.diagnosis.entries import entries_of
from pfwd.analysis.options import AnalysisOptions
from tests.campaigns.effects.march import SoilLaw, strike
from tests.campaigns.effects.response import GroundResponse, ground_response
from tests.campaigns.effects.soil import PowerLaw
from tests.inversion.simulated_drops import (
    HAMMER,
    MASS,
    NOISE,
    RADIUS,
    point_of,
    record_of,
    uniform_ground,
)


@cache
def response_over_rock(depth: float) -> GroundResponse:
    return ground_response(uniform_ground(60e6, depth), RADIUS, (0.0,), duration=0.036)


def simulated(depth: float = np.inf, exponent: float = 0.0) -> PointRecords:
    """Return a drop on rock at a depth, m, with a modulus that grows with stress in each instant.

    The depth is not declared.
    """
    response = response_over_rock(depth)
    samples = round(0.035 / response.time_step)
    largest = 250e-6
    law: SoilLaw | None = None
    if exponent:
        law = PowerLaw(response.static_stiffness, largest, exponent, rest=0.05 * largest)
    drop = strike(response, MASS, HAMMER, samples, law=law)
    moved = drop.plate_displacement
    return point_of(
        record_of(response.time_step, drop.load, moved, noise=NOISE * float(moved.max()))
    )


def fit_all(point: Point, drop: int) -> dict[Structure, float]:
    """Return the log evidence of every candidate structure."""
    candidates = candidate_structures([model.context for model in point.drops])
    fits = {structure: fit_briefly(point, structure, drop, {}) for structure in candidates}
    return {s: fit.log_evidence for s, fit in fits.items() if fit is not None}


def test_only_structures_that_could_be_the_best_are_fitted() -> None:
    evidence = {frozenset("de"): 50.0, frozenset("ab"): 10.0, frozenset("f"): 60.0}
    poor = frozenset("a")

    def fit(structure: Structure) -> Any:
        value = evidence[structure]
        return SimpleNamespace(log_evidence=value, occam_factor=lambda _: 3.0)

    ranking = fit_richest_first([poor, *evidence], fit)
    assert (ranking.evidence, ranking.bounds) == (evidence, {poor: 13.0})


def assert_same_choice(
    records: PointRecords, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> Structure:
    """Return the structure that both rankings choose; fewer are fitted in one of them."""
    last = len(records.records) - 1
    every = fit_all(Point(records, library), last)
    fitted: list[Structure] = []

    def count(point: Point, structure: Structure, *variants: object) -> Posterior | None:
        fitted.append(structure)
        return fit_briefly(point, structure, last, {})

    monkeypatch.setattr(structures, "fit_briefly", count)
    ranking = rank_structures(Point(records, library), last, {})
    ranked = ranking.bounds | ranking.evidence
    assert set(ranked) == set(every)
    assert set(ranking.evidence) == set(fitted)
    assert len(fitted) < len(every)
    # A short fit may end in another optimum in the other order of the fits; the better one counts.
    reached = {s: max(value, ranking.evidence.get(s, -np.inf)) for s, value in every.items()}
    best = max(reached, key=lambda structure: reached[structure])
    assert max(ranked, key=lambda structure: ranked[structure]) == best
    assert best in fitted
    for structure in fitted:
        # That of a measured drop is up to 31 better. A worse one would be a wrong ranking.
        assert ranking.evidence[structure] > every[structure] - 0.5
    return best


@pytest.mark.parametrize(
    ("depth", "exponent", "expected_effects", "absent"),
    [
        pytest.param(0.6, 0.0, {"bedrock"}, {"rebound"}, id="rock"),
        pytest.param(
            *(np.inf, 0.0, set(), {"rebound", "geophone_response"}),
            id="half-space",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *(np.inf, 0.4, {"stress_dependence"}, {"rebound"}),
            id="stiffening",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_best_structure_is_fitted(
    depth: float,
    exponent: float,
    expected_effects: set[str],
    absent: set[str],
    library: SurrogateLibrary,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    best = assert_same_choice(simulated(depth, exponent), library, monkeypatch)
    assert best >= expected_effects
    assert not best & absent


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("maxidyn_a_05", marks=pytest.mark.slow),
        pytest.param("minidyn_a_19", marks=pytest.mark.slow),
        pytest.param("minidyn_b_01", marks=pytest.mark.slow),
    ],
)
def test_measured_drops_have_the_same_structure(
    name: str, shared: Path, library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    (entry,) = entries_of(str(shared / "measured" / f"{name}.csv"), AnalysisOptions())
    assert_same_choice(entry.records, library, monkeypatch)


def test_the_structure_of_two_points_with_different_best_ones_is_fitted_at_both(
    library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fewer(contexts: Sequence[DropContext]) -> list[Structure]:
        excluded = {"spring_rig", "rebound", "damping_law"}
        return [s for s in candidate_structures(contexts) if not s & excluded]

    monkeypatch.setattr(structures, "candidate_structures", fewer)
    points = [simulated(0.6), simulated(0.6, exponent=0.2)]
    rankings = [rank_at_point(records, {}, library) for records in points]
    best = [max(ranking.evidence, key=ranking.evidence.__getitem__) for ranking in rankings]
    assert best[1] == best[0] | {"stress_dependence", "hysteretic_unloading"}
    # The first point excludes the structure that wins by a bound, without a fit.
    assert best[1] in rankings[0].bounds
    chosen = choose_structure(
        rankings, lambda place, s: structure_evidence(points[place], s, {}, library)
    )
    assert chosen == best[1]
    everywhere = [s for s in rankings[0].evidence if s in rankings[1].evidence]
    totals = {s: sum(ranking.evidence[s] for ranking in rankings) for s in everywhere}
    assert totals[chosen] == max(totals.values())


def test_the_occam_factor_is_that_of_the_deviations(library: SurrogateLibrary) -> None:
    point = Point(simulated(depth=0.6), library)
    poor: Structure = frozenset({"sensor_lag"})
    fit = fit_briefly(point, poor | {"plate_inertia", "stress_dependence"}, 0, {})
    prior = fit.model.deviation
    as_the_prior = replace(fit, covariance=np.diag(prior**2))
    assert as_the_prior.occam_factor(poor) == pytest.approx(0.0, abs=1e-9)
    # The mass, the exponent and the stress at rest are known four times as well.
    better = replace(fit, covariance=np.diag((prior / 4.0) ** 2))
    assert better.occam_factor(poor) == pytest.approx(3.0 * np.log(4.0))
    assert better.occam_factor(poor | {"stress_dependence"}) == pytest.approx(np.log(4.0))
