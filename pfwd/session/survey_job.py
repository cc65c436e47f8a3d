"""The job of the survey that a session measures into: what it says, what is said anew, kept."""

import dataclasses
import datetime
from collections.abc import Mapping
from typing import Any

from pfwd.errors import SurveyError
from pfwd.judging import Job, JobRequest, job_of, point_view
from pfwd.procedures import NO_PROCEDURE
from pfwd.session.events import PointReported
from pfwd.session.plan import SessionPlan
from pfwd.session.setup_file import MeasuringSetup, with_procedure
from pfwd_device.identity import Identity
from pfwd_device.recording import SurveyWriter
from pfwd_device.recording.survey_content import SurveyContent, SurveyPoint


@dataclasses.dataclass(frozen=True, slots=True)
class AgreedJob:
    """What a session measures by."""

    kept: Job
    """As the survey has it so far."""
    request: JobRequest
    """What has to be said of it."""
    setup: MeasuringSetup
    """With the procedure in force."""
    differences: tuple[str, ...]
    """Where it is said otherwise than the survey had it."""

    @property
    def job(self) -> Job:
        """As it is once that is said."""
        return self.kept.with_request(self.request)


def agreed_job(plan: SessionPlan, survey: SurveyContent | None) -> AgreedJob:
    """What is said now over what the survey says, and that over what is usual.

    Parameters
    ----------
    plan : SessionPlan
    survey : SurveyContent, optional
        None: nothing is written.

    Raises
    ------
    SurveyError, OptionError
        If the survey's procedure cannot be read, or the setup contradicts it.
    """
    chosen = plan.setup.procedure
    kept = Job() if survey is None else _kept(survey, replaceable=chosen is not None)
    setup = plan.setup
    if chosen is None:
        begins = survey is None or not survey.drops
        chosen = kept.procedure or (plan.usual_procedure if begins else None)
        if chosen is not None:
            setup = with_procedure(setup, chosen, f"procedure {chosen.name} of the survey")
        elif plan.usual_procedure is not None:
            # A survey of before, without a procedure: its points are seated as they were.
            seating = {"seating_drops": plan.usual_procedure.seating_drops or 0}
            setup = dataclasses.replace(setup, declared={**seating, **setup.declared})
    asked = plan.job.over(JobRequest(operator=_text(setup.declared.get("operator"))))
    if chosen is not None:
        asked = JobRequest(procedure=chosen).over(asked)
    if asked.operator is None and kept.operator is not None:
        declared = {**setup.declared, "operator": kept.operator}
        setup = dataclasses.replace(setup, declared=declared)
    elif asked.operator is not None:
        declared = {**setup.declared, "operator": asked.operator}
        setup = dataclasses.replace(setup, declared=declared)
    return AgreedJob(kept, asked.news(kept), setup, tuple(asked.differences(kept)))


def _kept(survey: SurveyContent, *, replaceable: bool) -> Job:
    try:
        return job_of(survey)
    except SurveyError:
        if not replaceable:  # by the one that is chosen now
            raise
        return dataclasses.replace(job_of(survey, NO_PROCEDURE), procedure=None)


def _text(value: Any) -> str | None:
    return None if value is None else str(value)[:200]


def instrument_request(identity: Identity) -> JobRequest:
    """What an instrument says that belongs to the job: itself, its calibration; and the clock."""
    calibration: list[Mapping[str, Any]] = []
    for channel in identity.channels:
        known = {
            "calibrated": channel.calibrated and channel.calibrated.isoformat(),
            "due": channel.due and channel.due.isoformat(),
        }
        said = {key: value for key, value in known.items() if value}
        if said:
            calibration.append({"channel": channel.name, **said})
    zone = datetime.datetime.now().astimezone().strftime("%z")
    return JobRequest(
        device=identity.serial_number or None,
        calibration=tuple(calibration) or None,
        time_zone=f"{zone[:3]}:{zone[3:5]}" if zone else None,
    )


def known_point(writer: SurveyWriter, name: str) -> PointReported | None:
    """What a survey that is written holds of a point; None: no drop."""
    for point in writer.contents().points:
        if point.name == name and point.drops:
            return point_known(point)
    return None


def point_known(point: SurveyPoint, *, is_replayed: bool = False) -> PointReported:
    """Return the event for a point that a survey holds."""
    return PointReported(point_view(point, Job()), is_replayed)
