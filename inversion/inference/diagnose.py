"""Diagnosis of a point: its residual before and after, and the effects that explain the difference.

A structure is a set of effects that are added to the base model. The discrepancy is the model error
beyond noise, see :mod:`inversion.inference.discrepancy`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.diagnosis.declarations import contradiction, find_suspect_declarations
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
from inversion.inference.effect_results import effect_results
from inversion.inference.held_out import last_drop_error
from inversion.inference.modulus import (
    Component,
    depth_range,
    equivalent_estimate,
    ground_of,
    mean_stress,
    quantiles,
    secant_estimate,
    secant_modulus,
)
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge, summarise
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.selection import (
    EXPLAINED_TO,
    LOG_ODDS,
    SIMILAR_DISCREPANCY_RATIO,
    Selection,
    is_sound,
    select,
)
from inversion.inference.structures import effects_of
from inversion.measured.bad_sensors import (
    MIN_LOAD_STEP_DEVIATIONS,
    MIN_MOTION_STEP_DEVIATIONS,
    find_step,
)
from inversion.notices import Notice, Value
from inversion.records import Interval, known
from inversion.result import is_open
from inversion.threads import single_threaded_blas

# Contact pressure at which moduli of different drops are compared, Pa.
_REFERENCE_PA = 100e3
# Relative error (95 %) of the modulus over the discrepancy of an unexplained record. It exceeds 1
# because parameters imitate part of the model error, and that part does not show as discrepancy.
_MODULUS_ERROR_PER_DISCREPANCY = 2.0
# Factor on the prior standard deviations in the base model: the priors then have no effect.
_NO_PRIORS = 30.0
# Residual over the noise, and over the peak, above both of which slow noise does not explain it.
_MAX_RESIDUAL_OVER_NOISE, _MAX_NOISE_OVER_PEAK = 2.0, 0.02
# Smallest posterior probability, relative to the best structure, of a structure in the interval.
_MIN_WEIGHT = 0.02
# If the best structure does not explain the record, structures of similar discrepancy have at least
# this weight, relative to the best one.
_SIMILAR_WEIGHT = 0.1
_MAX_REFIT_ITERATIONS = 12
# Largest ratio of the base model's residual with a sensor turned or exchanged to that as declared,
# at which the full diagnosis is repeated.
_MAX_CORRECTED_RESIDUAL_RATIO = 0.8
# Ratio of the ends of the modulus interval from which a notice on ambiguous effects states it.
_NOTICED_INTERVAL_RATIO = 1.1


def diagnose_point(
    records: PointRecords,
    library: SurrogateLibrary | None = None,
    instrument: InstrumentKnowledge | None = None,
    *,
    compare_declarations: bool = True,
    predict_last: bool = True,
) -> PointDiagnosis:
    """Return the effects that explain the residual of a point, and the fits without and with them.

    Parameters
    ----------
    records : PointRecords
    library : SurrogateLibrary, optional
    instrument : InstrumentKnowledge, optional
        What other points and declarations say about the instrument.
    compare_declarations : bool
        True: declared values that look doubtful are tested.
    predict_last : bool
        True: the last of several drops is held out and predicted.

    Raises
    ------
    RecordError, ModelError
        If a record cannot be used.
    """
    library = library or SurrogateLibrary()
    instrument = instrument or InstrumentKnowledge()
    with single_threaded_blas():
        point = Point(records, library)
        if all(map(_centre_rises, point.drops)):
            raise RecordError(
                "centre sensor: expected a downward (positive) deflection, got none; check its "
                "polarity and its cable"
            )
        base = fit_base(point)
        objections = _find_steps(point)
        if objections:
            return _point_diagnosis(point, base, base, None, objections)
        selection = select(point.coarse(), instrument)
        best, seating = fit_drops_of_selection(point, selection, instrument)
        diagnosis = _point_diagnosis(point, base, best, (selection, seating), [])
        if predict_last and len(records.records) > 1:
            part = last_drop_error(records, (base, best), instrument, library)
            diagnosis = replace(diagnosis, held_out=HeldOut.of("next", [part]))
    doubtful = (
        diagnosis.verdict == "unexplained"
        or diagnosis.after.is_undetermined
        or _on_declared_rock(diagnosis, point)
    )
    if not (compare_declarations and doubtful):
        return diagnosis
    contradicted = _find_contradicted_declaration(point, diagnosis, library, instrument)
    if contradicted is None:
        return diagnosis
    return replace(
        diagnosis,
        verdict="unexplained",
        after=_without_modulus(diagnosis.after),
        warnings=(*diagnosis.warnings, contradicted),
    )


def _on_declared_rock(diagnosis: PointDiagnosis, point: Point) -> bool:
    """Return whether effects were detected above declared rock, whose depth may then be wrong."""
    depth = point.records.records[0].bedrock_depth
    return bool(diagnosis.effects) and depth is not None and math.isfinite(depth)


def fit_base(point: Point) -> Posterior:
    """Fit the base model: one ground under all drops, without effects and priors.

    Every sample has the same weight, as in least squares; the discrepancy is used for the interval
    only.
    """
    model = PointModel(point, (), range(len(point.drops)), is_same_ground=True)
    model.deviation = _NO_PRIORS * model.deviation
    fit = PointFit(model)
    fit.approach(_MAX_REFIT_ITERATIONS)
    fit.estimate_discrepancy(fit.posterior())
    return fit.posterior()


def fit_drops_of_selection(
    point: Point, selection: Selection, instrument: InstrumentKnowledge
) -> tuple[Posterior, float]:
    """Return the fit of all drops with the best structure, and the log evidence of seating.

    A structure whose fit of all drops is implausible is removed from the selection, and the next
    one is fitted.
    """
    declared = instrument.declared_effects
    while True:
        structure = selection.best
        fits = []
        for same_ground in (True, False)[: len(point.drops)]:
            model = PointModel(
                point,
                effects_of(structure, declared),
                range(len(point.drops)),
                declared,
                is_same_ground=same_ground,
            )
            model.apply_priors(instrument.priors(model))
            values = model.start_from(selection.fits[structure].by_key)
            fits.append(PointFit(model, values).run_nearby(_MAX_REFIT_ITERATIONS))
        evidence = fits[-1].log_evidence - fits[0].log_evidence
        if evidence + LOG_ODDS > 0.0:
            fits.reverse()
        sound = [fit for fit in fits if is_sound(fit)]
        if sound or len(selection.fits) == 1:
            return (sound or fits)[0], evidence
        selection.refuse(structure)


def _point_diagnosis(
    point: Point,
    base: Posterior,
    best: Posterior,
    choice: tuple[Selection, float] | None,
    objections: Sequence[Notice],
) -> PointDiagnosis:
    """Return the diagnosis that follows from the fits of a point.

    Parameters
    ----------
    point : Point
    base, best : Posterior, of the base model and of the chosen structure
    choice : the structures from which the best was chosen, and the log evidence of seating; None:
        none
    objections : notices about the records that rule out any explanation
    """
    effects = effect_results(best, *choice) if choice else ()
    after = _fitted_state(best, choice[0] if choice else None)
    warnings = [*objections, *_unexplained_reasons(best)]
    if choice and choice[0].is_overparameterised:
        warnings.append(Notice("too-many-effects", {"effects": len(choice[0].best)}))
    verdict: Verdict = "unexplained"
    if not warnings:
        verdict = "explained" if best.model.effects or effects else "clean"
    if warnings:
        after = _with_discrepancy_error(after)
    return PointDiagnosis(
        name=point.records.name,
        numbers=point.records.numbers,
        verdict=verdict,
        noise_rms=float(max(model.noise[0] for model in point.drops)),
        before=replace(
            _fitted_state(base, None, with_drift=False),
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


def _fitted_state(
    posterior: Posterior, selection: Selection | None, *, with_drift: bool = True
) -> FittedState:
    """Return the residuals of a fit, and its modulus with the 95 % interval.

    Parameters
    ----------
    posterior : Posterior, of all drops
    selection : structures that the interval covers; None: only the fitted one
    with_drift : bool, True: the prediction includes the drift of sensors
    """
    model = posterior.model
    drops = [model.point.drops[drop] for drop in model.drops]
    predictions = posterior.recorded if with_drift else posterior.predictions
    pairs = list(zip(drops, predictions, strict=True))
    residuals = [predicted - model_of_drop.observed for model_of_drop, predicted in pairs]
    over_noise = [
        r / model_of_drop.noise[:, None] for model_of_drop, r in zip(drops, residuals, strict=True)
    ]
    full_record, contact = (
        math.hypot(
            *(
                model_of_drop.residual_over_peak(p, contact_only=contact_only)
                for model_of_drop, p in pairs
            )
        )
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
        residual_rms_over_peak=full_record,
        contact_residual_rms_over_peak=contact,
        stress_pa=stress,
        discrepancy_over_peak=posterior.discrepancy.scale,
        discrepancy_interval_over_peak=PointFit(model, posterior.values).scale_interval(posterior),
    )
    if rig:
        return replace(state, modulus_interval_pa=None)
    modulus = secant_modulus(posterior, stress)

    def mixture(of: Callable[[Posterior], tuple[float, float]]) -> tuple[float, float, float]:
        return quantiles(_components(posterior, selection, of))

    low, median, high = mixture(lambda fit: secant_estimate(fit, stress))
    state = replace(
        state,
        fitted_modulus=median,
        modulus_pa=median,
        modulus_sd_pa=median * secant_estimate(posterior, stress)[1],
        modulus_interval_pa=(low, high),
        modulus_depth_m=depth_range(ground),
        modulus_100kpa_pa=median / modulus * secant_modulus(posterior, _REFERENCE_PA),
        viscosity_pa_s=float(ground.viscosity),
        density_kg_m3=float(ground.density),
        bedrock_depth_m=1.0 / float(ground.inverse_depth) if ground.inverse_depth > 0.0 else None,
    )
    if drops[-1].measures_plate:
        low, median, high = mixture(equivalent_estimate)
        state = replace(
            state, equivalent_modulus_pa=median, equivalent_modulus_interval_pa=(low, high)
        )
    return _without_open_moduli(state)


def _components(
    posterior: Posterior,
    selection: Selection | None,
    of: Callable[[Posterior], tuple[float, float]],
) -> list[Component]:
    """Return a modulus by the chosen and by each of the other structures, with its weight.

    Evidence weights structures correctly only if one of them is right. If even the best one does
    not explain the record, or has too many effects, others of similar discrepancy get a weight that
    the interval shows.

    Parameters
    ----------
    posterior : Posterior, final fit of the chosen structure
    selection : Selection or None
    of : returns the logarithm of the modulus of a fit, and its standard deviation
    """
    log_modulus, deviation = of(posterior)
    components = [Component(1.0, log_modulus, deviation)]
    if selection is None:
        return components
    best = selection.fits[selection.best]
    weights = selection.weights()
    if best.discrepancy.scale > EXPLAINED_TO or selection.is_overparameterised:
        close = SIMILAR_DISCREPANCY_RATIO * best.discrepancy.scale
        weights |= {
            structure: max(weights[structure], _SIMILAR_WEIGHT)
            for structure, fit in selection.fits.items()
            if fit.discrepancy.scale <= close
        }
    # Fits of the selection have a narrower frequency band than the final one.
    log_modulus_of_best, _ = of(best)
    for structure, weight in weights.items():
        fit = selection.fits[structure]
        on_rig = any(effect.replaces_ground for effect in fit.model.effects)
        if fit is best or weight < _MIN_WEIGHT or on_rig:
            continue
        alternative, deviation = of(fit)
        components.append(
            Component(weight, log_modulus + alternative - log_modulus_of_best, deviation)
        )
    return components


def _without_modulus(state: FittedState) -> FittedState:
    """Return a state without its moduli, which the data do not determine."""
    return replace(
        state,
        modulus_pa=None,
        modulus_sd_pa=None,
        modulus_100kpa_pa=None,
        equivalent_modulus_pa=None,
    )


def _without_open_moduli(state: FittedState) -> FittedState:
    """Return a state without those moduli that their intervals leave open."""
    if is_open(state.equivalent_modulus_interval_pa):
        state = replace(state, equivalent_modulus_pa=None)
    if not state.is_undetermined:
        return state
    return replace(_without_modulus(state), equivalent_modulus_pa=state.equivalent_modulus_pa)


def _with_discrepancy_error(state: FittedState) -> FittedState:
    """Return a state whose intervals include the error that the discrepancy indicates."""
    if math.isnan(state.fitted_modulus):
        return state
    modulus, equivalent = state.fitted_modulus, state.equivalent_modulus_pa
    discrepancy = max(
        known(state.discrepancy_over_peak), known(state.contact_residual_rms_over_peak)
    )
    error = math.log1p(_MODULUS_ERROR_PER_DISCREPANCY * discrepancy)

    def wider(value: float, limits: Interval) -> Interval:
        low, high = (
            value * math.exp(sign * math.hypot(math.log(end / value), error))
            for sign, end in zip((-1.0, 1.0), limits, strict=True)
        )
        return low, high

    if equivalent is not None:
        limits = wider(equivalent, known(state.equivalent_modulus_interval_pa))
        state = replace(state, equivalent_modulus_interval_pa=limits)
    if state.modulus_sd_pa is not None:
        relative = math.hypot(state.modulus_sd_pa / modulus, error / NORMAL_95)
        state = replace(state, modulus_sd_pa=modulus * relative)
    limits = wider(modulus, known(state.modulus_interval_pa))
    return _without_open_moduli(replace(state, modulus_interval_pa=limits))


def _unexplained_reasons(posterior: Posterior) -> list[Notice]:
    """Return the reasons why a fit does not explain its records; empty: it does."""
    reasons = []
    discrepancy = posterior.discrepancy.scale
    if discrepancy > EXPLAINED_TO:
        values: dict[str, Value] = {"discrepancy_over_peak": discrepancy, "limit": EXPLAINED_TO}
        reasons.append(Notice("discrepancy-remains", values))
    # Only the last drop is judged, because the first of several drops may have a larger residual.
    model = posterior.model
    last = model.point.drops[model.last]
    residual = posterior.recorded[-1] - last.observed
    over_noise = _root_mean_square([residual / last.noise[:, None]])
    last_residual = posterior.residuals_over_peak()[-1]
    if (
        not reasons
        and over_noise > _MAX_RESIDUAL_OVER_NOISE
        and last_residual > _MAX_NOISE_OVER_PEAK
    ):
        reasons.append(Notice("noise-exceeded", {"residual_over_noise": over_noise}))
    return reasons


def _root_mean_square(parts: Sequence[FloatArray]) -> float:
    return math.sqrt(np.mean(np.concatenate([part.ravel() for part in parts]) ** 2))


def _warnings(
    effects: Sequence[EffectResult], verdict: Verdict, after: FittedState
) -> list[Notice]:
    notices = []
    for effect in effects:
        for parameter in effect.numbers:
            if parameter.at_bound:
                values = {"effect": effect.key, "parameter": known(parameter.name)}
                notices.append(Notice("effect-on-bound", values))
        if effect.alternatives:
            alternatives: dict[str, Value] = {"effect": effect.key, "others": effect.alternatives}
            notices.append(Notice("effect-ambiguous", alternatives))
    low, high = after.modulus_interval_pa or (math.nan, math.nan)
    if (
        high > _NOTICED_INTERVAL_RATIO * low
        and verdict == "explained"
        and not after.is_undetermined
    ):
        notices.append(Notice("modulus-uncertain", {"modulus_interval_pa": (low, high)}))
    return notices


def _find_contradicted_declaration(
    point: Point,
    diagnosis: PointDiagnosis,
    library: SurrogateLibrary,
    instrument: InstrumentKnowledge,
) -> Notice | None:
    """Return the warning about a declaration that the records contradict; None: there is none."""
    for suspect in find_suspect_declarations(point):
        if not suspect.is_about_ground:
            # The base model shows quickly whether the residual decreases with the sensor changed.
            with single_threaded_blas():
                changed = fit_base(Point(suspect.records, library))
            residual = known(_fitted_state(changed, None, with_drift=False).residual_rms_over_peak)
            if residual > _MAX_CORRECTED_RESIDUAL_RATIO * diagnosis.before.residual_over_peak:
                continue
        try:
            corrected = diagnose_point(
                suspect.records,
                library,
                instrument,
                compare_declarations=False,
                predict_last=False,
            )
        except RecordError:
            continue  # without the declaration the record is not valid, so the declaration is kept
        notice = contradiction(suspect, diagnosis, corrected)
        if notice is not None:
            return notice
    return None


def _centre_rises(model: DropModel) -> bool:
    """Return whether the innermost sensor, if it is under the plate, rises during the contact."""
    innermost = int(np.argmin(np.abs(model.context.offsets)))
    if abs(model.context.offsets[innermost]) > model.context.plate_radius:
        return False
    contact = model.observed[innermost][model.context.time <= model.context.contact_end]
    return not contact.mean() > 0.0


def _find_steps(point: Point) -> list[Notice]:
    """Return notices about steps during the contact that no motion or falling weight can cause."""
    notices = []
    for number, model in zip(point.records.numbers, point.drops, strict=True):
        time = model.record.time
        first, end = np.searchsorted(
            time, model.drop.start + np.array([0.0, model.context.contact_end])
        )
        traces: list[tuple[str, dict[str, Value], FloatArray, float]] = [
            ("sensor-steps", {"offset_m": sensor.offset}, sensor.values, MIN_MOTION_STEP_DEVIATIONS)
            for sensor in model.record.sensors
        ]
        traces.append(("load-steps", {}, model.record.load, MIN_LOAD_STEP_DEVIATIONS))
        for code, place_of, values, plain in traces:
            place = find_step(values, int(first), int(end), plain)
            if place is not None:
                after = float(time[place] - time[first])
                notices.append(Notice(code, {"drop": number, **place_of, "after_s": after}))
    return notices


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
