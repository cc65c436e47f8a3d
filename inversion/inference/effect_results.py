"""Effects of a fitted structure as results: values with deviations, evidence, alternatives."""

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

# A number is not determined by the data if its posterior standard deviation exceeds this fraction
# of the prior one.
_MAX_POSTERIOR_OVER_PRIOR = 0.8
# Step of numerical derivatives, in posterior standard deviations.
_STEP_OVER_POSTERIOR_SD = 1e-3
# Largest loss of log evidence at which another effect counts as an alternative, and largest number
# of alternatives that are named.
_MAX_EVIDENCE_LOSS, _MAX_ALTERNATIVES = 5.0, 2
# A number is on a bound if it is within this distance, in prior standard deviations. A bound is the
# absence of the effect if the prior mean is within this multiple of that distance.
_ON_BOUND, _ABSENCE_REACH = 1e-6, 2e5
# Largest ratio of the peak loads of drops from one height. Drops from several heights may differ
# because of seating or because of stress.
_SAME_HEIGHT = 1.1


def effect_results(
    posterior: Posterior, selection: Selection, seating_evidence: float
) -> tuple[EffectResult, ...]:
    """Return the effects of a point, the strongest first.

    Parameters
    ----------
    posterior : Posterior, of all drops
    selection : Selection, from which the structure was chosen
    seating_evidence : float, log evidence of drops on different ground over drops on the same
        ground
    """
    structure = selection.best
    weights = selection.weights()
    total = sum(weights.values())
    results = []
    for effect in posterior.model.effects:
        if effect.name not in structure:
            continue  # a declared effect is reported with the instrument
        parameters = _effect_parameters(posterior, effect)
        without = structure - {effect.name}
        result = effect_result(
            effect.result_name or effect.name,
            effect.scope,
            effect.advice,
            parameters,
            alternatives=_alternatives(selection, effect.name),
            probability=sum(w for s, w in weights.items() if effect.name in s) / total,
        )
        fit = selection.fits.get(without)
        if fit is not None:
            result = replace(
                result,
                evidence=selection.fits[structure].log_evidence - fit.log_evidence,
                residual_rms_over_peak_without=fit.residual_over_peak(),
            )
        results.append(result)
    if not posterior.model.is_same_ground:
        results.append(_seating_result(posterior, seating_evidence))
    # An effect of the instrument, which has no evidence, is first.
    return tuple(sorted(results, key=lambda effect: -np.nan_to_num(effect.evidence, nan=math.inf)))


def _alternatives(selection: Selection, name: str) -> tuple[str, ...]:
    """Return the effects that explain the record nearly as well in place of one.

    The most probable effect comes first.
    """
    best = selection.best
    min_evidence = selection.fits[best].log_evidence - _MAX_EVIDENCE_LOSS
    alternatives: dict[str, float] = {}
    for structure, fit in selection.fits.items():
        exchanged = structure - best
        if name in structure or len(exchanged) != 1 or fit.log_evidence < min_evidence:
            continue
        (alternative,) = exchanged
        alternative = BY_NAME[alternative].result_name or alternative
        if alternative == (BY_NAME[name].result_name or name):
            continue
        alternatives[alternative] = max(
            alternatives.get(alternative, -math.inf), selection.score(structure)
        )
    return tuple(
        sorted(alternatives, key=lambda alternative: -alternatives[alternative])[:_MAX_ALTERNATIVES]
    )


def _effect_parameters(posterior: Posterior, effect: Effect) -> list[EffectParameter]:
    """Return the numbers of an effect: recorded, fitted and fixed ones."""
    model = posterior.model
    of_drops = any(u.effect == effect.name and u.drop is not None for u in model.unknowns)
    by_drop = effect.scope == "drop"
    numbers = model.point.records.numbers
    recorded = {
        (name, unit, value, numbers[drop] if by_drop else None)
        for drop in model.drops
        for name, unit, value in effect.recorded_values(model.point.drops[drop].context)
    }
    parameters = [
        EffectParameter(name=name, unit=unit, value=value, sd=0.0, drop=number)
        for name, unit, value, number in sorted(recorded, key=lambda row: (row[3] or 0, row[0]))
    ]
    for drop in model.drops if of_drops else (model.last,):
        parameters += _fitted_parameters(
            posterior, effect, drop, numbers[drop] if of_drops else None
        )
    parameters += [
        EffectParameter(name=name, unit=unit, value=value, sd=0.0)
        for name, unit, value in effect.fixed_values(model.point.drops[0].context)
    ]
    return parameters


def _fitted_parameters(
    posterior: Posterior, effect: Effect, drop: int, number: int | None
) -> list[EffectParameter]:
    """Return the fitted numbers of an effect in a drop, with standard deviations."""
    model = posterior.model
    places = [
        place
        for place, unknown in enumerate(model.unknowns)
        if unknown.effect == effect.name and unknown.drop in (None, drop)
    ]

    context = model.point.drops[drop].context

    def values_after_step(place: int | None, step: float) -> dict[str, tuple[str, float]]:
        values = posterior.values.copy()
        if place is not None:
            values[place] += step
        _, active = model.ground_and_effects(values, drop)
        numbers = next(numbers for candidate, numbers in active if candidate.name == effect.name)
        return effect.reported_values(numbers, context)

    natural = {p.name for p in effect.parameters_for(context) if p.natural}
    values_at_fit = values_after_step(None, 0.0)
    covariance = posterior.covariance[np.ix_(places, places)]
    steps = _STEP_OVER_POSTERIOR_SD * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    moved = [
        values_after_step(place, float(step)) for place, step in zip(places, steps, strict=True)
    ]
    parameters = []
    for name, (unit, value) in values_at_fit.items():
        slopes = np.array(
            [
                (stepped[name][1] - value) / step if step > 0.0 else 0.0
                for stepped, step in zip(moved, steps, strict=True)
            ]
        )
        parameter_places = [
            place
            for place in places
            if model.unknowns[place].coordinate.name == name and model.unknowns[place].drop is None
        ]
        is_determined = all(
            math.sqrt(max(float(posterior.covariance[place, place]), 0.0))
            < _MAX_POSTERIOR_OVER_PRIOR * float(model.deviation[place])
            for place in parameter_places
        )
        deviation = math.sqrt(max(float(slopes @ covariance @ slopes), 0.0))
        parameters.append(
            EffectParameter(
                name=name,
                unit=unit,
                value=value,
                sd=deviation if is_determined else math.nan,
                drop=number,
                at_bound=any(_is_on_bound(posterior, place, natural) for place in parameter_places),
            )
        )
    return parameters


def _is_on_bound(posterior: Posterior, place: int, natural: Collection[str]) -> bool:
    """Return whether a number is on a bound.

    Physical limits and the absence of the effect do not count.
    """
    model, value = posterior.model, posterior.values[place]
    reach = _ON_BOUND * model.deviation[place]
    if model.unknowns[place].coordinate.name in natural:
        return False
    return any(
        abs(value - bound) <= reach and abs(model.mean[place] - bound) > _ABSENCE_REACH * reach
        for bound in (model.lower[place], model.upper[place])
    )


def _seating_result(posterior: Posterior, evidence: float) -> EffectResult:
    """Return the seating effect: earlier drops had ground of another stiffness."""
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
    alternatives = ("stress_dependence",) if heights_differ else ()
    return effect_result(
        effect.name,
        effect.scope,
        effect.advice,
        parameters,
        evidence=evidence,
        alternatives=alternatives,
    )
