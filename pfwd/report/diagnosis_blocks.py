"""The part of a point's report on the diagnosis of its residual, with its picture."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, TypeGuard

from pfwd.analysis.results import DiagnosisResult, EffectResult
from pfwd.facts import facts_of_effect, facts_of_state
from pfwd.judging import PointView
from pfwd.message_groups import group_messages
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Listing, Paragraph, Picture, Table
from pfwd.report.drawing import COLOURS, finish, margins, number_log_axis
from pfwd.report.formatting import percent
from pfwd.report.point_facts import all_warnings, diagnosis_counts, diagnosis_of
from pfwd.report.texts import Texts

_VERDICTS = ("clean", "explained", "unexplained")


def diagnosis_blocks(point: PointView, texts: Texts) -> list[Block]:
    """Return the verdict, the fits without and with effects, the residuals, and the effects.

    Parameters
    ----------
    point : PointView
        Without a diagnosis there is nothing to show.
    texts : Texts
    """
    diagnosis = diagnosis_of(point)
    if diagnosis is None:
        return []
    verdict = str(diagnosis.verdict)
    blocks: list[Block] = [
        Heading(texts["diagnosis"], 3),
        Paragraph(texts[f"verdict_{verdict}"] if verdict in _VERDICTS else verdict),
    ]
    blocks += _states(diagnosis, texts, counts=diagnosis_counts(point))
    steps = ladder_of(diagnosis, texts)
    if len(steps) > 2:
        picture = Picture(
            partial(draw_ladder, diagnosis=diagnosis, texts=texts),
            ladder_height(steps),
            texts["ladder_note"],
            f"{texts['diagnosis']}: {texts['point']} {point.shown_name}",
        )
        blocks.append(picture)
    effects = [_effect(effect, texts) for effect in diagnosis.effects]
    if effects:
        blocks += [Heading(texts["effects"], 3), Listing(tuple(effects))]
    reported = set(all_warnings(point))
    warnings = [warning for warning in diagnosis.warnings if warning not in reported]
    if warnings:
        groups = group_messages(("", warning) for warning in warnings)
        lines = tuple(texts.message(group.message) for group in groups)
        blocks.append(Listing(lines, "warning"))
    return blocks


def _states(diagnosis: DiagnosisResult, texts: Texts, *, counts: bool) -> list[Block]:
    """Return the table of the fits without and with effects, and the plate if they do not count."""
    rows = [
        (
            f"{texts[when]} ({texts['counts']})" if counts and when == "after" else texts[when],
            *(
                formatting.show(facts_of_state(state)[key], texts)
                for key in ("modulus", "equivalent")
            ),
            texts.word(str(state.model)),
            percent(state.contact_residual_rms_over_peak, texts),
            percent(state.residual_rms_over_peak, texts),
        )
        for when, state in (("before", diagnosis.before), ("after", diagnosis.after))
        if state is not None
    ]
    if not rows:
        return []
    columns = (
        "",
        f"{texts['modulus']} (95 %)",
        f"{texts['equivalent_modulus']} (95 %)",
        texts["model"],
        texts["contact_phase"],
        texts["residual"],
    )
    blocks: list[Block] = [Table(columns, tuple(rows), (1, 2, 4, 5))]
    if not counts:  # else the facts of the point have it
        plate = formatting.plate_text(
            diagnosis.plate or "rigid-rough",
            diagnosis.plate_radius_m,
            diagnosis.poisson_ratio,
            texts,
        )
        blocks.append(Paragraph(f"{texts['basis']}: {plate}", "note"))
    return blocks


def _effect(effect: EffectResult, texts: Texts) -> str:
    """Return an effect with all its parameters, the effects in its place, and the advice."""
    facts = facts_of_effect(effect)
    values = []
    for name, drop, fact in facts:
        words = [texts.word(name)] if len(facts) > 1 else []
        words += [] if drop is None else [f"({texts['drop']} {drop})"]
        values.append(" ".join([*words, formatting.show(fact, texts)]))
    text = texts.word(effect.name) + (f": {'; '.join(values)}" if values else "")
    alternatives = ", ".join(map(texts.word, effect.alternatives))
    text += f" ({texts['effect_or']} {alternatives})" if alternatives else ""
    advice = texts.advice(effect)
    return f"{text} – {advice}" if advice else text


Step = tuple[str, float, str]
"""Bar of the chart: label, residual over the peak, and kind (before, without or after)."""


def ladder_of(diagnosis: DiagnosisResult, texts: Texts) -> list[Step]:
    """Return the bars of the chart: base model, without each effect, all effects."""
    without = [
        (texts.say("without", effect=texts.word(str(effect.name))), residual, "without")
        for effect in diagnosis.effects
        if _is_part(residual := effect.residual_rms_over_peak_without)
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
"""Heights in mm: a bar with its gap, the margin above, and that below with numbers and title."""


def ladder_height(steps: Sequence[Step]) -> float:
    """Return the height of the chart that `draw_ladder` draws, mm."""
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
        axes.text(100 * residual * 1.04, place, percent(residual, texts), va="center", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(start, 160 * max(residual for _, residual, _ in steps))
    axes.set_yticks(range(len(steps)), [name for name, _, _ in steps])
    axes.invert_yaxis()
    axes.set_xlabel(texts["ladder_axis"], fontsize=7.5, labelpad=2)
    finish(axes, texts)
    number_log_axis(axes, texts)


def _is_part(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value) and value > 0.0
