"""Tasks for the worker process, and their outcomes."""

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
    """Priority of a task."""

    PREPARE = 0
    """Have the response table ready before the first drop."""
    QUICK = 1
    """The first modulus of a new drop."""
    FULL = 2
    """The full search of a drop."""
    DIAGNOSIS = 3
    """Diagnosis of the residual of a point."""


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """One analysis."""

    number: int
    """Number of the task."""
    urgency: Urgency
    drop: Drop
    setup: PointSetup
    screening: Screening
    options: AnalysisOptions
    file: str
    """File of the drop, for the result."""


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisTask:
    """The diagnosis of a point, or of all points of a file together."""

    number: int
    """Number of the task."""
    source: TracePoint | str
    """The point, or the path of a survey or a drop file; diagnoses of a survey are stored in it."""
    options: AnalysisOptions
    device: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Known effects of the device that measured a point, with their values."""
    urgency: Urgency = Urgency.DIAGNOSIS


@dataclass(frozen=True, eq=False, slots=True)
class TaskOutcome:
    """Outcome of a task in the worker process."""

    result: DropResult | None = None
    """Result of the drop; None when the task failed, or only prepares."""
    curves: TimeHistories | None = None
    """Time histories of the fit; None when there is no result."""
    fault: str | None = None
    """Why it failed, in one sentence."""
    details: str = ""
    """More on the failure, for the log."""
    diagnoses: tuple[DiagnosisResult, ...] = ()
    """One for each point of a `DiagnosisTask`."""


@dataclass(frozen=True, slots=True)
class DiagnosisProgress:
    """Progress of the diagnosis of a file."""

    kind: str
    """Kind of work, in words."""
    point: str
    """Name of the point that is being diagnosed; empty: this kind of work is complete."""
    count: int
    """Number of diagnosed points."""
    total: int
    """Number of points."""


@dataclass(frozen=True, slots=True)
class Building:
    """A response table is being built."""

    what: str
    fraction: float
