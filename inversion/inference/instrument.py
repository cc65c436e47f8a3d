"""Points of one instrument: choice of their common structure, fits, prediction of further drops."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import PointSummary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.base import Values
from inversion.effects.catalogue import BY_NAME
from inversion.errors import InversionError
from inversion.forward.library import SurrogateLibrary
from inversion.inference.next_drop import DropPredictor
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge as InstrumentKnowledge
from inversion.inference.population import population_priors, summarise
from inversion.inference.posterior import PointFit
from inversion.inference.selection import LOG_ODDS
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
# Number of neighbours on either side of a point whose summaries are used.
_MAX_NEIGHBOURS = 50
# Largest log evidence that one point contributes for or against an effect.
_MAX_POINT_EVIDENCE = 10.0

_R = TypeVar("_R")


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
                if gain + LOG_ODDS > 0.0:
                    candidates.add(name)
    shared: set[str] = set()
    for name in sorted(candidates, key=lambda name: -totals[name]):
        rivals = any(BY_NAME[name].conflicts_with(BY_NAME[shared_name]) for shared_name in shared)
        if totals[name] + LOG_ODDS > 0.0 and not rivals:
            shared.add(name)
    return frozenset(shared), frozenset(candidates - shared)


def _attempt(
    function: Callable[..., _R], records: PointRecords, library: SurrogateLibrary
) -> _R | None:
    """Return the result of a function for a point; None: the fits failed."""
    try:
        return function(records, library=library)
    except (InversionError, np.linalg.LinAlgError):
        return None


class InstrumentPoints:
    """Points of one instrument: their common structure, their fits, prediction of further drops.

    A structure is the set of effects in the model. The summary of a point is its fit with one
    structure.

    Parameters
    ----------
    points : sequence of PointRecords
    declared_effects : declared values of effects, by effect and parameter
    library : SurrogateLibrary, optional
    compute : callable, optional
        Returns the results of a function of records and library for the first points. Its
        arguments are the kind of work, the function and the number of points.
    """

    def __init__(
        self,
        points: Sequence[PointRecords],
        declared_effects: Mapping[str, Values] | None = None,
        library: SurrogateLibrary | None = None,
        compute: Callable[[str, Callable[..., Any], int], list[Any]] | None = None,
    ) -> None:
        self._points = tuple(points)
        self._declared_effects = declared_effects or {}
        self._library = library or SurrogateLibrary()
        self._compute = compute or self._compute_in_turn
        self._rankings: list[Ranking | None] = []
        self._summaries: dict[Structure, list[PointSummary | None]] = {}
        self._predictors: dict[int, DropPredictor] = {}

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
            if place not in self._predictors:
                structure = self._best_structure(None)
                if structure is None:
                    raise InversionError("no point of the instrument could be fitted")
                several = len(self._points) > 1
                summaries = self._summaries_with(structure) if several else []
                self._predictors[place] = drop_predictor(
                    self._points[place],
                    structure,
                    [s for i, s in enumerate(summaries) if i != place and s is not None],
                    self._declared_effects,
                    self._library,
                )
            return self._predictors[place].predict(record, self._library)

    def structure_without(self, place: int) -> Structure | None:
        """Return the structure that the points other than one support best; None: there is none."""
        return self._best_structure(place) if len(self._points) > 1 else None

    def neighbour_summaries(self, place: int) -> dict[int, PointSummary]:
        """Return the summaries, by index, of up to 50 points before and after a point.

        The point itself is not used, neither for the structure nor for the summaries.
        """
        structure = self.structure_without(place)
        if structure is None:
            return {}
        first = max(0, place - _MAX_NEIGHBOURS)
        summaries = self._summaries_with(structure)[first : place + _MAX_NEIGHBOURS + 1]
        return {i: s for i, s in enumerate(summaries, first) if i != place and s is not None}

    def _best_structure(self, excluded: int | None) -> Structure | None:
        """Return the structure that the points support best; None: no point could be fitted.

        Parameters
        ----------
        excluded : int or None
            Index of a point that is not used.
        """
        if not self._rankings:
            # One more than needed, because a point is not used in the choice of its own structure.
            n_ranked = min(len(self._points), MAX_RANKED_POINTS + 1)
            self._rankings = self._computed("candidate models", rank_at_point, n_ranked)
        ranked = {i: of for i, of in enumerate(self._rankings) if i != excluded and of is not None}
        places = list(ranked)[:MAX_RANKED_POINTS]

        def evidence_at(i: int, structure: Structure) -> float | None:
            evidence = partial(
                structure_evidence, structure=structure, declared_effects=self._declared_effects
            )
            return _attempt(evidence, self._points[places[i]], self._library)

        return choose_structure([ranked[i] for i in places], evidence_at) if places else None

    def _summaries_with(self, structure: Structure) -> list[PointSummary | None]:
        if structure not in self._summaries:
            summarise = partial(summarise_point, structure=structure)
            summaries = self._computed("points by themselves", summarise, len(self._points))
            self._summaries[structure] = summaries
        return self._summaries[structure]

    def _computed(self, kind: str, function: Callable[..., _R], count: int) -> list[_R | None]:
        function = partial(function, declared_effects=self._declared_effects)
        return self._compute(kind, partial(_attempt, function), count)

    def _compute_in_turn(self, kind: str, function: Callable[..., _R], count: int) -> list[_R]:
        return [function(records, library=self._library) for records in self._points[:count]]
