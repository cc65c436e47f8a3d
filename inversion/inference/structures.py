"""Candidate models: which effects the drops of an instrument have, compared by evidence.

A structure is a set of effects that stand or fall together. Within one, every unknown is free and
its prior holds it near the absence of the effect; so evidence decides between structures alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.carrier_resonance import CarrierResonance
from inversion.effects.catalogue import CATALOGUE
from inversion.effects.constant_q import ConstantQ
from inversion.effects.flight import Flight
from inversion.effects.growth import LinearGrowth, RootGrowth
from inversion.inference.point_model import STIFFNESS, PointModel
from inversion.inference.posterior import PointFit, Posterior

Structure = frozenset[str]
"""Names of the effects of a candidate model."""

# In every structure, with priors about zero: what no declaration is exact in.
_ALWAYS = frozenset({"sensor_lag", "plate_inertia"})
_BEND = frozenset({"stress_dependence", "hysteretic_unloading"})
_BRIEF_ITERATIONS = 8

# Flight takes the place of the catalogue's rebound, whose times are fitted. The search of the
# catalogue knows neither flight nor the carrier's resonance nor these soils.
_ORDERED: tuple[Effect, ...] = (
    ConstantQ(),
    RootGrowth(),
    LinearGrowth(),
    *(Flight() if effect.name == "rebound" else effect for effect in CATALOGUE),
    CarrierResonance(),
)
_BY_NAME = {effect.name: effect for effect in _ORDERED}


def effects_of(structure: Structure, declared_effects: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return the effects of a structure in the order in which they act.

    Parameters
    ----------
    structure : Structure
    declared_effects : names of effects of known values, which are in every model
    """
    names = structure | frozenset(declared_effects)
    return tuple(effect for effect in _ORDERED if effect.name in names)


def candidate_structures(contexts: Sequence[DropContext]) -> list[Structure]:
    """Return the structures that the drops of a point could show."""
    drops = tuple(contexts)
    grounds: list[Structure] = [frozenset()]
    if _BY_NAME["bedrock"].offered(drops):
        grounds.append(frozenset({"bedrock"}))
    beside_plate = bool((drops[0].offsets >= drops[0].plate_radius).any())
    if beside_plate and _BY_NAME["layer"].offered(drops):
        grounds += [ground | {"layer"} for ground in grounds]
    growths = ("root_growth", "linear_growth") if beside_plate else ("root_growth",)
    grounds += [frozenset({name}) for name in growths if _BY_NAME[name].offered(drops)]
    motions: list[Structure] = [frozenset(), _BEND, _BEND | {"flight"}]
    sensors: list[Structure] = [
        frozenset(),
        frozenset({"geophone_response"}),
        frozenset({"geophone_response", "carrier_resonance"}),
    ]
    structures = [
        ground | motion | sensor | _ALWAYS
        for ground, motion, sensor in itertools.product(grounds, motions, sensors)
    ]
    if _BY_NAME["constant_q"].offered(drops):
        # Not with the bend, which takes energy from each cycle too.
        damped = [ground | {"constant_q"} for ground in grounds if "layer" not in ground]
        structures += [g | s | _ALWAYS for g, s in itertools.product(damped, sensors)]
    if not beside_plate:
        structures += [frozenset({"spring_rig"}) | sensor for sensor in sensors[:2]]
    return structures


def fit_briefly(
    point: Point, structure: Structure, drop: int, declared_effects: Mapping[str, Values]
) -> Posterior | None:
    """Return a short fit of one drop from the best of its starting points.

    None: no starting point gives a finite prediction.
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


def rank_structures(
    point: Point, drop: int, declared_effects: Mapping[str, Values]
) -> dict[Structure, float]:
    """Return the log evidence of the candidate structures for one drop, or what it is at most.

    What effects have to gain at least is taken off (`Effect.least_gain`).

    Rich structures are fitted first. Without some of its effects a structure gains their Occam
    factor at most. A structure is not fitted if that cannot bring any of the next richer ones to
    the best; its evidence is then the least of these bounds. A structure that contains the best
    one is no bound, however badly its own fit ended.

    Parameters
    ----------
    point : Point
    drop : int, place of the drop
    declared_effects : values of effects that are known, by effect and parameter
    """
    fits: dict[Structure, Posterior] = {}
    evidence: dict[Structure, float] = {}
    candidates = candidate_structures([model.context for model in point.drops])
    for structure in sorted(candidates, key=len, reverse=True):
        best = max(fits, key=lambda s: evidence[s], default=structure)
        needed = least_gain(structure)
        bounds = {
            richer: fit.log_evidence + fit.occam_factor(structure) - needed
            for richer, fit in fits.items()
            if structure < richer
        }
        next_richer = [s for s in bounds if not any(other < s for other in bounds)]
        if bounds and all(not best <= s and bounds[s] < evidence[best] for s in next_richer):
            evidence[structure] = min(bounds.values())
            continue
        fit = fit_briefly(point, structure, drop, declared_effects)
        if fit is not None:
            fits[structure] = fit
            evidence[structure] = fit.log_evidence - needed
    return evidence


def least_gain(structure: Structure) -> float:
    """Return the log evidence by which a structure must exceed others to be preferred."""
    return sum(effect.least_gain for effect in effects_of(structure))


def fit_drops(
    point: Point, structure: Structure, drops: Sequence[int], declared_effects: Mapping[str, Values]
) -> Posterior:
    """Return the fit of drops by the effects' own priors, begun at a fit of the last one."""
    model = PointModel(point, effects_of(structure, declared_effects), drops, declared_effects)
    last = fit_briefly(point, structure, drops[-1], declared_effects)
    values = model.start.copy()
    for place, unknown in enumerate(model.unknowns):
        if unknown.drop is not None:
            if unknown.name == STIFFNESS:
                values[place] = model.starting_deviation(unknown.drop)
        elif last is not None:
            values[place] = last.by_key[unknown.key]
    return PointFit(model, values).run()
