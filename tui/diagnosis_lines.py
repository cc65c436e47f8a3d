"""A diagnosis in plain words: what was found, how sure, what it did, what to do in the field."""

import math
from typing import TypeGuard

from pfwd_survey.inverting.diagnosis.result import DiagnosisResult, EffectResult, FittedState
from tui.output import clean

_VERDICT = {
    "clean": "CLEAN: the base model leaves only noise",
    "explained": "EXPLAINED: the effects below bring the residual to the noise",
    "unexplained": "NOT EXPLAINED, the warnings say why: do not take the modulus for corrected",
}


def diagnosis_lines(result: DiagnosisResult) -> list[str]:
    """The result of ``pfwd diagnose`` as lines of text, SI made readable."""
    drops = ", ".join(map(str, result.drops or ())) or "none"
    device = "" if result.device is None else f", device {clean(result.device)}"
    lines = [f"{clean(result.file)}{device}, drops {drops}"]
    lines.append(f"  {_VERDICT.get(result.verdict or '', clean(result.verdict))}")
    if result.before is not None and result.after is not None:
        lines.append(
            f"  {result.plate} plate of radius {_short(result.plate_radius_m)} m, Poisson's ratio "
            f"{_short(result.poisson_ratio)}"
        )
        lines.append(f"  before  {_state(result.before)}")
        lines.append(f"  after   {_state(result.after)}")
        if result.effects:
            lines += _change(result.before.modulus_pa, result.after.modulus_pa)
    for effect in result.effects or ():
        lines += _effect(effect)
    held = result.held_out
    if held is not None:
        lines.append(
            f"  predicted from other drops or points: off by {_percent(held.before)} of the "
            f"peak before, {_percent(held.after)} after"
        )
    lines += [f"  {clean(text)}" for text in result.rejected or ()]
    lines += [f"  warning: {clean(text)}" for text in result.warnings or ()]
    return lines


def _state(state: FittedState) -> str:
    modulus, deviation = state.modulus_pa, state.modulus_sd_pa
    text = f"E {modulus / 1e6:.4g} MPa" if _is_finite(modulus) else "no ground"
    if _is_finite(modulus) and _is_finite(deviation):
        text += f" ± {deviation / 1e6:.2g}"
    over_noise = state.residual_over_noise
    times = f"{over_noise:.1f}" if _is_finite(over_noise) else "-"
    return (
        f"{text}, {state.model}; residual {_percent(state.residual_rms_over_peak)} of the "
        f"peak (contact {_percent(state.contact_residual_rms_over_peak)}), "
        f"{times} times the noise"
    )


def _change(before: float | None, after: float | None) -> list[str]:
    if not _is_finite(before) or not _is_finite(after):
        return []
    return [f"  the modulus changes by {100 * (after / before - 1):+.1f} %"]


def _effect(effect: EffectResult) -> list[str]:
    numbers = []
    for parameter in effect.parameters or ():
        unit = "" if parameter.unit == "-" else f" {clean(parameter.unit)}"
        drop = "" if parameter.drop is None else f" (drop {parameter.drop})"
        sd = f" ± {parameter.sd:.2g}" if _is_finite(parameter.sd) else ""
        value = f"{parameter.value:.4g}" if _is_finite(parameter.value) else "-"
        numbers.append(f"{clean(parameter.name).replace('_', ' ')}{drop} {value}{sd}{unit}")
    evidence = effect.evidence
    shared = "declared" if effect.scope == "point" else "shared by the device's points"
    strength = f"evidence {evidence:.0f}" if _is_finite(evidence) else shared
    lines = [f"  {clean(effect.name)}: {'; '.join(numbers)} [{strength}]"]
    if effect.alternatives:
        lines.append(f"    could as well be {', '.join(map(clean, effect.alternatives))}")
    if effect.advice:
        lines.append(f"    {clean(effect.advice)}")
    return lines


def _percent(value: float | None) -> str:
    return f"{100 * value:.2g} %" if _is_finite(value) else "-"


def _short(value: float | None) -> str:
    return f"{value:g}" if _is_finite(value) else "-"


def _is_finite(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)
