"""A diagnosis in plain words: what was found, how sure, what it did, what to do in the field."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypeGuard

from pfwd.analysis.diagnosis.result import (
    DiagnosisResult,
    EffectResult,
    FittedState,
    HeldOut,
)
from pfwd.digits import read_in, rounded, with_ends, with_width
from pfwd.export.json_text import json_text
from pfwd.message_groups import as_ranges, group_messages
from tui.output import clean

if TYPE_CHECKING:
    from pfwd.procedures import PointModulus

_VERDICT = {
    "clean": "CLEAN: no effect is asked for",
    "explained": "EXPLAINED: the effects below leave next to nothing",
    "unexplained": "NOT EXPLAINED: more is left than the effects tell, the warnings say why",
}
_NO_DROP = "NOTHING TO DIAGNOSE: no drop of the point can be used"
# Moduli that differ by less than this part need not both be told.
_SAME = 0.02
# From this part on no digits after the point.
_TENTH = 0.1
# One of so many times is told by its nearer end: its width would leave no digit.
_WIDE = 3.0


def diagnosis_lines(result: DiagnosisResult, *, warnings: bool = True) -> list[str]:
    """The result of ``pfwd diagnose`` as lines of text, SI made readable.

    Parameters
    ----------
    result : DiagnosisResult
    warnings : bool
        Whether they are among the lines; of many points `diagnosis_warnings` has each once.
    """
    drops = ", ".join(map(str, result.drops or ())) or "none"
    device = "" if result.device is None else f", device {clean(result.device)}"
    point = "" if result.point is None else f", point {clean(result.point)}"
    lines = [f"{clean(result.file)}{point}{device}, drops {drops}"]
    verdict = _VERDICT.get(result.verdict or "", clean(result.verdict))
    lines.append(f"  {_NO_DROP if result.drops == () else verdict}")
    if result.before is not None and result.after is not None:
        lines.append(
            f"  {result.plate} plate of radius {_short(result.plate_radius_m)} m, Poisson's ratio "
            f"{_short(result.poisson_ratio)}"
        )
        lines.append(f"  before  {_state(result.before)}")
        lines.append(f"  after   {_state(result.after)}")
        if result.effects:
            lines += _change(result.before, result.after)
        elif result.verdict == "unexplained" and _modulus(result.before) != _modulus(result.after):
            lines.append("  no effect is taken over: after is the base model within usual soils")
        lines += _advice(result)
    for effect in result.effects or ():
        lines += _effect(effect)
    lines += _held_out(result.held_out)
    lines += [f"  {clean(text)}" for text in result.rejected or ()]
    return [*lines, *diagnosis_warnings([result])] if warnings else lines


def nothing_lines(results: Sequence[DiagnosisResult]) -> list[str]:
    """Several points none of whose drops can be used, in one line; their warnings say why."""
    names = _names(results)
    empty = [name for name, result in zip(names, results, strict=True) if result.drops == ()]
    if not empty:
        return []
    order = list(dict.fromkeys(names))
    where = "all points" if len(empty) == len(results) else as_ranges(empty, order)
    return [
        f"NOTHING TO DIAGNOSE at {where} ({len(empty)}): none of their drops can be used, the "
        "warnings say why"
    ]


def _names(results: Sequence[DiagnosisResult]) -> list[str]:
    return [clean(result.file if result.point is None else result.point) for result in results]


def diagnosis_warnings(results: Sequence[DiagnosisResult]) -> list[str]:
    """What is to be known of diagnoses: each sentence once, with its points as ranges."""
    names = _names(results)
    order = list(dict.fromkeys(names))
    said = [
        (name, text)
        for name, result in zip(names, results, strict=True)
        for text in result.warnings or ()
    ]
    lines = []
    for group in group_messages(said):
        where = f", {as_ranges(group.places, order)}" if len(results) > 1 else ""
        where = ", all points" if len(group.places) == len(order) > 2 else where
        lines.append(f"  warning{where}: {clean(group.text)}")
    return lines


def diagnosis_line(point: str, result: DiagnosisResult) -> str:
    """The diagnosis of a point that is being measured, in one line."""
    after = result.after or FittedState()
    left = _percent(after.residual_rms_over_peak)
    effects = ", ".join(clean(effect.name).replace("_", " ") for effect in result.effects or ())
    modulus = _modulus(after) or "no modulus"
    word = (result.verdict or "").upper()
    if result.corrected and result.verdict == "unexplained":
        word = "CORRECTED"
    return f"point {clean(point)} diagnosed: {modulus}, {word}, {left} of the peak left" + (
        f": {effects}" if effects else ""
    )


def _advice(result: DiagnosisResult) -> list[str]:
    """What an engineer may do with the number, in a sentence."""
    after = result.after
    if after is None or after.modulus_interval_pa is None:
        return []
    if after.left_open:
        return ["  The record leaves the modulus open: take none from it."]
    if not _is_finite(after.modulus_pa):
        return []
    low, high = after.modulus_interval_pa
    wide = (high - low) / 1e6
    value, *ends = _shown(after.modulus_pa, after.modulus_interval_pa)
    if result.use == "do-not-use":
        return [f"  Do not use the diagnosed modulus: {result.use_reason}."]
    word = "Design value" if result.use == "design" else "Use with care:"
    text = f"  {word} {value} MPa ({' to '.join(ends)})"
    if _is_finite(after.stress_pa):
        text += f", secant modulus at {after.stress_pa / 1e3:.0f} kPa"
        other = after.modulus_100kpa_pa
        if _is_finite(other) and abs(other / after.modulus_pa - 1.0) > _SAME:
            text += f" ({rounded(other / 1e6, wide)} MPa at 100 kPa)"
    reason = f": {result.use_reason}" if result.use == "with-care" else ""
    return [f"{text}{reason}."]


_PREDICTED = {"next": "next drop", "drop": "each drop", "sensor": "each sensor"}


def _held_out(held: HeldOut | None) -> list[str]:
    """Return how well held-out parts are predicted, and every number fitted to them."""
    if held is None:
        return []
    what = f"{_PREDICTED.get(held.mode or '', 'held-out part')} predicted"
    if not held.is_prediction and held.mode != "next":
        what = "device of the other points" if held.mode == "point" else "ground of the other drops"
        what += ", the rest fitted"
    lines = [
        f"  {what}: off by {_percent(held.after)} of the peak (contact "
        f"{_percent(held.contact_after)}), base model {_percent(held.before)} "
        f"({_percent(held.contact_before)}), {_scaled(held)}"
    ]
    parts = held.by or ()
    if len(parts) > 1:
        each = ", ".join(f"{clean(part.name)} {_percent(part.after)}" for part in parts)
        lines.append(f"    {each}")
    names = ", ".join(clean(name).replace("_", " ") for name in held.fitted or ())
    lines.append(f"    fitted to the held-out data: {names or 'nothing'}")
    return lines


def _scaled(held: HeldOut) -> str:
    if held.scaled_record is None:
        return "no preceding record to scale"
    return (
        f"preceding record scaled by the peak loads {_percent(held.scaled_record)} "
        f"({_percent(held.contact_scaled_record)})"
    )


def _modulus(state: FittedState) -> str:
    """The modulus with its interval, MPa, with the digits that it supports; empty: no ground."""
    modulus, interval = state.modulus_pa, state.modulus_interval_pa
    if interval is not None and state.left_open:
        low, high = (rounded(end / 1e6, end / 1e6) for end in interval)
        return f"E left open ({low} to {high} MPa)"
    if not _is_finite(modulus):
        return ""
    if interval is None or not all(map(math.isfinite, interval)):
        return f"E {modulus / 1e6:.3g} MPa"
    middle, *ends = _shown(modulus, interval)
    return f"E {middle} MPa ({' to '.join(ends)})"


def _shown(modulus: float, interval: tuple[float, float]) -> tuple[str, str, str]:
    """A modulus and the ends of its interval, MPa, with the digits that it supports."""
    middle, low, high = (value / 1e6 for value in (modulus, *interval))
    if high > _WIDE * low:
        return with_ends(middle, (low, high))
    return with_width(middle, (low, high))


def _state(state: FittedState) -> str:
    text = _modulus(state) or "no ground"
    over_noise = state.residual_over_noise
    times = f"{over_noise:.1f}" if _is_finite(over_noise) else "-"
    return (
        f"{text}, {state.model}; residual {_percent(state.residual_rms_over_peak)} of the "
        f"peak (contact {_percent(state.contact_residual_rms_over_peak)}), "
        f"{times} times the noise"
    )


def _change(before: FittedState, after: FittedState) -> list[str]:
    first, last = before.modulus_pa, after.modulus_pa
    if not _is_finite(first) or not _is_finite(last) or before.left_open or after.left_open:
        return []
    return [f"  the modulus changes by {100 * (last / first - 1):+.1f} %"]


def _effect(effect: EffectResult) -> list[str]:
    numbers = []
    for parameter in effect.parameters or ():
        scale, unit = read_in(clean(parameter.unit))
        unit = f" {unit}" if unit else ""
        drop = "" if parameter.drop is None else f" (drop {parameter.drop})"
        name = f"{clean(parameter.name).replace('_', ' ')}{drop}"
        if not _is_finite(parameter.value):
            numbers.append(f"{name} -")
        elif not _is_finite(parameter.sd):
            given = not _is_finite(effect.probability)
            shown = f"{name} {scale * parameter.value:.3g}{unit}"
            numbers.append(shown if given else f"{name} not fixed")
        elif parameter.sd == 0.0:
            numbers.append(f"{name} {scale * parameter.value:.3g}{unit}")
        else:
            spread = scale * parameter.sd
            value = rounded(scale * parameter.value, spread)
            numbers.append(f"{name} {value} ± {rounded(spread, spread)}{unit}")
    evidence = effect.evidence
    shared = "declared" if effect.scope == "point" else "shared by the device's points"
    strength = f"evidence {evidence:.0f}" if _is_finite(evidence) else shared
    if _is_finite(effect.probability) and _is_finite(evidence):
        strength += f", probability {100 * effect.probability:.0f} %"
    told = f": {'; '.join(numbers)}" if numbers else ""
    # What was found without a fit has no scope, and no strength.
    told += "" if effect.scope is None and not _is_finite(evidence) else f" [{strength}]"
    lines = [f"  {clean(effect.name)}{told}"]
    if effect.alternatives:
        lines.append(f"    could as well be {', '.join(map(clean, effect.alternatives))}")
    if effect.advice:
        lines.append(f"    {clean(effect.advice)}")
    return lines


def _percent(value: float | None) -> str:
    if not _is_finite(value):
        return "-"
    return f"{100 * value:.0f} %" if value >= _TENTH else f"{100 * value:.2g} %"


def _short(value: float | None) -> str:
    return f"{value:g}" if _is_finite(value) else "-"


def _is_finite(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def show_diagnosis(
    result: DiagnosisResult,
    *,
    as_json: bool,
    modulus: "PointModulus | Literal['unknown'] | None" = "unknown",
) -> None:
    """Print a diagnosis.

    Parameters
    ----------
    result : DiagnosisResult
    as_json : bool
    modulus : PointModulus or None, optional
        The modulus in force at its point; by default that of the diagnosis alone.
    """
    if as_json:
        from pfwd.judging.verdicts import modulus_in_force
        from pfwd.procedures.point import in_force_as_dict

        modulus = modulus_in_force(result) if modulus == "unknown" else modulus
        print(json_text(result.to_json() | in_force_as_dict(modulus)), flush=True)
        return
    for line in diagnosis_lines(result, warnings=False):
        print(line, flush=True)
