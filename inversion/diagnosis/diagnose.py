"""The diagnosis of a point: the error before and after, and what stands between."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from inversion.diagnosis.acceptance import is_worth_reporting, reasons_to_reject
from inversion.diagnosis.findings import (
    DeviceValues,
    DropCurves,
    FoundEffect,
    FoundParameter,
    ModelState,
    PointDiagnosis,
    Verdict,
)
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.prediction import held_out_errors, predict, residual_over_peak
from inversion.diagnosis.problem import Point, Unknown
from inversion.diagnosis.search import Candidate, Search
from inversion.effects.base import Ground
from inversion.fitting.uncertainty import NORMAL_95
from inversion.forward.library import SurrogateLibrary
from inversion.threads import single_threaded_blas

# Times the noise up to which a model is nearly right.
_NEARLY = 3.0
# A range of moduli so wide is told.
_WIDE = 1.1


def diagnose_point(
    records: PointRecords,
    library: SurrogateLibrary | None = None,
    device: DeviceValues | None = None,
    likely: Collection[str] = (),
) -> PointDiagnosis:
    """Which effects the residual of a point asks for, and what they change.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    device : values of device effects that are known from elsewhere, by effect and parameter
    likely : names of effects that were found before; tried first

    Raises
    ------
    RecordError, ModelError
        If a record cannot be used.
    """
    with single_threaded_blas():
        point = Point(records, library or SurrogateLibrary())
        base = Search([point], priors=False).base()
        search = Search([point], fixed=device)
        best = search.run(likely)
        return _report(point, search, base, best)


def _report(point: Point, search: Search, base: Candidate, best: Candidate) -> PointDiagnosis:
    objections = reasons_to_reject(point, best)
    if objections and best.effects and not is_worth_reporting(point, base, best):
        names = " with ".join(effect.name for effect in best.effects)
        best = search.base()
        objections = reasons_to_reject(point, best)
        if objections:
            objections.append(
                f"{names} came nearest, but left more than half of it or ran into a bound: not "
                "taken over"
            )
    # What explains little has no alternatives.
    others = {
        effect.name: search.alternatives(best, effect) if best.over_noise <= _NEARLY else {}
        for effect in best.effects
    }
    before = _state(point, base)
    moduli = [
        _modulus(point, candidate) for found in others.values() for candidate in found.values()
    ]
    after = _state(point, best, moduli)
    effects = _effects(point, search, best, others)
    helped = bool(effects) or bool(search.fixed)
    verdict: Verdict = "unexplained"
    if not objections:
        verdict = "explained" if helped else "clean"
    held_before, held_after = held_out_errors(point, base, best)
    return PointDiagnosis(
        name=point.records.name,
        numbers=point.records.numbers,
        verdict=verdict,
        noise_rms=float(max(model.noise[0] for model in point.drops)),
        before=before,
        after=after,
        effects=effects,
        held_out_before=held_before,
        held_out_after=held_after,
        warnings=(*_warnings(best, effects, verdict, after), *objections),
        curves=_curves(point, base, best),
    )


def _modulus(point: Point, candidate: Candidate) -> float:
    """Of the ground under the last drop, Pa."""
    return _ground(point, candidate).modulus


def _ground(point: Point, candidate: Candidate) -> Ground:
    found, last = candidate.fit, len(point.drops) - 1
    ground = point.ground(found.problem.own[0], found.own[0])
    for effect, values in found.problem.values(0, found.device, found.own[0], last):
        ground = effect.ground(ground, values, point.drops[-1].context)
    return ground


def _state(point: Point, candidate: Candidate, moduli: Sequence[float] = ()) -> ModelState:
    left = np.concatenate(
        [
            (predicted - model.observed).ravel()
            for model, predicted in zip(point.drops, predict(candidate), strict=True)
        ]
    )
    found = candidate.fit
    ground = _ground(point, candidate)
    rig = any(effect.replaces_ground for effect in candidate.effects)
    model = "half-space" if ground.inverse_depth == 0.0 else "layer"
    index = len(found.problem.device)
    relative = math.nan
    if not rig:
        ratio, unit_value = found.problem.own[0][0].parameter, float(found.own[0][0])
        deviation = ratio.deviation(unit_value, found.deviations()[index])
        relative = deviation / float(ratio.value(unit_value))
    return ModelState(
        model="rig" if rig else model,
        modulus=math.nan if rig else ground.modulus,
        modulus_deviation=math.nan if rig else ground.modulus * relative,
        modulus_interval=_interval(
            math.nan if rig else ground.modulus, relative, _model_error(point, candidate), moduli
        ),
        residual_rms=float(np.sqrt(np.mean(left**2))),
        residual_over_noise=candidate.over_noise,
        residual_rms_over_peak=residual_over_peak(point, candidate),
        contact_residual_rms_over_peak=residual_over_peak(point, candidate, contact_only=True),
    )


def _model_error(point: Point, candidate: Candidate) -> float:
    """Relative error (95 %) of the modulus that the effects' own simplifications may leave."""
    found, last = candidate.fit, len(point.drops) - 1
    values = found.problem.values(0, found.device, found.own[0], last)
    return math.hypot(0.0, *(effect.model_error(numbers) for effect, numbers in values))


def _interval(
    modulus: float, relative: float, model_error: float, others: Sequence[float]
) -> tuple[float, float]:
    """95 % of a modulus, Pa, by its relative deviation and the model's relative error, and all
    that equally good sets of effects give.
    """
    noise = math.exp(NORMAL_95 * min(relative, 3.0)) if math.isfinite(relative) else math.inf
    wide = noise * (1.0 + model_error)
    return min(modulus / wide, *others, modulus), max(modulus * wide, *others, modulus)


def _effects(
    point: Point, search: Search, best: Candidate, others: Mapping[str, Mapping[str, Candidate]]
) -> tuple[FoundEffect, ...]:
    deviations = best.fit.deviations()
    bounds = {id(unknown) for unknown in best.fit.at_bound()}
    found = []
    for effect in best.effects:
        told = {
            (name, unit, value, None if effect.scope != "drop" else number)
            for number, model in zip(point.records.numbers, point.drops, strict=True)
            for name, unit, value in effect.known(model.context)
        }
        parameters = [
            FoundParameter(name, unit, value, 0.0, number, False)
            for name, unit, value, number in sorted(
                told, key=lambda known: (known[3] or 0, known[0])
            )
        ]
        for unknown, unit_value, deviation in zip(
            best.fit.unknowns, best.fit.unit_values, deviations, strict=True
        ):
            if unknown.effect is effect:
                parameters.append(
                    _parameter(point, unknown, unit_value, deviation, id(unknown) in bounds)
                )
        parameters += [
            FoundParameter(name, unit, value, 0.0, None, False)
            for name, unit, value in effect.held(point.drops[0].context)
        ]
        found.append(
            FoundEffect(
                name=effect.name,
                scope=effect.scope,
                advice=effect.advice,
                parameters=tuple(parameters),
                evidence=search.without(best, effect).score - best.score,
                alternatives=tuple(others[effect.name]),
            )
        )
    return tuple(sorted(found, key=lambda effect: -effect.evidence))


def _parameter(
    point: Point, unknown: Unknown, unit_value: float, deviation: float, at_bound: bool
) -> FoundParameter:
    p, where = unknown.parameter, float(unit_value)
    number = None if unknown.drop is None else point.records.numbers[unknown.drop]
    return FoundParameter(
        p.name, p.unit, float(p.value(where)), p.deviation(where, deviation), number, at_bound
    )


def _warnings(
    best: Candidate, effects: Sequence[FoundEffect], verdict: Verdict, after: ModelState
) -> list[str]:
    found = []
    for effect in effects:
        for parameter in effect.parameters:
            if parameter.at_bound:
                found.append(f"{effect.name}: {parameter.name} sits on a bound")
        if effect.alternatives:
            others = ", ".join(effect.alternatives)
            found.append(f"{effect.name} cannot be told from {others}")
    low, high = after.modulus_interval
    if high > _WIDE * low and verdict == "explained":
        found.append(
            f"the modulus is known no better than {low / 1e6:.3g} to {high / 1e6:.3g} MPa, with "
            "the effects that cannot be told apart"
        )
    for unknown in best.fit.at_bound():
        if unknown.effect is None:
            name = unknown.parameter.name.replace("_", " ")
            found.append(f"{name} of the ground sits on a bound")
    return found


def _curves(point: Point, base: Candidate, best: Candidate) -> tuple[DropCurves, ...]:
    return tuple(
        DropCurves(
            number=number,
            time=model.context.time + model.drop.start,
            load=model.context.load,
            observed=model.observed,
            before=before,
            after=after,
            offsets=model.drop.positions,
            contact_end=model.context.contact_end + model.drop.start,
        )
        for number, model, before, after in zip(
            point.records.numbers, point.drops, predict(base), predict(best), strict=True
        )
    )
