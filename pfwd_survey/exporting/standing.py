"""How the points of a survey stand: what is judged, against which target, and the verdict."""

from dataclasses import dataclass

from pfwd_survey.exporting.rows import PointRows
from pfwd_survey.judging import Job
from pfwd_survey.judging.verdicts import diagnosis_now
from pfwd_survey.procedures import PointProgress


@dataclass(frozen=True, slots=True)
class Standing:
    """How one point stands."""

    procedure: str | None
    """Its name; None: nobody chose one."""
    progress: PointProgress
    diagnosis: str | None
    """Verdict of the diagnosis that holds; None: there is none."""
    chainage_m: float | None
    """Of its station, m; None: it is none, or none is said."""


def standing_of(job: Job, found: PointRows) -> Standing:
    """How a point of a survey stands, as screen, log and report have it."""
    point, progress = found.measured, found.progress
    diagnosis, station = diagnosis_now(point), job.station(point.name)
    return Standing(
        None if job.procedure is None else job.procedure.name,
        progress,
        None if diagnosis is None else diagnosis.verdict,
        None if station is None else station.chainage_m,
    )
