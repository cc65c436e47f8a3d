"""Stored points and drops of a survey as events, with traces and all results."""

import os
from dataclasses import replace

from pfwd.analysis.result_store import readable_results
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import compare, screen
from pfwd.errors import SurveyError
from pfwd.files.folders import open_for_edits, refuse_no_survey
from pfwd.judging import Job, point_view
from pfwd.judging.view import NO_SETUP
from pfwd.session.events import PointReported, SavedDrop
from pfwd_device.recording import Survey, SurveyDrop, SurveyWriter, read_survey
from pfwd_device.recording.survey_content import SurveyPoint


def stored_results(folder: str | os.PathLike[str], record: int) -> list[DropResult]:
    """All results of a drop, by its number within the survey: trials, then those that count."""
    drop = _find(read_survey(folder), record)
    return [*readable_results(drop)][::-1]


def add_result(folder: str | os.PathLike[str], record: int, result: DropResult) -> None:
    """Store another result of a drop of a survey that no session writes; the others stay.

    Raises
    ------
    RecordingError
        If another program writes it.
    """
    refuse_no_survey(folder)
    with open_for_edits(folder) as writer:
        writer.save_result(record, result.to_json(), "trial" if result.is_trial else "drop")


def recorded_drop(folder: str | os.PathLike[str], record: int) -> SavedDrop:
    """Read a drop of a survey with its traces, and screen it beside the drops before it.

    Warnings and sensors that take no part in the fit are not stored; the traces show them.

    Raises
    ------
    SurveyError, RecordingError
        If it is not there, or not whole.
    """
    survey = read_survey(folder)
    stored = _find(survey, record)
    point = next(candidate for candidate in survey.points if candidate.name == stored.point)
    traces = stored.read().drop
    drops = point_view(point, Job()).drops
    view = next(drop for drop in drops if drop.record == record)
    if view.setup is NO_SETUP:
        raise SurveyError(f"drop {view.number} of point {point.name}: {view.own.reason}")
    largest = max(drop.own_pulse_peak for drop in drops if (drop.record or 0) <= record)
    screening = compare(screen(traces, view.setup), view.own_pulse_peak, largest)
    file = str(stored.file or survey.folder)
    return SavedDrop(point.name, replace(view, screening=screening), traces, file)


def _find(survey: Survey, record: int) -> SurveyDrop:
    for drop in survey.drops:
        if drop.number == record:
            return drop
    raise SurveyError(f"{survey.folder}: expected drop {record} of the survey, got none")


def read_point_event(writer: SurveyWriter, name: str) -> PointReported | None:
    """Return the event for a point of the survey that is being written; None: it has no drop."""
    for point in writer.contents().points:
        if point.name == name and point.drops:
            return point_event(point)
    return None


def point_event(point: SurveyPoint, *, is_replayed: bool = False) -> PointReported:
    """Return the event for a stored point."""
    return PointReported(point_view(point, Job()), is_replayed)
