"""The points of one instrument: their structure, their fits, and predictors of next drops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from inversion.inference.population import (
    learn_next_drop,
    population_priors,
    summarise,
)
from inversion.inference.posterior import PointFit
from inversion.inference.structures import (
    Structure,
    effects_of,
    fit_drops,
    rank_structures,
)
from inversion.threads import single_threaded_blas

# Points on which the structure is chosen: the evidence of more decides the same.
MAX_RANKED_POINTS = 5
# Log evidence by which one point decides at most, and that all points together have to give.
_MOST_SAID, _ASKED_FOR = 10.0, 3.0


def structure_evidence(
    records: PointRecords, declared_effects: Mapping[str, Values], library: SurrogateLibrary
) -> dict[Structure, float]:
    """Return the log evidence of each candidate structure for the last drop of a point."""
    point = Point(records, library).coarse()
    return rank_structures(point, len(point.drops) - 1, declared_effects)


def choose_structure(evidence: Sequence[Mapping[Structure, float]]) -> Structure:
    """Return the structure of the largest evidence, summed over points that all could show it."""
    common = frozenset.intersection(*(frozenset(of_point) for of_point in evidence))
    return max(sorted(common, key=sorted), key=lambda s: sum(of[s] for of in evidence))


def summarise_point(
    records: PointRecords,
    structure: Structure,
    declared_effects: Mapping[str, Values],
    library: SurrogateLibrary,
) -> PointSummary:
    """Return the summary of a point that is fitted by itself."""
    point = Point(records, library)
    return summarise(fit_drops(point, structure, range(len(point.drops)), declared_effects))


def drop_predictor(
    records: PointRecords,
    structure: Structure,
    other_points: Sequence[PointSummary],
    declared_effects: Mapping[str, Values],
    library: SurrogateLibrary,
) -> DropPredictor:
    """Return the predictor of drops of a point.

    Parameters
    ----------
    records : PointRecords, of the point
    structure : Structure
    other_points : summaries of the other points of the instrument
    declared_effects : values of effects that are known, by effect and parameter
    library : SurrogateLibrary
    """
    point = Point(records, library)
    drops = range(len(point.drops))
    alone = fit_drops(point, structure, drops, declared_effects)
    posterior = alone
    if other_points:
        model = PointModel(point, effects_of(structure, declared_effects), drops, declared_effects)
        model.apply_priors(population_priors(other_points, model))
        fits = [PointFit(model, values).run() for values in (model.start, alone.values)]
        posterior = max(fits, key=lambda fit: fit.log_evidence)
    points = [*other_points, summarise(posterior)]
    return DropPredictor(
        posterior, learn_next_drop(points, first=True), learn_next_drop(points, first=False)
    )


def shared_effects(gains: Sequence[Mapping[str, float]]) -> tuple[Structure, Structure]:
    """Return the device effects that points share, and those that single points wrongly show.

    Parameters
    ----------
    gains : of each point the log evidence of each effect, see `Selection.gains`
    """
    totals: dict[str, float] = {}
    shown = set()
    for of_point in gains:
        for name, gain in of_point.items():
            if BY_NAME[name].scope == "device":
                totals[name] = totals.get(name, 0.0) + min(max(gain, -_MOST_SAID), _MOST_SAID)
                if gain > _ASKED_FOR:
                    shown.add(name)
    shared: set[str] = set()
    for name in sorted(shown, key=lambda name: -totals[name]):
        rivals = any(BY_NAME[name].conflicts_with(BY_NAME[other]) for other in shared)
        if totals[name] > _ASKED_FOR and not rivals:
            shared.add(name)
    return frozenset(shared), frozenset(shown - shared)


class Instrument:
    """Points of one instrument, from each of which next drops are predicted.

    Parameters
    ----------
    points : sequence of PointRecords
    declared_effects : values of effects that are known, by effect and parameter
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
        place : int, of the point
        time, load : (n,) ndarray of float, s and N; time 0 is the trigger
        """
        last = self._points[place].records[-1]
        silent = tuple(replace(sensor, values=np.zeros_like(load)) for sensor in last.sensors)
        record = replace(last, time=time, load=load, sensors=silent)
        with single_threaded_blas():
            return self._predictor(place).predict(record, self._library)

    def _predictor(self, place: int) -> DropPredictor:
        if self._structure is None:
            evidence = [
                structure_evidence(records, self._declared_effects, self._library)
                for records in self._points[:MAX_RANKED_POINTS]
            ]
            self._structure = choose_structure(evidence)
            if len(self._points) > 1:
                self._summaries = [
                    summarise_point(records, self._structure, self._declared_effects, self._library)
                    for records in self._points
                ]
        if place not in self._predictors:
            other_points = [s for i, s in enumerate(self._summaries) if i != place]
            self._predictors[place] = drop_predictor(
                self._points[place],
                self._structure,
                other_points,
                self._declared_effects,
                self._library,
            )
        return self._predictors[place]
