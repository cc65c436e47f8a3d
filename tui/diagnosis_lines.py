"""A diagnosis in plain words: what was found, how sure, what it did, what to do in the field."""

import math
from collections.abc import Mapping
from typing import Any

from tui.output import clean

_VERDICT = {
    "clean": "CLEAN: the base model leaves only noise",
    "explained": "EXPLAINED: the effects below bring the residual to the noise",
    "unexplained": "NOT EXPLAINED, the warnings say why: do not take the modulus for corrected",
}


def diagnosis_lines(record: Mapping[str, Any]) -> list[str]:
    """The record of ``pfwd diagnose`` as lines of text, SI made readable.

    Parameters
    ----------
    record : mapping
        With the keys of ``pfwd diagnose --json``.
    """
    drops = ", ".join(map(str, record["drops"])) or "none"
    device = "" if record["device"] is None else f", device {clean(record['device'])}"
    lines = [f"{clean(record['file'])}{device}, drops {drops}"]
    lines.append(f"  {_VERDICT[record['verdict']]}")
    if record["before"] is not None:
        lines.append(
            f"  {record['plate']} plate of radius {record['plate_radius_m']:g} m, Poisson's ratio "
            f"{record['poisson_ratio']:g}"
        )
        lines.append(f"  before  {_state(record['before'])}")
        lines.append(f"  after   {_state(record['after'])}")
        lines += _change(record)
    for effect in record["effects"]:
        lines += _effect(effect)
    held = record["held_out"]
    if held is not None:
        lines.append(
            f"  predicted from other drops or points: off by {_percent(held['before'])} of the "
            f"peak before, {_percent(held['after'])} after"
        )
    lines += [f"  {clean(text)}" for text in record["rejected"]]
    lines += [f"  warning: {clean(text)}" for text in record["warnings"]]
    return lines


def _state(state: Mapping[str, Any]) -> str:
    modulus, deviation = state["modulus_pa"], state["modulus_sd_pa"]
    text = "no ground" if _missing(modulus) else f"E {modulus / 1e6:.4g} MPa"
    if not _missing(modulus) and not _missing(deviation):
        text += f" ± {deviation / 1e6:.2g}"
    return (
        f"{text}, {state['model']}; residual {_percent(state['residual_rms_over_peak'])} of the "
        f"peak (contact {_percent(state['contact_residual_rms_over_peak'])}), "
        f"{state['residual_over_noise']:.1f} times the noise"
    )


def _change(record: Mapping[str, Any]) -> list[str]:
    before, after = record["before"]["modulus_pa"], record["after"]["modulus_pa"]
    if _missing(before) or _missing(after) or not record["effects"]:
        return []
    return [f"  the modulus changes by {100 * (after / before - 1):+.1f} %"]


def _effect(effect: Mapping[str, Any]) -> list[str]:
    numbers = []
    for p in effect["parameters"]:
        unit = "" if p["unit"] == "-" else f" {p['unit']}"
        drop = f" (drop {p['drop']})" if "drop" in p else ""
        sd = "" if _missing(p["sd"]) else f" ± {p['sd']:.2g}"
        numbers.append(f"{p['name'].replace('_', ' ')}{drop} {p['value']:.4g}{sd}{unit}")
    evidence = effect["evidence"]
    strength = "shared by the device's points" if _missing(evidence) else f"evidence {evidence:.0f}"
    lines = [f"  {effect['name']}: {'; '.join(numbers)} [{strength}]"]
    if effect["alternatives"]:
        lines.append(f"    could as well be {', '.join(effect['alternatives'])}")
    if effect.get("advice"):
        lines.append(f"    {effect['advice']}")
    return lines


def _percent(value: float | None) -> str:
    return "-" if _missing(value) else f"{100 * float(value or 0.0):.2g} %"


def _missing(value: Any) -> bool:
    return value is None or not math.isfinite(value)
