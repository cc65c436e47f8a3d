"""What several parts of a report say of a point."""

import datetime
from collections.abc import Mapping

from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.files.header import IMPORTED
from pfwd.judging import DropView, PointView
from pfwd.procedures import Verdict
from pfwd.report import shown
from pfwd.report.texts import Texts


def verdict_of(point: PointView) -> str:
    """Kind of a point's mark; a discarded point has no verdict."""
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def diagnosis_of(point: PointView) -> DiagnosisResult | None:
    """Return the diagnosis that a report shows; None: none is in force, or it is discarded."""
    return None if point.discarded else point.diagnosis_in_force


def used_drops(point: PointView) -> list[DropView]:
    """The drops that are averaged."""
    return [drop for drop in point.drops if drop.number in point.progress.used]


def time_of(point: PointView) -> str:
    """When the first averaged drop fell, by the clock of the place; empty: nobody said."""
    for drop in (*used_drops(point), *point.drops):
        if time := local_time(drop):
            return time
    noted = point.setup.extra.get(IMPORTED)
    said = noted.get("time_local") if isinstance(noted, Mapping) else None
    return said.replace("T", " ") if isinstance(said, str) else ""


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


def first_result(point: PointView) -> DropResult | None:
    """The first result with a modulus, of an averaged drop where there is one."""
    for drop in (*used_drops(point), *point.drops):
        if drop.result is not None and drop.result.modulus_pa is not None:
            return drop.result
    return None


def effective_result(point: PointView) -> DropResult:
    """The first result with an effective modulus, of an averaged drop where there is one."""
    for drop in (*used_drops(point), *point.drops):
        if drop.result is not None and drop.result.effective_modulus_pa is not None:
            return drop.result
    return DropResult()


def modulus_text(point: PointView, texts: Texts) -> str:
    """The modulus of the point that counts, marked where the data do not support it."""
    modulus = point.progress.modulus
    if modulus is None:
        return shown.NOTHING
    ends = None if modulus.interval is None else [end / 1e6 for end in modulus.interval]
    return shown.with_interval(
        modulus.value / 1e6, ends, "MPa", texts, marked=modulus.not_supported is not None
    )


def all_warnings(point: PointView) -> list[str]:
    """What is said of the point and of its drops, each sentence once."""
    found = [*point.warnings, *point.progress.faults, *point.progress.notes]
    for drop in point.drops:
        found += [*drop.marks, *drop.warnings]
    return list(dict.fromkeys(found))
