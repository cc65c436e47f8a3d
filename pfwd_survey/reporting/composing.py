"""What a report says, in which order: the same blocks for HTML and for PDF."""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pfwd_survey.files.header import declared_values
from pfwd_survey.inverting.analysis import ASSUMED_POISSON_RATIO
from pfwd_survey.procedures import Number, Procedure, Quantity, Verdict, judge
from pfwd_survey.procedures.moduli import mean
from pfwd_survey.procedures.profile import CHECKS
from pfwd_survey.reporting import shown
from pfwd_survey.reporting.blocks import (
    Block,
    Code,
    Heading,
    Listing,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
)
from pfwd_survey.reporting.content import NO_PROCEDURE, Report, ReportDrop, ReportPoint
from pfwd_survey.reporting.drawing import (
    draw_compaction,
    draw_map,
    draw_profile,
    draw_traces,
    place,
)
from pfwd_survey.reporting.fonts import Letters
from pfwd_survey.reporting.texts import Texts

MOST_TRACES = 6
"""Drops in one picture of traces: the averaged ones, then the last before them."""

_NUMBER_UNITS = {
    "seating": (1.0, ""),
    "measured": (1.0, ""),
    "factor": (1.0, ""),
    "nominal_pressure_pa": (1e-3, "kPa"),
    "nominal_load_n": (1e-3, "kN"),
    "poisson_ratio": (1.0, ""),
    "plate_radius_m": (1.0, "m"),
    **{key: (check.scale, check.unit) for key, check in CHECKS.items()},
}


_NAMES = {
    "seating": "seating drops",
    "measured": "measured drops",
    "factor": "plate factor",
    "nominal_pressure_pa": "nominal pressure",
    "nominal_load_n": "nominal load",
    "poisson_ratio": "Poisson's ratio",
    "plate_radius_m": "plate radius",
}


def compose(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """The blocks of a report.

    Parameters
    ----------
    report : Report
    texts : Texts
    letters : Letters
        For names in drawings.

    Returns
    -------
    list of Block
        The first heading is that of the report.
    """
    blocks: list[Block] = [Heading(report.title, level=1)]
    blocks.append(Paragraph(texts["report"], "note"))
    blocks += _summary(report, texts, letters)
    blocks += _points_table(report, texts)
    blocks.append(Paragraph(texts["uncertainty_note"], "note"))
    if texts.code != "en":
        blocks.append(Paragraph(texts["messages_note"], "note"))
    blocks += _procedure(report.procedure, texts) if report.chosen else []
    blocks += _device(report, texts)
    for point in report.points:
        blocks += _point(point, report, texts)
    blocks += _recompute(report, texts)
    return blocks


def verdict_of(point: ReportPoint) -> str:
    """Kind of a point's mark; a discarded point has no verdict."""
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def _summary(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    kept = [point for point in report.points if not point.discarded]
    counts = Counter(verdict_of(point) for point in kept)
    times = sorted(drop.time_local for point in report.points for drop in point.drops)
    times = [time for time in times if time]
    operators = sorted({str(p.setup.operator) for p in report.points if p.setup.operator})
    rows = [
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
    ]
    blocks: list[Block] = [
        Heading(texts["summary"]),
        Pairs(tuple((label, value) for label, value in rows if value)),
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


def _points_table(report: Report, texts: Texts) -> list[Block]:
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
            _mean_modulus(point, texts),
            shown.basis_of(_first_result(point)),
            shown.target_of(progress.target, report.procedure.quantity),
            Mark(kind, word),
        ]
        rows.append(tuple(cells))
    blocks: list[Block] = [Heading(texts["points"]), Table(tuple(columns), tuple(rows), (1,))]
    warned = [
        f"{texts['point']} {point.name}: {text}"
        for point in report.points
        for text in _all_warnings(point)
    ]
    blocks.append(Heading(texts["warnings"], 3))
    if warned:
        blocks.append(Listing(tuple(_grouped(report, texts)), "warning"))
    else:
        blocks.append(Paragraph(texts["no_warnings"], "note"))
    return blocks


def _all_warnings(point: ReportPoint) -> list[str]:
    found = [*point.warnings, *point.progress.faults, *point.progress.notes]
    for drop in point.drops:
        found += [*drop.marks, *drop.warnings]
    return list(dict.fromkeys(found))


def _grouped(report: Report, texts: Texts) -> list[str]:
    """Every warning once, with the points that it holds for."""
    points: dict[str, list[str]] = {}
    for point in report.points:
        for text in _all_warnings(point):
            points.setdefault(text, []).append(point.name)
    return [
        f"{text} ({texts['point' if len(names) == 1 else 'points']} {', '.join(names)})"
        for text, names in points.items()
    ]


def _used(point: ReportPoint) -> list[ReportDrop]:
    return [drop for drop in point.drops if drop.number in point.progress.used]


def _first_result(point: ReportPoint) -> Mapping[str, Any] | None:
    for drop in (*_used(point), *point.drops):
        if drop.result is not None and drop.result.get("modulus_pa") is not None:
            return drop.result
    return None


def _mean_modulus(point: ReportPoint, texts: Texts) -> str:
    """Mean modulus of the inversion over the averaged drops, whatever the procedure judges."""
    facts = [drop.facts for drop in _used(point)]
    value = judge(NO_PROCEDURE, facts, plate_radius=point.setup.plate_radius).value
    return shown.NOTHING if value is None else shown.value_of(value, texts)


def _procedure(procedure: Procedure, texts: Texts) -> list[Block]:
    blocks: list[Block] = [
        Heading(f"{texts['procedure']}: {procedure.title}"),
        Pairs(((texts["procedure"], procedure.name), (texts["source"], procedure.source))),
    ]
    if procedure.about:
        blocks.append(Paragraph(procedure.about, "note"))
    rows = []
    for key, number in procedure.numbers().items():
        words = CHECKS[key].words if key in CHECKS else _NAMES.get(key, key)
        rows.append(
            (
                words,
                _number(procedure, key, number),
                number.source,
                _state(procedure, number, texts),
            )
        )
    if rows:
        columns = (texts["number"], texts["value"], texts["source"], "")
        blocks.append(Table(columns, tuple(rows), (1,)))
    return blocks


def _number(procedure: Procedure, key: str, number: Number) -> str:
    scale, unit = _NUMBER_UNITS.get(key, (1.0, ""))
    if key.startswith("target"):
        deflection = procedure.quantity is Quantity.DEFLECTION
        scale, unit = (1e3, "mm") if deflection else (1e-6, "MPa")
    for suffix in ("_pa", "_n", "_m"):
        if not unit and key.endswith(suffix):
            unit = {"_pa": "Pa", "_n": "N", "_m": "m"}[suffix]
    return f"{number.value * scale:g} {unit}".strip()


def _state(procedure: Procedure, number: Number, texts: Texts) -> str:
    if number.verified:
        return texts["verified"]
    return texts["enforced_unverified" if procedure.enforce_unverified else "not_verified"]


def _device(report: Report, texts: Texts) -> list[Block]:
    blocks: list[Block] = [Heading(texts["device"])]
    if not report.instruments:
        return [*blocks, Paragraph(texts["imported"], "note")]
    for identity in report.instruments:
        rows = (
            (texts["instrument"], str(identity.get("model") or "")),
            (texts["serial"], str(identity.get("serial_number") or "")),
            (texts["firmware"], str(identity.get("firmware") or "")),
            (texts["rate"], shown.scaled(identity.get("sampling_rate"), 1.0, "Hz", 4)),
            (texts["plate"], _plate(identity)),
        )
        blocks.append(Pairs(tuple(row for row in rows if row[1])))
        names = ("channel", "role", "offset", "sensitivity", "response", "calibrated", "due")
        channels = [_channel(channel) for channel in identity.get("channels") or ()]
        blocks.append(Table(tuple(texts[name] for name in names), tuple(channels), (2, 3)))
    if report.check is not None:
        blocks.append(Pairs(((texts["check"], _check(report.check)),)))
    return blocks


def _plate(identity: Mapping[str, Any]) -> str:
    radius, mass = identity.get("plate_radius"), identity.get("plate_mass")
    parts = [f"r = {radius:g} m"] if radius is not None else []
    parts += [f"m = {mass:g} kg"] if mass is not None else []
    return ", ".join([*parts, f"sensor on {identity.get('centre_sensor')}"])


def _channel(channel: Mapping[str, Any]) -> tuple[str, ...]:
    frequency, damping = channel.get("natural_frequency"), channel.get("damping")
    response = shown.NOTHING
    if frequency is not None and damping is not None:
        response = f"{frequency:g} Hz, {damping:g}"
    return (
        str(channel.get("name") or ""),
        str(channel.get("role") or ""),
        f"{channel.get('offset', 0):g} m",
        f"{channel.get('sensitivity', math.nan):.4g}",
        response,
        str(channel.get("calibrated") or shown.NOTHING),
        str(channel.get("due") or shown.NOTHING),
    )


def _check(check: Mapping[str, Any]) -> str:
    details = check.get("details", check)
    parts = [str(check.get("time_utc") or "")]
    if isinstance(details.get("zero_n"), int | float):
        parts.append(f"zero {details['zero_n']:.0f} N")
    if isinstance(details.get("span_ratio"), int | float):
        parts.append(f"span {100 * details['span_ratio']:.1f} %")
    parts += [str(fault) for fault in details.get("faults") or ()] or ["OK"]
    return ", ".join(part for part in parts if part)


def _point(point: ReportPoint, report: Report, texts: Texts) -> list[Block]:
    progress = point.progress
    kind = verdict_of(point)
    word = texts["discarded"] if point.discarded else texts[kind]
    blocks: list[Block] = [Heading(f"{texts['point']} {point.name}", new_page=True)]
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
            f"{_mean_modulus(point, texts)}; {shown.basis_of(_first_result(point))}",
        ),
        (texts["target"], _target(point, report)),
        (texts["used"], ", ".join(map(str, progress.used)) or shown.NOTHING),
        (texts["excluded"], "; ".join(f"{n}: {why}" for n, why in progress.excluded)),
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
    blocks.append(Pairs(tuple(row for row in rows if row[1] and row[1] != shown.NOTHING)))
    traced = [drop for drop in _used(point) if drop.curves is not None][-MOST_TRACES:]
    if not traced:
        traced = [drop for drop in point.drops if drop.curves is not None][-MOST_TRACES:]
    if traced:
        names = ", ".join(str(drop.number) for drop in traced)
        caption = f"{texts['traces']}, {texts['drops']} {names}. {texts['traces_note']}"
        alternative = f"{texts['traces']}: {texts['point']} {point.name}"
        blocks.append(
            Picture(partial(draw_traces, drops=traced, texts=texts), 98, caption, alternative)
        )
    if len(progress.compaction) > 1:
        caption = f"{texts['compaction']}. {texts['compaction_note']}"
        blocks.append(
            Picture(
                partial(draw_compaction, point=point, texts=texts), 42, caption, texts["compaction"]
            )
        )
    blocks += _results(point, texts)
    found = _all_warnings(point)
    drop_notes = [f"{texts['drop']} {d.number}: {note}" for d in point.drops for note in d.notes]
    if found:
        blocks += [Heading(texts["warnings"], 3), Listing(tuple(found), "warning")]
    if drop_notes:
        blocks += [Heading(texts["notes"], 3), Listing(tuple(drop_notes))]
    blocks.append(Heading(texts["diagnosis"], 3))
    blocks += _diagnosis(point, texts)
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


def _results(point: ReportPoint, texts: Texts) -> list[Block]:
    kinds = dict(point.progress.kinds)
    rows = []
    for drop in point.drops:
        facts, result = drop.facts, drop.result or {}
        kind = str(kinds.get(drop.number, facts.kind))
        rows.append(
            (
                str(drop.number),
                texts[kind],
                shown.scaled(facts.peak_load, 1e-3, ""),
                shown.scaled(facts.peak_deflection, 1e6, ""),
                shown.scaled(facts.pulse_duration, 1e3, ""),
                shown.modulus_of(drop.result, texts, unit=""),
                _with_given(result, "viscosity", "pa_s", 1e-3),
                _with_given(result, "density", "kg_m3", 1.0),
                _with_given(result, "bedrock_depth", "m", 1.0),
                shown.scaled(result.get("residual_rms_over_peak"), 1e2, "", 2),
                shown.scaled(result.get("peak_modulus_pa"), 1e-6, ""),
            )
        )
    columns = tuple(f"{texts[name]}{', ' if unit else ''}{unit}" for name, unit in _COLUMNS)
    table = Table(columns, tuple(rows), (0, *range(2, len(columns))))
    basis: dict[str, list[str]] = {}
    for drop in point.drops:
        if drop.result is not None and drop.result.get("modulus_pa") is not None:
            where = texts["stored" if drop.stored else "fitted"]
            text = (
                f"{shown.basis_of({**drop.result, 'bedrock_depth_m': None})}; "
                f"{drop.result.get('method')}, {texts['load']}: {drop.result.get('load')}; "
                f"{texts['seed']} {drop.result.get('seed')}; {where}; "
                f"{texts['peak_method']}: k = {drop.result.get('peak_factor') or math.nan:.4g}, "
                f"{texts['peak_note']}"
            )
            basis.setdefault(text, []).append(str(drop.number))
    lines = [f"{texts['drop']} {', '.join(numbers)}: {text}" for text, numbers in basis.items()]
    return [
        Heading(texts["results"], 3),
        table,
        *(Paragraph(line, "note") for line in lines),
    ]


def _with_given(result: Mapping[str, Any], name: str, unit: str, scale: float) -> str:
    return shown.with_deviation(
        result.get(f"{name}_{unit}"), result.get(f"{name}_sd_{unit}"), scale, ""
    )


def _diagnosis(point: ReportPoint, texts: Texts) -> list[Block]:
    record = point.diagnosis
    if record is None:
        return [Paragraph(texts["no_diagnosis"], "note")]
    verdict = str(record.get("verdict"))
    known = f"verdict_{verdict}" in ("verdict_clean", "verdict_explained", "verdict_unexplained")
    blocks: list[Block] = [Paragraph(texts[f"verdict_{verdict}"] if known else verdict)]
    rows = []
    for when in ("before", "after"):
        state = record.get(when)
        if isinstance(state, Mapping):
            modulus = shown.with_deviation(
                state.get("modulus_pa"), state.get("modulus_sd_pa"), 1e-6, "MPa"
            )
            rows.append(
                (
                    texts[when],
                    modulus,
                    str(state.get("model")),
                    shown.percent(state.get("residual_rms_over_peak")),
                )
            )
    if rows:
        columns = ("", f"{texts['modulus']} ± s", texts["model"], texts["residual"])
        blocks.append(Table(columns, tuple(rows), (1, 3)))
        ratio = point.setup.poisson_ratio
        ratio = ASSUMED_POISSON_RATIO if ratio is None else ratio
        basis = f"rigid-rough {point.setup.plate_radius:g} m, ν {ratio:g}"
        blocks.append(Paragraph(f"{texts['basis']}: {basis}", "note"))
    effects = [_effect(effect) for effect in record.get("effects") or ()]
    if effects:
        blocks += [Heading(texts["effects"], 3), Listing(tuple(effects))]
    warnings = tuple(map(str, record.get("warnings") or ()))
    return [*blocks, Listing(warnings, "warning")] if warnings else blocks


def _effect(effect: Mapping[str, Any]) -> str:
    value = shown.with_deviation(
        effect.get("value"), effect.get("sd"), 1.0, str(effect.get("unit") or "")
    )
    text = f"{str(effect.get('name')).replace('_', ' ')}: {value}"
    others = ", ".join(str(one).replace("_", " ") for one in effect.get("alternatives") or ())
    return text + (f" (or: {others})" if others else "")


def _recompute(report: Report, texts: Texts) -> list[Block]:
    settings = ", ".join(f"{key} {value}" for key, value in report.settings.items())
    rows = (
        (texts["command"], report.command),
        (texts["survey"], f"{report.survey}, {report.survey_id}"),
        (texts["software"], ", ".join(f"{n} {v}" for n, v in report.software.items())),
        (texts["settings"], settings),
    )
    blocks: list[Block] = [
        Heading(texts["recompute"], new_page=True),
        Paragraph(texts["recompute_note"], "note"),
        Pairs(rows),
    ]
    declared: dict[str, list[str]] = {}
    for point in report.points:
        said = {k: v for k, v in declared_values(point.setup).items() if k != "point"}
        text = json.dumps(said, ensure_ascii=False, default=str, sort_keys=True)
        declared.setdefault(text, []).append(point.name)
    blocks.append(Heading(texts["declared"], 3))
    for text, names in declared.items():
        blocks.append(Paragraph(f"{texts['point']} {', '.join(names)}", "note"))
        blocks.append(Code(text))
    files = [
        (point.name, str(drop.number), f"drop-{drop.record:06d}.h5", drop.checksum)
        for point in report.points
        for drop in point.drops
        if drop.checksum
    ]
    if files:
        columns = (texts["point"], texts["drop"], texts["file"], texts["checksum"])
        blocks.append(Table(columns, tuple(files), (1,)))
    if report.chosen and report.procedure.file is not None:
        blocks += [Heading(texts["procedure"], 3), Code(report.procedure.text)]
    return blocks
