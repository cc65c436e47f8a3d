"""The beginning of a report: what was found on the whole, and every point in one line."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pfwd_survey.procedures import Quantity, Verdict
from pfwd_survey.procedures.moduli import mean
from pfwd_survey.reporting import shown
from pfwd_survey.reporting.blocks import (
    Block,
    Heading,
    Listing,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
)
from pfwd_survey.reporting.content import Report, ReportPoint
from pfwd_survey.reporting.drawing import draw_map, draw_profile, place
from pfwd_survey.reporting.fonts import Letters
from pfwd_survey.reporting.point_facts import (
    all_warnings,
    first_result,
    mean_modulus,
    verdict_of,
)
from pfwd_survey.reporting.texts import Texts


def summary_blocks(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """What was measured and judged, damage, the range of values, map and profile."""
    kept = [point for point in report.points if not point.discarded]
    blocks: list[Block] = [
        Heading(texts["summary"]),
        Pairs(tuple((label, value) for label, value in _rows(report, kept, texts) if value)),
    ]
    if report.damage:
        blocks += [
            Heading(texts["damage"], 3),
            Listing(tuple(report.damage), "warning"),
        ]
    values = [p.progress.value.value for p in kept if p.progress.value is not None]
    if len(values) > 1:
        blocks.append(Paragraph(_range(report, values, texts)))
    if place(report):
        blocks.append(
            Picture(
                partial(draw_map, report=report, texts=texts, letters=letters),
                80,
                f"{texts['map']}. {texts['map_note']}",
                texts["map"],
            )
        )
    else:
        blocks.append(Paragraph(texts["no_positions"], "note"))
    if values:
        blocks.append(
            Picture(
                partial(draw_profile, report=report, texts=texts, letters=letters),
                62,
                f"{texts['profile']}. {texts['profile_note']}",
                texts["profile"],
            )
        )
    return blocks


def _rows(report: Report, kept: Sequence[ReportPoint], texts: Texts) -> tuple[tuple[str, str], ...]:
    counts = Counter(verdict_of(point) for point in kept)
    times = sorted(drop.time_local for point in report.points for drop in point.drops)
    times = [time for time in times if time]
    operators = sorted({str(p.setup.operator) for p in report.points if p.setup.operator})
    return (
        (texts["survey"], report.survey),
        (texts["made"], report.made.replace("T", " ")),
        (texts["period"], " – ".join(dict.fromkeys((times[0], times[-1]))) if times else ""),
        (texts["operator"], ", ".join(operators)),
        (texts["instrument"], ", ".join(map(_instrument_name, report.instruments))),
        (texts["software"], ", ".join(f"{n} {v}" for n, v in report.software.items())),
        (texts["judged_by"], _judged_by(report, texts)),
        (texts["points"], f"{len(kept)} ({sum(len(p.drops) for p in kept)} {texts['drops']})"),
        (
            texts["verdict"],
            texts.say("verdicts", **{kind: counts[kind] for kind in Verdict}),
        ),
    )


def _range(report: Report, values: Sequence[float], texts: Texts) -> str:
    deflection = report.procedure.quantity is Quantity.DEFLECTION
    scale, unit = (1e3, "mm") if deflection else (1e-6, "MPa")
    middle = mean(values)
    variance = math.fsum((value - middle) ** 2 for value in values) / (len(values) - 1)
    return texts.say(
        "value_range",
        name=shown.name_of(report.procedure.quantity, texts),
        low=f"{shown.digits(min(values) * scale)} {unit}",
        high=f"{shown.digits(max(values) * scale)} {unit}",
        mean=f"{shown.digits(middle * scale)} {unit}",
        cv=shown.percent(math.sqrt(variance) / middle),
    )


def _judged_by(report: Report, texts: Texts) -> str:
    if not report.chosen:
        return f"{texts['modulus_full']}; {texts['no_procedure']}"
    name = report.procedure.quantity
    what = texts["modulus_full"] if name is Quantity.MODULUS else shown.name_of(name, texts)
    return f"{report.procedure.name} ({report.procedure.title}): {what}"


def _instrument_name(identity: Mapping[str, Any]) -> str:
    return f"{identity.get('model', '')} {identity.get('serial_number', '')}".strip()


def points_table(report: Report, texts: Texts) -> list[Block]:
    """Every point in one line, and every warning once."""
    judged = report.procedure.quantity is not Quantity.MODULUS
    columns = [texts["point"], texts["used"]]
    columns += [shown.name_of(report.procedure.quantity, texts)] if judged else []
    columns += [texts["modulus"], texts["basis"], texts["target"], texts["verdict"]]
    rows = []
    for point in report.points:
        progress = point.progress
        cells: list[str | Mark] = [point.name, str(len(progress.used))]
        if judged:
            cells.append(shown.value_of(progress.value, texts))
        kind = verdict_of(point)
        word = texts["discarded"] if point.discarded else texts[kind]
        cells += [
            mean_modulus(point, texts),
            shown.basis_of(first_result(point)),
            shown.target_of(progress.target, report.procedure.quantity),
            Mark(kind, word),
        ]
        rows.append(tuple(cells))
    blocks: list[Block] = [Heading(texts["points"]), Table(tuple(columns), tuple(rows), (1,))]
    blocks.append(Heading(texts["warnings"], 3))
    warnings = _grouped(report, texts)
    if warnings:
        blocks.append(Listing(tuple(warnings), "warning"))
    else:
        blocks.append(Paragraph(texts["no_warnings"], "note"))
    return blocks


def _grouped(report: Report, texts: Texts) -> list[str]:
    """Every warning once, with the points that it holds for."""
    points: dict[str, list[str]] = {}
    for point in report.points:
        for text in all_warnings(point):
            points.setdefault(text, []).append(point.name)
    return [
        f"{text} ({texts['point' if len(names) == 1 else 'points']} {', '.join(names)})"
        for text, names in points.items()
    ]
