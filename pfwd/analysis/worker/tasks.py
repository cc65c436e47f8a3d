"""Tasks for the worker process that inverts drops, and their outcomes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from inversion.result import TimeHistories
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd_device import Drop


class Urgency(IntEnum):
    """Priority of a task; the smallest number is done first."""

    PREPARE = 0
    """Load the response table before the first drop."""
    QUICK = 1
    """Compute the first modulus of a new drop."""
    FULL = 2
    """Invert a drop with the full search."""
    DIAGNOSIS = 3
    """Diagnose the residual of a point."""


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """Inversion of one drop, as the worker process receives it."""

    number: int
    """Number of the task, in the order of the requests."""
    urgency: Urgency
    drop: Drop
    setup: PointSetup
    screening: Screening
    options: AnalysisOptions
    file: str
    """Path of the file with the drop, for the result."""
    preceding: DropResult | None = None
    """Result from which a preliminary fit starts; None: the inversion is a full one."""


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisTask:
    """Diagnosis of a point, or of all points of a file together."""

    number: int
    """Number of the task, in the order of the requests."""
    source: TracePoint | str
    """The point, or the path of a survey or a drop file; diagnoses of a survey are stored in it."""
    options: AnalysisOptions
    device: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Known parameters of device effects, by effect and parameter, in SI units."""
    urgency: Urgency = Urgency.DIAGNOSIS


@dataclass(frozen=True, eq=False, slots=True)
class TaskOutcome:
    """Outcome of a task, as the worker process sends it."""

    result: DropResult | None = None
    """Result of the drop; None: the task failed, or has no result."""
    curves: TimeHistories | None = None
    """Measured and fitted traces; None: there is no result."""
    fault: str | None = None
    """Reason why the task failed, one sentence; None: it succeeded."""
    details: str = ""
    """Further information on the failure, for the log."""
    diagnoses: tuple[DiagnosisResult, ...] = ()
    """For a `DiagnosisTask`: one diagnosis for each point."""


@dataclass(frozen=True, slots=True)
class DiagnosisProgress:
    """Progress of the diagnosis of a file."""

    kind: str
    """Kind of work, in words for the user."""
    point: str
    """Name of the point that is being diagnosed; empty: this kind of work is complete."""
    count: int
    """Number of diagnosed points."""
    total: int
    """Number of points."""


@dataclass(frozen=True, slots=True)
class Building:
    """Progress of building a response table."""

    what: str
    fraction: float
