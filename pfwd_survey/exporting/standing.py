"""How the points of a survey stand: what is judged, against which target, and the verdict."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

from pfwd_device.recording.survey_content import SurveyContent, SurveyPoint
from pfwd_survey.exporting.rows import Results
from pfwd_survey.judging import Job, MeasuredPoint, job_of, judge_point, measured_point
from pfwd_survey.judging.drops import compared
from pfwd_survey.judging.verdicts import diagnosis_now
from pfwd_survey.procedures import NO_PROCEDURE, PointProgress, PointValue, judge


@dataclass(frozen=True, slots=True)
class Standing:
    """How one point stands."""

    procedure: str | None
    """Its name; None: nobody chose one."""
    progress: PointProgress
    modulus: PointValue | None
    """Mean modulus of the inversion over the drops that count, whatever the procedure judges."""
    diagnosis: str | None
    """Verdict of the diagnosis that holds; None: there is none."""
    chainage_m: float | None
    """Of its station, m; None: it is none, or none is said."""


def standings(content: SurveyContent, inverted: Results | None = None) -> Iterator[Standing]:
    """How each point of a survey stands, in their order, as screen, log and report have it.

    Parameters
    ----------
    content : SurveyContent
    inverted : mapping, optional
        Results in place of the stored ones.
    """
    job = job_of(content)
    for point in content.points:
        yield _standing(job, _measured(point, inverted))


def _measured(point: SurveyPoint, inverted: Results | None) -> MeasuredPoint:
    measured = measured_point(point)
    if inverted is None:
        return measured
    drops = tuple(
        drop.with_result(inverted.get((point.title, drop.facts.number))) for drop in measured.drops
    )
    # What was diagnosed was the fit of another result.
    return dataclasses.replace(measured, drops=drops, diagnosis=None)


def _standing(job: Job, point: MeasuredPoint) -> Standing:
    progress = judge_point(job, point)
    used = [fact for fact in compared(point.drops) if fact.number in progress.used]
    radius = point.drops[-1].setup.plate_radius if point.drops else 0.0
    found, station = diagnosis_now(point), job.station(point.name)
    return Standing(
        None if job.procedure is None else job.procedure.name,
        progress,
        judge(NO_PROCEDURE, used, plate_radius=radius).value,
        None if found is None else found.verdict,
        None if station is None else station.chainage_m,
    )
