"""Plan of a measuring session, the job that follows from it, and how a session ended.

The job of a survey is its procedure, targets, stations and operator.
"""

import dataclasses
import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError, SurveyError, quote, refusal
from pfwd.judging import Job, JobRequest, job_of
from pfwd.procedures import NO_PROCEDURE, Procedure
from pfwd.session.position import PositionSource
from pfwd.session.setup_file import MeasuringSetup, with_procedure
from pfwd_device.errors import RecordingError
from pfwd_device.identity import Identity
from pfwd_device.recording import Survey
from pfwd_device.recording.record import point_name


class Ending(StrEnum):
    """Reason for the end of a session."""

    DONE = "done"
    """The requested number of drops is measured, the operator stopped, or the feed ended."""
    LOST = "lost"
    """The connection was lost for longer than `SessionPlan.give_up`."""
    UNSAVED = "unsaved"
    """At least one drop could not be written to the disk."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPlan:
    """Plan of a session: where and how it measures, when it ends, how drops are analysed.

    Raises
    ------
    OptionError
        If `point` is not a valid name.
    """

    point: str | None = None
    """Name of the test point; None: that of the setup, else the last one of the survey, else the
    first station."""
    setup: MeasuringSetup = field(default_factory=MeasuringSetup)
    """Declarations, and settings of instrument and detection."""
    drops: int | None = None
    """Number of drops after which the session ends; None: no limit."""
    options: AnalysisOptions | None = field(default_factory=AnalysisOptions)
    """Options of the analysis; None: no drop is inverted."""
    give_up: float | None = None
    """Time without connection after which the session ends, s; None: it waits without limit."""
    job: JobRequest = field(default_factory=JobRequest)
    """Changes of the survey's job; everything else of the job stays as it is."""
    default_procedure: Procedure | None = None
    """Procedure for a new survey if none was chosen; None: no procedure."""
    changed_calibration: Literal["refuse", "ask", "accept"] = "refuse"
    """What to do if the calibration of the instrument differs from that of the survey's drops:
    "refuse" raises OptionError, "ask" waits for `Session.accept_calibration`, "accept" records."""
    position: PositionSource | None = None
    """Receiver that provides a position with every drop; None: no receiver."""

    def __post_init__(self) -> None:
        if self.point is None:
            return
        try:
            object.__setattr__(self, "point", point_name(self.point))
        except RecordingError as err:
            expected = "a name of 1 to 64 characters"
            raise OptionError(refusal("--point", expected, quote(self.point))) from err

    @property
    def named_point(self) -> str | None:
        """Name of the point in the plan or in the setup; None: neither has one."""
        declared = self.setup.declared.get("point")
        return self.point or (None if declared is None else point_name(str(declared)))


@dataclass(frozen=True, slots=True)
class SessionJob:
    """Job of a session: the job of its survey with the changes of the plan."""

    recorded: Job
    """Job in the survey."""
    request: JobRequest
    """Changes to record."""
    setup: MeasuringSetup
    """Setup with the procedure of the job."""
    differences: tuple[str, ...]
    """Values in which the plan differs from the job in the survey, one sentence each."""

    @property
    def job(self) -> Job:
        """Job of the survey after the requested changes."""
        return self.recorded.with_request(self.request)


def session_job(plan: SessionPlan, survey: Survey | None) -> SessionJob:
    """Return the job of a session: the plan overrides the survey, and the survey overrides
    defaults.

    Parameters
    ----------
    plan : SessionPlan
    survey : Survey or None
        Survey to record into; None: nothing is recorded.

    Raises
    ------
    SurveyError, OptionError
        If the procedure of the survey cannot be read, or the setup contradicts it.
    """
    chosen = plan.setup.procedure
    recorded = Job() if survey is None else _recorded_job(survey, replaceable=chosen is not None)
    setup = plan.setup
    if chosen is None:
        is_new = survey is None or not survey.drops
        chosen = recorded.procedure or (plan.default_procedure if is_new else None)
        if chosen is not None:
            setup = with_procedure(setup, chosen, f"procedure {chosen.name} of the survey")
        elif plan.default_procedure is not None:
            # The survey has drops and no procedure; only its seating drops are added.
            seating = {"seating_drops": plan.default_procedure.seating_drops or 0}
            setup = dataclasses.replace(setup, declared={**seating, **setup.declared})
    operator = setup.declared.get("operator")
    request = plan.job.over(JobRequest(operator=None if operator is None else str(operator)[:200]))
    if chosen is not None:
        request = JobRequest(procedure=chosen).over(request)
    operator = recorded.operator if request.operator is None else request.operator
    if operator is not None:
        declared = {**setup.declared, "operator": operator}
        setup = dataclasses.replace(setup, declared=declared)
    differences = tuple(request.differences(recorded))
    return SessionJob(recorded, request.news(recorded), setup, differences)


def _recorded_job(survey: Survey, *, replaceable: bool) -> Job:
    try:
        return job_of(survey)
    except SurveyError:
        if not replaceable:
            raise
        # The plan chooses another procedure, which replaces the unreadable one.
        return dataclasses.replace(job_of(survey, NO_PROCEDURE), procedure=None)


def instrument_request(identity: Identity) -> JobRequest:
    """Return the job change that records an instrument's serial number and calibration dates.

    It also records the time zone of this computer.
    """
    calibration: list[Mapping[str, Any]] = []
    for channel in identity.channels:
        dates = {"calibrated": channel.calibrated, "due": channel.due}
        declared = {key: date.isoformat() for key, date in dates.items() if date}
        if declared:
            calibration.append({"channel": channel.name, **declared})
    zone = datetime.datetime.now().astimezone().strftime("%z")
    return JobRequest(
        device=identity.serial_number or None,
        calibration=tuple(calibration) or None,
        time_zone=f"{zone[:3]}:{zone[3:5]}" if zone else None,
    )
