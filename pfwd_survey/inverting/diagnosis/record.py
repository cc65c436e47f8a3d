"""The result of a diagnosis as it is told, with the keys of ``pfwd diagnose --json``."""

import math
from collections.abc import Sequence
from typing import Any

from inversion.diagnosis import FoundEffect, HeldOutPart, ModelState, PointDiagnosis
from pfwd_survey.digits import rounded
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.result import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
    HeldOut,
    HeldOutOne,
)

_ERRORS = (
    "before",
    "after",
    "contact_before",
    "contact_after",
    "scaled_record",
    "contact_scaled_record",
)
# How the screening says that nothing fell.
_NO_DROP = ("false trigger", "no pulse")


def diagnosis_result(entry: DiagnosisPoint, found: PointDiagnosis | None) -> DiagnosisResult:
    """What is told of one point; `found` is None where no drop of it was measured."""
    if entry.rig is not None:
        # Loaded here: on the ground nobody needs it.
        from pfwd_survey.inverting.diagnosis.rig import rig_result

        return rig_result(entry, entry.rig)
    conditions: dict[str, Any] = {}
    if entry.records is not None:
        first = entry.records.records[0]
        conditions = {
            "plate": "rigid-rough",
            "plate_radius_m": first.instrument.plate_radius,
            "poisson_ratio": first.poisson_ratio,
        }
    if found is None:
        return DiagnosisResult(
            file=entry.file,
            point=entry.point,
            device=entry.device,
            drops=(),
            rejected=entry.rejected,
            **conditions,
            verdict="unexplained",
            corrected=False,
            effects=(_false_trigger(),) if _nothing_fell(entry.rejected) else (),
            warnings=(*entry.warnings, *entry.rejected, "no measured drop to diagnose"),
        )
    return DiagnosisResult(
        file=entry.file,
        point=entry.point,
        device=entry.device,
        drops=tuple(found.numbers),
        rejected=entry.rejected,
        **conditions,
        verdict=found.verdict,
        corrected=found.corrected,
        noise_rms_m=found.noise_rms,
        before=_state(found.before),
        effects=tuple(_effect(effect) for effect in found.effects),
        after=_state(found.after, stress=True),
        held_out=_held_out(found),
        elapsed_s=found.elapsed if math.isfinite(found.elapsed) else None,
        warnings=(*entry.warnings, *found.warnings, *_left_open(found.after)),
    )


def _held_out(found: PointDiagnosis) -> HeldOut | None:
    """Return how well the parts of a point are predicted: root mean squares, and each."""
    parts = found.held_out_by
    if not parts:
        return None
    errors: dict[str, Any] = {
        key: _root_mean_square([getattr(part, key) for part in parts]) for key in _ERRORS
    }
    return HeldOut(
        mode=found.held_out_mode,
        fitted=tuple(dict.fromkeys(name for part in parts for name in part.fitted)),
        by=tuple(_held_out_one(part) for part in parts),
        **errors,
    )


def _held_out_one(part: HeldOutPart) -> HeldOutOne:
    errors: dict[str, Any] = {key: getattr(part, key) for key in _ERRORS}
    return HeldOutOne(name=part.name, fitted=part.fitted, **errors)


def _root_mean_square(errors: Sequence[float | None]) -> float | None:
    """Return that of the errors that there are; None: there are none."""
    known = [error for error in errors if error is not None]
    return math.sqrt(sum(error**2 for error in known) / len(known)) if known else None


def _left_open(after: ModelState) -> list[str]:
    """Why there is ground and no modulus."""
    if not after.left_open:
        return []
    low, high = (rounded(end / 1e6, end / 1e6) for end in after.modulus_interval)
    return [
        f"the records leave the modulus open, between {low} and {high} MPa: none is told; another "
        "declared depth, more sensors or a longer record may fix it"
    ]


def _nothing_fell(rejected: Sequence[str]) -> bool:
    """Whether the screening found a drop that is none, by its reasons ("drop 1: ...")."""
    return any(text.partition(": ")[2].startswith(_NO_DROP) for text in rejected)


def _false_trigger() -> EffectResult:
    return EffectResult(name="false_trigger", unit="-", parameters=(), alternatives=())


def _state(state: ModelState, *, stress: bool = False) -> FittedState:
    ground = math.isfinite(state.modulus)
    known = ground and not state.left_open
    return FittedState(
        model=state.model,
        modulus_pa=state.modulus if known else None,
        modulus_sd_pa=state.modulus_deviation if known else None,
        modulus_interval_pa=state.modulus_interval if ground else None,
        stress_pa=state.stress if stress else None,
        modulus_100kpa_pa=state.modulus_100kpa if stress and known else None,
        residual_rms_m=state.residual_rms,
        residual_over_noise=state.residual_over_noise,
        residual_rms_over_peak=state.residual_rms_over_peak,
        contact_residual_rms_over_peak=state.contact_residual_rms_over_peak,
    )


def _effect(effect: FoundEffect) -> EffectResult:
    first = effect.parameters[0].name
    alike = sorted((p for p in effect.parameters if p.name == first), key=lambda p: p.value)
    middle = alike[len(alike) // 2]
    return EffectResult(
        name=effect.name,
        scope=effect.scope,
        value=middle.value,
        sd=middle.deviation,
        unit=middle.unit,
        parameters=tuple(
            EffectParameter(
                name=p.name,
                value=p.value,
                sd=p.deviation,
                unit=p.unit,
                drop=p.drop,
                spread=p.spread if math.isfinite(p.spread) else None,
            )
            for p in effect.parameters
        ),
        evidence=effect.evidence,
        probability=effect.probability,
        residual_without_over_peak=effect.residual_without,
        alternatives=tuple(effect.alternatives),
        advice=effect.advice,
    )
