"""Stored points and drops of a survey as events of a session, with traces and all results."""

import os
from dataclasses import replace

from inversion.notices import text_of
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import compare, screen
from pfwd.errors import SurveyError
from pfwd.files.folders import open_for_edits, refuse_no_survey
from pfwd.judging import Job, point_view
from pfwd.judging.view import NO_SETUP
from pfwd.session.events import PointReported, SavedDrop
from pfwd_device.recording import Survey, SurveyDrop, SurveyWriter, read_survey
from pfwd_device.recording.survey_reader import SurveyPoint


def stored_results(folder: str | os.PathLike[str], record: int) -> list[DropResult]:
    """Return all results of a drop: trials first, then the results that count.

    Parameters
    ----------
    folder : path of a survey
    record : int
        Number of the drop within the survey.
    """
    drop = _find(read_survey(folder), record)
    return [*drop.readable_results(DropResult.from_json)][::-1]


def add_result(folder: str | os.PathLike[str], record: int, result: DropResult) -> None:
    """Save a further result of a drop in a survey that no session is writing to.

    Parameters
    ----------
    folder : path of a survey
    record : int
        Number of the drop within the survey.
    result : DropResult

    Raises
    ------
    RecordingError
        If another program is writing to the survey.
    """
    refuse_no_survey(folder)
    with open_for_edits(folder) as writer:
        writer.save_result(record, result.to_stored(), "trial" if result.is_trial else "drop")


def recorded_drop(folder: str | os.PathLike[str], record: int) -> SavedDrop:
    """Read a drop of a survey with its traces and screen it again.

    It is screened again because warnings and unused sensors are not stored.

    Parameters
    ----------
    folder : path of a survey
    record : int
        Number of the drop within the survey.

    Raises
    ------
    SurveyError, RecordingError
        If there is no such drop, or it is damaged.
    """
    survey = read_survey(folder)
    stored = _find(survey, record)
    point = next(candidate for candidate in survey.points if candidate.name == stored.point)
    traces = stored.read().drop
    drops = point_view(point, Job()).drops
    view = next(drop for drop in drops if drop.record == record)
    if view.setup is NO_SETUP:
        raise SurveyError(f"drop {view.number} of point {point.name}: {text_of(view.own.reason)}")
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
    """Return the event for a point of the survey that is open for writing; None: it has no drop."""
    for point in writer.contents().points:
        if point.name == name and point.drops:
            return point_event(point)
    return None


def point_event(point: SurveyPoint, *, is_replayed: bool = False) -> PointReported:
    """Return the event that reports a stored point."""
    return PointReported(point_view(point, Job()), is_replayed)
