"""Plan of a measuring session, the job that follows from it, and the way it ended."""

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
from pfwd_device.recording.record import point_name
from pfwd_device.recording.survey_content import SurveyContent


class Ending(StrEnum):
    """End of a session."""

    DONE = "done"
    """The session did what was requested, or the feed had ended."""
    LOST = "lost"
    """The instrument did not come back in time."""
    UNSAVED = "unsaved"
    """The disk did not take a drop to the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionPlan:
    """Plan of a session.

    Raises
    ------
    OptionError
        If the name of the point cannot be one.
    """

    point: str | None = None
    """Name of the test point; None: what the setup declares, the survey's last, or the first."""
    setup: MeasuringSetup = field(default_factory=MeasuringSetup)
    """Declarations and detection."""
    drops: int | None = None
    """Number of drops after which the session ends; None: it goes on."""
    options: AnalysisOptions | None = field(default_factory=AnalysisOptions)
    """Options of the analysis; None: no drop is inverted."""
    give_up: float | None = None
    """s after which a lost instrument ends the session; None: never."""
    job: JobRequest = field(default_factory=JobRequest)
    """Changes of the survey's job; the rest of the job stays as it is."""
    default_procedure: Procedure | None = None
    """Procedure of a new survey for which none was chosen; None: none."""
    changed_calibration: Literal["refuse", "ask", "accept"] = "refuse"
    """Response to an instrument whose calibration differs from that of the survey's drops: end with
    an error, wait for `Session.accept_calibration`, or record."""
    position: PositionSource | None = None
    """Source of the position at every drop; None: no receiver."""

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
        """Name of the point by the plan or the setup; None: it has no name."""
        declared = self.setup.declared.get("point")
        return self.point or (None if declared is None else point_name(str(declared)))


@dataclass(frozen=True, slots=True)
class SessionJob:
    """Job of a session: that of its survey, and the changes by the plan."""

    recorded: Job
    """Job that the survey has."""
    request: JobRequest
    """Changes that have to be recorded."""
    setup: MeasuringSetup
    """Setup with the procedure in force."""
    differences: tuple[str, ...]
    """Differences from the recorded job, one sentence each."""

    @property
    def job(self) -> Job:
        """Job after the changes."""
        return self.recorded.with_request(self.request)


def session_job(plan: SessionPlan, survey: SurveyContent | None) -> SessionJob:
    """Return the job of a session: the plan overrides the survey, and this the defaults.

    Parameters
    ----------
    plan : SessionPlan
    survey : SurveyContent, optional
        Survey into which the session records; None: it records nothing.

    Raises
    ------
    SurveyError, OptionError
        If the survey's procedure cannot be read, or the setup contradicts it.
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
            # A survey of an earlier version, without a procedure: only the seating is added.
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


def _recorded_job(survey: SurveyContent, *, replaceable: bool) -> Job:
    try:
        return job_of(survey)
    except SurveyError:
        if not replaceable:  # by the one that is chosen now
            raise
        return dataclasses.replace(job_of(survey, NO_PROCEDURE), procedure=None)


def instrument_request(identity: Identity) -> JobRequest:
    """Return the job's serial number and calibration of an instrument, and the local time zone."""
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
