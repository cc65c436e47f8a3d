"""The effects of a fitted structure as results: values with deviations, evidence, alternatives."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from inversion.diagnosis.findings import EffectParameter, EffectResult, effect_result
from inversion.effects.base import Effect
from inversion.effects.catalogue import BY_NAME
from inversion.inference.point_model import STIFFNESS
from inversion.inference.posterior import Posterior
from inversion.inference.selection import Selection
from inversion.records import known

# A number is not told if its deviation is more than this part of its prior's.
_NO_MORE_THAN_PRIOR = 0.8
# Step of derivatives, in deviations of the posterior.
_STEP = 1e-3
# Structures without an effect whose log evidence is at most so much below the best one's: what
# they have in its place would do as well. And how many of these are named.
_ALIKE, _MOST_ALTERNATIVES = 5.0, 2
# In prior deviations, and times that: how near a bound is, and how near it absence lies.
_ON_BOUND, _NEAR_ABSENCE = 1e-6, 2e5
# Ratio of peak loads up to which a hammer fell from one height. Drops from several heights differ
# by seating or by the stress.
_SAME_HEIGHT = 1.1


def effects_found(
    posterior: Posterior, selection: Selection, seating_evidence: float
) -> tuple[EffectResult, ...]:
    """Return the effects of a point, strongest first.

    Parameters
    ----------
    posterior : Posterior, of all drops
    selection : Selection, among which the structure was chosen
    seating_evidence : float, log evidence of drops on different ground over drops on the same
    """
    structure = selection.best
    weights = selection.weights()
    total = sum(weights.values())
    found = []
    for effect in posterior.model.effects:
        if effect.name not in structure:
            continue  # declared, and told with the instrument
        parameters = _parameters(posterior, effect)
        without = structure - {effect.name}
        one = effect_result(
            effect.told_as or effect.name,
            effect.scope,
            effect.advice,
            parameters,
            alternatives=_alternatives(selection, effect.name),
            probability=sum(w for s, w in weights.items() if effect.name in s) / total,
        )
        fit = selection.fits.get(without)
        if fit is not None:
            one = replace(
                one,
                evidence=selection.fits[structure].log_evidence - fit.log_evidence,
                residual_without_over_peak=fit.residuals_over_peak()[-1],
            )
        found.append(one)
    if not posterior.model.drops_alike:
        found.append(_seating(posterior, seating_evidence))
    return tuple(sorted(found, key=lambda effect: -_sortable(known(effect.evidence))))


def _sortable(evidence: float) -> float:
    """Return the evidence, or infinity for an effect of the instrument."""
    return math.inf if math.isnan(evidence) else evidence


def _alternatives(selection: Selection, name: str) -> tuple[str, ...]:
    """Return effects that would do in the place of one, the likeliest first."""
    best = selection.best
    least = selection.fits[best].log_evidence - _ALIKE
    others: dict[str, float] = {}
    for structure, fit in selection.fits.items():
        exchanged = structure - best
        if name in structure or len(exchanged) != 1 or fit.log_evidence < least:
            continue
        (other,) = exchanged
        other = BY_NAME[other].told_as or other
        if other == (BY_NAME[name].told_as or name):
            continue
        others[other] = max(others.get(other, -math.inf), selection.score(structure))
    return tuple(sorted(others, key=lambda other: -others[other])[:_MOST_ALTERNATIVES])


def _parameters(posterior: Posterior, effect: Effect) -> list[EffectParameter]:
    """Return what the record itself tells, the fitted numbers, and what is held."""
    model = posterior.model
    of_drops = any(u.effect == effect.name and u.drop is not None for u in model.unknowns)
    by_drop = effect.scope == "drop"
    numbers = model.point.records.numbers
    found = {
        (name, unit, value, numbers[drop] if by_drop else None)
        for drop in model.drops
        for name, unit, value in effect.known(model.point.drops[drop].context)
    }
    parameters = [
        EffectParameter(name=name, unit=unit, value=value, sd=0.0, drop=number)
        for name, unit, value, number in sorted(found, key=lambda one: (one[3] or 0, one[0]))
    ]
    for drop in model.drops if of_drops else (model.last,):
        parameters += _fitted(posterior, effect, drop, numbers[drop] if of_drops else None)
    parameters += [
        EffectParameter(name=name, unit=unit, value=value, sd=0.0)
        for name, unit, value in effect.held(model.point.drops[0].context)
    ]
    return parameters


def _fitted(
    posterior: Posterior, effect: Effect, drop: int, number: int | None
) -> list[EffectParameter]:
    """Return the fitted numbers of an effect in a drop."""
    model = posterior.model
    places = [
        place
        for place, unknown in enumerate(model.unknowns)
        if unknown.effect == effect.name and unknown.drop in (None, drop)
    ]

    context = model.point.drops[drop].context

    def told_with(place: int | None, step: float) -> dict[str, tuple[str, float]]:
        values = posterior.values.copy()
        if place is not None:
            values[place] += step
        _, active = model.ground_and_effects(values, drop)
        numbers = next(numbers for other, numbers in active if other.name == effect.name)
        return effect.told(numbers, context)

    natural = {p.name for p in effect.parameters_for(context) if p.natural}
    here = told_with(None, 0.0)
    covariance = posterior.covariance[np.ix_(places, places)]
    steps = _STEP * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    moved = [told_with(place, float(step)) for place, step in zip(places, steps, strict=True)]
    parameters = []
    for name, (unit, value) in here.items():
        slopes = np.array(
            [
                (there[name][1] - value) / step if step > 0.0 else 0.0
                for there, step in zip(moved, steps, strict=True)
            ]
        )
        own = [
            place
            for place in places
            if model.unknowns[place].coordinate.name == name and model.unknowns[place].drop is None
        ]
        is_known = all(
            math.sqrt(max(float(posterior.covariance[place, place]), 0.0))
            < _NO_MORE_THAN_PRIOR * float(model.deviation[place])
            for place in own
        )
        deviation = math.sqrt(max(float(slopes @ covariance @ slopes), 0.0))
        parameters.append(
            EffectParameter(
                name=name,
                unit=unit,
                value=value,
                sd=deviation if is_known else math.nan,
                drop=number,
                at_bound=any(_is_on_bound(posterior, place, natural) for place in own),
            )
        )
    return parameters


def _is_on_bound(posterior: Posterior, place: int, natural: Collection[str]) -> bool:
    """Return whether a number ended on a bound where neither nature nor absence puts it."""
    model, value = posterior.model, posterior.values[place]
    reach = _ON_BOUND * model.deviation[place]
    if model.unknowns[place].coordinate.name in natural:
        return False
    return any(
        abs(value - bound) <= reach and abs(model.mean[place] - bound) > _NEAR_ABSENCE * reach
        for bound in (model.lower[place], model.upper[place])
    )


def _seating(posterior: Posterior, evidence: float) -> EffectResult:
    """Return the effect of drops that met ground of another stiffness than the last one."""
    effect, model = BY_NAME["seating"], posterior.model
    parameters = []
    for place, unknown in enumerate(model.unknowns):
        if unknown.name == STIFFNESS and unknown.drop is not None:
            ratio = math.exp(float(posterior.values[place]))
            deviation = math.sqrt(float(posterior.covariance[place, place]))
            parameters.append(
                EffectParameter(
                    name=effect.parameters[0].name,
                    unit=effect.parameters[0].unit,
                    value=ratio,
                    sd=ratio * deviation,
                    drop=model.point.records.numbers[unknown.drop],
                )
            )
    loads = [model.point.drops[drop].drop.peak_load for drop in model.drops]
    heights_differ = max(loads) > _SAME_HEIGHT * min(loads)
    others = ("stress_dependence",) if heights_differ else ()
    return effect_result(
        effect.name, effect.scope, effect.advice, parameters, evidence=evidence, alternatives=others
    )
