"""Diagnosis of a point: its residual before and after, and the effects that explain the difference.

A structure is a set of effects that are added to the base model. The discrepancy is the model error
beyond noise, see :mod:`inversion.inference.discrepancy`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

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
from inversion.forward.library import SurrogateLibrary
from inversion.inference.base import BaseFit, fit_base
from inversion.inference.effect_results import effect_results
from inversion.inference.held_out import last_drop_error
from inversion.inference.modulus import NORMAL_95, Component, ModulusOf
from inversion.inference.point_model import PointModel
from inversion.inference.population import InstrumentKnowledge, summarise
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.selection import (
    EXPLAINED_TO,
    LOG_ODDS,
    Selection,
    is_sound,
    select,
)
from inversion.inference.state import (
    doubtful_weights,
    fitted_state,
    unexplained_reasons,
    without_modulus,
)
from inversion.inference.structures import effects_of
from inversion.measured.bad_sensors import (
    MIN_LOAD_STEP_DEVIATIONS,
    MIN_MOTION_STEP_DEVIATIONS,
    find_step,
)
from inversion.notices import Notice, Value
from inversion.threads import single_threaded_blas

# Smallest posterior probability, relative to the best structure, of a structure in the interval.
_MIN_WEIGHT = 0.02
_MAX_REFIT_ITERATIONS = 12
# Largest ratio of the base model's residual with a sensor turned or exchanged to that as declared,
# at which the full diagnosis is repeated.
_MAX_CORRECTED_RESIDUAL_RATIO = 0.8
# Ratio of the ends of the modulus interval, without the error of the instrument, from which a
# notice on ambiguous effects states it.
_NOTICED_INTERVAL_RATIO = 1.1
# Factor on the standard deviation of a modulus by a structure, unless no effect is needed: the
# posterior omits what effects of no catalogue change in the modulus. Chosen on the blind campaign
# of seed 640127 (29 November 2026), shown on another one, see docs/blind-campaign.md.
CALIBRATED_FACTOR = 4.0


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
            return _point_diagnosis(point, base, base.best, None, objections)
        point = point.with_modulus_error(instrument.modulus_error)
        selection = select(point.coarse(), instrument)
        best, seating = fit_drops_of_selection(point, selection, instrument)
        diagnosis = _point_diagnosis(point, base, best, (selection, seating), [])
        if predict_last and len(records.records) > 1:
            part = last_drop_error(records, (base.best, best), instrument, library)
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
        after=without_modulus(diagnosis.after),
        warnings=(*diagnosis.warnings, contradicted),
    )


def _on_declared_rock(diagnosis: PointDiagnosis, point: Point) -> bool:
    """Return whether effects were detected above declared rock, whose depth may then be wrong."""
    depth = point.records.records[0].bedrock_depth
    return bool(diagnosis.effects) and depth is not None and math.isfinite(depth)


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
    base: BaseFit,
    best: Posterior,
    choice: tuple[Selection, float] | None,
    objections: Sequence[Notice],
) -> PointDiagnosis:
    """Return the diagnosis that follows from the fits of a point.

    Parameters
    ----------
    point : Point
    base : BaseFit, of the base model
    best : Posterior, of the chosen structure
    choice : the structures from which the best was chosen, and the log evidence of seating; None:
        none
    objections : notices about the records that rule out any explanation
    """
    effects = effect_results(best, *choice) if choice else ()
    reasons = unexplained_reasons(best)
    warnings = [*objections, *reasons]
    if choice and choice[0].is_overparameterised:
        warnings.append(Notice("too-many-effects", {"effects": len(choice[0].best)}))
    verdict: Verdict = "unexplained"
    if not warnings:
        verdict = "explained" if best.model.effects or effects else "clean"
    after = base.state
    if choice:
        factor = 1.0 if verdict == "clean" else CALIBRATED_FACTOR
        after = fitted_state(best, partial(_components, best, choice[0], factor))
    return PointDiagnosis(
        name=point.records.name,
        numbers=point.records.numbers,
        verdict=verdict,
        noise_rms=float(max(model.noise[0] for model in point.drops)),
        before=replace(
            base.state,
            stress_pa=None,
            modulus_100kpa_pa=None,
            discrepancy_over_peak=None,
            discrepancy_interval_over_peak=None,
        ),
        after=after,
        effects=effects,
        held_out=None,
        warnings=(*_warnings(effects, verdict, after, best.model.point.modulus_error), *warnings),
        curves=_curves(point, base.best, best),
        summary=summarise(best),
        structure=choice[0].best if choice else frozenset(),
        gains=choice[0].gains() if choice else {},
        score=choice[0].score(choice[0].best) if choice else math.nan,
    )


def _components(
    posterior: Posterior, selection: Selection, factor: float, of: ModulusOf
) -> list[Component]:
    """Return a modulus by the chosen and by each of the other structures, with its weight.

    Parameters
    ----------
    posterior : Posterior, final fit of the chosen structure
    selection : Selection
    factor : float, on each standard deviation without the error of the instrument
    of : ModulusOf
    """
    instrument = posterior.model.point.modulus_error / NORMAL_95

    def calibrated(deviation: float) -> float:
        of_fit = math.sqrt(max(deviation**2 - instrument**2, 0.0))
        return math.hypot(factor * of_fit, instrument)

    log_modulus, deviation = of(posterior)
    components = [Component(1.0, log_modulus, calibrated(deviation))]
    best = selection.fits[selection.best]
    weights = selection.weights()
    if best.discrepancy.scale > EXPLAINED_TO or selection.is_overparameterised:
        in_doubt = doubtful_weights([*weights.values()], [selection.fits[s] for s in weights], best)
        weights = dict(zip(weights, in_doubt, strict=True))
    # Fits of the selection have a narrower frequency band than the final one.
    log_modulus_of_best, _ = of(best)
    for structure, weight in weights.items():
        fit = selection.fits[structure]
        on_rig = any(effect.replaces_ground for effect in fit.model.effects)
        if fit is best or weight < _MIN_WEIGHT or on_rig:
            continue
        alternative, deviation = of(fit)
        components.append(
            Component(
                weight, log_modulus + alternative - log_modulus_of_best, calibrated(deviation)
            )
        )
    return components


def _warnings(
    effects: Sequence[EffectResult], verdict: Verdict, after: FittedState, modulus_error: float
) -> list[Notice]:
    notices = []
    for effect in effects:
        for parameter in effect.parameters:
            if parameter.at_bound:
                values = {"effect": effect.name, "parameter": parameter.name}
                notices.append(Notice("effect-on-bound", values))
        if effect.alternatives:
            alternatives: dict[str, Value] = {"effect": effect.name, "others": effect.alternatives}
            notices.append(Notice("effect-ambiguous", alternatives))
    low, high = after.modulus_interval_pa or (math.nan, math.nan)
    if (
        math.log(high / low) > math.hypot(math.log(_NOTICED_INTERVAL_RATIO), 2.0 * modulus_error)
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
            residual = changed.state.residual_rms_over_peak
            if residual > _MAX_CORRECTED_RESIDUAL_RATIO * diagnosis.before.residual_rms_over_peak:
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
            residual_rms_over_peak=model.residual_over_peak(after, contact_only=False),
            contact_residual_rms_over_peak=model.residual_over_peak(after, contact_only=True),
        )
        for number, model, before, after in zip(
            point.records.numbers, point.drops, base.recorded, best.recorded, strict=True
        )
    )
