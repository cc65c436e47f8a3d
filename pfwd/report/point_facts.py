"""Facts of a point that several parts of a report have."""

import datetime
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from inversion.notices import RANGE_DASH, Notice, without_drops
from pfwd.analysis.results import DiagnosisResult
from pfwd.facts import fact_of_modulus
from pfwd.files.header import IMPORTED, declared_values
from pfwd.judging import DropView, PointView
from pfwd.judging.stations import chainage_of_point
from pfwd.message_groups import MessageGroup, as_ranges, group_messages, ranges_of
from pfwd.procedures import Kind, PointDrop, Quantity, Verdict
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Listing, Mark, Paragraph
from pfwd.report.content import Report
from pfwd.report.formatting import Column, number, symbol_title
from pfwd.report.texts import Texts


def verdict_columns(report: Report, texts: Texts) -> tuple[Column, Column]:
    """Return the columns with the target and the verdict of each point."""
    quantity = report.procedure.quantity
    targets = [formatting.target_of(p.progress.target, quantity, texts) for p in report.points]
    verdicts = [verdict_mark(point, texts) for point in report.points]
    return (
        Column(texts["target"], targets, right=False, always=True),
        Column(texts["verdict"], verdicts, right=False),
    )


def drop_columns(drops: Sequence[PointDrop], texts: Texts) -> tuple[Column, ...]:
    """Return the columns with load, deflection and duration of the pulse of drops."""
    return (
        Column(symbol_title("F", "kN"), [number("load", drop.peak_load, texts) for drop in drops]),
        Column(
            symbol_title("s", "mm"),
            [number("settlement", drop.peak_deflection, texts) for drop in drops],
        ),
        Column(
            f"{texts['pulse']}, ms",
            [number("duration", drop.pulse_duration, texts) for drop in drops],
        ),
    )


def verdict_mark(point: PointView, texts: Texts) -> Mark:
    """Return the verdict of a point as a mark in a cell."""
    kind = verdict_of(point)
    return Mark(kind, texts["discarded"] if point.discarded else texts[kind])


def verdict_of(point: PointView) -> str:
    """Return the verdict of a point as a key of the marks; a discarded point has none."""
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def diagnosis_of(point: PointView) -> DiagnosisResult | None:
    """Return the diagnosis that a report shows; None: none is in force, or it is discarded."""
    return None if point.discarded else point.diagnosis_in_force


def used_drops(point: PointView) -> list[DropView]:
    """Return the averaged drops."""
    return [drop for drop in point.drops if drop.number in point.progress.used]


def shown_drops(point: PointView) -> list[DropView]:
    """Return the averaged drops; where none is averaged, those that took part."""
    excluded = (Kind.REJECTED, Kind.DISCARDED)
    return used_drops(point) or [
        drop
        for drop, facts in zip(point.drops, point.facts, strict=True)
        if facts.kind not in excluded
    ]


def time_of(point: PointView) -> str:
    """Return the time of the first averaged drop, ISO 8601; else the time that its file states."""
    for drop in (*used_drops(point), *point.drops):
        if time := local_time(drop):
            return time
    noted = point.setup.extra.get(IMPORTED)
    stated = noted.get("time_local") if isinstance(noted, Mapping) else None
    return stated.replace("T", " ") if isinstance(stated, str) else ""


def local_time(drop: DropView) -> str:
    """Return the recorded time of a drop, ISO 8601 with its zone; empty: not recorded."""
    for key in ("time_local", "time_utc"):
        text = drop.metadata.get(key)
        if isinstance(text, str) and text:
            try:
                time = datetime.datetime.fromisoformat(text)
            except ValueError:
                continue
            return time.isoformat(sep=" ", timespec="seconds")
    return ""


def clock_and_zone(point: PointView, texts: Texts) -> tuple[str, str]:
    """Return the time of a point by the clock of its place, and the name of the time zone.

    A time that is recorded in UTC is converted to the zone that the job declares. Both texts are
    empty where no time is known.
    """
    text = time_of(point)
    if not text:
        return "", ""
    try:
        time = datetime.datetime.fromisoformat(text)
    except ValueError:
        return text, texts["zone_not_declared"]
    zone = point.job.time_zone
    if time.tzinfo is None and zone is None:
        return text, texts["zone_not_declared"]
    if zone is not None:
        local_zone = datetime.datetime.fromisoformat(f"2000-01-01T00:00{zone}").tzinfo
        if time.tzinfo is None:
            time = time.replace(tzinfo=local_zone)
        elif not time.utcoffset():
            time = time.astimezone(local_zone)
    return f"{time:%Y-%m-%d %H:%M:%S}", str(time.tzname())


def time_with_zone(point: PointView, texts: Texts) -> str:
    """Return the time of a point with its time zone in one text; empty: unknown."""
    return " ".join(filter(None, clock_and_zone(point, texts)))


def target_notes(report: Report, texts: Texts) -> list[Block]:
    """Return the notes on targets that were changed after the drops, or replaced by a slip."""
    quantity = report.procedure.quantity
    notes: dict[str, list[str]] = {}
    for point in report.points:
        if point.name in report.target_changes:
            time, before = report.target_changes[point.name]
            moment = f"{time[:MINUTE_LENGTH].replace('T', ' ')} UTC"
            target = formatting.target_of(before, quantity, texts)
            note = texts.say("target_changed", time=moment, target=target)
            notes.setdefault(note, []).append(point.shown_name)
    if report.replaced_target is not None:
        target = formatting.target_of(report.replaced_target, quantity, texts)
        notes[texts.say("target_of_slip", target=target)] = [report.points[0].shown_name]
    return [
        Paragraph(f"{', '.join(dict.fromkeys(names))}: {note}", "small warning")
        for note, names in notes.items()
    ]


def names_text(values: Iterable[object]) -> str:
    """Return the different values as a text, sorted; empty: there is none."""
    return ", ".join(sorted({str(value) for value in values if value is not None}))


def is_response_declared(report: Report) -> bool:
    """Return whether a response of a sensor is declared, which is then taken out of deflections."""
    setups = [drop.setup for point in report.points for drop in point.drops]
    return any(setup.geophone_natural_frequency for setup in setups)


def chainage_column(report: Report, texts: Texts) -> tuple[str, list[str]]:
    """Return the title of the column of chainages, and the chainage of each point in m."""
    chainages = [
        chainage_of_point(
            point.shown_name,
            point.job.station(point.shown_name),
            [declared_values(point.setup)],
        )
        for point in report.points
    ]
    cells = [
        formatting.NO_VALUE if c is None else texts.decimals(f"{round(c, 2):.10g}")
        for c in chainages
    ]
    return symbol_title(texts["chainage"], "m"), cells


MINUTE_LENGTH = len("2026-01-31 14:05")
"""Number of characters of a time to the minute."""


def time_cells(report: Report, texts: Texts) -> tuple[str, list[str]]:
    """Return the title of a column of times, and the time of each point to the minute.

    The title names the time zone where all points have the same one.
    """
    times = [clock_and_zone(point, texts) for point in report.points]
    zones = {zone for time, zone in times if time}
    if len(zones) == 1:
        return f"{texts['time']}, {zones.pop()}", [time[:MINUTE_LENGTH] for time, _ in times]
    return texts["time"], [f"{time[:MINUTE_LENGTH]} {zone}".strip() for time, zone in times]


def modulus_text(point: PointView, texts: Texts) -> str:
    """Return the modulus in force of the point, marked if the data do not support it."""
    return _fitted_text(point, Quantity.MODULUS, texts)


def equivalent_text(point: PointView, texts: Texts) -> str:
    """Return the equivalent modulus of the point, from the source of its modulus in force."""
    return _fitted_text(point, Quantity.EQUIVALENT_MODULUS, texts)


def _fitted_text(point: PointView, quantity: Quantity, texts: Texts) -> str:
    return formatting.show(fact_of_modulus(point.progress.modulus, quantity), texts)


def diagnosis_counts(point: PointView) -> bool:
    """Return whether the modulus of the point is that of its diagnosis."""
    return point.counting_diagnosis is not None


def all_warnings(point: PointView) -> list[Notice]:
    """Return the warnings about a point and its drops, each once.

    Warnings of fits are not among them where the diagnosis counts in their place: they would
    contradict it.
    """
    messages = [*point.warnings, *point.progress.faults, *point.progress.notes]
    for drop in point.drops:
        screened = () if drop.screening is None else drop.screening.warnings
        messages += [*drop.marks, *(screened if diagnosis_counts(point) else drop.warnings)]
    return list(dict.fromkeys(messages))


@dataclass(frozen=True, slots=True)
class PointMessages:
    """Messages of one meaning, with the points and drops that they are about."""

    group: MessageGroup[str]
    """The message without the numbers of drops before it; its places are keys of points."""
    drops: Mapping[str, tuple[str, ...]]
    """Numbers of the drops by the key of the point, where the message names any."""


def group_point_messages(messages: Iterable[tuple[str, Notice]]) -> list[PointMessages]:
    """Group messages by their meaning, whatever drops they name.

    Parameters
    ----------
    messages : iterable of (key of the point, message)

    Examples
    --------
    >>> from inversion.notices import Notice, of_drops
    >>> lost = Notice("no-pulse", {"change_n": 5.0})
    >>> (item,) = group_point_messages([("A", of_drops(lost, 1, 2)), ("B", of_drops(lost, 3))])
    >>> item.group.text, item.group.places, dict(item.drops)
    ('no pulse: the load changes by 5 N at most', ('A', 'B'), {'A': ('1', '2'), 'B': ('3',)})
    """
    by_rest: list[tuple[str, Notice]] = []
    numbers: list[tuple[str, Notice, tuple[str, ...]]] = []
    for place, message in messages:
        rest, listed = without_drops(message)
        by_rest.append((place, rest))
        if listed:
            numbers.append((place, rest, tuple(map(str, listed))))
    drops: dict[Hashable, dict[str, tuple[str, ...]]] = {}
    for place, rest, of_place in numbers:
        (group,) = group_messages([(place, rest)])
        of_key = drops.setdefault(group.key, {})
        of_key[place] = tuple(dict.fromkeys((*of_key.get(place, ()), *of_place)))
    return [PointMessages(group, drops.get(group.key, {})) for group in group_messages(by_rest)]


def remarks_of(point: PointView, texts: Texts, common: Collection[Hashable]) -> list[Block]:
    """Return the warnings of a point that not all points share, and the notes of its drops.

    Parameters
    ----------
    point : PointView
    texts : Texts
    common : collection
        Keys of messages that hold for all points.
    """
    order = [str(drop.number) for drop in point.drops]
    messages = group_point_messages((point.shown_name, text) for text in all_warnings(point))
    warnings = [
        texts.message(item.group.message)
        if not numbers
        else f"{drops_text(numbers, order, texts)}: {texts.message(item.group.message)}"
        for item in messages
        if item.group.key not in common
        for numbers in [item.drops.get(point.shown_name, ())]
    ]
    blocks: list[Block] = []
    if warnings:
        blocks.append(Paragraph("; ".join(warnings), "small warning"))
    drop_notes = [f"{texts['drop']} {d.number}: {note}" for d in point.drops for note in d.notes]
    if drop_notes:
        blocks += [Heading(texts["notes"], 3), Listing(tuple(drop_notes))]
    return blocks


def drops_text(numbers: Collection[str], order: Sequence[str], texts: Texts) -> str:
    """Return the numbers of drops as ranges, after the word for them."""
    ranges = as_ranges(numbers, order, RANGE_DASH)
    return f"{texts['drop' if len(numbers) == 1 else 'drops']} {ranges}"


MAX_LISTED_RANGES = 6
"""Number of point names and ranges that a message lists; of more it gives the count."""


def points_text(
    places: Sequence[str], order: Sequence[str], names: Mapping[str, str], texts: Texts
) -> str:
    """Return the points that a message applies to, as a text: all, ranges, or their count.

    Parameters
    ----------
    places : sequence of str
        Keys of the points.
    order : sequence of str
        Keys of all points of the report.
    names : mapping of key to name
    texts : Texts
    """
    if len(places) == len(order) > 1:
        return texts.say("all_points", count=len(order))
    ranges = ranges_of(places, order)
    if len(ranges) > MAX_LISTED_RANGES:
        return texts.say("some_points", count=len(places), all=len(order))
    listed = ", ".join(f" {RANGE_DASH} ".join(names[end] for end in ends) for ends in ranges)
    key = "point_named" if len(places) == 1 else "points_named"
    return texts.say(key, count=len(places), names=listed)
