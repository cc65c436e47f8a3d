"""The second part of a report: map and profile of the points, and the warnings."""

from collections.abc import Hashable
from functools import partial

from pfwd.report.blocks import (
    Block,
    Heading,
    Listing,
    Pairs,
    Paragraph,
    Picture,
)
from pfwd.report.certificate_blocks import MAX_ROWS
from pfwd.report.content import Report
from pfwd.report.drawing import draw_map, draw_profile, place
from pfwd.report.fonts import Letters
from pfwd.report.peaks_blocks import has_only_peaks, peaks_profile
from pfwd.report.point_facts import (
    MINUTE_LENGTH,
    PointMessages,
    all_warnings,
    group_point_messages,
    points_text,
)
from pfwd.report.texts import Texts


def summary_blocks(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """Return the blocks of the summary: survey, damage, sketch and profile of the points."""
    points = [point for point in report.points if not point.discarded]
    blocks: list[Block] = [
        # The table of many points has no room on the first page: the summary takes its place.
        Heading(texts["summary"], new_page=1 < len(report.points) <= MAX_ROWS),
        Pairs(tuple((label, value) for label, value in _rows(report, texts) if value)),
    ]
    if report.damage:
        blocks += [
            Heading(texts["damage"], 3),
            Listing(tuple(report.damage), "warning"),
        ]
    several = len(report.points) > 1
    if several and place(report):
        blocks.append(
            Picture(
                partial(draw_map, report=report, texts=texts, letters=letters),
                74,
                f"{texts['map']}. {texts['map_note']}",
                texts["map"],
            )
        )
    elif several:
        blocks.append(Paragraph(texts["no_positions"], "note"))
    if has_only_peaks(report):
        blocks += peaks_profile(report, texts, letters)
    if several and any(point.progress.value is not None for point in points):
        blocks.append(
            Picture(
                partial(draw_profile, report=report, texts=texts, letters=letters),
                60,
                f"{texts['profile']}. {texts['profile_note']}",
                texts["profile"],
            )
        )
    return blocks


def _rows(report: Report, texts: Texts) -> tuple[tuple[str, str], ...]:
    return (
        (texts["survey"], report.survey_name),
        (texts["made"], f"{report.made[:MINUTE_LENGTH].replace('T', ' ')} {report.zone}"),
        (texts["software"], report.software),
    )


def warning_blocks(report: Report, texts: Texts) -> list[Block]:
    """Return the warnings: each meaning once, with the number of points it holds for.

    Those of a single point stand on its page.
    """
    if len(report.points) == 1:
        return []
    blocks: list[Block] = [Heading(texts["warnings"], 3)]
    warnings = _grouped(report, texts)
    if warnings:
        blocks.append(Listing(tuple(warnings), "warning"))
    else:
        blocks.append(Paragraph(texts["no_warnings"], "note"))
    return blocks


def _grouped(report: Report, texts: Texts) -> list[str]:
    """Return each warning once, with the points and the number of drops that it holds for."""
    order = [str(number) for number in range(len(report.points))]
    names = {number: p.shown_name for number, p in zip(order, report.points, strict=True)}
    groups = _messages_by_point(report)
    lines = []
    for item in sorted(groups, key=lambda item: -len(item.group.places)):
        places = [points_text(item.group.places, order, names, texts)]
        if item.drops:
            count = sum(map(len, item.drops.values()))
            places.append(texts.say("one_drop_of" if count == 1 else "drops_of", count=count))
        lines.append(f"{texts.message(item.group.message)} ({'; '.join(places)})")
    return lines


def common_warnings(report: Report) -> set[Hashable]:
    """Return keys of the messages that hold for every point; a point's page does not repeat them.

    A message on some drops of each point is not among them.
    """
    if len(report.points) < 2:
        return set()
    return {
        item.group.key
        for item in _messages_by_point(report)
        if len(item.group.places) == len(report.points) and not item.drops
    }


def _messages_by_point(report: Report) -> list[PointMessages]:
    return group_point_messages(
        (str(number), text)
        for number, point in enumerate(report.points)
        for text in all_warnings(point)
    )
