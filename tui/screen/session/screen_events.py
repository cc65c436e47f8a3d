"""What the screen is told besides the events of the session: its begin and end, what was read."""

from dataclasses import dataclass, field
from typing import Any

from pfwd.analysis.results import DiagnosisResult, DropResult, TimeHistories
from pfwd.judging import PointView
from pfwd.session.events import SavedDrop, SessionEvent
from pfwd.session.plan import Ending


@dataclass(frozen=True, slots=True)
class SessionBegan:
    """The session runs; what has to be asked of it goes to `session`."""

    session: Any = field(repr=False)
    point: str


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """The session is over."""

    ending: Ending | None
    """None: it failed."""
    error: str = ""
    """Why, in one sentence."""
    retry: float | None = None
    """s until it is tried again; None: it is not."""
    no_device: bool = False
    """Whether it failed at the port."""


@dataclass(frozen=True, eq=False, slots=True)
class ContentsRead:
    """The survey as it is on the disk."""

    points: tuple[PointView, ...]
    drops: bool
    """Whether its drops are shown too: in a replay they come one by one."""


@dataclass(frozen=True, eq=False, slots=True)
class DropRead:
    """A drop of the survey with its traces and all its results."""

    saved: SavedDrop
    results: tuple[DropResult, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Refitted:
    """A drop that was fitted anew, with other settings or for its curves alone."""

    point: str
    number: int
    label: str
    """Which settings; empty: for the curves."""
    result: DropResult | None
    curves: TimeHistories | None
    fault: str = ""
    """Why there is no result."""


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisDone:
    """What the diagnosis of a file has found."""

    file: str
    results: tuple[DiagnosisResult, ...]
    """One a point."""
    error: str = ""


ScreenEvent = (
    SessionEvent | SessionBegan | SessionEnded | ContentsRead | DropRead | Refitted | DiagnosisDone
)
