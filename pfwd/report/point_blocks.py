"""The part of a report on one point: its facts, traces, results and diagnosis."""

import math
from collections.abc import Collection, Hashable, Mapping
from functools import partial
from typing import Any

from inversion.notices import RANGE_DASH
from pfwd.analysis.results import DropResult
from pfwd.facts import facts_of_drop
from pfwd.files.photos import is_sound_photo, photos_of
from pfwd.judging import DropView, PointView
from pfwd.message_groups import as_ranges, group_messages
from pfwd.procedures import Verdict
from pfwd.report import formatting
from pfwd.report.blocks import (
    Block,
    Heading,
    Pairs,
    Paragraph,
    Picture,
)
from pfwd.report.content import Report
from pfwd.report.diagnosis_blocks import diagnosis_blocks
from pfwd.report.drawing import MAX_PHOTOS, draw_photos, draw_point
from pfwd.report.formatting import Column, declared
from pfwd.report.ground_blocks import ground_blocks
from pfwd.report.peaks_blocks import (
    has_only_peaks,
    has_only_stiffness,
    peaks_blocks,
    peaks_point_blocks,
)
from pfwd.report.point_facts import (
    diagnosis_counts,
    diagnosis_of,
    drop_columns,
    drops_text,
    remarks_of,
    time_with_zone,
    used_drops,
    verdict_of,
)
from pfwd.report.point_result import result_rows
from pfwd.report.texts import Texts
from pfwd.units import Fact, unit_of_effect

MAX_DRAWN_DROPS = 6
"""Number of drops in one picture of traces: the averaged ones, else the last ones."""

_EMPTY_LETTERS = f"{formatting.NO_VALUE}; "
"""Characters of a value that is not known."""

_PHOTO_HEIGHT = 45.0
"""Height of a row of photos, mm."""

_TRACES_HEIGHT, _DROPS_HEIGHT = 50.0, 30.0
"""Heights of the picture of a point with traces and without, mm: two points fit on a page."""


def point_blocks(
    point: PointView, report: Report, texts: Texts, common: Collection[Hashable] = ()
) -> list[Block]:
    """Return the blocks on one point.

    Parameters
    ----------
    point : PointView
    report : Report
    texts : Texts
    common : collection
        Keys of messages that hold for all points; the first part of the report has them.
    """
    rows = tuple(row for row in _rows(point, report, texts) if row[1].strip(_EMPTY_LETTERS))
    kept = not point.discarded and all(drop.discarded is None for drop in point.drops)
    if has_only_stiffness(report) and kept:
        # That a rig has no modulus, no target and no averaged drop is stated once, not here.
        unneeded = (texts["verdict"], texts["used"])
        rows = tuple(row for row in rows if row[0] not in unneeded)
    if has_only_peaks(report):
        return peaks_point_blocks(point, rows, texts, common)
    blocks: list[Block] = [
        Heading(f"{texts['point']} {point.shown_name}"),
        Pairs(rows),
        *_pictures(point, texts),
        *ground_blocks(_traced(point), point.shown_name, texts),
        *([] if has_only_stiffness(report) else _results(point, texts)),
        *peaks_blocks(point, texts),
        *remarks_of(point, texts, common),
    ]
    if diagnosis_of(point) is not None:
        blocks += diagnosis_blocks(point, texts)
    return blocks


def photo_blocks(point: PointView, survey: str, texts: Texts) -> list[Block]:
    """Return the first photos of a point, how many more there are, and which are damaged.

    Parameters
    ----------
    point : PointView
    survey : path of the survey
    texts : Texts
    """
    files = photos_of(survey, point.name)
    sound = [file for file in files if is_sound_photo(file)]
    blocks: list[Block] = [
        Paragraph(texts["photo_damaged"].format(name=file.name), "warning")
        for file in files
        if file not in sound
    ]
    drawn = sound[:MAX_PHOTOS]
    caption = texts["photos"] if len(sound) == len(drawn) else f"{texts['photos']}: {len(sound)}"
    draw = partial(draw_photos, files=drawn)
    blocks += [Picture(draw, _PHOTO_HEIGHT, caption, texts["photos"])] if drawn else []
    return blocks


def _rows(point: PointView, report: Report, texts: Texts) -> list[tuple[str, str]]:
    progress = point.progress
    word = texts["discarded"] if point.discarded else texts[verdict_of(point)]
    # "no target" is its own reason.
    has_reason = progress.verdict is not Verdict.NONE or point.discarded
    reason = f": {texts.message(progress.verdict_reason)}" if has_reason else ""
    rows = [(texts["verdict"], word + reason)]
    if not report.procedure.quantity.is_fitted:
        rows += [
            (
                formatting.name_of(report.procedure.quantity, texts),
                f"{formatting.value_of(progress.value, texts)}; "
                f"{formatting.value_basis(progress.value, texts)}",
            )
        ]
    spread = formatting.percent(progress.deflection_spread, texts)
    s_over_v = formatting.show(Fact("duration", progress.s_over_v), texts)
    scatter = [
        f"{name}: {value}"
        for name, value in ((texts["spread"], spread), (texts["s_over_v"], s_over_v))
        if value != formatting.NO_VALUE
    ]
    around = [
        f"{texts[name]}: {value}"
        for name, value in (
            ("moisture", declared(point.setup.moisture, texts, "%")),
            ("temperature", declared(point.setup.temperature, texts, "°C")),
            ("material", _text_of(point.setup.material)),
            ("photos", _text_of(point.setup.photos)),
        )
        if value and value != formatting.NO_VALUE
    ]
    rows += [
        *result_rows(point, texts),
        (texts["target"], _target(point, report, texts)),
        (texts["used"], _used(point, texts)),
        (texts["checks"], "; ".join(scatter)),
        # It is a law of the fits of single drops; a diagnosis that counts has its own.
        (texts["stress"], "" if diagnosis_counts(point) else _stress(point, texts)),
        (
            texts["position"],
            "; ".join(
                filter(None, (time_with_zone(point, texts), position_text(point.place, texts)))
            ),
        ),
        (texts["conditions"], "; ".join(around)),
        (texts["notes"], "; ".join(point.notes)),
    ]
    return rows


def _used(point: PointView, texts: Texts) -> str:
    """Return the numbers of the averaged drops, and of the excluded ones with their reasons."""
    used = ", ".join(map(str, point.progress.used)) or formatting.NO_VALUE
    excluded = _excluded(point, texts)
    return f"{used}; {texts['excluded'].lower()}: {excluded}" if excluded else used


def _excluded(point: PointView, texts: Texts) -> str:
    order = [str(drop.number) for drop in point.drops]
    excluded = [(str(drop.number), drop.reason) for drop in point.progress.excluded]
    return "; ".join(
        f"{as_ranges(group.places, order, RANGE_DASH)}: {texts.message(group.message)}"
        for group in group_messages(excluded)
    )


def _traced(point: PointView) -> list[DropView]:
    """Return the drops whose curves are drawn."""
    traced = [drop for drop in used_drops(point) if drop.curves is not None][-MAX_DRAWN_DROPS:]
    return traced or [drop for drop in point.drops if drop.curves is not None][-MAX_DRAWN_DROPS:]


def _pictures(point: PointView, texts: Texts) -> list[Block]:
    traced = _traced(point)
    if not traced and len(point.progress.compaction) < 2:
        return []
    order = [str(drop.number) for drop in point.drops]
    names = drops_text([str(drop.number) for drop in traced], order, texts)
    caption = f"{texts['traces']}, {names}. " if traced else ""
    caption += f"{texts['compaction']}." if len(point.progress.compaction) > 1 else ""
    alternative = f"{texts['traces']}: {texts['point']} {point.shown_name}"
    draw = partial(draw_point, point=point, drops=traced, texts=texts)
    return [
        Picture(draw, _TRACES_HEIGHT if traced else _DROPS_HEIGHT, caption.strip(), alternative)
    ]


def _target(point: PointView, report: Report, texts: Texts) -> str:
    text = formatting.target_of(point.progress.target, report.procedure.quantity, texts)
    source = texts.message(point.progress.target_source)
    return f"{text} ({source})" if text != formatting.NO_VALUE and source else text


def _text_of(value: object) -> str:
    return "" if value is None else str(value)


def _stress(point: PointView, texts: Texts) -> str:
    stress = point.progress.stress
    if stress is None:
        return ""
    low, high = (end / 1e3 for end in stress.pressures)
    deviation = stress.exponent_deviation
    if deviation is not None and abs(stress.exponent) < 2 * deviation:  # 95 %: it may be none
        return texts.say("stress_none", low=f"{low:.0f}", high=f"{high:.0f}")
    exponent = formatting.show(
        Fact(unit_of_effect("-"), stress.exponent, deviation=deviation), texts
    )
    return texts.say("stress_text", exponent=exponent, low=f"{low:.0f}", high=f"{high:.0f}")


def position_text(position: Mapping[str, Any] | None, texts: Texts) -> str:
    """Return the coordinates with the quality of the fix; empty: unknown."""
    if position is None:
        return ""
    parts = [
        f"{position['latitude']:.6f}, {position['longitude']:.6f}",
        texts.word(str(position["source"])),
    ]
    if position.get("fix") is not None:
        parts.append(texts.word(str(position["fix"])))
    for key, name in (
        ("hdop", "HDOP"),
        ("satellites", texts["satellites"]),
        ("age_s", texts["age_of_fix"]),
    ):
        value = position.get(key)
        if value is not None:
            is_number = isinstance(value, int | float)
            parts.append(f"{name} {texts.decimals(f'{value:.3g}')}" if is_number else str(value))
    return ", ".join(parts)


def _results(point: PointView, texts: Texts) -> list[Block]:
    kinds = dict(point.progress.kinds)
    is_diagnosed = diagnosis_counts(point)
    results = [drop.result or DropResult() for drop in point.drops]
    fitted = [facts_of_drop(result) for result in results]
    for drop, of_drop in zip(point.drops, fitted, strict=True):
        if is_diagnosed and not drop.has_layers:  # the diagnosis has one modulus for all drops
            of_drop["modulus"] = Fact("modulus", None)

    def column(key: str, title: str) -> Column:
        return Column(title, [formatting.show(of[key], texts, with_unit=False) for of in fitted])

    table = formatting.table(
        Column(texts["drop"], [str(drop.number) for drop in point.drops]),
        Column(
            texts["kind"],
            [texts[str(kinds.get(facts.number, facts.kind))] for facts in point.facts],
            right=False,
        ),
        *drop_columns(point.facts, texts),
        column("modulus", f"{texts['modulus']}, MPa"),
        column("equivalent", f"{texts['equivalent_modulus']}, MPa"),
        column("viscosity", f"{texts['viscosity']}, kPa s"),
        column("density", f"{texts['density']}, kg/m³"),
        column("bedrock", f"{texts['bedrock']}, m"),
        Column(
            texts["residual"],
            [formatting.percent(result.residual_rms_over_peak, texts) for result in results],
        ),
        column("peak modulus", f"{texts['peak_method']}, MPa"),
    )
    basis: dict[str, list[str]] = {}
    for drop in point.drops:
        stored_result = drop.result
        if stored_result is not None and stored_result.modulus_pa is not None:
            where = texts["stored" if stored_result.stored else "fitted"]
            text = (
                f"{formatting.basis_of(stored_result, texts, with_depth=False)}; "
                f"{texts.word(str(stored_result.method))}, "
                f"{texts['load']}: {texts.word(str(stored_result.load))}; "
                f"{texts['seed']} {stored_result.seed}; {where}; "
                f"{texts['peak_method']}: k = "
                f"{texts.decimals(f'{stored_result.peak_factor or math.nan:.4g}')}"
            )
            basis.setdefault(text, []).append(str(drop.number))
    order = [str(drop.number) for drop in point.drops]
    lines = [f"{drops_text(numbers, order, texts)}: {text}" for text, numbers in basis.items()]
    if is_diagnosed and any(drop.has_layers for drop in point.drops):
        lines.append(texts["layers_replaced"])
    return [table, *(Paragraph(line, "note") for line in lines)]
