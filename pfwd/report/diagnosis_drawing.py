"""The picture of a diagnosis: what is left before, without each effect, and after."""

import math
from typing import Any, TypeGuard

from pfwd.analysis.results import DiagnosisResult
from pfwd.report.drawing import COLOURS, finish, margins
from pfwd.report.texts import Texts

Step = tuple[str, float, str]
"""Words, residual over the peak, and before, without or after."""


def ladder_of(found: DiagnosisResult, texts: Texts) -> list[Step]:
    """What is left before, without each effect from the one that matters most, and after."""
    without = [
        (texts.say("without", effect=texts.word(str(effect.name))), left, "without")
        for effect in found.effects or ()
        if _is_part(left := effect.residual_without_over_peak)
    ]
    without.sort(key=lambda step: -step[1])
    ends = [
        (texts[when], state.residual_rms_over_peak, when)
        for when, state in (("before", found.before), ("after", found.after))
        if state is not None
    ]
    steps = [*ends[:1], *without, *ends[1:]]
    return [(name, left, kind) for name, left, kind in steps if _is_part(left)]


def draw_ladder(figure: Any, found: DiagnosisResult, texts: Texts) -> None:
    """Bars of what is left, percent of the peak, on a logarithmic axis."""
    steps = ladder_of(found, texts)
    axes = figure.subplots(gridspec_kw=margins(0.27, 0.95, 0.2, 0.98))
    colours = {"before": COLOURS[1], "without": COLOURS[5], "after": COLOURS[0]}
    lowest = min(left for _, left, _ in steps)
    start = 100 * lowest / 1.6
    for place, (_, left, kind) in enumerate(steps):
        axes.barh(place, 100 * left - start, left=start, height=0.62, color=colours[kind])
        text = f"{100 * left:.2g} %".replace(".", texts.decimal)
        axes.text(100 * left * 1.04, place, text, va="center", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(start, 160 * max(left for _, left, _ in steps))
    axes.set_yticks(range(len(steps)), [name for name, _, _ in steps])
    axes.invert_yaxis()
    axes.set_xlabel(texts["ladder_axis"], fontsize=7.5)
    finish(axes, texts)


def _is_part(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value) and value > 0.0
