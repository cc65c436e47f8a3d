"""The diagnosis of a point: the error before and after, and what stands between."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.declarations import contradiction, doubts
from inversion.diagnosis.findings import (
    DropCurves,
    EffectResult,
    FittedState,
    HeldOut,
    PointDiagnosis,
    Verdict,
)
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.errors import RecordError
from inversion.fitting.uncertainty import NORMAL_95
from inversion.forward.library import SurrogateLibrary
from inversion.inference.effects_found import effects_found
from inversion.inference.held_out import last_drop_error
from inversion.inference.modulus import (
    Component,
    component,
    ground_of,
    interval,
    mean_stress,
    secant_modulus,
)
from inversion.inference.point_model import STIFFNESS, PointModel
from inversion.inference.population import InstrumentKnowledge, summarise
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.selection import Selection, select
from inversion.inference.structures import effects_of
from inversion.measured.steps import PLAIN_LOAD, PLAIN_MOTION, find_step
from inversion.notices import Notice, Value
from inversion.records import known
from inversion.threads import single_threaded_blas

EXPLAINED_TO = 5e-3
"""Discrepancy over the peak up to which a record is explained."""

# Pa: the stress at which moduli of different drops are compared.
_REFERENCE_PA = 100e3
# Relative error (95 %) of the modulus over the discrepancy of an unexplained record: what the
# model lacks shows only as far as its parameters cannot imitate it.
_BEHIND_LEFT = 2.0
# Prior deviations of the base model over those of the inference: no priors in effect.
_NO_PRIORS = 30.0
# Residual over the noise and over the peak from which on slow noise alone does not explain it.
_MOST_OVER_NOISE, _MOST_NOISE = 2.0, 0.02
# Weight of a structure over the best one's from which on it counts for the interval.
_LEAST_WEIGHT = 0.02
# Discrepancy over the best structure's up to which another one of a wrong model is as good.
_AS_CLOSE = 1.5
_LOG_ODDS_OF_SEATING = -3.0
_ITERATIONS = 12
# Of what the base model leaves of a point: a sensor that is turned or exchanged has to leave less.
_FITS_BETTER = 0.8
# A range of moduli so wide is told.
_WIDE = 1.1


def diagnose_point(
    records: PointRecords,
    library: SurrogateLibrary | None = None,
    instrument: InstrumentKnowledge | None = None,
    *,
    compare_declarations: bool = True,
    predict_last: bool = True,
) -> PointDiagnosis:
    """Which effects the residual of a point asks for, and what they change.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary
    instrument : InstrumentKnowledge, what is known of the instrument from elsewhere
    compare_declarations : bool, whether other declarations are tried where the records contradict
        them
    predict_last : bool, whether the last of several drops is held out and predicted

    Raises
    ------
    RecordError, ModelError
        If a record cannot be used.
    """
    library = library or SurrogateLibrary()
    instrument = instrument or InstrumentKnowledge()
    with single_threaded_blas():
        point = Point(records, library)
        if all(map(_rises, point.drops)):
            raise RecordError(
                "centre sensor: expected a downward (positive) deflection, found none; check its "
                "polarity and whether it is alive"
            )
        base = fit_base(point)
        objections = _steps(point)
        if objections:
            return _diagnosis(point, base, base, None, objections)
        selection, best, seating = _choose(point, instrument)
        told = _diagnosis(point, base, best, (selection, seating), [])
        if predict_last and len(records.records) > 1:
            part = last_drop_error(records, (base, best), instrument, library)
            told = replace(told, held_out=HeldOut.of("next", [part]))
    doubtful = (
        told.verdict == "unexplained" or told.after.left_open or _on_declared_rock(told, point)
    )
    if not (compare_declarations and doubtful):
        return told
    contradicted = _contradicted(point, told, library, instrument)
    if contradicted is None:
        return told
    return replace(
        told,
        verdict="unexplained",
        after=_withheld(told.after),
        warnings=(*told.warnings, contradicted),
    )


def _on_declared_rock(told: PointDiagnosis, point: Point) -> bool:
    """Return whether effects were found above rock that is declared: its depth may be wrong."""
    depth = point.records.records[0].bedrock_depth
    return bool(told.effects) and depth is not None and math.isfinite(depth)


def fit_base(point: Point) -> Posterior:
    """Return the fit of the base model: one ground under all drops, no effect and no prior.

    As for a fit by least squares every sample counts alike; the discrepancy is for the interval.
    """
    model = PointModel(point, (), range(len(point.drops)), drops_alike=True)
    model.deviation = _NO_PRIORS * model.deviation
    fit = PointFit(model)
    fit.approach(_ITERATIONS)
    fit.estimate_discrepancy(fit.posterior())
    return fit.posterior()


def _choose(point: Point, instrument: InstrumentKnowledge) -> tuple[Selection, Posterior, float]:
    """Return the structures of a drop, the fit of all drops by the best, and its seating evidence.

    The last drop tells the structure. If all drops together leave much more than it does, that of
    the drop before may be the better one, unless other points tell what is likely.
    """
    coarse, last = point.coarse(), len(point.drops) - 1
    selection = select(coarse, last, instrument)
    found = (selection, *fit_drops_of_selection(point, selection, instrument))
    together, alone = (f.discrepancy.scale for f in (found[1], selection.fits[selection.best]))
    if last == 0 or instrument.nearby or together < max(_AS_CLOSE * alone, EXPLAINED_TO):
        return found
    before = select(coarse, last - 1, instrument)
    other = (before, *fit_drops_of_selection(point, before, instrument))
    return max((found, other), key=lambda one: one[1].log_evidence + one[0].log_odds(one[0].best))


def fit_drops_of_selection(
    point: Point, selection: Selection, instrument: InstrumentKnowledge
) -> tuple[Posterior, float]:
    """Return the fit of all drops by the best structure, and the log evidence of seating."""
    structure, declared = selection.best, instrument.declared_effects
    of_one_drop = selection.fits[structure]
    fits = []
    for alike in (True, False)[: len(point.drops)]:
        model = PointModel(
            point,
            effects_of(structure, declared),
            range(len(point.drops)),
            declared,
            drops_alike=alike,
        )
        model.apply_priors(instrument.priors(model))
        values = model.values_near(of_one_drop.by_key)
        for place, unknown in enumerate(model.unknowns):
            if unknown.name == STIFFNESS and unknown.drop is not None:
                values[place] = model.starting_deviation(unknown.drop)
        fits.append(PointFit(model, values).run_nearby(_ITERATIONS))
    if len(fits) == 1:
        return fits[0], 0.0
    evidence = fits[1].log_evidence - fits[0].log_evidence
    return fits[int(evidence + _LOG_ODDS_OF_SEATING > 0.0)], evidence


def _diagnosis(
    point: Point,
    base: Posterior,
    best: Posterior,
    choice: tuple[Selection, float] | None,
    objections: Sequence[Notice],
) -> PointDiagnosis:
    """Return what a fit says of a point.

    Parameters
    ----------
    point : Point
    base, best : Posterior, of the base model and of the chosen structure
    choice : the structures among which it was chosen, and the log evidence of seating
    objections : what speaks against any fit
    """
    effects = effects_found(best, *choice) if choice else ()
    after = _state(best, choice[0] if choice else None)
    warnings = [*objections, *_reasons(best)]
    if choice and choice[0].says_too_much:
        warnings.append(Notice("too-many-effects", {"effects": len(choice[0].best)}))
    verdict: Verdict = "unexplained"
    if not warnings:
        verdict = "explained" if best.model.effects or effects else "clean"
    if warnings:
        after = _with_what_is_left(after)
    return PointDiagnosis(
        name=point.records.name,
        numbers=point.records.numbers,
        verdict=verdict,
        noise_rms=float(max(model.noise[0] for model in point.drops)),
        before=replace(
            _state(base, None, with_drift=False),
            stress_pa=None,
            modulus_100kpa_pa=None,
            discrepancy_over_peak=None,
            discrepancy_interval_over_peak=None,
        ),
        after=after,
        effects=effects,
        held_out=None,
        warnings=(*_warnings(effects, verdict, after), *warnings),
        curves=_curves(point, base, best),
        summary=summarise(best),
        structure=choice[0].best if choice else frozenset(),
        gains=choice[0].gains() if choice else {},
        score=choice[0].score(choice[0].best) if choice else math.nan,
    )


def _state(
    posterior: Posterior, selection: Selection | None, *, with_drift: bool = True
) -> FittedState:
    """Return what a fit leaves, and its modulus with the interval.

    Parameters
    ----------
    posterior : Posterior, of all drops
    selection : structures over which the interval goes; None: no others
    with_drift : bool, whether the drift of sensors is part of what is predicted
    """
    model = posterior.model
    drops = [model.point.drops[drop] for drop in model.drops]
    predictions = posterior.recorded if with_drift else posterior.predictions
    pairs = list(zip(drops, predictions, strict=True))
    residuals = [predicted - one.observed for one, predicted in pairs]
    over_noise = [r / one.noise[:, None] for one, r in zip(drops, residuals, strict=True)]
    whole, contact = (
        math.hypot(*(one.residual_over_peak(p, contact_only=contact_only) for one, p in pairs))
        / math.sqrt(len(pairs))
        for contact_only in (False, True)
    )
    rig = any(effect.replaces_ground for effect in model.effects)
    ground = ground_of(posterior)
    stress = mean_stress(model)
    state = FittedState(
        model="rig" if rig else "half-space" if ground.inverse_depth == 0.0 else "layer",
        modulus_interval_pa=(math.nan, math.nan),
        residual_rms_m=_root_mean_square(residuals),
        residual_over_noise=_root_mean_square(over_noise),
        residual_rms_over_peak=whole,
        contact_residual_rms_over_peak=contact,
        stress_pa=stress,
        discrepancy_over_peak=posterior.discrepancy.scale,
        discrepancy_interval_over_peak=PointFit(model, posterior.values).scale_interval(posterior),
    )
    if rig:
        return replace(state, modulus_interval_pa=None)
    modulus = secant_modulus(posterior, stress)
    here = component(posterior, 1.0, math.log(modulus), stress)
    components = [here]
    if selection is not None:
        components += _of_other_structures(selection, here.middle, stress)
    low, high = interval(components)
    state = replace(
        state,
        fitted_modulus=modulus,
        modulus_pa=modulus,
        modulus_sd_pa=modulus * here.deviation,
        modulus_interval_pa=(min(low, modulus), max(high, modulus)),
        modulus_100kpa_pa=secant_modulus(posterior, _REFERENCE_PA),
    )
    return _withheld(state) if state.left_open else state


def _of_other_structures(selection: Selection, middle: float, stress: float) -> list[Component]:
    """Return what other structures say of the modulus.

    Evidence weighs structures if one of them is right. If even the best one leaves something that
    no effect tells, or has more effects than a point tells apart, others that leave hardly more
    count alike.

    Parameters
    ----------
    selection : Selection, of one drop
    middle : float, logarithm of the modulus by the best structure and all drops
    stress : float, Pa
    """
    best = selection.fits[selection.best]
    weights = selection.weights()
    if best.discrepancy.scale > EXPLAINED_TO or selection.says_too_much:
        close = _AS_CLOSE * best.discrepancy.scale
        weights |= {s: 1.0 for s, fit in selection.fits.items() if fit.discrepancy.scale <= close}
    of_one_drop = math.log(secant_modulus(best, stress))
    found = []
    for structure, weight in weights.items():
        fit = selection.fits[structure]
        on_rig = any(effect.replaces_ground for effect in fit.model.effects)
        if fit is best or weight < _LEAST_WEIGHT or on_rig:
            continue
        shift = math.log(secant_modulus(fit, stress)) - of_one_drop
        found.append(component(fit, weight, middle + shift, stress))
    return found


def _withheld(state: FittedState) -> FittedState:
    """Return a state without the modulus that it leaves open."""
    return replace(state, modulus_pa=None, modulus_sd_pa=None, modulus_100kpa_pa=None)


def _with_what_is_left(state: FittedState) -> FittedState:
    """Return a state with the error of the modulus that may be behind what is not explained."""
    if math.isnan(state.fitted_modulus):
        return state
    modulus = state.fitted_modulus
    left = max(known(state.discrepancy_over_peak), known(state.contact_residual_rms_over_peak))
    behind = math.log1p(_BEHIND_LEFT * left)
    low, high = (
        modulus * math.exp(sign * math.hypot(math.log(end / modulus), behind))
        for sign, end in zip((-1.0, 1.0), known(state.modulus_interval_pa), strict=True)
    )
    wider = replace(state, modulus_interval_pa=(low, high))
    if wider.left_open or state.modulus_sd_pa is None:
        return _withheld(wider)
    relative = math.hypot(state.modulus_sd_pa / modulus, behind / NORMAL_95)
    return replace(wider, modulus_sd_pa=modulus * relative)


def _reasons(posterior: Posterior) -> list[Notice]:
    """Return the reasons why a fit does not explain its records."""
    found = []
    discrepancy = posterior.discrepancy.scale
    if discrepancy > EXPLAINED_TO:
        values: dict[str, Value] = {"discrepancy_over_peak": discrepancy, "limit": EXPLAINED_TO}
        found.append(Notice("discrepancy-remains", values))
    # The first of several drops may leave more.
    model = posterior.model
    last = model.point.drops[model.last]
    residual = posterior.recorded[-1] - last.observed
    over_noise = _root_mean_square([residual / last.noise[:, None]])
    left = posterior.residuals_over_peak()[-1]
    if not found and over_noise > _MOST_OVER_NOISE and left > _MOST_NOISE:
        found.append(Notice("noise-exceeded", {"residual_over_noise": over_noise}))
    return found


def _root_mean_square(parts: Sequence[FloatArray]) -> float:
    return math.sqrt(np.mean(np.concatenate([part.ravel() for part in parts]) ** 2))


def _warnings(
    effects: Sequence[EffectResult], verdict: Verdict, after: FittedState
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
    return found


def _contradicted(
    point: Point, told: PointDiagnosis, library: SurrogateLibrary, instrument: InstrumentKnowledge
) -> Notice | None:
    """Return the warning about a declaration that the records of a point contradict, or None."""
    for doubt in doubts(point):
        if not doubt.of_ground:
            # The base model tells in no time whether a sensor fits better so.
            with single_threaded_blas():
                changed = fit_base(Point(doubt.records, library))
            left = known(_state(changed, None, with_drift=False).residual_rms_over_peak)
            if left > _FITS_BETTER * told.before.left_over_peak:
                continue
        try:
            other = diagnose_point(
                doubt.records,
                library,
                instrument,
                compare_declarations=False,
                predict_last=False,
            )
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


def _curves(point: Point, base: Posterior, best: Posterior) -> tuple[DropCurves, ...]:
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
            point.records.numbers, point.drops, base.predictions, best.recorded, strict=True
        )
    )
