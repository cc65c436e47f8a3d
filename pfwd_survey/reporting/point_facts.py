"""What several parts of a report say of a point."""

from collections.abc import Mapping

from pfwd_survey.files.header import IMPORTED
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.procedures import Verdict
from pfwd_survey.reporting import shown
from pfwd_survey.reporting.content import ReportDrop, ReportPoint
from pfwd_survey.reporting.texts import Texts


def verdict_of(point: ReportPoint) -> str:
    """Kind of a point's mark; a discarded point has no verdict."""
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def used_drops(point: ReportPoint) -> list[ReportDrop]:
    """The drops that are averaged."""
    return [drop for drop in point.drops if drop.number in point.progress.used]


def time_of(point: ReportPoint) -> str:
    """When the first averaged drop fell, by the clock of the place; empty: nobody said."""
    for drop in (*used_drops(point), *point.drops):
        if drop.time_local:
            return drop.time_local
    noted = point.setup.extra.get(IMPORTED)
    said = noted.get("time_local") if isinstance(noted, Mapping) else None
    return said.replace("T", " ") if isinstance(said, str) else ""


def first_result(point: ReportPoint) -> DropResult | None:
    """The first result with a modulus, of an averaged drop where there is one."""
    for drop in (*used_drops(point), *point.drops):
        if drop.result is not None and drop.result.modulus_pa is not None:
            return drop.result
    return None


def effective_result(point: ReportPoint) -> DropResult:
    """The first result with an effective modulus, of an averaged drop where there is one."""
    for drop in (*used_drops(point), *point.drops):
        if drop.result is not None and drop.result.effective_modulus_pa is not None:
            return drop.result
    return DropResult()


def modulus_text(point: ReportPoint, texts: Texts) -> str:
    """The modulus of the point that counts, marked where the data do not support it."""
    modulus = point.progress.modulus
    if modulus is None:
        return shown.NOTHING
    ends = None if modulus.interval is None else [end / 1e6 for end in modulus.interval]
    return shown.with_interval(
        modulus.value / 1e6, ends, "MPa", texts, marked=modulus.not_supported is not None
    )


def all_warnings(point: ReportPoint) -> list[str]:
    """What is said of the point and of its drops, each sentence once."""
    found = [*point.warnings, *point.progress.faults, *point.progress.notes]
    for drop in point.drops:
        found += [*drop.marks, *drop.warnings]
    return list(dict.fromkeys(found))
