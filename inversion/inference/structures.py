"""Candidate models: which effects the drops of an instrument have, compared by evidence.

A structure is a set of effects that stand or fall together. Within one, every unknown is free and
its prior holds it near the absence of the effect; so evidence decides between structures alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.inference.point_model import STIFFNESS, PointModel
from inversion.inference.posterior import PointFit, Posterior

Structure = frozenset[str]
"""Names of the effects of a candidate model."""

# In every structure, with priors about zero: what no declaration is exact in.
ALWAYS = frozenset({"sensor_lag", "plate_inertia"})
_BEND = frozenset({"stress_dependence", "hysteretic_unloading"})
_BRIEF_ITERATIONS = 8


def effects_of(structure: Structure, declared_effects: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return the effects of a structure in the order in which they act.

    Parameters
    ----------
    structure : Structure
    declared_effects : names of effects of known values, which are in every model
    """
    names = structure | frozenset(declared_effects)
    return tuple(effect for effect in CATALOGUE if effect.name in names)


def candidate_structures(contexts: Sequence[DropContext]) -> list[Structure]:
    """Return the structures that the drops of a point could show."""
    drops = tuple(contexts)
    grounds: list[Structure] = [frozenset()]
    if BY_NAME["bedrock"].offered(drops):
        grounds.append(frozenset({"bedrock"}))
    beside_plate = bool((drops[0].offsets >= drops[0].plate_radius).any())
    if beside_plate and BY_NAME["layer"].offered(drops):
        grounds += [ground | {"layer"} for ground in grounds]
    growths = ("modulus_gradient_root", "modulus_gradient")[: 2 if beside_plate else 1]
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
        # Not with the bend, which takes energy from each cycle too.
        damped = [ground | {"damping_law"} for ground in grounds if "layer" not in ground]
        structures += [g | s | ALWAYS for g, s in itertools.product(damped, sensors)]
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

    Parameters
    ----------
    point : Point
    drop : int, place of the drop
    declared_effects : values of effects that are known, by effect and parameter
    """
    candidates = candidate_structures([model.context for model in point.drops])
    return fit_richest_first(
        candidates, lambda structure: fit_briefly(point, structure, drop, declared_effects)
    )


def fit_richest_first(
    candidates: Sequence[Structure], fit: Callable[[Structure], Posterior | None]
) -> dict[Structure, float]:
    """Return the log evidence of structures, or what it is at most; fit those that could win.

    What effects have to gain at least is taken off (`Effect.least_gain`).

    Without some of its effects a structure gains their Occam factor at most. A structure is not
    fitted if that cannot bring any of the next richer ones to the best; its evidence is then the
    least of these bounds. A structure that contains the best one is no bound, however badly its
    own fit ended.

    Parameters
    ----------
    candidates : sequence of Structure
    fit : returns the fit of a structure; None: it has none
    """
    fits: dict[Structure, Posterior] = {}
    evidence: dict[Structure, float] = {}
    for structure in sorted(candidates, key=len, reverse=True):
        best = max(fits, key=lambda s: evidence[s], default=structure)
        needed = least_gain(structure)
        bounds = {
            richer: found.log_evidence + found.occam_factor(structure) - needed
            for richer, found in fits.items()
            if structure < richer
        }
        next_richer = [s for s in bounds if not any(other < s for other in bounds)]
        if bounds and all(not best <= s and bounds[s] < evidence[best] for s in next_richer):
            evidence[structure] = min(bounds.values())
            continue
        found = fit(structure)
        if found is not None:
            fits[structure] = found
            evidence[structure] = found.log_evidence - needed
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
