"""The diagnosis of a point and of a survey: the error before and after, and what stands between."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from inversion.diagnosis.fit import fit
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point, Problem, Unknown
from inversion.diagnosis.search import EXPLAINED, Candidate, Search
from inversion.effects.base import Effect, Ground
from inversion.effects.catalogue import BY_NAME, CATALOGUE
from inversion.kernel import FloatArray
from inversion.library import SurrogateLibrary
from inversion.threads import single_threaded_blas

Verdict = Literal["clean", "explained", "unexplained"]
_STEPS_OF_HELD_OUT = 10
# So many effects at once can be told from one record, and from several: more would fit anything.
_BELIEVED_OF_ONE, _BELIEVED = 2, 4
# Times the noise that slow noise may reach by chance, and up to which a model is nearly right.
_SLOW_NOISE, _NEARLY = 2.5, 3.0
# A range of moduli so wide is told.
_WIDE = 1.1

DeviceValues = dict[str, dict[str, float]]


@dataclass(frozen=True)
class FoundParameter:
    """One number of an effect.

    Parameters
    ----------
    name, unit : str
    value, deviation : float, SI
    drop : int or None, number of the drop that it belongs to
    at_bound : bool
    """

    name: str
    unit: str
    value: float
    deviation: float
    drop: int | None
    at_bound: bool


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the residual asks for.

    Parameters
    ----------
    name, scope, advice : str
    parameters : tuple of FoundParameter, the most telling first
    evidence : float, drop of the information criterion
    alternatives : tuple of str, effects that would do in its place
    """

    name: str
    scope: str
    advice: str
    parameters: tuple[FoundParameter, ...]
    evidence: float
    alternatives: tuple[str, ...]


@dataclass(frozen=True)
class State:
    """A model with its error.

    Parameters
    ----------
    model : "half-space" or "layer", or "rig" when there is no ground
    modulus, modulus_deviation : float, Pa; NaN for a rig
    modulus_interval : (float, float), Pa: 95 %, and all that effects give which would do as well
    residual_rms : float, m
    residual_over_noise : float
    residual_rms_over_peak, contact_residual_rms_over_peak : float
    """

    model: str
    modulus: float
    modulus_deviation: float
    modulus_interval: tuple[float, float]
    residual_rms: float
    residual_over_noise: float
    residual_rms_over_peak: float
    contact_residual_rms_over_peak: float


@dataclass(frozen=True, eq=False)
class DropCurves:
    """One drop before and after, for plots.

    Parameters
    ----------
    number : int
    time : (n,) ndarray of float, s
    load : (n,) ndarray of float, N
    observed, before, after : (n_sensors, n) ndarray of float, m
    offsets : (n_sensors,) ndarray of float, m
    contact_end : float, s
    """

    number: int
    time: FloatArray
    load: FloatArray
    observed: FloatArray
    before: FloatArray
    after: FloatArray
    offsets: FloatArray
    contact_end: float


@dataclass(frozen=True, eq=False)
class PointDiagnosis:
    """What was found at one point.

    Parameters
    ----------
    name : str
    numbers : tuple of int, of the drops
    verdict : Verdict
    noise_rms : float, m
    before, after : State
    effects : tuple of FoundEffect, strongest first
    held_out_before, held_out_after : float or None, residual over peak on what was not fitted
    warnings : tuple of str
    curves : tuple of DropCurves
    """

    name: str
    numbers: tuple[int, ...]
    verdict: Verdict
    noise_rms: float
    before: State
    after: State
    effects: tuple[FoundEffect, ...]
    held_out_before: float | None
    held_out_after: float | None
    warnings: tuple[str, ...]
    curves: tuple[DropCurves, ...] = field(repr=False)

    @property
    def corrected(self) -> bool:
        """Whether the modulus after may be taken for corrected."""
        return self.verdict == "explained"


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
        base = Search([point]).base()
        search = Search([point], fixed=device)
        best = search.run(likely)
        return _report(point, search, base, best)


def _report(point: Point, search: Search, base: Candidate, best: Candidate) -> PointDiagnosis:
    explained = _explains(point, best)
    # What explains little has no alternatives.
    others = {
        effect.name: search.alternatives(best, effect) if best.over_noise <= _NEARLY else {}
        for effect in best.effects
    }
    before = _state(point, base)
    moduli = [_modulus(point, one) for found in others.values() for one in found.values()]
    after = _state(point, best, moduli)
    effects = _effects(point, search, best, others)
    helped = bool(effects) or bool(search.fixed)
    verdict: Verdict = "unexplained"
    if explained:
        verdict = "explained" if helped else "clean"
    held_before, held_after = _held_out(point, base, best)
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
        warnings=tuple(_warnings(best, effects, verdict, after)),
        curves=_curves(point, base, best),
    )


def _explains(point: Point, best: Candidate) -> bool:
    """Whether what is left is noise, and what is gone may be believed to be explained."""
    records = len(point.drops) * point.drops[0].observed.shape[0]
    if len(best.effects) > (_BELIEVED_OF_ONE if records == 1 else _BELIEVED):
        return False
    if best.over_noise <= EXPLAINED:
        return True
    # Slow noise may look large at single samples: then what its correlation leaves counts.
    return best.over_noise <= _SLOW_NOISE and best.fit.excess <= 1.0


def _predict(candidate: Candidate) -> list[FloatArray]:
    found = candidate.fit
    return found.problem.predict(0, found.device, found.own[0])


def _modulus(point: Point, candidate: Candidate) -> float:
    """Of the ground under the last drop, Pa."""
    return _ground(point, candidate).modulus


def _ground(point: Point, candidate: Candidate) -> Ground:
    found, last = candidate.fit, len(point.drops) - 1
    ground = point.ground(found.problem.own[0], found.own[0])
    for effect, values in found.problem.values(0, found.device, found.own[0], last):
        ground = effect.ground(ground, values, point.drops[-1].context)
    return ground


def _state(point: Point, candidate: Candidate, moduli: Sequence[float] = ()) -> State:
    predicted = _predict(candidate)
    pairs = list(zip(point.drops, predicted, strict=True))
    left = np.concatenate([(w - m.observed).ravel() for m, w in pairs])
    whole = [m.residual_over_peak(w, contact_only=False) for m, w in pairs]
    contact = [m.residual_over_peak(w, contact_only=True) for m, w in pairs]
    found = candidate.fit
    ground = _ground(point, candidate)
    rig = any(effect.replaces_ground for effect in candidate.effects)
    model = "half-space" if ground.inverse_depth == 0.0 else "layer"
    index = len(found.problem.device)
    relative = math.nan
    if not rig:
        first = found.problem.own[0][0].parameter
        relative = found.deviations()[index] * math.log(first.upper / first.lower)
    return State(
        model="rig" if rig else model,
        modulus=math.nan if rig else ground.modulus,
        modulus_deviation=math.nan if rig else ground.modulus * relative,
        modulus_interval=_interval(
            math.nan if rig else ground.modulus, relative, _doubt(point, candidate), moduli
        ),
        residual_rms=float(np.sqrt(np.mean(left**2))),
        residual_over_noise=candidate.over_noise,
        residual_rms_over_peak=float(np.sqrt(np.mean(np.square(whole)))),
        contact_residual_rms_over_peak=float(np.sqrt(np.mean(np.square(contact)))),
    )


def _doubt(point: Point, candidate: Candidate) -> float:
    """Relative error (95 %) of the modulus that the effects' own simplifications may leave."""
    found, last = candidate.fit, len(point.drops) - 1
    values = found.problem.values(0, found.device, found.own[0], last)
    return math.hypot(0.0, *(effect.doubt(numbers) for effect, numbers in values))


def _interval(
    modulus: float, relative: float, doubt: float, others: Sequence[float]
) -> tuple[float, float]:
    """95 % of a modulus with a relative deviation and doubt, Pa, and whatever else it might be."""
    noise = math.exp(1.96 * min(relative, 3.0)) if math.isfinite(relative) else math.inf
    wide = noise * (1.0 + doubt)
    return min(modulus / wide, *others, modulus), max(modulus * wide, *others, modulus)


def _effects(
    point: Point, search: Search, best: Candidate, others: Mapping[str, Mapping[str, Candidate]]
) -> tuple[FoundEffect, ...]:
    deviations = best.fit.deviations()
    bounds = {id(one) for one in best.fit.at_bound()}
    found = []
    for effect in best.effects:
        told = {
            (name, unit, value, None if effect.scope != "drop" else number)
            for number, model in zip(point.records.numbers, point.drops, strict=True)
            for name, unit, value in effect.known(model.context)
        }
        parameters = [
            FoundParameter(name, unit, value, 0.0, number, False)
            for name, unit, value, number in sorted(told, key=lambda one: (one[3] or 0, one[0]))
        ]
        for one, place, deviation in zip(
            best.fit.unknowns, best.fit.places, deviations, strict=True
        ):
            if one.effect is effect:
                parameters.append(_parameter(point, one, place, deviation, id(one) in bounds))
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
    return tuple(sorted(found, key=lambda one: -one.evidence))


def _parameter(
    point: Point, one: Unknown, place: float, deviation: float, at_bound: bool
) -> FoundParameter:
    value = one.value(float(place))
    p = one.parameter
    slope = value * math.log(p.upper / p.lower) if p.logarithmic else p.upper - p.lower
    number = None if one.drop is None else point.records.numbers[one.drop]
    return FoundParameter(p.name, p.unit, value, float(abs(slope) * deviation), number, at_bound)


def _held_out(point: Point, base: Candidate, best: Candidate) -> tuple[float | None, float | None]:
    """Residual over peak of each drop, predicted from the others; None with a single drop."""
    count = len(point.drops)
    if count < 2:
        return None, None
    errors: dict[str, list[float]] = {"before": [], "after": []}
    for left_out in range(count):
        for name, candidate in (("before", base), ("after", best)):
            errors[name].append(_predict_left_out(candidate, left_out))
    before, after = (float(np.sqrt(np.mean(np.square(e)))) for e in errors.values())
    return before, after


def _predict_left_out(candidate: Candidate, left_out: int) -> float:
    """Error of a drop on the ground that the others gave.

    What belongs to a single drop (how it sat, what it left behind) cannot be known from others:
    that alone is taken from the drop itself.
    """
    problem = candidate.fit.problem
    drops = range(len(problem.points[0].drops))
    others = _without(problem, {left_out})
    found = fit(others, candidate.fit.device, candidate.fit.own, _STEPS_OF_HELD_OUT)
    device, own = found.device, found.own[0].copy()
    free = [i for i, one in enumerate(problem.own[0]) if one.drop == left_out]
    if free:
        alone = _without(problem, set(drops) - {left_out})

        def residual(places: FloatArray) -> FloatArray:
            own[free] = places
            return np.nan_to_num(alone.residual(0, device, own), nan=1e6, posinf=1e6, neginf=-1e6)

        start = np.clip(candidate.fit.own[0][free], 2e-3, 1.0 - 2e-3)
        solved = least_squares(residual, start, bounds=(0.0, 1.0), max_nfev=_STEPS_OF_HELD_OUT)
        own[free] = solved.x
    predicted = problem.predict(0, device, own)[left_out]
    return problem.points[0].drops[left_out].residual_over_peak(predicted, contact_only=False)


def _without(problem: Problem, drops: Collection[int]) -> Problem:
    return Problem(
        problem.points,
        problem.effects,
        problem.fixed,
        scope=problem.scope,
        left_out={(0, drop) for drop in drops},
    )


def _warnings(
    best: Candidate, effects: Sequence[FoundEffect], verdict: Verdict, after: State
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
    for one in best.fit.at_bound():
        if one.effect is None:
            found.append(f"{one.parameter.name.replace('_', ' ')} of the ground sits on a bound")
    if verdict == "unexplained" and best.over_noise <= EXPLAINED:
        found.append(
            f"{len(effects)} effects at once fit this residual, but would fit almost any: measure "
            "again, with more drops or sensors; do not take the modulus for corrected"
        )
    elif verdict == "unexplained":
        found.append(
            f"residual not explained: {best.over_noise:.1f} times the noise is left; do not take "
            "the modulus for corrected"
        )
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
            offsets=model.context.offsets,
            contact_end=model.context.contact_end + model.drop.start,
        )
        for number, model, before, after in zip(
            point.records.numbers, point.drops, _predict(base), _predict(best), strict=True
        )
    )


def left_out_error(
    records: PointRecords,
    found: PointDiagnosis,
    device: DeviceValues,
    library: SurrogateLibrary | None = None,
) -> float:
    """Residual over peak of a point whose ground is fitted, with device effects from elsewhere.

    Parameters
    ----------
    records : PointRecords
    found : PointDiagnosis, of the point; says which effects it has of its own
    device : values of the device effects that other points gave
    library : SurrogateLibrary
    """
    with single_threaded_blas():
        point = Point(records, library or SurrogateLibrary())
        search = Search([point], fixed=device)
        names = [effect.name for effect in found.effects if effect.name not in device]
        return _state(point, search.named(names)).residual_rms_over_peak


@dataclass(frozen=True, eq=False)
class DeviceFindings:
    """Device effects of a survey.

    Parameters
    ----------
    values, deviations : by effect and parameter
    drops : int, how many they rest on
    """

    values: DeviceValues
    deviations: Mapping[str, Mapping[str, float]]
    drops: int


def device_effects() -> tuple[Effect, ...]:
    """Effects of the catalogue whose values belong to the device."""
    return tuple(effect for effect in CATALOGUE if effect.scope == "device")


def fit_device(
    points: Sequence[PointRecords],
    found: Sequence[PointDiagnosis],
    names: Sequence[str],
    library: SurrogateLibrary,
) -> DeviceFindings:
    """Values of device effects, fitted over all points together, each with its own effects.

    Parameters
    ----------
    points : sequence of PointRecords
    found : sequence of PointDiagnosis, of the same points; says which effects each has of its own
    names : sequence of str, device effects
    library : SurrogateLibrary
    """
    with single_threaded_blas():
        chosen = [BY_NAME[name] for name in names]
        made = [Point(records, library) for records in points]
        local = [
            [*chosen, *(BY_NAME[e.name] for e in one.effects if e.scope != "device")]
            for one in found
        ]
        problem = Problem(made, _union(local), local=local)
        device = np.array([_known_place(one, found) for one in problem.device])
        owns = [
            np.array([_own_place(one, diagnosis) for one in own])
            for own, diagnosis in zip(problem.own, found, strict=True)
        ]
        result = fit(problem, device, owns, 12)
    deviations = result.deviations()
    values: DeviceValues = {}
    spread: dict[str, dict[str, float]] = {}
    for one, place, deviation in zip(problem.device, result.device, deviations, strict=False):
        assert one.effect is not None
        p = one.parameter
        value = one.value(float(place))
        slope = value * math.log(p.upper / p.lower) if p.logarithmic else p.upper - p.lower
        values.setdefault(one.effect.name, {})[p.name] = value
        spread.setdefault(one.effect.name, {})[p.name] = float(abs(slope) * deviation)
    return DeviceFindings(values, spread, sum(len(point.drops) for point in made))


def _union(local: Sequence[Sequence[Effect]]) -> list[Effect]:
    return [effect for effect in CATALOGUE if any(effect in one for one in local)]


def _known_place(one: Unknown, found: Sequence[PointDiagnosis]) -> float:
    assert one.effect is not None
    known = [
        p.value
        for diagnosis in found
        for effect in diagnosis.effects
        if effect.name == one.effect.name
        for p in effect.parameters
        if p.name == one.parameter.name
    ]
    return one.place(float(np.median(known)) if known else one.parameter.starts[0])


def _own_place(one: Unknown, diagnosis: PointDiagnosis) -> float:
    if one.effect is None:
        return one.place(one.parameter.starts[0])
    for effect in diagnosis.effects:
        if effect.name != one.effect.name:
            continue
        number = None if one.drop is None else diagnosis.numbers[one.drop]
        for p in effect.parameters:
            if p.name == one.parameter.name and p.drop == number:
                return one.place(p.value)
    return one.place(one.parameter.starts[0])
