"""What a report says, in which order: the same blocks for HTML and for PDF."""

import json

from pfwd_survey.files.header import declared_values
from pfwd_survey.reporting.blocks import Block, Code, Heading, Pairs, Paragraph, Table
from pfwd_survey.reporting.content import Report
from pfwd_survey.reporting.device_blocks import device_blocks
from pfwd_survey.reporting.fonts import Letters
from pfwd_survey.reporting.point_blocks import point_blocks
from pfwd_survey.reporting.procedure_blocks import procedure_blocks
from pfwd_survey.reporting.summary_blocks import points_table, summary_blocks
from pfwd_survey.reporting.texts import Texts


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
    blocks += summary_blocks(report, texts, letters)
    blocks += points_table(report, texts)
    blocks.append(Paragraph(texts["uncertainty_note"], "note"))
    if texts.code != "en":
        blocks.append(Paragraph(texts["messages_note"], "note"))
    blocks += procedure_blocks(report.procedure, texts) if report.chosen else []
    blocks += device_blocks(report, texts)
    for point in report.points:
        blocks += point_blocks(point, report, texts)
    blocks += _recompute(report, texts)
    return blocks


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
