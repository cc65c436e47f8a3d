"""Points of one instrument: choice of their common structure, fits, prediction of further drops."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import PointSummary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.base import Values
from inversion.effects.catalogue import BY_NAME
from inversion.forward.library import SurrogateLibrary
from inversion.inference.next_drop import DropPredictor
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge as InstrumentKnowledge
from inversion.inference.population import population_priors, summarise
from inversion.inference.posterior import PointFit
from inversion.inference.structures import (
    Ranking,
    Structure,
    effects_of,
    fit_briefly,
    fit_drops,
    rank_structures,
)
from inversion.threads import single_threaded_blas

# Number of points on which the structure is chosen. More points do not change the choice.
MAX_RANKED_POINTS = 5
# Largest log evidence that one point contributes for or against an effect, and smallest sum over
# all points for a shared effect.
_MAX_POINT_EVIDENCE, _MIN_TOTAL_EVIDENCE = 10.0, 3.0


def rank_at_point(
    records: PointRecords, declared_effects: Mapping[str, Values], library: SurrogateLibrary
) -> Ranking:
    """Return the ranking of the candidate structures by the last drop of a point."""
    point = Point(records, library).coarse()
    return rank_structures(point, len(point.drops) - 1, declared_effects)


def structure_evidence(
    records: PointRecords,
    structure: Structure,
    declared_effects: Mapping[str, Values],
    library: SurrogateLibrary,
) -> float | None:
    """Return the log evidence of a structure for the last drop of a point, see `Ranking`.

    The result is None if the fit fails.
    """
    point = Point(records, library).coarse()
    fit = fit_briefly(point, structure, len(point.drops) - 1, declared_effects)
    return None if fit is None else fit.log_evidence


def choose_structure(
    rankings: Sequence[Ranking], evidence_at: Callable[[int, Structure], float | None]
) -> Structure:
    """Return the structure with the largest log evidence, summed over the points.

    Only structures that every point has are compared. The best one is fitted where it has only an
    upper bound, and its evidence is added to the rankings, until the best one is fitted at every
    point.

    Parameters
    ----------
    rankings : Ranking of each point
    evidence_at : fits a structure at a point, given by its index, and returns the log evidence;
        None: the fit failed
    """
    while True:
        at_points = [ranking.bounds | ranking.evidence for ranking in rankings]
        common = frozenset.intersection(*map(frozenset, at_points))
        best = max(sorted(common, key=sorted), key=lambda s: sum(of[s] for of in at_points))
        missing = [place for place, of in enumerate(rankings) if best not in of.evidence]
        if not missing:
            return best
        for place in missing:
            rankings[place].add(best, evidence_at(place, best))


def summarise_point(
    records: PointRecords,
    structure: Structure,
    declared_effects: Mapping[str, Values],
    library: SurrogateLibrary,
) -> PointSummary:
    """Fit a point without knowledge from other points, and return its summary."""
    point = Point(records, library)
    return summarise(fit_drops(point, structure, range(len(point.drops)), declared_effects))


def drop_predictor(
    records: PointRecords,
    structure: Structure,
    peer_points: Sequence[PointSummary],
    declared_effects: Mapping[str, Values],
    library: SurrogateLibrary,
) -> DropPredictor:
    """Fit a point with priors from the other points, and return a predictor of its drops.

    Parameters
    ----------
    records : PointRecords, of the point
    structure : Structure
    peer_points : summaries of the other points of the instrument
    declared_effects : declared values of effects, by effect and parameter
    library : SurrogateLibrary
    """
    point = Point(records, library)
    drops = range(len(point.drops))
    single_point_fit = fit_drops(point, structure, drops, declared_effects)
    posterior = single_point_fit
    if peer_points:
        model = PointModel(point, effects_of(structure, declared_effects), drops, declared_effects)
        model.apply_priors(population_priors(peer_points, model))
        fits = [PointFit(model, values).run() for values in (model.start, single_point_fit.values)]
        posterior = max(fits, key=lambda fit: fit.log_evidence)
    return DropPredictor(posterior, peer_points)


def shared_effects(gains: Sequence[Mapping[str, float]]) -> tuple[Structure, Structure]:
    """Return the device effects that the points share, and those that only single points support.

    Parameters
    ----------
    gains : for each point, log evidence of each effect, see `Selection.gains`
    """
    totals: dict[str, float] = {}
    candidates = set()
    for of_point in gains:
        for name, gain in of_point.items():
            if BY_NAME[name].scope == "device":
                totals[name] = totals.get(name, 0.0) + min(
                    max(gain, -_MAX_POINT_EVIDENCE), _MAX_POINT_EVIDENCE
                )
                if gain > _MIN_TOTAL_EVIDENCE:
                    candidates.add(name)
    shared: set[str] = set()
    for name in sorted(candidates, key=lambda name: -totals[name]):
        rivals = any(BY_NAME[name].conflicts_with(BY_NAME[shared_name]) for shared_name in shared)
        if totals[name] > _MIN_TOTAL_EVIDENCE and not rivals:
            shared.add(name)
    return frozenset(shared), frozenset(candidates - shared)


class InstrumentPoints:
    """Points of one instrument, at each of which the next drop can be predicted.

    Parameters
    ----------
    points : sequence of PointRecords
    declared_effects : declared values of effects, by effect and parameter
    """

    def __init__(
        self, points: Sequence[PointRecords], declared_effects: Mapping[str, Values] | None = None
    ) -> None:
        self._points = tuple(points)
        self._declared_effects = declared_effects or {}
        self._library = SurrogateLibrary()
        self._predictors: dict[int, DropPredictor] = {}
        self._structure: Structure | None = None
        self._summaries: list[PointSummary] = []

    def predict_next(self, place: int, time: FloatArray, load: FloatArray) -> FloatArray:
        """Return the displacements of a drop that follows those of a point, (n_sensors, n), m.

        Parameters
        ----------
        place : int, index of the point
        time, load : (n,) ndarray of float, s and N; time 0 is the trigger
        """
        last = self._points[place].records[-1]
        silent = tuple(replace(sensor, values=np.zeros_like(load)) for sensor in last.sensors)
        record = replace(last, time=time, load=load, sensors=silent)
        with single_threaded_blas():
            return self._predictor(place).predict(record, self._library)

    def _evidence(self, place: int, structure: Structure) -> float | None:
        """Return the log evidence of a structure at a point, see `structure_evidence`."""
        records = self._points[place]
        return structure_evidence(records, structure, self._declared_effects, self._library)

    def _predictor(self, place: int) -> DropPredictor:
        if self._structure is None:
            rankings = [
                rank_at_point(records, self._declared_effects, self._library)
                for records in self._points[:MAX_RANKED_POINTS]
            ]
            self._structure = choose_structure(rankings, self._evidence)
            if len(self._points) > 1:
                self._summaries = [
                    summarise_point(records, self._structure, self._declared_effects, self._library)
                    for records in self._points
                ]
        if place not in self._predictors:
            peer_points = [s for i, s in enumerate(self._summaries) if i != place]
            self._predictors[place] = drop_predictor(
                self._points[place],
                self._structure,
                peer_points,
                self._declared_effects,
                self._library,
            )
        return self._predictors[place]
