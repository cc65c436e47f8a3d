"""The part of a report on one point: its facts, traces, results and diagnosis."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

from pfwd_survey.inverting.analysis import ASSUMED_POISSON_RATIO
from pfwd_survey.inverting.diagnosis.result import EffectResult
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.procedures import Quantity
from pfwd_survey.reporting import shown
from pfwd_survey.reporting.blocks import (
    Block,
    Heading,
    Listing,
    Pairs,
    Paragraph,
    Picture,
    Table,
)
from pfwd_survey.reporting.content import Report, ReportDrop, ReportPoint
from pfwd_survey.reporting.drawing import draw_compaction, draw_traces
from pfwd_survey.reporting.ground_blocks import effective_of, ground_blocks
from pfwd_survey.reporting.peaks_blocks import peaks_blocks
from pfwd_survey.reporting.point_facts import (
    all_warnings,
    effective_result,
    first_result,
    mean_modulus,
    used_drops,
    verdict_of,
)
from pfwd_survey.reporting.texts import Texts

_NO_RESULT = DropResult()

MOST_TRACES = 6
"""Drops in one picture of traces: the averaged ones, then the last before them."""

_COLUMNS = (
    ("drop", ""),
    ("kind", ""),
    ("load", "kN"),
    ("deflection", "µm"),
    ("pulse", "ms"),
    ("modulus", "MPa"),
    ("viscosity", "kPa s"),
    ("density", "kg/m³"),
    ("bedrock", "m"),
    ("residual", "%"),
    ("peak_method", "MPa"),
)


def point_blocks(point: ReportPoint, report: Report, texts: Texts) -> list[Block]:
    """All of one point, on a page of its own."""
    return [
        Heading(f"{texts['point']} {point.name}", new_page=True),
        Pairs(
            tuple(row for row in _rows(point, report, texts) if row[1] and row[1] != shown.NOTHING)
        ),
        *_pictures(point, texts),
        *ground_blocks(_traced(point), point.name, texts),
        *_results(point, texts),
        *peaks_blocks(point, texts),
        *_remarks(point, texts),
        Heading(texts["diagnosis"], 3),
        *_diagnosis(point, texts),
    ]


def _rows(point: ReportPoint, report: Report, texts: Texts) -> list[tuple[str, str]]:
    progress = point.progress
    word = texts["discarded"] if point.discarded else texts[verdict_of(point)]
    rows = [(texts["verdict"], f"{word}: {progress.verdict_reason}")]
    if report.procedure.quantity is not Quantity.MODULUS:
        rows += [
            (
                shown.name_of(report.procedure.quantity, texts),
                f"{shown.value_of(progress.value, texts)}; "
                f"{shown.value_basis(progress.value, texts)}",
            )
        ]
    rows += [
        (
            texts["modulus"],
            f"{mean_modulus(point, texts)}; {shown.basis_of(first_result(point))}",
        ),
        (texts["effective"], effective_of(effective_result(point), texts)),
        (texts["target"], _target(point, report)),
        (texts["used"], ", ".join(map(str, progress.used)) or shown.NOTHING),
        (
            texts["excluded"],
            "; ".join(f"{drop.number}: {drop.reason}" for drop in progress.excluded),
        ),
        (texts["spread"], shown.percent(progress.deflection_spread)),
        (texts["s_over_v"], shown.scaled(progress.s_over_v, 1e3, "ms")),
        (texts["stress"], _stress(point, texts)),
        (texts["position"], _position(point.position)),
        (texts["time"], next((drop.time_local for drop in point.drops if drop.time_local), "")),
        (texts["moisture"], shown.scaled(point.setup.moisture, 1.0, "%")),
        (texts["temperature"], shown.scaled(point.setup.temperature, 1.0, "°C")),
        (texts["material"], _said(point.setup.material)),
        (texts["photos"], _said(point.setup.photos)),
        (texts["notes"], "; ".join(point.notes)),
    ]
    return rows


def _traced(point: ReportPoint) -> list[ReportDrop]:
    """The drops whose curves are shown."""
    traced = [drop for drop in used_drops(point) if drop.curves is not None][-MOST_TRACES:]
    return traced or [drop for drop in point.drops if drop.curves is not None][-MOST_TRACES:]


def _pictures(point: ReportPoint, texts: Texts) -> list[Block]:
    blocks: list[Block] = []
    traced = _traced(point)
    if traced:
        names = ", ".join(str(drop.number) for drop in traced)
        caption = f"{texts['traces']}, {texts['drops']} {names}. {texts['traces_note']}"
        alternative = f"{texts['traces']}: {texts['point']} {point.name}"
        blocks.append(
            Picture(partial(draw_traces, drops=traced, texts=texts), 98, caption, alternative)
        )
    if len(point.progress.compaction) > 1:
        caption = f"{texts['compaction']}. {texts['compaction_note']}"
        blocks.append(
            Picture(
                partial(draw_compaction, point=point, texts=texts), 42, caption, texts["compaction"]
            )
        )
    return blocks


def _remarks(point: ReportPoint, texts: Texts) -> list[Block]:
    blocks: list[Block] = []
    found = all_warnings(point)
    drop_notes = [f"{texts['drop']} {d.number}: {note}" for d in point.drops for note in d.notes]
    if found:
        blocks += [Heading(texts["warnings"], 3), Listing(tuple(found), "warning")]
    if drop_notes:
        blocks += [Heading(texts["notes"], 3), Listing(tuple(drop_notes))]
    return blocks


def _target(point: ReportPoint, report: Report) -> str:
    text = shown.target_of(point.progress.target, report.procedure.quantity)
    source = point.progress.target_source
    return f"{text} ({source})" if text != shown.NOTHING and source else text


def _said(value: object) -> str:
    return "" if value is None else str(value)


def _stress(point: ReportPoint, texts: Texts) -> str:
    stress = point.progress.stress
    if stress is None:
        return ""
    low, high = (end / 1e3 for end in stress.pressures)
    exponent = shown.with_deviation(stress.exponent, stress.exponent_deviation, 1.0, "")
    return texts.say("stress_text", exponent=exponent, low=f"{low:.0f}", high=f"{high:.0f}")


def _position(position: Mapping[str, Any] | None) -> str:
    if position is None:
        return ""
    parts = [f"{position['latitude']:.6f}, {position['longitude']:.6f}", str(position["source"])]
    for key, name in (("fix", ""), ("hdop", "HDOP"), ("satellites", "sat."), ("age_s", "age s")):
        value = position.get(key)
        if value is not None:
            parts.append(f"{name} {value:.3g}" if isinstance(value, int | float) else str(value))
    return ", ".join(parts)


def _results(point: ReportPoint, texts: Texts) -> list[Block]:
    kinds = dict(point.progress.kinds)
    rows = []
    for drop in point.drops:
        facts, result = drop.facts, drop.result or _NO_RESULT
        kind = str(kinds.get(drop.number, facts.kind))
        rows.append(
            (
                str(drop.number),
                texts[kind],
                shown.scaled(facts.peak_load, 1e-3, ""),
                shown.scaled(facts.peak_deflection, 1e6, ""),
                shown.scaled(facts.pulse_duration, 1e3, ""),
                shown.modulus_of(drop.result, texts, unit=""),
                shown.with_deviation(result.viscosity_pa_s, result.viscosity_sd_pa_s, 1e-3, ""),
                shown.with_deviation(result.density_kg_m3, result.density_sd_kg_m3, 1.0, ""),
                shown.with_deviation(result.bedrock_depth_m, result.bedrock_depth_sd_m, 1.0, ""),
                shown.scaled(result.residual_rms_over_peak, 1e2, "", 2),
                shown.scaled(result.peak_modulus_pa, 1e-6, ""),
            )
        )
    columns = tuple(f"{texts[name]}{', ' if unit else ''}{unit}" for name, unit in _COLUMNS)
    table = Table(columns, tuple(rows), (0, *range(2, len(columns))))
    basis: dict[str, list[str]] = {}
    for drop in point.drops:
        found = drop.result
        if found is not None and found.modulus_pa is not None:
            where = texts["stored" if drop.stored else "fitted"]
            text = (
                f"{shown.basis_of(found, with_depth=False)}; "
                f"{found.method}, {texts['load']}: {found.load}; "
                f"{texts['seed']} {found.seed}; {where}; "
                f"{texts['peak_method']}: k = {found.peak_factor or math.nan:.4g}, "
                f"{texts['peak_note']}"
            )
            basis.setdefault(text, []).append(str(drop.number))
    lines = [f"{texts['drop']} {', '.join(numbers)}: {text}" for text, numbers in basis.items()]
    return [
        Heading(texts["results"], 3),
        table,
        *(Paragraph(line, "note") for line in lines),
    ]


def _diagnosis(point: ReportPoint, texts: Texts) -> list[Block]:
    found = point.diagnosis
    if found is None:
        return [Paragraph(texts["no_diagnosis"], "note")]
    verdict = str(found.verdict)
    known = f"verdict_{verdict}" in ("verdict_clean", "verdict_explained", "verdict_unexplained")
    blocks: list[Block] = [Paragraph(texts[f"verdict_{verdict}"] if known else verdict)]
    rows = []
    for when, state in (("before", found.before), ("after", found.after)):
        if state is not None:
            modulus = shown.with_deviation(state.modulus_pa, state.modulus_sd_pa, 1e-6, "MPa")
            residual = shown.percent(state.residual_rms_over_peak)
            rows.append((texts[when], modulus, str(state.model), residual))
    if rows:
        columns = ("", f"{texts['modulus']} ± s", texts["model"], texts["residual"])
        blocks.append(Table(columns, tuple(rows), (1, 3)))
        ratio = point.setup.poisson_ratio
        ratio = ASSUMED_POISSON_RATIO if ratio is None else ratio
        basis = f"rigid-rough {point.setup.plate_radius:g} m, ν {ratio:g}"
        blocks.append(Paragraph(f"{texts['basis']}: {basis}", "note"))
    effects = [_effect(effect) for effect in found.effects or ()]
    if effects:
        blocks += [Heading(texts["effects"], 3), Listing(tuple(effects))]
    warnings = found.warnings or ()
    return [*blocks, Listing(warnings, "warning")] if warnings else blocks


def _effect(effect: EffectResult) -> str:
    value = shown.with_deviation(effect.value, effect.sd, 1.0, effect.unit or "")
    text = f"{str(effect.name).replace('_', ' ')}: {value}"
    others = ", ".join(name.replace("_", " ") for name in effect.alternatives or ())
    return text + (f" (or: {others})" if others else "")
