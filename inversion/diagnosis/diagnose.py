"""The diagnosis of a point: the error before and after, and what stands between."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.acceptance import (
    can_be_told,
    is_worth_reporting,
    reasons_to_reject,
    would_fit_anything,
)
from inversion.diagnosis.averaging import Averaged, average
from inversion.diagnosis.declarations import contradiction, doubts
from inversion.diagnosis.discrepancy import Discrepancy
from inversion.diagnosis.findings import (
    CALIBRATION,
    LEFT_OPEN,
    DeviceValues,
    DropCurves,
    EffectParameter,
    EffectResult,
    FittedState,
    HeldOut,
    PointDiagnosis,
    UnknownKey,
    Verdict,
    effect_result,
)
from inversion.diagnosis.model import ALIKE, DropModel, PointRecords
from inversion.diagnosis.prediction import (
    ground_below,
    held_out_drops,
    predict,
    residual_over_peak,
)
from inversion.diagnosis.problem import Point, Unknown
from inversion.diagnosis.search import ALIKE as AS_GOOD
from inversion.diagnosis.search import ENOUGH, EXPLAINED, FAR, WORTH, Candidate, Search, past_bounds
from inversion.errors import RecordError
from inversion.fitting.uncertainty import NORMAL_95
from inversion.forward.library import SurrogateLibrary
from inversion.measured.steps import PLAIN_LOAD, PLAIN_MOTION, find_step
from inversion.notices import Notice, Value
from inversion.records import known
from inversion.threads import single_threaded_blas

# Pa: the stress at which moduli of different drops are compared.
_REFERENCE_PA = 100e3
# Times the noise up to which a model is nearly right.
_NEARLY = 3.0
# A parameter is not fixed by the records when its deviation is this part of its range, or this part
# of what nature leaves open anyway.
_NOT_FIXED, _NO_MORE_THAN_PRIOR = 0.25, 0.8
# Deviation of a logarithm beyond which nothing is known.
_UNKNOWN = 3.0
# Relative error (95 %) of the modulus over what is left unexplained of the peak. What the model
# lacks shows only as far as its parameters cannot imitate it: what they imitate is not seen, and
# nothing says that it is less. Of undeclared effects in finite elements twice of what is left
# holds as many as it should (docs/theory.md).
_BEHIND_LEFT = 2.0
# Of sets with a value on its bound one without is told that leaves at most so many times as much.
_AS_CLOSE = 1.5
# Of what the base model leaves of a point: a sensor that is turned or exchanged has to leave less.
_FITS_BETTER = 0.8
# A range of moduli so wide is told.
_WIDE = 1.1


def diagnose_point(
    records: PointRecords,
    library: SurrogateLibrary | None = None,
    device: DeviceValues | None = None,
    likely: Collection[str] = (),
    begun: Sequence[Mapping[UnknownKey, float]] = (),
    leave_out: bool = True,
    spread: DeviceValues | None = None,
    *,
    plain: bool = False,
    brief: bool = False,
) -> PointDiagnosis:
    """Which effects the residual of a point asks for, and what they change.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    device : values of device effects that are known from elsewhere, by effect and parameter
    likely : names of effects that were found before; tried first
    begun : values from which they may begin, as `PointDiagnosis.values` has them
    spread : deviations of the device's values, within which the point may move them; what has
        none is held
    leave_out : bool, whether each drop is tried on the ground of the others
    plain : bool, whether every sample counts alike from the beginning, as where it was found that
        much more than noise is left (`PointDiagnosis.plain`)
    brief : bool, whether what a survey needs of a point that is looked at again is enough: without
        alternatives, without what each effect alone is worth, and with nothing left out

    Raises
    ------
    RecordError, ModelError
        If a record cannot be used.
    """
    library = library or SurrogateLibrary()
    with single_threaded_blas():
        point = Point(records, library)
        if all(map(_rises, point.drops)):
            raise RecordError(
                "centre sensor: expected a downward (positive) deflection, found none; check its "
                "polarity and whether it is alive"
            )
        base = Search([point], priors=False).base()
        by_noise = Search([point], fixed=device, spread=spread)
        stepped = _steps(point)
        if stepped:
            return _told(point, by_noise, base, by_noise.base(), {}, stepped, leave_out)
        search, best, objections = by_noise, base, list[Notice]()
        for looked, found in _looked_for(by_noise, likely, begun, plain):
            taken, against = _accepted(point, looked, base, found)
            sound = bool(taken.effects) and not past_bounds(taken)
            if sound or not best.effects:
                search, best, objections = looked, taken, against
            if sound:
                break
        if brief:
            return _told(point, search, base, best, {}, objections, False, brief=True)
        told = _report(point, by_noise, search, base, best, objections, leave_out)
    if told.verdict != "unexplained" and not told.after.left_open:
        return told
    again = partial(diagnose_point, library=library, device=device, spread=spread, brief=True)
    contradicted = _contradicted(point, told, library, again)
    return replace(told, warnings=(*told.warnings, contradicted)) if contradicted else told


def _contradicted(
    point: Point,
    told: PointDiagnosis,
    library: SurrogateLibrary,
    again: Callable[[PointRecords], PointDiagnosis],
) -> Notice | None:
    """Return the warning about a declaration that the records of a point contradict, or None."""
    for doubt in doubts(point):
        if not doubt.of_ground:
            # The base model tells in no time whether a sensor fits better so.
            with single_threaded_blas():
                changed = Point(doubt.records, library)
                left = residual_over_peak(changed, Search([changed], priors=False).base())
            if left > _FITS_BETTER * told.before.left_over_peak:
                continue
        try:
            other = again(doubt.records)
        except RecordError:
            continue  # so it would be no record of a drop: what is declared is no worse
        said = contradiction(doubt, told, other)
        if said is not None:
            return said
    return None


def _rises(model: DropModel) -> bool:
    """Whether the innermost sensor, if it is under the plate, rises in the contact."""
    innermost = int(np.argmin(np.abs(model.context.offsets)))
    if abs(model.context.offsets[innermost]) > model.context.plate_radius:
        return False
    contact = model.observed[innermost][model.context.time <= model.context.contact_end]
    return not contact.mean() > 0.0


def _steps(point: Point) -> list[Notice]:
    """Return warnings about records that step in the contact, as no motion or weight could."""
    said = []
    for number, model in zip(point.records.numbers, point.drops, strict=True):
        time = model.record.time
        first, end = np.searchsorted(
            time, model.drop.start + np.array([0.0, model.context.contact_end])
        )
        traces: list[tuple[str, dict[str, Value], FloatArray, float]] = [
            ("sensor-steps", {"offset_m": sensor.offset}, sensor.values, PLAIN_MOTION)
            for sensor in model.record.sensors
        ]
        traces.append(("load-steps", {}, model.record.load, PLAIN_LOAD))
        for code, place_of, values, plain in traces:
            place = find_step(values, int(first), int(end), plain)
            if place is not None:
                after = float(time[place] - time[first])
                said.append(Notice(code, {"drop": number, **place_of, "after_s": after}))
    return said


def _looked_for(
    by_noise: Search,
    likely: Collection[str],
    begun: Sequence[Mapping[UnknownKey, float]],
    plain: bool,
) -> Iterator[tuple[Search, Candidate]]:
    """Searches with the best sets of effects that they found, the one that is preferred first.

    First the noise weighs what is left. Of a velocity that is integrated it is slow: so weighed, a
    fit of real drops gives a quarter of the peak away in the tail, where noise could be so large,
    to gain a hundredth where noise is none. Where much more than noise is left, every sample
    counts alike, and the noise weighs again what comes near to it.

    Parameters
    ----------
    by_noise : Search, by which nothing has been looked for
    plain : bool, whether every sample counts alike from the beginning
    """
    best = by_noise.base() if plain else by_noise.run(likely, begun, near=True)
    if not plain and best.fit.excess <= FAR:
        yield by_noise, best
        return
    points = [point.coarse() for point in by_noise.points]
    alike = Search(points, fixed=by_noise.fixed, spread=by_noise.spread, scope=ALIKE)
    found = alike.run(likely, begun, beside=best)
    if found.over_noise <= EXPLAINED:
        near = by_noise.begun_at(found)
        if near.over_noise <= EXPLAINED:
            yield by_noise, near
    if found.over_noise < best.over_noise:
        yield alike, found
    yield by_noise, best


def _report(
    point: Point,
    by_noise: Search,
    search: Search,
    base: Candidate,
    best: Candidate,
    objections: list[Notice],
    leave_out: bool,
) -> PointDiagnosis:
    others = _alternatives(point, search, best)
    simpler = _simpler(search.base(), best, others) or _on_ground(best, others)
    if simpler is not None and not reasons_to_reject(point, simpler):
        best, objections = simpler, []
        others = _alternatives(point, search, best)
    found = _told(point, search, base, best, others, objections, leave_out)
    if objections and best.effects and found.after.left_open:
        nothing = by_noise.base()
        objections = [
            *reasons_to_reject(point, nothing),
            Notice("effects-leave-modulus-open", {"factor": LEFT_OPEN, "effects": _names(best)}),
        ]
        found = _told(point, by_noise, base, nothing, {}, objections, leave_out)
    return found


def _told(
    point: Point,
    search: Search,
    base: Candidate,
    best: Candidate,
    others: Mapping[str, Mapping[str, Candidate]],
    objections: Sequence[Notice],
    leave_out: bool,
    *,
    brief: bool = False,
) -> PointDiagnosis:
    """What a set of effects says of the point.

    Parameters
    ----------
    others : of each effect what would do in its place
    objections : what speaks against the set
    """
    averaged = None
    if not any(effect.replaces_ground for effect in best.effects):
        alike = [candidate for found in others.values() for candidate in found.values()]
        fitted = search.fitted
        if objections:
            # What would not be told says nothing of the modulus.
            fitted = [c for c in fitted if is_worth_reporting(point, base, c)]
        averaged = average(
            best,
            [*fitted, *alike],
            search.independent,
            partial(_modulus_of_same, point, best),
            partial(_model_error, point),
        )
    before = _state(point, base)
    moduli = [
        _modulus_of_same(point, best, candidate)
        for found in others.values()
        for candidate in found.values()
    ]
    if averaged is not None and would_fit_anything(point, best):
        # So many effects fit anything: the modulus is between what they say and what none says.
        moduli.append(_modulus(point, base))
    after = _state(point, best, moduli, averaged)
    if objections:
        after = _left_open(after)
    effects = _effects(point, search, best, others, averaged, brief=brief)
    helped = bool(effects) or bool(search.fixed)
    verdict: Verdict = "unexplained"
    if not objections:
        verdict = "explained" if helped else "clean"
    held_out = held_out_drops(point, base, best) if leave_out else []
    return PointDiagnosis(
        name=point.records.name,
        numbers=point.records.numbers,
        verdict=verdict,
        noise_rms=float(max(model.noise[0] for model in point.drops)),
        before=replace(before, stress_pa=None, modulus_100kpa_pa=None),
        after=after,
        effects=effects,
        held_out=HeldOut.of("drop", held_out),
        warnings=(*_warnings(best, effects, verdict, after), *objections),
        curves=_curves(point, base, best),
        values=search.values(best),
        plain=search.scope.plain,
        independent=search.independent,
    )


def _accepted(
    point: Point, search: Search, base: Candidate, best: Candidate
) -> tuple[Candidate, list[Notice]]:
    """The set of effects that is told, and what speaks against it.

    That is the best one, if nothing does; else the best of those that were tried against which
    nothing speaks; else the best one that takes most of the residual away, of those that are past
    no bound if there are any; else none.
    """
    objections = reasons_to_reject(point, best)
    if not objections or not best.effects:
        return best, objections
    tried = sorted((c for c in search.fitted if c.effects), key=lambda c: c.score)
    for candidate in tried:
        if not reasons_to_reject(point, candidate):
            return candidate, []
    near = [best, *(c for c in tried if can_be_told(point, c) or c.score < best.score + AS_GOOD)]
    close = [*near, *(c for c in tried if c.fit.excess < _AS_CLOSE * best.fit.excess)]
    worth, inside = (
        [c for c in some if is_worth_reporting(point, base, c)]
        for some in (near, (c for c in close if not past_bounds(c)))
    )
    for candidate in (*inside, *worth):
        return candidate, reasons_to_reject(point, candidate)
    objections = reasons_to_reject(point, search.base())
    if objections:
        objections.append(Notice("effects-leave-residual", {"effects": _names(best)}))
    return search.base(), objections


def _names(candidate: Candidate) -> str:
    return " with ".join(effect.name for effect in candidate.effects)


def _alternatives(point: Point, search: Search, best: Candidate) -> dict[str, dict[str, Candidate]]:
    """What would do in the place of each effect; what explains little or anything has none."""
    near = best.over_noise <= _NEARLY and can_be_told(point, best)
    return {e.name: search.alternatives(best, e) if near else {} for e in best.effects}


def _simpler(
    base: Candidate, best: Candidate, others: Mapping[str, Mapping[str, Candidate]]
) -> Candidate | None:
    """Of the alternatives one of fewer numbers that leaves no more than noise as well.

    Below that a better fit tells nothing: what is taken for noise holds the model's own error. It
    has to be worth its numbers all the same.
    """
    found = [
        candidate
        for alternatives in others.values()
        for candidate in alternatives.values()
        if candidate.fit.problem.size < best.fit.problem.size
        and candidate.over_noise <= EXPLAINED
        and candidate.fit.excess <= ENOUGH
        and candidate.score < base.score - WORTH * len(candidate.effects)
    ]
    return min(found, key=lambda c: (c.fit.problem.size, c.score), default=None)


def _on_ground(best: Candidate, others: Mapping[str, Mapping[str, Candidate]]) -> Candidate | None:
    """Of what cannot be told from a rig the best one on ground, as drops usually are."""
    found = [
        candidate
        for effect in best.effects
        if effect.replaces_ground
        for candidate in others[effect.name].values()
        if not any(other.replaces_ground for other in candidate.effects)
    ]
    return min(found, key=lambda c: c.score, default=None)


def _modulus(point: Point, candidate: Candidate) -> float:
    """Of the ground under the last drop, secant at its stress, Pa."""
    return ground_below(point, candidate).modulus * _bent(point, candidate, _stress(point))


def _modulus_of_same(point: Point, best: Candidate, candidate: Candidate) -> float:
    """Of another set the modulus of that medium whose modulus the best set tells, Pa.

    A medium so stiff that it stands in the place of rock is no ground: what lies on it is.
    """
    ground = ground_below(point, candidate)
    instead_of_rock = (
        ground_below(point, best).inverse_depth > 0.0
        and ground.inverse_depth == 0.0
        and bool(ground.above)
        and ground.modulus > LEFT_OPEN * ground.above[-1].modulus
    )
    if not instead_of_rock:
        return _modulus(point, candidate)
    return ground.above[-1].modulus * _bent(point, candidate, _stress(point))


def _stress(point: Point) -> float:
    """Mean contact pressure at the peak of the last drop, Pa."""
    last = point.drops[-1].context
    return last.peak_load / (math.pi * last.plate_radius**2)


def _bent(point: Point, candidate: Candidate, stress: float) -> float:
    """Secant modulus at a stress over that of the ground under the last drop, as it was fitted."""
    found, last = candidate.fit, len(point.drops) - 1
    values = found.problem.values(0, found.device, found.own[0], last)
    context = point.drops[-1].context
    return math.prod(effect.modulus_at(stress, numbers, context) for effect, numbers in values)


def _state(
    point: Point,
    candidate: Candidate,
    moduli: Sequence[float] = (),
    averaged: Averaged | None = None,
) -> FittedState:
    left = np.concatenate(
        [
            (predicted - model.observed).ravel()
            for model, predicted in zip(point.drops, predict(candidate), strict=True)
        ]
    )
    ground = ground_below(point, candidate)
    rig = any(effect.replaces_ground for effect in candidate.effects)
    model = "rig" if rig else "half-space" if ground.inverse_depth == 0.0 else "layer"
    modulus, deviation, interval = math.nan, math.nan, (math.nan, math.nan)
    if not rig:
        modulus = _modulus(point, candidate)
        if averaged is None:
            place = len(candidate.fit.problem.device)
            ratio = candidate.fit.problem.own[0][0].parameter
            where = float(candidate.fit.own[0][0])
            spread = ratio.deviation(where, float(candidate.fit.deviations()[place]))
            relative = min(spread / float(ratio.value(where)), _UNKNOWN)
            interval = _interval(modulus, relative, _model_error(point, candidate))
        else:
            relative = averaged.deviation
            # Effects that cannot be told apart count in full, however heavy they weigh.
            low, high = averaged.interval
            wide = 1.0 + CALIBRATION
            interval = min(low, modulus), max(high, modulus)
            if moduli:
                interval = min(*interval, min(moduli) / wide), max(*interval, max(moduli) * wide)
        deviation = modulus * relative
    state = FittedState(
        model=model,
        modulus_pa=modulus,
        modulus_sd_pa=deviation,
        modulus_interval_pa=interval,
        fitted_modulus=modulus,
        residual_rms_m=float(np.sqrt(np.mean(left**2))),
        residual_over_noise=candidate.over_noise,
        residual_rms_over_peak=residual_over_peak(point, candidate),
        contact_residual_rms_over_peak=residual_over_peak(point, candidate, contact_only=True),
        stress_pa=_stress(point),
        modulus_100kpa_pa=ground.modulus * _bent(point, candidate, _REFERENCE_PA),
    )
    return _withheld(state) if rig or state.left_open else state


def _withheld(state: FittedState) -> FittedState:
    """Return a state without the modulus that it has no ground for, or leaves open."""
    interval = state.modulus_interval_pa if math.isfinite(state.fitted_modulus) else None
    return replace(
        state,
        modulus_pa=None,
        modulus_sd_pa=None,
        modulus_interval_pa=interval,
        modulus_100kpa_pa=None,
    )


def _left_open(state: FittedState) -> FittedState:
    """Return a state with the error of the modulus that may be behind the unexplained residual."""
    modulus = state.fitted_modulus
    if math.isnan(modulus):
        return state
    left = max(state.left_over_peak, known(state.contact_residual_rms_over_peak))
    behind = math.log1p(_BEHIND_LEFT * left)
    low, high = (
        modulus * math.exp(sign * math.hypot(math.log(edge / modulus), behind))
        for sign, edge in zip((-1.0, 1.0), known(state.modulus_interval_pa), strict=True)
    )
    wider = replace(state, modulus_interval_pa=(low, high))
    if wider.left_open or state.modulus_sd_pa is None:
        return _withheld(wider)
    relative = state.modulus_sd_pa / modulus
    return replace(wider, modulus_sd_pa=modulus * math.hypot(relative, behind / NORMAL_95))


def _model_error(point: Point, candidate: Candidate) -> float:
    """Relative error (95 %) of the modulus by calibration and by the effects' simplifications."""
    found, last = candidate.fit, len(point.drops) - 1
    values = found.problem.values(0, found.device, found.own[0], last)
    return math.hypot(CALIBRATION, *(effect.model_error(numbers) for effect, numbers in values))


def _interval(modulus: float, relative: float, model_error: float) -> tuple[float, float]:
    """95 % of a modulus, Pa, by its relative deviation and the model's relative error."""
    wide = math.exp(NORMAL_95 * relative) * (1.0 + model_error)
    return modulus / wide, modulus * wide


def _effects(
    point: Point,
    search: Search,
    best: Candidate,
    others: Mapping[str, Mapping[str, Candidate]],
    averaged: Averaged | None,
    *,
    brief: bool = False,
) -> tuple[EffectResult, ...]:
    discrepancy = averaged.discrepancy if averaged else Discrepancy.of(best.fit)
    deviations = np.sqrt(np.maximum(np.diag(discrepancy.covariance), 0.0))
    probabilities = averaged.probabilities if averaged else {}
    bounds = {id(unknown) for unknown in best.fit.at_bound()}
    found = []
    for effect in best.effects:
        told = {
            (name, unit, value, None if effect.scope != "drop" else number)
            for number, model in zip(point.records.numbers, point.drops, strict=True)
            for name, unit, value in effect.known(model.context)
        }
        parameters = [
            EffectParameter(name=name, unit=unit, value=value, sd=0.0, drop=number)
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
            EffectParameter(name=name, unit=unit, value=value, sd=0.0)
            for name, unit, value in effect.held(point.drops[0].context)
        ]
        one = effect_result(
            effect.name,
            effect.scope,
            effect.advice,
            parameters,
            alternatives=tuple(others.get(effect.name, ())),
            probability=probabilities.get(effect.name, 1.0),
        )
        if not brief:
            without = search.without(best, effect)
            left = residual_over_peak(point, without)
            one = replace(one, evidence=without.score - best.score, residual_without_over_peak=left)
        found.append(one)
    if brief:
        return tuple(found)
    return tuple(sorted(found, key=lambda effect: -known(effect.evidence)))


def _parameter(
    point: Point, unknown: Unknown, unit_value: float, deviation: float, at_bound: bool
) -> EffectParameter:
    p, where = unknown.parameter, float(unit_value)
    number = None if unknown.drop is None else point.records.numbers[unknown.drop]
    told = deviation < _NOT_FIXED and (
        p.prior is None or deviation * p.from_prior(where)[1] < _NO_MORE_THAN_PRIOR
    )
    spread = p.deviation(where, deviation) if told else math.nan
    return EffectParameter(
        name=p.name,
        unit=p.unit,
        value=float(p.value(where)),
        sd=spread,
        drop=number,
        at_bound=at_bound,
    )


def _warnings(
    best: Candidate, effects: Sequence[EffectResult], verdict: Verdict, after: FittedState
) -> list[Notice]:
    found = []
    for effect in effects:
        for parameter in effect.numbers:
            if parameter.at_bound:
                values = {"effect": effect.key, "parameter": known(parameter.name)}
                found.append(Notice("effect-on-bound", values))
        if effect.alternatives:
            alike: dict[str, Value] = {"effect": effect.key, "others": effect.alternatives}
            found.append(Notice("effect-ambiguous", alike))
    low, high = after.modulus_interval_pa or (math.nan, math.nan)
    if high > _WIDE * low and verdict == "explained" and not after.left_open:
        found.append(Notice("modulus-uncertain", {"modulus_interval_pa": (low, high)}))
    for unknown in best.fit.at_bound():
        if unknown.effect is None:
            found.append(Notice("ground-on-bound", {"parameter": unknown.parameter.name}))
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
