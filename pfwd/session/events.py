"""Events that a measuring session reports to a screen, a log or a script. All are immutable."""

import datetime
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from inversion.notices import Notice
from inversion.result import TimeHistories
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd.judging import DropView, Job, PointView, SurveyView
from pfwd_device.acquisition.items import Disconnected, Samples
from pfwd_device.drop import Drop
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Status


@dataclass(frozen=True, slots=True)
class InstrumentReady:
    """The instrument is connected, and its declarations are complete."""

    url: str
    identity: Identity
    """Identity of the instrument, with the values of the setup file in place of its own."""
    setup: PointSetup
    """Declarations for the points to be measured."""
    differences: tuple[str, ...]
    """Values in which the setup file differs from the instrument, one sentence each."""
    warnings: tuple[str, ...]
    """Warnings about calibration and response of the channels."""
    again: bool
    """True: the instrument was connected earlier in the session."""


@dataclass(frozen=True, slots=True)
class InstrumentLost:
    """The connection to the instrument is lost; the session waits for it."""

    reason: str
    time_utc: datetime.datetime

    @classmethod
    def of(cls, item: Disconnected) -> "InstrumentLost":
        """Return the event for a disconnection that the driver reports."""
        return cls(item.reason, item.time_utc)


@dataclass(frozen=True, eq=False, slots=True)
class LiveSamples:
    """Samples that have just arrived, for a live display."""

    samples: Samples
    identity: Identity
    drop_load: float
    """Load above the load at rest at which a drop is detected, N."""


@dataclass(frozen=True, slots=True)
class InstrumentStatus:
    """Battery, temperature and other state of the instrument, and counters of the connection."""

    status: Status
    counters: Mapping[str, float | None]
    """Numbers of discarded messages by their kind, and the drift of the instrument's clock, ppm."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The load at rest is known, and drops can be detected."""


@dataclass(frozen=True, slots=True)
class NotReady:
    """No drop can be recorded until the next `Ready`."""

    reason: str


@dataclass(frozen=True, slots=True)
class SensorCheck:
    """Result of a check of the load cell's zero and span, and of the noise of every channel."""

    details: Mapping[str, Any]
    """Values as recorded; keys ``zero_n``, ``span_ratio`` and ``channels``."""
    faults: tuple[Notice, ...]
    """Faults, one sentence each; empty: none."""


@dataclass(frozen=True, eq=False, slots=True)
class SavedDrop:
    """Saved drop with its traces."""

    point: str
    """Name of its test point."""
    view: DropView
    """Drop as screened, without traces."""
    drop: Drop
    """Traces."""
    file: str = ""
    """Path of the drop that its results state; empty: not in a file."""
    spare: str | None = None
    """Spare folder that holds the drop, because the survey cannot be written; None: it is in the
    survey."""
    received: float | None = None
    """Time at which its last sample arrived, s, monotonic clock; None: in a replay."""

    @property
    def number(self) -> int:
        """Number of the drop within its point."""
        return self.view.number

    @property
    def record(self) -> int | None:
        """Number of the drop within the survey; None: a replay without output."""
        return self.view.record

    @property
    def setup(self) -> PointSetup:
        """Declarations of plate, ground and instrument that apply to the drop."""
        return self.view.setup

    @property
    def screening(self) -> Screening:
        """Result of the screening, by its record and by comparison with the drops before it."""
        assert self.view.screening is not None
        return self.view.screening


@dataclass(frozen=True, eq=False, slots=True)
class DropSaved:
    """A drop is safe on the disk and thereby acknowledged; in a replay it was so before."""

    saved: SavedDrop
    identical: bool | None = None
    """In a replay: True if the traces equal the recorded ones bit by bit. None: not a replay."""


@dataclass(frozen=True, eq=False, slots=True)
class DropNotSaved:
    """A drop could not be written; it is NOT safe, stays in memory, and is tried again."""

    point: str
    number: int
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class DropAnalysed:
    """A drop has a modulus, or a reason why it has none."""

    saved: SavedDrop
    delay: float | None
    """Time from the arrival of the drop's last sample to this result, s; None: in a replay."""
    result: DropResult
    curves: TimeHistories | None
    """Measured and fitted traces for a display; None: the analysis failed."""
    full: bool
    """True: the result is that of the full search. False: that of the quick fit."""
    final: bool
    """True: no further result of the drop follows."""


@dataclass(frozen=True, eq=False, slots=True)
class PointDiagnosed:
    """A point was diagnosed with the drops that it has so far."""

    point: str
    result: DiagnosisResult


@dataclass(frozen=True, slots=True)
class DiagnosisAwaited:
    """The diagnosis of a point with its present drops was requested, or is awaited no longer."""

    point: str
    awaited: bool
    """False: the diagnosis was reported before, failed, or was given up."""


@dataclass(frozen=True, slots=True)
class Rebounded:
    """The weight bounced and hit the plate again after a drop."""

    point: str
    number: int
    delay: float
    """Time from the trigger of the drop to that of the rebound, s."""
    peak_load: float
    """Peak load, N."""


@dataclass(frozen=True, slots=True)
class PointBegan:
    """Further drops belong to another test point, which the operator has chosen."""

    point: str


@dataclass(frozen=True, slots=True)
class JobReported:
    """Job of the survey (procedure, targets, stations); at the start and after each change."""

    job: Job
    differences: tuple[str, ...] = ()
    """Values in which the requested job differs from that of the survey, one sentence each."""


@dataclass(frozen=True, eq=False, slots=True)
class PointReported:
    """A point that the survey had before this session."""

    point: PointView
    """Point; its values are judged by the listener's job."""
    is_replayed: bool = False
    """True: its drops follow one by one in a replay."""


@dataclass(frozen=True, eq=False, slots=True)
class SurveyRead:
    """All points of the survey that the session records into, as read from the disk."""

    points: tuple[PointView, ...]


@dataclass(frozen=True, slots=True)
class Edited:
    """An edit of a point or drop is saved; recorded data stay as they are."""

    what: str
    """Property, as in `pfwd.files.editing.Edit`."""
    value: Any
    point: str | None
    """Name of the edited point; None: a drop was edited."""
    number: int | None
    """Number of the edited drop within the survey; None: a point was edited."""


@dataclass(frozen=True, slots=True)
class TableBuilding:
    """A response table of the model is being computed, once for a plate and a Poisson's ratio."""

    what: str
    fraction: float


@dataclass(frozen=True, slots=True)
class SessionNotice:
    """Notice for the operator, shown on the screen or in the log."""

    text: str
    serious: bool = False
    details: str = field(default="", repr=False)
    """Text for the log file, such as a traceback."""
    kind: str = ""
    """Kind of a message that an instrument can cause without limit; `Repeats` limits how often it
    is shown. Empty: the message is always shown."""


@dataclass(frozen=True, slots=True)
class BatteryLow(SessionNotice):
    """The instrument reports that its battery is low."""


@dataclass(frozen=True, slots=True)
class DropsWaiting(SessionNotice):
    """Drops wait in the instrument at the end of the session and are not recorded."""


@dataclass(frozen=True, slots=True)
class StorageLow(SessionNotice):
    """The disk is nearly full, or has room again."""

    drops_remaining: int | None = 0
    """Approximate number of drops for which there is room; None: there is enough again."""


@dataclass(frozen=True, slots=True)
class CalibrationChanged(SessionNotice):
    """The calibration of the instrument differs from that of its earlier drops in the survey."""

    serious: bool = True
    waits: bool = False
    """True: nothing is recorded until `Session.accept_calibration` is called with this event."""


@dataclass(frozen=True, slots=True)
class SurveyFilesChanged(SessionNotice):
    """Files of the survey were removed or changed, or its folder cannot be written."""

    serious: bool = True


@dataclass(frozen=True, slots=True)
class DropNotPublished(SessionNotice):
    """The HDF5 file of a drop could not be written; the drop is safe in the survey's journal."""

    serious: bool = True
    point: str = ""
    number: int = 0
    reason: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class SurveyChanged:
    """An event has changed the survey; it follows that event.

    The view is immutable and shares all unchanged points and drops with the views before it.
    """

    view: SurveyView = field(repr=False)
    """Survey with this event and all earlier ones."""
    point: str | None
    """Name of the point that changed; None: the job, or several points."""
    cause: "SessionEvent" = field(repr=False)


SessionEvent = (
    InstrumentReady
    | InstrumentLost
    | LiveSamples
    | InstrumentStatus
    | Ready
    | NotReady
    | SensorCheck
    | DropSaved
    | DropNotSaved
    | DropAnalysed
    | PointDiagnosed
    | DiagnosisAwaited
    | Rebounded
    | PointBegan
    | JobReported
    | PointReported
    | SurveyRead
    | Edited
    | SurveyChanged
    | TableBuilding
    | SessionNotice
)


N_REPORTED_FIRST = 5
"""Number of messages of a kind that are shown one by one, before the limit applies."""

REPEAT_INTERVAL = 60.0
"""Shortest time between later messages of a kind, s; each states the number since the last one. An
instrument can send 100,000 messages a second: with this limit a day has less than 1500 lines."""


class Repeats:
    """Limit for repeated messages, separate for each kind, so that many of one kind hide no other.

    Parameters
    ----------
    clock : callable
        Returns the time, s, monotonic; for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reported: dict[str, int] = {}
        self._last: dict[str, float] = {}
        self._unreported: dict[str, int] = {}

    def due(self, kind: str) -> int | None:
        """Decide whether a message of a kind is shown now.

        Returns
        -------
        int or None
            Number of messages of the kind that were not shown since the last one; None: this
            message is not shown either.
        """
        now = self._clock()
        reported = self._reported.get(kind, 0)
        if reported >= N_REPORTED_FIRST and now - self._last[kind] < REPEAT_INTERVAL:
            self._unreported[kind] = self._unreported.get(kind, 0) + 1
            return None
        self._reported[kind], self._last[kind] = reported + 1, now
        return self.take(kind)

    def take(self, kind: str) -> int:
        """Return the number of messages of a kind that were not shown, and reset it to 0."""
        return self._unreported.pop(kind, 0)

    def rest(self) -> dict[str, int]:
        """Return the numbers of messages that were not shown, by kind, and reset them to 0."""
        unreported, self._unreported = self._unreported, {}
        return unreported
