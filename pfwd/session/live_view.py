"""Content of a survey while it is measured, updated by the events of the session.

Screen and command line apply the same events. Points that the survey had before arrive as
`PointReported`. In a replay their drops do not count until they are replayed.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from pfwd.analysis.result_store import rests_on
from pfwd.files.moving import moved_to
from pfwd.judging import DropView, PointView, SurveyView
from pfwd.judging.drops import RATE_DEVIATION
from pfwd.judging.places import place_in
from pfwd.procedures import PointProgress
from pfwd.session.events import (
    DiagnosisAwaited,
    DropAnalysed,
    DropSaved,
    Edited,
    JobReported,
    PointDiagnosed,
    PointReported,
    SavedDrop,
    SessionEvent,
)


def apply_event(view: SurveyView, event: SessionEvent) -> tuple[SurveyView, str | None]:
    """Return the survey after an event, and the name of the point that the event concerns.

    Returns
    -------
    view : SurveyView
    name : str or None
        None: the event concerns no point.
    """
    match event:
        case JobReported(job):
            return view.with_job(job), None
        case PointReported(stored):
            return with_stored(view, [stored], is_replayed=event.is_replayed), stored.name
        case DropSaved(saved):
            point = _with_drop(_point_of(view, saved.point), saved)
        case DropAnalysed():
            point = _with_analysis(_point_of(view, event.saved.point), event)
        case PointDiagnosed(name, diagnosis):
            point = replace(_point_of(view, name), diagnosis=diagnosis)
        case DiagnosisAwaited(name, awaited):
            point = replace(_point_of(view, name), awaits_diagnosis=awaited)
        case Edited(point=str(name)):
            point = _with_edit(_point_of(view, name), event)
        case Edited(number=int(record)):
            owner = _owner_of(view, record)
            if owner is None:
                return view, None
            point = _with_edited_drop(owner, event)
        case _:
            return view, None
    return view.with_points([point]), point.name


def with_stored(
    view: SurveyView, points: Iterable[PointView], *, is_replayed: bool = False
) -> SurveyView:
    """Return the survey with stored points added, together with the drops measured since.

    Parameters
    ----------
    view : SurveyView
    points : iterable of PointView
    is_replayed : bool
        True: the stored drops do not count yet, because they are replayed one by one.
    """

    def merged(stored: PointView) -> PointView:
        present = view.points.get(stored.name)
        newer = () if present is None else present.drops
        awaited = present is not None and present.awaits_diagnosis
        stored = replace(stored, awaits_diagnosis=awaited)
        drops = {drop.number: drop for drop in stored.drops}
        if is_replayed:
            repeated = tuple(drops.get(drop.number, drop) for drop in newer)
            return replace(stored, drops=repeated, replayed=stored.drops)
        for drop in newer:
            drops[drop.number] = _with_edits(drop, drops.get(drop.number))
        return replace(stored, drops=_sorted(drops))

    return view.with_points(map(merged, points))


def _with_edits(drop: DropView, stored: DropView | None) -> DropView:
    """Return a drop of this session with the discard or move that an edit in the survey made."""
    if stored is None or drop.discarded is not None:
        return drop
    return replace(drop, discarded=stored.discarded, moved_to=stored.moved_to)


def _point_of(view: SurveyView, name: str) -> PointView:
    return view.points.get(name) or PointView(name)


def _sorted(drops: Mapping[int, DropView]) -> tuple[DropView, ...]:
    return tuple(drops[number] for number in sorted(drops))


def _with_drop(point: PointView, saved: SavedDrop) -> PointView:
    drop = _stored_drop(point, saved.number) or saved.view
    drops = {drop.number: drop for drop in point.drops} | {saved.number: drop}
    received = saved.view.metadata.get("position")
    place = received if point.place is None and place_in(received) is not None else point.place
    return replace(point, drops=_sorted(drops), place=place)


def _stored_drop(point: PointView, number: int) -> DropView | None:
    return next((drop for drop in point.replayed if drop.number == number), None)


def _with_analysis(point: PointView, event: DropAnalysed) -> PointView:
    number, result = event.saved.number, event.result
    stored, drop = _stored_drop(point, number), point.drop(number)
    if drop is None or (stored is not None and stored.facts.modulus is not None):
        return point  # a replayed drop keeps the result that is stored in the survey
    if result.is_trial or not result.has_ground or not rests_on(result, drop.setup):
        return point
    drops = {drop.number: drop for drop in point.drops} | {number: drop.with_result(result)}
    return replace(point, drops=_sorted(drops))


def _with_edit(point: PointView, event: Edited) -> PointView:
    value = event.value
    match event.what:
        case "target":
            target = float(value) if isinstance(value, int | float) else None
            return replace(point, target=target)
        case "discard" | "restore":
            return replace(point, discarded=event.what == "discard")
        case "name":
            return replace(point, title=str(value))
        case "note":
            return replace(point, notes=(*point.notes, str(value)))
        case "position":
            place = None if place_in(value) is None else {**value, "source": "edited"}
            return replace(point, place=place)
    return point


def _owner_of(view: SurveyView, record: int) -> PointView | None:
    for point in view.points.values():
        if any(drop.record == record for drop in (*point.drops, *point.replayed)):
            return point
    return None


def _with_edited_drop(point: PointView, event: Edited) -> PointView:
    def edited(drop: DropView) -> DropView:
        if drop.record != event.number:
            return drop
        return replace(drop, **_changes(drop, event))

    return replace(
        point,
        drops=tuple(map(edited, point.drops)),
        replayed=tuple(map(edited, point.replayed)),
    )


def _changes(drop: DropView, event: Edited) -> dict[str, Any]:
    """Return the new values of the fields of a drop that an edit changes."""
    match event.what:
        case "restore":
            return {"discarded": None, "moved_to": None}
        case "discard":
            moved = moved_to(event.value)
            return {"discarded": moved or str(event.value or ""), "moved_to": moved}
        case "note":
            return {"notes": (*drop.notes, str(event.value))}
        case _ if event.what == RATE_DEVIATION:
            return {"metadata": {**drop.metadata, RATE_DEVIATION: event.value}}
    return {}


class CompletePoints:
    """Reports points when they are complete and when their verdicts change.

    A point is complete when it has the drops that the procedure requires. A point whose verdict is
    on a fitted modulus is reported after its diagnosis. A point that is no longer complete is
    reported again. If only its value changes, it is reported at the end of the session.

    Parameters
    ----------
    report : callable
        Receives the point.
    analysed : bool
        True: drops are inverted, and a point waits for the results of its drops.
    """

    def __init__(self, report: Callable[[PointView], None], *, analysed: bool) -> None:
        self._report = report
        self._analysed = analysed
        self.view = SurveyView()
        """Content of the survey after the events so far."""
        self._reported: dict[str, PointProgress] = {}
        self._waiting: dict[str, set[int]] = {}

    def take(self, event: SessionEvent) -> None:
        """Apply an event of the session."""
        self.view, name = apply_event(self.view, event)
        if isinstance(event, DropAnalysed) and event.final:
            self._waiting.get(event.saved.point, set()).discard(event.saved.number)
        if isinstance(event, DropSaved) and self._analysed:
            waiting = self._waiting.setdefault(event.saved.point, set())
            if event.saved.screening.status != "rejected":
                waiting.add(event.saved.number)
        if isinstance(event, JobReported):
            for reported in self._reported:
                self._report_if_changed(reported)
        elif name is not None and not isinstance(event, PointReported):
            self._report_if_changed(name)

    def rest(self) -> None:
        """Report the remaining points at the end of the session, without waiting for results."""
        self._waiting.clear()
        for name in self.view.points:
            self._report_if_changed(name, last=True)

    def _report_if_changed(self, name: str, *, last: bool = False) -> None:
        point = self.view.points[name]
        progress, before = point.progress, self._reported.get(name)
        if self._waiting.get(name) or not (progress.complete or before):
            return
        if point.is_verdict_pending and not last:
            return
        changed = before is None or _verdict(before) != _verdict(progress)
        if changed or (last and before is not None and before.value != progress.value):
            self._reported[name] = progress
            self._report(point)


def _verdict(progress: PointProgress) -> tuple[object, ...]:
    return progress.complete, progress.verdict, progress.target
