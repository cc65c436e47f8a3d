"""The second part of a report: where the points are, what holds for all of them, what to know."""

from collections.abc import Hashable, Sequence
from functools import partial

from pfwd.message_groups import as_ranges, group_messages
from pfwd.report.blocks import (
    Block,
    Heading,
    Listing,
    Pairs,
    Paragraph,
    Picture,
)
from pfwd.report.content import Report
from pfwd.report.drawing import draw_map, draw_profile, place
from pfwd.report.fonts import Letters
from pfwd.report.point_facts import all_warnings
from pfwd.report.texts import Texts


def summary_blocks(report: Report, texts: Texts, letters: Letters) -> list[Block]:
    """Damage, map and profile."""
    kept = [point for point in report.points if not point.discarded]
    blocks: list[Block] = [
        Heading(texts["summary"]),
        Pairs(tuple((label, value) for label, value in _rows(report, texts) if value)),
    ]
    if report.damage:
        blocks += [
            Heading(texts["damage"], 3),
            Listing(tuple(report.damage), "warning"),
        ]
    if place(report):
        blocks.append(
            Picture(
                partial(draw_map, report=report, texts=texts, letters=letters),
                74,
                f"{texts['map']}. {texts['map_note']}",
                texts["map"],
            )
        )
    else:
        blocks.append(Paragraph(texts["no_positions"], "note"))
    if any(point.progress.value is not None for point in kept):
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
        (texts["survey"], report.survey),
        (texts["made"], report.made.replace("T", " ")),
        (texts["software"], ", ".join(f"{n} {v}" for n, v in report.software.items())),
    )


def warning_blocks(report: Report, texts: Texts) -> list[Block]:
    """What is to be known of the points: each meaning once, with how many it holds for."""
    blocks: list[Block] = [Heading(texts["warnings"], 3)]
    warnings = _grouped(report, texts)
    if warnings:
        blocks.append(Listing(tuple(warnings), "warning"))
    else:
        blocks.append(Paragraph(texts["no_warnings"], "note"))
    return blocks


MOST_RANGES = 6
"""Names and ranges of names that a warning lists; of more it says the count alone."""


def _grouped(report: Report, texts: Texts) -> list[str]:
    places = [(str(number), point) for number, point in enumerate(report.points)]
    said = [(number, text) for number, point in places for text in all_warnings(point)]
    names = {number: point.shown_name for number, point in places}
    order = [number for number, _ in places]
    lines = []
    for group in sorted(group_messages(said), key=lambda group: -len(group.places)):
        lines.append(f"{texts.grouped(group)} ({_where(group.places, order, names, texts)})")
    return lines


def _where(places: Sequence[str], order: Sequence[str], names: dict[str, str], texts: Texts) -> str:
    """Of which points: all, ranges of names, or how many."""
    if len(places) == len(order) > 1:
        return texts.say("all_points", count=len(order))
    ranges = as_ranges(places, order).split(", ")
    if len(ranges) > MOST_RANGES:
        return texts.say("some_points", count=len(places), all=len(order))
    said = ", ".join(" – ".join(names[end] for end in part.split(" to ")) for part in ranges)
    key = "point_named" if len(places) == 1 else "points_named"
    return texts.say(key, count=len(places), names=said)


def common_warnings(report: Report) -> set[Hashable]:
    """Keys of the messages of what holds for every point, which its own page need not say again."""
    if len(report.points) < 2:
        return set()
    said = [
        (str(number), text)
        for number, point in enumerate(report.points)
        for text in all_warnings(point)
    ]
    return {g.key for g in group_messages(said) if len(g.places) == len(report.points)}
