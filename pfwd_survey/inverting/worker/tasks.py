"""What the worker and its process say to each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Drop
from pfwd_survey.files.header import PointSetup
from pfwd_survey.files.traces import TracePoint
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.drops import Screening


class Urgency(IntEnum):
    """What goes before what."""

    PREPARE = 0
    """Have the response table ready before the first drop."""
    QUICK = 1
    """The first modulus of a new drop."""
    FULL = 2
    """The full search of a drop."""
    DIAGNOSIS = 3
    """What is behind the residual of a point."""


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """One analysis."""

    number: int
    """Of the task."""
    urgency: Urgency
    drop: Drop
    setup: PointSetup
    screening: Screening
    options: AnalysisOptions
    file: str
    """Where the drop is kept, for the result."""


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisTask:
    """The diagnosis of a point."""

    number: int
    """Of the task."""
    point: TracePoint
    options: AnalysisOptions
    device: Mapping[str, Mapping[str, float]]
    """Effects of the device that are known, with their values."""
    urgency: Urgency = Urgency.DIAGNOSIS


@dataclass(frozen=True, eq=False, slots=True)
class Curves:
    """What was measured and what the model makes of it, for a display."""

    time: NDArray[np.float64]
    """(n,), s, 0 is the trigger."""
    load: NDArray[np.float64]
    """Measured, without offset, (n,), N."""
    model_load: NDArray[np.float64]
    """The load that the model was given, (n,), N."""
    observed: NDArray[np.float64]
    """Displacement, (sensors, n), m."""
    predicted: NDArray[np.float64]
    """(sensors, n), m."""
    offsets: NDArray[np.float64]
    """(sensors,), m; negative: on the other side of the plate."""
    peaks: NDArray[np.float64]
    """Largest observed before a second contact, (sensors,), m; residuals are parts of it."""
    window_end: float
    """Last instant that the fit used, s."""
    contact_end: float
    """The load has gone, s."""


@dataclass(frozen=True, eq=False, slots=True)
class TaskOutcome:
    """What the process says of a task."""

    result: DropResult | None = None
    """None when it failed, and for a task that only prepares."""
    curves: Curves | None = None
    """None when there is no result."""
    fault: str | None = None
    """Why it failed, in one sentence."""
    details: str = ""
    """More on the failure, for the log."""
    diagnosis: DiagnosisResult | None = None
    """Of a point, where it was asked for."""


@dataclass(frozen=True, slots=True)
class Building:
    """A response table is being built."""

    what: str
    fraction: float
