"""A survey as readers need it: its job, its points with their drops, and their verdicts.

Screen, log, reports, exports and scripts use the same views. The functions of this module make them
from a folder or an exported file, `pfwd.session.live_view` from the events of a session. Nothing is
inverted here.
"""

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from inversion.notices import Notice
from pfwd.analysis.drop_facts import stored_facts, unbroken_peaks
from pfwd.analysis.result_store import (
    last_diagnosis,
    rests_on,
    result_that_counts,
)
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import SurveyError
from pfwd.files.editing import discard_reason, last_discard, later_declarations
from pfwd.files.folders import is_survey, is_survey_file
from pfwd.files.header import Declaration, PointSetup, setup_from
from pfwd.files.opening import survey_content
from pfwd.judging.drops import RATE_DEVIATION, DropView, drop_from_traces
from pfwd.judging.job import Job, job_of
from pfwd.judging.places import place_in
from pfwd.judging.verdicts import PointView, modulus_in_force
from pfwd.procedures import Kind, PointDrop, Procedure
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.record import COPY_OF

_METADATA = (
    *("position", "time_utc", "time_local", "operator", "identity", "marks", RATE_DEVIATION),
    *("imported_from", "imported_sha256", COPY_OF),
)
"""Recorded keys of a drop that readers need; all of them would fill the memory."""

NO_SETUP = PointSetup(plate_radius=0.0, test="stiffness")
"""Setup of a drop that cannot be read; such a drop is rejected."""


@dataclass(frozen=True, eq=False)
class SurveyView:
    """Survey: its job and its points."""

    job: Job = field(default_factory=Job)
    points: Mapping[str, PointView] = field(default_factory=dict)
    """Points in order, by the name under which their drops are stored."""

    def with_job(self, job: Job) -> "SurveyView":
        """Return the survey with all points judged by another job."""
        points = {name: replace(point, job=job) for name, point in self.points.items()}
        return SurveyView(job, points)

    def with_points(self, points: Iterable[PointView]) -> "SurveyView":
        """Return the survey with these points added.

        They replace points of the same name.
        """
        judged = {point.name: replace(point, job=self.job) for point in points}
        return SurveyView(self.job, {**self.points, **judged})


def read_points(folder: str | os.PathLike[str]) -> tuple[PointView, ...]:
    """Return the points of the survey in a folder, without its job: with an empty one.

    Another program may be writing the survey at the same time.

    Raises
    ------
    SurveyError, RecordingError
        If the folder holds no survey.
    """
    return tuple(point_views(survey_content(folder), Job()))


def point_views(survey: Survey, job: Job | None = None) -> Iterator[PointView]:
    """Yield the points of a stored survey in their order, each when its drops have been read.

    Parameters
    ----------
    survey : Survey
    job : Job, optional
        Job to judge by; None: that of the survey.

    Raises
    ------
    SurveyError
        If the stored procedure cannot be read.
    """
    job = job_of(survey) if job is None else job
    for point in survey.points:
        yield point_view(point, job)


def point_view(point: SurveyPoint, job: Job) -> PointView:
    """Return the view of a stored point.

    A damaged drop is rejected with the damage as its reason.
    """
    drops: list[DropView] = []
    later = later_declarations(point)
    for drop in point.drops:
        drops.append(_drop_view(drop, later, drops[-1] if drops else None))
    return PointView(
        name=point.name,
        drops=tuple(drops),
        target=_target_of(point),
        discarded=point.discarded,
        diagnosis=last_diagnosis(point),
        title=point.title,
        job=job,
        notes=point.notes,
        place=place_of_point(point, drops, point.declared),
        source=point,
    )


def job_of_folder(folder: str | os.PathLike[str], instead: Procedure | None = None) -> Job:
    """Return the job of the survey in a folder.

    Parameters
    ----------
    folder : path of a survey
    instead : Procedure, optional
        Procedure that the caller uses in any case; errors in the stored one are then ignored.

    Raises
    ------
    SurveyError, RecordingError
        If the folder holds no survey, or its procedure cannot be read.
    """
    survey = survey_content(folder)
    try:
        return job_of(survey)
    except SurveyError:
        if instead is None:
            raise
        return replace(job_of(survey, instead), procedure=None)


def with_moduli_in_force(diagnoses: Sequence[DiagnosisResult]) -> list[DiagnosisResult]:
    """Return diagnoses with the modulus to use at each point, see `modulus_in_force`.

    Each survey among the diagnosed files is read once, for the stored fits of its drops.
    """
    points: dict[tuple[str, str], PointView] = {}
    for file in dict.fromkeys(str(diagnosis.file) for diagnosis in diagnoses):
        if is_survey(file) or is_survey_file(file):
            # A survey that was damaged since the diagnosis counts as a file without fits.
            with contextlib.suppress(RecordingError, SurveyError):
                views = point_views(survey_content(file))
                points |= {(file, view.shown_name): view for view in views}
    moduli = (modulus_in_force(d, points.get((str(d.file), str(d.point)))) for d in diagnoses)
    return [
        replace(diagnosis, point_modulus=modulus)
        for diagnosis, modulus in zip(diagnoses, moduli, strict=True)
    ]


def _drop_view(drop: SurveyDrop, later: Mapping[str, Any], before: DropView | None) -> DropView:
    """Return the view of a stored drop.

    Parameters
    ----------
    drop : SurveyDrop
    later : mapping
        `later_declarations` of its point.
    before : DropView, optional
        The drop before it; if both have the same setup, which is the rule, it is checked once.
    """
    recorded: dict[str, Any] = {
        "discarded": discard_reason(last_discard(drop)) if drop.discarded else None,
        "record": drop.number,
        "notes": drop.notes,
        "source": drop,
    }
    try:
        record = drop.read_facts()
    except RecordingError as err:
        return _damaged(drop, err, recorded | {"fault": str(err)})
    recorded |= recorded_fields(record, before)
    for edit in drop.edits:  # of drops before the deviation was known
        if edit["what"] == RATE_DEVIATION:
            recorded["metadata"][RATE_DEVIATION] = edit.get("value")
    recorded["last_result"] = last = result_that_counts(drop)
    if last is None:
        recorded["fault"] = drop.damage_of_results
    try:
        setup = None
        if before is not None and before.declared is recorded["declared"]:
            setup = before.setup
        if setup is None or setup is NO_SETUP:
            setup = setup_now(record.declared, later, drop.point)
        if last is not None and last.has_ground and rests_on(last, setup):
            recorded["result"] = last
        stored = stored_facts(drop.drop, setup, record.metadata, last)
        if stored is not None:
            return DropView(*stored, setup, **recorded)
        traces = record.drop if record.drop is not None else drop.read_traces().drop
        return drop_from_traces(traces, setup, **recorded)
    except (RecordingError, SurveyError) as err:
        return _damaged(drop, err, recorded)


def _damaged(drop: SurveyDrop, err: Exception, recorded: Mapping[str, Any]) -> DropView:
    reason = Notice("record-unreadable", {"fault": str(err)})
    facts = PointDrop(drop.drop, Kind.REJECTED, reason=reason)
    # The damage is reported, even of a drop that was discarded or moved.
    discarded = recorded["discarded"] and Notice("discarded")
    return DropView(facts, 0.0, NO_SETUP, **{**recorded, "discarded": discarded, "result": None})


def recorded_fields(record: DropFacts, before: DropView | None) -> dict[str, Any]:
    """Return the fields of a DropView that are recorded.

    Fields that are equal to those of the drop before are shared with it.

    Traces are not among them, because those of a large survey would fill the memory.
    """
    declared: Mapping[str, Any] = record.declared
    metadata = {key: record.metadata[key] for key in _METADATA if key in record.metadata}
    if before is not None and before.declared is not None:
        if before.declared == declared:
            declared = before.declared
        for key, value in metadata.items():
            if key in before.metadata and before.metadata[key] == value:
                metadata[key] = before.metadata[key]
    traces = record.drop
    return {
        "declared": declared,
        "metadata": metadata,
        "peaks": record.peaks if traces is None else unbroken_peaks(traces),
        "has_traces": traces is None or traces.only_peaks is None,
    }


def setup_now(declared: Mapping[str, Any], later: Mapping[str, Any], where: str) -> PointSetup:
    """Return the setup of a drop, with the declarations that were edited later.

    Parameters
    ----------
    declared : mapping
        Declarations recorded with the drop, by the keys of a header.
    later : mapping
        `later_declarations` of its point.
    where : str
        Origin of the declarations, the beginning of error messages.

    Raises
    ------
    SurveyError
        If a value is outside of its range.
    """
    declarations = {**declared, **later}
    return setup_from(
        {key: Declaration(value, where) for key, value in declarations.items()}, where
    )


def _target_of(point: SurveyPoint) -> float | None:
    """Return the target declared for a point, Pa or m; None: not declared, or not valid."""
    target = point.target
    sound = isinstance(target, int | float) and not isinstance(target, bool)
    return float(target) if sound and 0 < target < float("inf") else None


def place_of_point(
    point: SurveyPoint | None, drops: Sequence[DropView], declared: Mapping[str, Any]
) -> Mapping[str, Any] | None:
    """Return the `PointView.place` of a point, or of some of its drops.

    An edited position is used before that of the receiver at the first drop with a fix, and that
    before the declared one.

    Parameters
    ----------
    point : SurveyPoint or None
    drops : sequence of DropView
    declared : mapping
        Declarations of the point, by the keys of a header.
    """
    stored = [point, *(drop.source for drop in drops)]
    edits = [source.position for source in stored if source is not None]
    edited = [{**edit, "source": "edited"} for edit in edits if isinstance(edit, Mapping)]
    received = [drop.metadata.get("position") for drop in drops]
    declared_place = {key: declared.get(key) for key in ("latitude", "longitude")}
    places = (*edited, *received, {**declared_place, "source": "declared"})
    return next((place for place in places if place_in(place) is not None), None)
