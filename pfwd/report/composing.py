"""What a report says, in which order: the same blocks for HTML and for PDF."""

import dataclasses
import json
import os
from collections.abc import Mapping
from typing import Any

from inversion.records import is_number, stored_fields
from inversion.result import InversionResult
from pfwd.analysis.results import DropResult
from pfwd.files.header import IMPORTED, declared_values
from pfwd.judging import PointView
from pfwd.report.blocks import (
    Block,
    Code,
    Heading,
    Pairs,
    Paragraph,
    Table,
    Together,
)
from pfwd.report.certificate_blocks import (
    MAX_POINTS_WITH_CURVES,
    MAX_ROWS,
    certificate_blocks,
    curve_blocks,
    points_table,
)
from pfwd.report.content import Report
from pfwd.report.device_blocks import device_blocks
from pfwd.report.fonts import Letters
from pfwd.report.localising import localised, names_of
from pfwd.report.lot_blocks import lot_blocks
from pfwd.report.peaks_blocks import basin_of_drop, has_only_peaks
from pfwd.report.point_blocks import photo_blocks, point_blocks
from pfwd.report.procedure_blocks import procedure_blocks
from pfwd.report.summary_blocks import common_warnings, summary_blocks, warning_blocks
from pfwd.report.texts import Texts


def compose(
    report: Report,
    texts: Texts,
    letters: Letters,
    company: str | None = None,
    logo: str | os.PathLike[str] | None = None,
) -> list[Block]:
    """The blocks of a report.

    Parameters
    ----------
    report : Report
    texts : Texts
    letters : Letters
        For names in drawings.
    company : str, optional
        Of the first page.
    logo : path of a picture, optional

    Returns
    -------
    list of Block
        The first heading is that of the report.
    """
    certificate = certificate_blocks(report, texts, letters, company, logo)
    blocks = [*certificate]
    only_peaks = has_only_peaks(report)
    overview = summary_blocks(report, texts, letters)
    if len(report.points) > MAX_ROWS:  # their table has no room on the first page, the map has
        blocks += [*overview, Heading(texts["points"]), points_table(report, texts)]
    elif len(report.points) > 1:
        blocks += [on_new_page(overview[0]), *overview[1:]]
    else:
        blocks += overview
    if len(report.points) > MAX_POINTS_WITH_CURVES:
        blocks += curve_blocks(report, texts, letters)
    blocks += lot_blocks(report, texts)
    blocks += warning_blocks(report, texts)
    if not only_peaks or any(point.progress.value is not None for point in report.points):
        blocks.append(Paragraph(texts["uncertainty_note"], "note"))
    if not only_peaks:
        blocks.append(Paragraph(f"{texts['traces_note']} {texts['compaction_note']}", "note"))
    if any(basin_of_drop(drop) is not None for point in report.points for drop in point.drops):
        blocks += [Heading(texts["basin"], 3), Paragraph(texts["basin_note"], "note")]
    if texts.code not in ("en", *texts.with_messages):
        blocks.append(Paragraph(texts["messages_note"], "note"))
    common = common_warnings(report)
    keep = {texts[name] for name in _AS_THEY_ARE}
    # Names of documents (TP BF-StB part B 8.3) have dots that are no decimal signs.
    keep |= {block.text for block in certificate if isinstance(block, Paragraph)}
    pages = [
        Together((*point_blocks(p, report, texts, common), *photo_blocks(p, report.survey, texts)))
        for p in report.points
    ]
    names = names_of(report)
    found = localised(blocks, texts, keep, names)
    found += procedure_blocks(report.procedure, texts) if report.chosen else []
    found += device_blocks(report, texts)
    return [*found, *localised(pages, texts, keep, names), *_recompute(report, texts)]


_AS_THEY_ARE = ("survey", "made", "software", "judged_by", "position", "period", "photos")
"""Labels of what has dots that are no decimal signs."""


def on_new_page(heading: Block) -> Block:
    """A heading at the beginning of a page."""
    return dataclasses.replace(heading, new_page=True) if isinstance(heading, Heading) else heading


def _declared(report: Report, texts: Texts) -> list[Block]:
    """What was declared: what all points share once, then what they have of their own."""
    said = [(point.shown_name, _said(point)) for point in report.points]
    first = said[0][1] if said else {}
    shared = {k: v for k, v in first.items() if all(o.get(k, _ABSENT) == v for _, o in said)}
    points: dict[str, list[str]] = {}
    for name, values in said:
        own = {key: value for key, value in values.items() if key not in shared}
        points.setdefault(_text(own), []).append(name)
    blocks: list[Block] = [Code(_text(shared))] if shared else []
    lines = [f"{', '.join(names)}: {text}" for text, names in points.items() if text != "{}"]
    return [*blocks, Code("\n".join(lines))] if lines else blocks


_ABSENT = object()


def _said(point: PointView) -> dict[str, Any]:
    """The keys of a point; the remarks of its import are among the warnings."""
    said = {key: v for key, v in declared_values(point.setup).items() if key != "point"}
    noted = said.pop(IMPORTED, None)
    if isinstance(noted, Mapping):
        said |= {f"{IMPORTED}.{key}": v for key, v in noted.items() if key != "remarks"}
    elif noted is not None:
        said[IMPORTED] = noted
    return said


def _text(said: Mapping[str, Any]) -> str:
    return json.dumps(said, ensure_ascii=False, default=str, sort_keys=True)


def _recompute(report: Report, texts: Texts) -> list[Block]:
    settings = ", ".join(f"{key} {value}" for key, value in report.settings.items())
    rows = (
        (texts["command"], report.command),
        (texts["survey"], f"{report.survey}, {report.survey_id}"),
        (texts["software"], ", ".join(f"{n} {v}" for n, v in report.software.items())),
        (texts["settings"], "" if has_only_peaks(report) else settings),
    )
    blocks: list[Block] = [
        Heading(texts["recompute"]),
        Paragraph(texts["recompute_note"], "note"),
        Pairs(tuple(row for row in rows if row[1])),
    ]
    blocks += [Heading(texts["declared"], 3), *_declared(report, texts)]
    files = [
        (point.shown_name, str(drop.number), f"drop-{drop.record:06d}.h5", checksum)
        for point in report.points
        for drop in point.drops
        if drop.record is not None and (checksum := report.checksums.get(drop.record))
    ]
    if files:
        columns = (texts["point"], texts["drop"], texts["file"], texts["checksum"])
        blocks.append(Table(columns, tuple(files), (1,)))
    values = _values_of_averaged_drops(report)
    if values:
        blocks += [Heading(texts["result_values"], 3), Code("\n".join(values))]
    if report.chosen and report.procedure.file is not None:
        blocks += [Heading(texts["procedure"], 3), Code(report.procedure.text)]
    return blocks


def _values_of_averaged_drops(report: Report) -> list[str]:
    """Return a line for each averaged drop with the values of its result."""
    return [
        f"{point.shown_name}, {drop.number}: {result_values(drop.result)}"
        for point in report.points
        for drop in point.drops
        if drop.number in point.progress.used and drop.result is not None
    ]


def result_values(result: DropResult) -> str:
    """Return the numbers of a result under their JSON keys, SI units, in one line."""
    written = result.to_json()
    texts = []
    for field in stored_fields(InversionResult):
        value = written.get(field.name)
        if is_number(value):
            texts.append(f"{field.name} {value:.6g}")
        elif isinstance(value, list) and value and all(map(is_number, value)):
            ends = " ".join(f"{end:.6g}" for end in value)
            texts.append(f"{field.name} [{ends}]")
    return ", ".join(texts)
