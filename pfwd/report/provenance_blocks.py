"""The parts of a report on the procedure, the instruments, and what repeats the computation."""

import datetime
import json
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from inversion.notices import messages_in
from inversion.records import JsonRecord, is_number, stored_fields
from inversion.result import InversionResult
from pfwd.files.header import IMPORTED, REMARK_CODES, declared_values
from pfwd.judging import PointView
from pfwd.procedures import Procedure, SourcedNumber
from pfwd.report import formatting
from pfwd.report.blocks import (
    Block,
    Code,
    Heading,
    Pairs,
    Paragraph,
    Table,
)
from pfwd.report.content import Report
from pfwd.report.formatting import declared
from pfwd.report.peaks_blocks import has_only_peaks
from pfwd.report.point_facts import used_drops
from pfwd.report.texts import Texts
from pfwd_plugins.quantities import QUANTITY_BY_ROLE, Measurand


def procedure_blocks(procedure: Procedure, texts: Texts) -> list[Block]:
    """Return the blocks on the procedure with all its numbers."""
    blocks: list[Block] = [
        Heading(f"{texts['procedure']}: {texts.title(procedure)}"),
        Pairs(((texts["procedure"], procedure.name), (texts["source"], procedure.source))),
    ]
    if procedure.about:
        blocks.append(Paragraph(texts.about(procedure), "note"))
    rows = []
    for key, number in procedure.numbers().items():
        rows.append(
            (
                texts.number_name(key),
                texts.decimals(procedure.shown_number(key)),
                texts.source(procedure, key, number),
                _state(procedure, number, texts),
            )
        )
    if rows:
        columns = (texts["number"], texts["value"], texts["source"], "")
        blocks.append(Table(columns, tuple(rows), (1,)))
    return blocks


def _state(procedure: Procedure, number: SourcedNumber, texts: Texts) -> str:
    if number.verified:
        return texts["verified"]
    return texts["enforced_unverified" if procedure.enforce_unverified else "not_verified"]


def device_blocks(report: Report, texts: Texts) -> list[Block]:
    """Return the blocks on the instruments of the survey and the last check of their sensors."""
    blocks: list[Block] = [Heading(texts["device"])]
    if not report.instruments:
        return [*blocks, Paragraph(texts["imported"], "note")]
    for identity in report.instruments:
        rows = (
            (texts["instrument"], str(identity.get("model") or "")),
            (texts["serial"], str(identity.get("serial_number") or "")),
            (texts["firmware"], str(identity.get("firmware") or "")),
            (texts["rate"], declared(identity.get("sampling_rate"), texts, "Hz")),
            (texts["plate"], _plate(identity, texts)),
        )
        blocks.append(Pairs(tuple(row for row in rows if row[1])))
        names = ("channel", "role", "offset", "sensitivity", "response", "calibrated", "due")
        channels = [_channel(channel, texts) for channel in identity.get("channels") or ()]
        blocks.append(Table(tuple(texts[name] for name in names), tuple(channels), (2, 3)))
    if report.check is not None:
        blocks.append(Pairs(((texts["check"], _check(report.check, texts)),)))
    return blocks


def _plate(identity: Mapping[str, Any], texts: Texts) -> str:
    radius, mass = identity.get("plate_radius"), identity.get("plate_mass")
    parts = [f"r = {declared(radius, texts, 'm')}"] if radius is not None else []
    parts += [f"m = {declared(mass, texts, 'kg')}"] if mass is not None else []
    return ", ".join([*parts, texts.word(f"sensor_on_{identity.get('centre_sensor')}")])


def _channel(channel: Mapping[str, Any], texts: Texts) -> tuple[str, ...]:
    frequency, damping = channel.get("natural_frequency"), channel.get("damping")
    response = formatting.NO_VALUE
    if frequency is not None and damping is not None:
        response = f"{declared(frequency, texts, 'Hz')}, {declared(damping, texts)}"
    role = str(channel.get("role") or "")
    quantity = QUANTITY_BY_ROLE.get(role, Measurand.VOLTAGE)
    return (
        str(channel.get("name") or ""),
        texts.word(role),
        declared(channel.get("offset", 0), texts, "m"),
        declared(channel.get("sensitivity"), texts, quantity.sensitivity_unit),
        response,
        str(channel.get("calibrated") or formatting.NO_VALUE),
        str(channel.get("due") or formatting.NO_VALUE),
    )


def _utc_text(text: str) -> str:
    """Return a time in UTC, ISO 8601, to the minute; another text as it is."""
    try:
        time = datetime.datetime.fromisoformat(text)
    except ValueError:
        return text
    return f"{time:%Y-%m-%d %H:%M} UTC"


def _check(check: Mapping[str, Any], texts: Texts) -> str:
    details = check.get("details", check)
    parts = [_utc_text(str(check.get("time_utc") or ""))]
    if isinstance(details.get("zero_n"), int | float):
        parts.append(texts.say("check_zero", value=f"{details['zero_n']:.0f}"))
    if isinstance(details.get("span_ratio"), int | float):
        parts.append(
            texts.say("check_span", value=texts.decimals(f"{100 * details['span_ratio']:.1f}"))
        )
    faults = [texts.message(fault) for fault in messages_in(details.get("faults"))]
    parts += faults or [texts["check_passed"]]
    return ", ".join(part for part in parts if part)


def _declared(report: Report, texts: Texts) -> list[Block]:
    """Return the declarations that all points share, then those that differ."""
    declared = [(point.shown_name, _declarations_of(point)) for point in report.points]
    first = declared[0][1] if declared else {}
    shared = {
        key: value
        for key, value in first.items()
        if all(values.get(key, _ABSENT) == value for _, values in declared)
    }
    points: dict[str, list[str]] = {}
    for name, values in declared:
        different = {key: value for key, value in values.items() if key not in shared}
        points.setdefault(_json_text(different), []).append(name)
    blocks: list[Block] = [Code(_json_text(shared))] if shared else []
    lines = [f"{', '.join(names)}: {text}" for text, names in points.items() if text != "{}"]
    return [*blocks, Code("\n".join(lines))] if lines else blocks


_ABSENT = object()


def _declarations_of(point: PointView) -> dict[str, Any]:
    """Return the keys of a point; the remarks of its import are among the warnings."""
    declared = {key: v for key, v in declared_values(point.setup).items() if key != "point"}
    imported = declared.pop(IMPORTED, None)
    if isinstance(imported, Mapping):
        reported_keys = ("remarks", REMARK_CODES)
        declared |= {f"{IMPORTED}.{k}": v for k, v in imported.items() if k not in reported_keys}
    elif imported is not None:
        declared[IMPORTED] = imported
    return declared


def _json_text(declared: Mapping[str, Any]) -> str:
    return json.dumps(declared, ensure_ascii=False, default=str, sort_keys=True)


def recompute_blocks(report: Report, texts: Texts) -> list[Block]:
    """Return the blocks with all that is needed to compute the report again."""
    settings = ", ".join(f"{key} {value}" for key, value in report.settings.items())
    rows = (
        (texts["command"], report.command),
        (texts["survey"], f"{report.survey_name}, {report.survey_id}"),
        (texts["software"], report.software),
        (texts["settings"], "" if has_only_peaks(report) else settings),
    )
    blocks: list[Block] = [
        Heading(texts["recompute"]),
        Paragraph(texts["recompute_note"], "note"),
        Pairs(tuple(row for row in rows if row[1])),
    ]
    blocks += [Heading(texts["declared"], 3), *_declared(report, texts)]
    blocks += _imported_files(report, texts)
    files = [
        (point.shown_name, str(drop.number), f"drop-{drop.record:06d}.h5", checksum)
        for point in report.points
        for drop in point.drops
        if drop.record is not None and (checksum := report.checksums.get(drop.record))
    ]
    if files:
        columns = (texts["point"], texts["drop"], texts["file"], texts["checksum"])
        blocks.append(Table(columns, tuple(files), (1,)))
    blocks += _values_in_force(report, texts)
    if report.chosen and report.procedure.file is not None:
        blocks += [Heading(texts["procedure"], 3), Code(report.procedure.text)]
    return blocks


def _imported_files(report: Report, texts: Texts) -> list[Block]:
    """Return the table of the files that drops were imported from, with their checksums."""
    stored = [drop.metadata for point in report.points for drop in point.drops]
    files = dict.fromkeys(
        (str(data["imported_from"]), str(data.get("imported_sha256") or formatting.NO_VALUE))
        for data in stored
        if data.get("imported_from")
    )
    if not files:
        return []
    table = Table((texts["original_file"], texts["checksum"]), tuple(files))
    return [Heading(texts["original_files"], 3), table]


def _values_in_force(report: Report, texts: Texts) -> list[Block]:
    """Return tables with the values of each diagnosis that counts, else of the averaged drops."""
    tables: list[Block] = []
    for point in report.points:
        diagnosis = point.counting_diagnosis
        if diagnosis is not None and diagnosis.after is not None:
            results = {texts["diagnosis"]: result_values(diagnosis.after)}
        else:
            results = {
                f"{texts['drop']} {drop.number}": result_values(drop.result)
                for drop in used_drops(point)
                if drop.result is not None
            }
        titles = list(results)
        for first in range(0, len(titles), _DROPS_OF_A_TABLE):
            group = titles[first : first + _DROPS_OF_A_TABLE]
            keys = dict.fromkeys(key for title in group for key in results[title])
            rows = [
                (
                    key,
                    *(
                        texts.decimals(results[title].get(key, formatting.NO_VALUE))
                        for title in group
                    ),
                )
                for key in keys
            ]
            right = tuple(range(1, len(group) + 1))
            tables.append(Table((point.shown_name, *group), tuple(rows), right))
    return [Heading(texts["result_values"], 3), *tables] if tables else []


_DROPS_OF_A_TABLE = 4
"""Largest number of drops whose values are side by side on a page."""


def result_values(result: JsonRecord) -> dict[str, str]:
    """Return the numbers of a result as texts without exponents, by their JSON keys, SI units."""
    written = result.to_json()
    texts = {}
    kind = InversionResult if isinstance(result, InversionResult) else type(result)
    for field in stored_fields(kind):
        value = written.get(field.name)
        numbers = value if isinstance(value, list) else [value]
        if numbers and all(map(is_number, numbers)):
            texts[field.name] = " – ".join(f"{Decimal(f'{n:.6g}'):f}" for n in numbers)
    return texts
