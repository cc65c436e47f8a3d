"""The content of a report in its order: the same blocks for HTML and for PDF."""

import os

from pfwd.report.blocks import (
    Block,
    Heading,
    Paragraph,
    Together,
)
from pfwd.report.certificate_blocks import (
    MAX_POINTS_WITH_CURVES,
    MAX_ROWS,
    certificate_blocks,
    curve_blocks,
    points_blocks,
)
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.lot_blocks import lot_blocks
from pfwd.report.peaks_blocks import basin_of_drop, has_only_peaks, has_only_stiffness
from pfwd.report.point_blocks import photo_blocks, point_blocks
from pfwd.report.point_facts import is_response_declared
from pfwd.report.provenance_blocks import device_blocks, procedure_blocks, recompute_blocks
from pfwd.report.summary_blocks import common_warnings, summary_blocks, warning_blocks
from pfwd.report.texts import Texts


def compose(
    report: Report,
    texts: Texts,
    letters: Letters,
    company: str | None = None,
    logo: str | os.PathLike[str] | None = None,
) -> list[Block]:
    """Return the blocks of a report.

    Parameters
    ----------
    report : Report
    texts : Texts
    letters : Letters
        Widths of names in drawings.
    company : str, optional
        Name on the first page.
    logo : path of a picture, optional

    Returns
    -------
    list of Block
        The first heading is that of the report.
    """
    blocks = certificate_blocks(report, texts, letters, company, logo)
    only_peaks = has_only_peaks(report)
    overview = summary_blocks(report, texts, letters)
    if len(report.points) > MAX_ROWS:  # their table has no room on the first page, the map has
        blocks += [*overview, Heading(texts["points"]), *points_blocks(report, texts)]
    else:
        blocks += overview
    if len(report.points) > MAX_POINTS_WITH_CURVES:
        blocks += curve_blocks(report, texts, letters)
    blocks += lot_blocks(report, texts)
    blocks += warning_blocks(report, texts)
    inverted = not only_peaks and not has_only_stiffness(report)
    if inverted or any(point.progress.value is not None for point in report.points):
        blocks.append(Paragraph(texts["uncertainty_note"], "note"))
    if inverted:
        corrected = f" {texts['compaction_note']}" if is_response_declared(report) else ""
        blocks.append(Paragraph(texts["traces_note"] + corrected, "note"))
    if any(basin_of_drop(drop) is not None for point in report.points for drop in point.drops):
        blocks += [Heading(texts["basin"], 3), Paragraph(texts["basin_note"], "note")]
    if texts.code not in ("en", *texts.with_messages):
        blocks.append(Paragraph(texts["messages_note"], "note"))
    common = common_warnings(report)
    pages = [
        Together((*point_blocks(p, report, texts, common), *photo_blocks(p, report.survey, texts)))
        for p in report.points
    ]
    blocks += procedure_blocks(report.procedure, texts) if report.chosen else []
    blocks += device_blocks(report, texts)
    return [*blocks, *pages, *recompute_blocks(report, texts)]
