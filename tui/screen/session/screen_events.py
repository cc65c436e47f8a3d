"""Events of the screen besides those of the session: its start and end, and what was read."""

from dataclasses import dataclass, field
from typing import Any

from pfwd.analysis.results import DiagnosisResult, DropResult, TimeHistories
from pfwd.session.events import SavedDrop, SessionEvent
from pfwd.session.plan import Ending


@dataclass(frozen=True, slots=True)
class SessionStarted:
    """Event: a session runs now; `session` receives requests, `point` is its point."""

    session: Any = field(repr=False)
    point: str


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """Event: a session has ended, or could not start."""

    ending: Ending | None
    """Way in which the session ended; None: by an error."""
    error: str = ""
    """Error in one sentence."""
    retry: float | None = None
    """Time until the next attempt, s; None: there is none."""
    no_device: bool = False
    """True if the port could not be opened."""


@dataclass(frozen=True, eq=False, slots=True)
class DropRead:
    """Event: a drop was read from the survey, with its traces and all its results."""

    saved: SavedDrop
    results: tuple[DropResult, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Refit:
    """Event: a fit of a drop has ended, with other settings or to get its curves."""

    point: str
    number: int
    label: str
    """Settings of the fit in words; empty: to get the curves."""
    result: DropResult | None
    curves: TimeHistories | None
    fault: str = ""
    """Reason why there is no result."""


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisFinished:
    """Event: the diagnosis of a survey or drop file has ended."""

    file: str
    results: tuple[DiagnosisResult, ...]
    """Diagnoses, one for each point."""
    error: str = ""
    not_stored: str = ""
    """Reason why the diagnoses are not stored with the survey; empty: they are."""


ScreenEvent = SessionEvent | SessionStarted | SessionEnded | DropRead | Refit | DiagnosisFinished
