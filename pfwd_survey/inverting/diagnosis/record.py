"""The machine-readable record of a diagnosis, with the keys of ``pfwd diagnose --json``."""

from typing import Any

from inversion.diagnosis import FoundEffect, ModelState, PointDiagnosis
from pfwd_survey.inverting.diagnosis.entries import Entry


def diagnosis_record(entry: Entry, found: PointDiagnosis | None) -> dict[str, Any]:
    """One point as the machine-readable record of ``pfwd diagnose --json``."""
    record: dict[str, Any] = {
        "file": entry.file,
        "device": entry.device,
        "drops": [] if found is None else list(found.numbers),
        "rejected": list(entry.rejected),
    }
    if entry.records is not None:
        first = entry.records.records[0]
        record |= {
            "plate": "rigid-rough",
            "plate_radius_m": first.instrument.plate_radius,
            "poisson_ratio": first.poisson_ratio,
        }
    if found is None:
        nothing = {"verdict": "unexplained", "corrected": False, "noise_rms_m": None}
        effects = [_false_trigger()] if entry.rejected else []
        return (
            record
            | nothing
            | {
                "before": None,
                "effects": effects,
                "after": None,
                "held_out": None,
                "warnings": [*entry.warnings, *entry.rejected, "no measured drop to diagnose"],
            }
        )
    held = None
    if found.held_out_before is not None:
        held = {"before": found.held_out_before, "after": found.held_out_after}
    return record | {
        "verdict": found.verdict,
        "corrected": found.corrected,
        "noise_rms_m": found.noise_rms,
        "before": _state_record(found.before),
        "effects": [_effect_record(effect) for effect in found.effects],
        "after": _state_record(found.after),
        "held_out": held,
        "warnings": [*entry.warnings, *found.warnings],
    }


def _false_trigger() -> dict[str, Any]:
    return {
        "name": "false_trigger",
        "value": None,
        "sd": None,
        "unit": "-",
        "parameters": [],
        "evidence": None,
        "alternatives": [],
    }


def _state_record(state: ModelState) -> dict[str, Any]:
    return {
        "model": state.model,
        "modulus_pa": state.modulus,
        "modulus_sd_pa": state.modulus_deviation,
        "modulus_interval_pa": list(state.modulus_interval),
        "residual_rms_m": state.residual_rms,
        "residual_over_noise": state.residual_over_noise,
        "residual_rms_over_peak": state.residual_rms_over_peak,
        "contact_residual_rms_over_peak": state.contact_residual_rms_over_peak,
    }


def _effect_record(effect: FoundEffect) -> dict[str, Any]:
    first = effect.parameters[0]
    alike = [p.value for p in effect.parameters if p.name == first.name]
    middle = sorted(alike)[len(alike) // 2]
    return {
        "name": effect.name,
        "scope": effect.scope,
        "value": middle,
        "sd": first.deviation,
        "unit": first.unit,
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "sd": p.deviation,
                "unit": p.unit,
                **({} if p.drop is None else {"drop": p.drop}),
            }
            for p in effect.parameters
        ],
        "evidence": effect.evidence,
        "alternatives": list(effect.alternatives),
        "advice": effect.advice,
    }
