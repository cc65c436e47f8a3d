"""The picture of a diagnosis: the residual before, without each effect, and after."""

import math
from collections.abc import Sequence
from typing import Any, TypeGuard

from pfwd.analysis.results import DiagnosisResult
from pfwd.report.drawing import COLOURS, finish, margins
from pfwd.report.shown import percent
from pfwd.report.texts import Texts

Step = tuple[str, float, str]
"""Label, residual over the peak, and before, without or after."""


def ladder_of(diagnosis: DiagnosisResult, texts: Texts) -> list[Step]:
    """Return the residuals before, without each effect, and after; the largest effect first."""
    without = [
        (texts.say("without", effect=texts.word(str(effect.name))), residual, "without")
        for effect in diagnosis.effects or ()
        if _is_part(residual := effect.residual_without_over_peak)
    ]
    without.sort(key=lambda step: -step[1])
    ends = [
        (texts[when], state.residual_rms_over_peak, when)
        for when, state in (("before", diagnosis.before), ("after", diagnosis.after))
        if state is not None
    ]
    steps = [*ends[:1], *without, *ends[1:]]
    return [(name, residual, kind) for name, residual, kind in steps if _is_part(residual)]


_ROW, _ABOVE, _BELOW = 4.2, 1.0, 11.0
"""mm: a bar with its gap, and the margins; numbers and title of the axis stand below the bars."""


def ladder_height(steps: Sequence[Step]) -> float:
    """Return the height of the picture of `draw_ladder`, mm."""
    return _ROW * len(steps) + _ABOVE + _BELOW


def draw_ladder(figure: Any, diagnosis: DiagnosisResult, texts: Texts) -> None:
    """Draw the residuals as bars, percent of the peak, on a logarithmic axis."""
    steps = ladder_of(diagnosis, texts)
    height = ladder_height(steps)
    axes = figure.subplots(gridspec_kw=margins(0.27, 0.95, _BELOW / height, 1 - _ABOVE / height))
    colours = {"before": COLOURS[1], "without": COLOURS[5], "after": COLOURS[0]}
    lowest = min(residual for _, residual, _ in steps)
    start = 100 * lowest / 1.6
    for place, (_, residual, kind) in enumerate(steps):
        axes.barh(place, 100 * residual - start, left=start, height=0.62, color=colours[kind])
        text = percent(residual).replace(".", texts.decimal)
        axes.text(100 * residual * 1.04, place, text, va="center", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(start, 160 * max(residual for _, residual, _ in steps))
    axes.set_yticks(range(len(steps)), [name for name, _, _ in steps])
    axes.invert_yaxis()
    axes.set_xlabel(texts["ladder_axis"], fontsize=7.5, labelpad=2)
    finish(axes, texts)
    _number_log_axis(axes, texts)


def _number_log_axis(axes: Any, texts: Texts) -> None:
    """Number a logarithmic axis with plain numbers, at 1, 2 and 5 where it is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    low, high = axes.get_xlim()
    digits = (1.0,) if high > 300 * low else (1.0, 2.0, 5.0)
    axes.xaxis.set_major_locator(LogLocator(10.0, digits))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(
        FuncFormatter(lambda value, _place: f"{value:g}".replace(".", texts.decimal))
    )


def _is_part(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value) and value > 0.0
