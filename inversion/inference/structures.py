"""Candidate models of the drops of an instrument, compared by evidence.

A structure is a set of effects. Within a structure every unknown is fitted, with a prior centred on
the absence of its effect. Evidence only decides between structures.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.inference.point_model import PointModel
from inversion.inference.posterior import PointFit, Posterior

Structure = frozenset[str]
"""Names of the effects of a candidate model."""

# Effects in every candidate structure, with priors centred on zero: no declaration of delay or mass
# is exact.
ALWAYS = frozenset({"sensor_lag", "plate_inertia"})
_BEND = frozenset({"stress_dependence", "hysteretic_unloading"})
_BRIEF_ITERATIONS = 8


@dataclass(frozen=True)
class Ranking:
    """Log evidence of the candidate structures of a point.

    Parameters
    ----------
    evidence : log evidence of the structures that were fitted
    bounds : upper bounds of it for structures that were not fitted
    """

    evidence: dict[Structure, float] = field(default_factory=dict)
    bounds: dict[Structure, float] = field(default_factory=dict)

    def add(self, structure: Structure, log_evidence: float | None) -> None:
        """Store the log evidence of a structure in place of its bound; None: its fit failed."""
        self.bounds.pop(structure, None)
        if log_evidence is not None:
            self.evidence[structure] = log_evidence


def effects_of(structure: Structure, declared_effects: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return the effects of a structure in the order in which they act.

    Parameters
    ----------
    structure : Structure
    declared_effects : names of effects with declared values, which are in every model
    """
    names = structure | frozenset(declared_effects)
    return tuple(effect for effect in CATALOGUE if effect.name in names)


def candidate_structures(contexts: Sequence[DropContext]) -> list[Structure]:
    """Return the structures with which the search for the effects of a point begins."""
    drops = tuple(contexts)
    grounds: list[Structure] = [frozenset()]
    if BY_NAME["bedrock"].offered(drops):
        grounds.append(frozenset({"bedrock"}))
    has_outer_sensor = bool((drops[0].offsets >= drops[0].plate_radius).any())
    if has_outer_sensor and BY_NAME["layer"].offered(drops):
        grounds += [ground | {"layer"} for ground in grounds]
    growths = ("modulus_gradient_root", "modulus_gradient")[: 2 if has_outer_sensor else 1]
    grounds += [frozenset({name}) for name in growths if BY_NAME[name].offered(drops)]
    motions: list[Structure] = [frozenset(), _BEND, _BEND | {"rebound"}]
    sensors: list[Structure] = [
        frozenset(),
        frozenset({"geophone_response"}),
        frozenset({"geophone_response", "carrier_resonance"}),
    ]
    structures = [
        ground | motion | sensor | ALWAYS
        for ground, motion, sensor in itertools.product(grounds, motions, sensors)
    ]
    if BY_NAME["damping_law"].offered(drops):
        # Not combined with stress dependence and hysteresis, which dissipate energy per cycle, too.
        damped = [ground | {"damping_law"} for ground in grounds if "layer" not in ground]
        structures += [g | s | ALWAYS for g, s in itertools.product(damped, sensors)]
    if not has_outer_sensor:
        structures += [frozenset({"spring_rig"}) | sensor for sensor in sensors[:2]]
    return structures


def fit_briefly(
    point: Point, structure: Structure, drop: int, declared_effects: Mapping[str, Values]
) -> Posterior | None:
    """Return a short fit of one drop, the best over its starting points.

    The result is None if no starting point gives a finite prediction.
    """
    effects = effects_of(structure, declared_effects)
    context = point.drops[drop].context
    n_starts = max(
        (len(c.starts) for effect in effects for c in effect.coordinates(context)), default=1
    )
    fits = []
    for variant in range(n_starts):
        model = PointModel(point, effects, [drop], declared_effects, variant)
        try:
            fits.append(PointFit(model).run_briefly(_BRIEF_ITERATIONS))
        except np.linalg.LinAlgError:
            continue
    return max(fits, key=lambda fit: fit.log_evidence, default=None)


def rank_structures(point: Point, drop: int, declared_effects: Mapping[str, Values]) -> Ranking:
    """Return the log evidence of the candidate structures for one drop, or an upper bound of it.

    Parameters
    ----------
    point : Point
    drop : int, index of the drop
    declared_effects : declared values of effects, by effect and parameter
    """
    candidates = candidate_structures([model.context for model in point.drops])
    return fit_richest_first(
        candidates, lambda structure: fit_briefly(point, structure, drop, declared_effects)
    )


def fit_richest_first(
    candidates: Sequence[Structure], fit: Callable[[Structure], Posterior | None]
) -> Ranking:
    """Return the log evidence of structures, or an upper bound of it.

    Only structures that could be the best are fitted.

    Structures with many effects are fitted first. Without some of its effects a structure gains at
    most their Occam factor. A structure is not fitted if this bound, for any of the next richer
    structures, is below the best evidence; its bound is then the smallest of these. A structure
    that contains the best one gives no bound, as its own fit may have failed.

    Parameters
    ----------
    candidates : sequence of Structure
    fit : returns the fit of a structure; None: the fit failed
    """
    fits: dict[Structure, Posterior] = {}
    ranking = Ranking()
    evidence = ranking.evidence
    for structure in sorted(candidates, key=len, reverse=True):
        best = max(fits, key=lambda s: evidence[s], default=structure)
        bounds = {
            richer: fit_of_richer.log_evidence + fit_of_richer.occam_factor(structure)
            for richer, fit_of_richer in fits.items()
            if structure < richer
        }
        next_richer = [s for s in bounds if not any(subset < s for subset in bounds)]
        if bounds and all(not best <= s and bounds[s] < evidence[best] for s in next_richer):
            ranking.bounds[structure] = min(bounds.values())
            continue
        fit_of_richer = fit(structure)
        if fit_of_richer is not None:
            fits[structure] = fit_of_richer
            ranking.add(structure, fit_of_richer.log_evidence)
    return ranking


def fit_drops(
    point: Point, structure: Structure, drops: Sequence[int], declared_effects: Mapping[str, Values]
) -> Posterior:
    """Fit drops with the priors of the effects; the fit starts at one of the last drop."""
    model = PointModel(point, effects_of(structure, declared_effects), drops, declared_effects)
    last = fit_briefly(point, structure, drops[-1], declared_effects)
    return PointFit(model, None if last is None else model.start_from(last.by_key)).run()
