"""Content of a survey while it is measured, updated by the events of the session.

The session applies its events and publishes each new view as `SurveyChanged`; screen and command
line draw that view. Points that the survey had before arrive as `PointReported`. In a replay their
drops do not count until they are replayed.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from pfwd.analysis.result_store import rests_on
from pfwd.files.editing import discard_reason
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
    PointBegan,
    PointDiagnosed,
    PointReported,
    Rebounded,
    SessionEvent,
    SurveyChanged,
    SurveyRead,
)


def apply_event(view: SurveyView, event: SessionEvent) -> SurveyChanged | None:
    """Return the survey as an event changes it; None: the event does not change it."""
    name: str | None
    match event:
        case JobReported(job):
            return SurveyChanged(view.with_job(job), None, event)
        case SurveyRead(stored):
            merged = with_stored(view, stored).points
            points = {**{point.name: merged[point.name] for point in stored}, **merged}
            return SurveyChanged(replace(view, points=points), None, event)
        case PointReported(point):
            changed = with_stored(view, [point], is_replayed=event.is_replayed)
            return SurveyChanged(changed, point.name, event)
        case PointBegan(name):
            if name in view.points:
                return None
            point = PointView(name)
        case DropSaved(saved):
            point = _with_drop(_point_of(view, saved.point), event)
        case DropAnalysed(saved):
            point = _with_analysis(_point_of(view, saved.point), event)
        case Rebounded(name, number):
            point = _with_changed_drop(
                _point_of(view, name),
                number,
                lambda drop: replace(drop, rebounds=(*drop.rebounds, event.peak_load)),
            )
        case PointDiagnosed(name, diagnosis):
            point = replace(_point_of(view, name), diagnosis=diagnosis)
        case DiagnosisAwaited(name, awaited):
            point = replace(_point_of(view, name), awaits_diagnosis=awaited)
        case Edited(point=str(name)):
            point = _with_edit(_point_of(view, name), event)
        case Edited(number=int(record)):
            owner = point_of_record(view, record)
            if owner is None:
                return None
            point = _with_edited_drop(owner, event)
        case _:
            return None
    return SurveyChanged(view.with_points([point]), point.name, event)


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
    return replace(drop, discarded=stored.discarded)


def _point_of(view: SurveyView, name: str) -> PointView:
    return view.points.get(name) or PointView(name)


def _sorted(drops: Mapping[int, DropView]) -> tuple[DropView, ...]:
    return tuple(drops[number] for number in sorted(drops))


def _with_drop(point: PointView, event: DropSaved) -> PointView:
    saved = event.saved
    drop = _stored_drop(point, saved.number) or saved.view
    drop = replace(drop, awaits_result=saved.view.awaits_result, identical=event.identical)
    drops = {drop.number: drop for drop in point.drops} | {saved.number: drop}
    received = saved.view.metadata.get("position")
    place = received if point.place is None and place_in(received) is not None else point.place
    return replace(point, drops=_sorted(drops), place=place)


def _stored_drop(point: PointView, number: int) -> DropView | None:
    return next((drop for drop in point.replayed if drop.number == number), None)


def _with_analysis(point: PointView, event: DropAnalysed) -> PointView:
    number, result = event.saved.number, event.result
    stored = _stored_drop(point, number)
    # A replayed drop keeps the result that is stored in the survey.
    has_stored_result = stored is not None and stored.facts.modulus is not None

    def analysed(drop: DropView) -> DropView:
        drop = replace(drop, awaits_result=drop.awaits_result and not event.final)
        if has_stored_result or result.is_trial:
            return drop
        if result.has_ground and rests_on(result, drop.setup):
            return drop.with_result(result)
        return drop if drop.last_result is not None else replace(drop, last_result=result)

    return _with_changed_drop(point, number, analysed)


def _with_changed_drop(
    point: PointView, number: int, change: Callable[[DropView], DropView]
) -> PointView:
    drops = tuple(change(drop) if drop.number == number else drop for drop in point.drops)
    return replace(point, drops=drops)


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


def point_of_record(view: SurveyView, record: int) -> PointView | None:
    """Return the point of a drop by its number within the survey; None: there is none."""
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
            return {"discarded": None}
        case "discard":
            return {"discarded": discard_reason(event.value)}
        case "note":
            return {"notes": (*drop.notes, str(event.value))}
        case _ if event.what == RATE_DEVIATION:
            return {"metadata": {**drop.metadata, RATE_DEVIATION: event.value}}
    return {}


class CompletePoints:
    """Reports points when they are complete and when their verdicts change.

    A point is complete when it has the drops that the procedure requires, and no result of them is
    awaited. A point whose verdict is on a fitted modulus is reported after its diagnosis. A point
    that is no longer complete is reported again. If only its value changes, it is reported at the
    end of the session.

    Parameters
    ----------
    report : callable
        Receives the point.
    """

    def __init__(self, report: Callable[[PointView], None]) -> None:
        self._report = report
        self._view = SurveyView()
        self._reported: dict[str, PointProgress] = {}

    def take(self, change: SurveyChanged) -> None:
        """Take a change of the survey."""
        self._view = change.view
        if isinstance(change.cause, JobReported):
            for name in tuple(self._reported):
                self._report_if_changed(name)
        elif change.point is not None and not isinstance(change.cause, PointReported):
            self._report_if_changed(change.point)

    def rest(self) -> None:
        """Report the remaining points at the end of the session, without waiting for results."""
        for name in self._view.points:
            self._report_if_changed(name, last=True)

    def _report_if_changed(self, name: str, *, last: bool = False) -> None:
        point = self._view.points[name]
        progress, before = point.progress, self._reported.get(name)
        if not (progress.complete or before):
            return
        awaits_result = any(drop.awaits_result for drop in point.drops)
        if (awaits_result or point.is_verdict_pending) and not last:
            return
        changed = before is None or _verdict(before) != _verdict(progress)
        if changed or (last and before is not None and before.value != progress.value):
            self._reported[name] = progress
            self._report(point)


def _verdict(progress: PointProgress) -> tuple[object, ...]:
    return progress.complete, progress.verdict, progress.target
