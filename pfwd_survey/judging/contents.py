"""The points of a survey that is read, judged: from what is stored, nothing is inverted."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import read_survey
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.survey_content import SurveyContent, SurveyDrop, SurveyPoint
from pfwd_survey.errors import SurveyError
from pfwd_survey.files.folders import is_survey, refuse_no_survey
from pfwd_survey.files.header import Declaration, PointSetup, setup_from
from pfwd_survey.files.moving import moved_to
from pfwd_survey.inverting.diagnosis.holding import last_diagnosis
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.drop_facts import stored_facts
from pfwd_survey.inverting.keeping import result_that_counts
from pfwd_survey.inverting.kept import is_sound, rests_on
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.judging.drops import MeasuredDrop, measured_drop
from pfwd_survey.judging.job import Job, job_of
from pfwd_survey.judging.verdicts import (
    JudgedPoint,
    MeasuredPoint,
    judge_point,
    modulus_in_force,
)
from pfwd_survey.procedures import Kind, PointDrop, PointModulus, Procedure

DAMAGED = "damaged record"


def job_of_folder(folder: str | os.PathLike[str], instead: Procedure | None = None) -> Job:
    """What the survey of a folder is measured by.

    Parameters
    ----------
    folder : path of a survey
    instead : Procedure, optional
        Chosen in place of the kept one where that cannot be read.

    Raises
    ------
    SurveyError, RecordingError
    """
    refuse_no_survey(folder)
    survey = read_survey(folder)
    try:
        return job_of(survey)
    except SurveyError:
        if instead is None:
            raise
        return replace(job_of(survey, instead), procedure=None)


@dataclass(frozen=True, slots=True)
class KeptDrop:
    """A drop of a survey, ready to be judged."""

    drop: SurveyDrop
    measured: MeasuredDrop
    result: DropResult | None
    """That counts; None: there is none that rests on what is declared now."""
    record: DropFacts | None = None
    """As it was recorded; None: it is damaged."""
    setup: PointSetup | None = None
    """What is declared of it now; None: it is damaged, or a value is outside of its range."""
    last: DropResult | None = None
    """The last one that is no trial, whatever it rests on."""
    fault: str | None = None
    """What is damaged, its record or its results; None: nothing."""


def judged_points(survey: SurveyContent, job: Job | None = None) -> Iterator[JudgedPoint]:
    """The points of a survey in their order, each with how it stands.

    Parameters
    ----------
    survey : SurveyContent
    job : Job, optional
        None: that of the survey.

    Raises
    ------
    SurveyError
        If the procedure that the survey keeps cannot be read.
    """
    job = job_of(survey) if job is None else job
    for point in survey.points:
        measured = measured_point(point)
        yield JudgedPoint(point.title, judge_point(job, measured), point.discarded)


def moduli_in_force(
    file: str, diagnoses: Sequence[DiagnosisResult]
) -> Iterator[PointModulus | None]:
    """Return the modulus in force after each diagnosis of one file.

    Parameters
    ----------
    file : str
        What was diagnosed; the fits that a survey stores count as its fitted moduli.
    diagnoses : sequence of DiagnosisResult
    """
    points: dict[str, MeasuredPoint] = {}
    job = None
    if is_survey(file):
        try:
            survey = read_survey(file)
            job = job_of(survey)
            points = {point.title: measured_point(point) for point in survey.points}
        except (RecordingError, SurveyError):
            job = None  # damaged since it was diagnosed: as without a survey
    for diagnosis in diagnoses:
        yield modulus_in_force(diagnosis, points.get(str(diagnosis.point)), job)


def measured_point(point: SurveyPoint, kept: Iterable[KeptDrop] | None = None) -> MeasuredPoint:
    """A point of a survey, ready to be judged.

    Parameters
    ----------
    point : SurveyPoint
    kept : iterable of KeptDrop, optional
        Its drops as `kept_drops` has them, where they were read before.
    """
    return MeasuredPoint(
        name=point.title,
        drops=tuple(drop.measured for drop in (kept_drops(point) if kept is None else kept)),
        target=target_of_point(point),
        discarded=point.discarded,
        diagnosis=last_diagnosis(point),
    )


def kept_drops(point: SurveyPoint) -> Iterator[KeptDrop]:
    """The drops of a point in the order they fell."""
    later = said_later(point)
    before = None
    for drop in point.drops:
        before = kept_drop(drop, later, before)
        yield before


def kept_drop(
    drop: SurveyDrop, later: Mapping[str, Any], before: KeptDrop | None = None
) -> KeptDrop:
    """One drop; a damaged one is rejected.

    Parameters
    ----------
    drop : SurveyDrop
    later : mapping
        What was declared of its point after it was measured, see `said_later`.
    before : KeptDrop, optional
        Another one of its point. Nearly always the same is declared of both, and looked at once.
    """
    try:
        record = drop.read_facts()
    except RecordingError as err:
        return KeptDrop(drop, _damaged(drop, err), None, fault=str(err))
    last, fault = None, None
    try:
        last = result_that_counts(drop)
    except (RecordingError, SurveyError) as err:
        fault = str(err)
    setup = None
    try:
        if before is not None and before.record and before.record.declared == record.declared:
            setup = before.setup
        if setup is None:
            setup = setup_now(record.declared, later, drop.point)
        result = last
        if fault is not None or (last is not None and not is_sound(last)):
            result = last_sound(drop)  # an earlier one may be whole
        measured = measured_now(drop, record, setup, result)
    except (RecordingError, SurveyError) as err:
        return KeptDrop(drop, _damaged(drop, err), None, record, setup, last, fault)
    counts = result if result is not None and rests_on(result, setup) else None
    return KeptDrop(drop, measured.with_result(counts), counts, record, setup, last, fault)


def _damaged(drop: SurveyDrop, err: Exception) -> MeasuredDrop:
    facts = PointDrop(drop.drop, Kind.REJECTED, reason=f"{DAMAGED}: {err}")
    return MeasuredDrop(facts, 0.0, _NO_SETUP)


def measured_now(
    drop: SurveyDrop, record: DropFacts, setup: PointSetup, result: DropResult | None
) -> MeasuredDrop:
    """A drop by its own record: from what was kept with its result, else from its traces."""
    kept = stored_facts(drop.drop, setup, record.metadata, result)
    if kept is not None:
        return as_said(drop, MeasuredDrop(*kept, setup))
    traces = record.drop if record.drop is not None else drop.read_traces().drop
    return as_said(drop, measured_drop(traces, setup))


def as_said(drop: SurveyDrop, measured: MeasuredDrop) -> MeasuredDrop:
    """A drop as a person discarded it, or moved it to another point."""
    discarded = discarding_of(drop)
    if discarded is None:
        return measured
    said = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    where = moved_to(said[-1]) if said else None
    return measured.with_discarding(discarded) if where is None else measured.with_move(where)


_NO_SETUP = PointSetup(plate_radius=0.0, test="stiffness")
"""Of a drop that cannot be read; it takes part in nothing."""


def kept_result(drop: SurveyDrop, setup: PointSetup) -> DropResult | None:
    """The result of a drop that counts: the last whole one that is no trial.

    None where there is none, or it was found with other values than are declared now.
    """
    found = last_sound(drop)
    return found if found is not None and rests_on(found, setup) else None


def last_sound(drop: SurveyDrop) -> DropResult | None:
    """The last whole result of a drop that is no trial, whatever it rests on."""
    try:
        last = drop.read_last_result()
        if last is None:
            return None
        result = DropResult.from_json(last)
        if _counts(result):
            return result
    except (RecordingError, SurveyError):
        pass  # an earlier one may be whole
    for said in _readable(drop):
        if _counts(said):
            return said
    return None


def _readable(drop: SurveyDrop) -> Iterator[DropResult]:
    """Those that can be read, the last one first."""
    from pfwd_device.recording.survey_content import read_result

    paths = drop.results
    if not paths:  # within an exported survey
        try:
            stored = drop.read_results()
        except RecordingError:
            return
        for said in reversed(stored):
            try:
                yield DropResult.from_json(said)
            except SurveyError:
                continue
        return
    for path in reversed(paths):
        try:
            yield DropResult.from_json(read_result(path), str(path))
        except (RecordingError, SurveyError):
            continue


def _counts(result: DropResult) -> bool:
    return not result.is_trial and is_sound(result)


def said_later(point: SurveyPoint) -> dict[str, Any]:
    """What was said of a point after it was measured, as keys of a header; the last counts."""
    said: dict[str, Any] = {}
    for edit in point.edits:
        what, value = edit["what"], edit.get("value")
        if what == "declared" and isinstance(value, dict):
            said |= value
        elif what == "operator" and value is not None:
            said["operator"] = value
    return said


def setup_now(declared: Mapping[str, Any], later: Mapping[str, Any], where: str) -> PointSetup:
    """What is declared of a drop now.

    Raises
    ------
    SurveyError
        If a value is outside of its range.
    """
    known = {**declared, **later}
    return setup_from({key: Declaration(value, where) for key, value in known.items()}, where)


def discarding_of(drop: SurveyDrop) -> str | None:
    """Why a person discarded a drop; "" without a reason, None: nobody did."""
    if not drop.discarded:
        return None
    said = [edit.get("value") for edit in drop.edits if edit["what"] == "discard"]
    if not said or not said[-1]:
        return ""
    return moved_to(said[-1]) or str(said[-1])


def target_of_point(point: SurveyPoint) -> float | None:
    """What was said of the point itself, Pa or m; None: nothing that could be one."""
    target = point.target
    sound = isinstance(target, int | float) and not isinstance(target, bool)
    return float(target) if sound and 0 < target < float("inf") else None
