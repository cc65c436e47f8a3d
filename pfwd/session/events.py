"""Events of a measuring session for its displays. All are immutable."""

import datetime
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from inversion.result import TimeHistories
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd.judging import DropView, Job, PointView
from pfwd_device.acquisition.items import Disconnected, Samples
from pfwd_device.drop import Drop
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Status


@dataclass(frozen=True, slots=True)
class InstrumentReady:
    """The instrument answers, and what is declared of it is complete."""

    url: str
    identity: Identity
    """Identity of the instrument, with the values of the setup file in place of its own."""
    setup: PointSetup
    """Declarations for the points to come."""
    differences: tuple[str, ...]
    """Differences of the setup file from the instrument."""
    warnings: tuple[str, ...]
    """Warnings on calibration and response of the channels."""
    again: bool
    """True: the instrument was lost before."""


@dataclass(frozen=True, slots=True)
class CalibrationChanged:
    """The instrument is calibrated otherwise than for the drops that the survey has of it."""

    serial_number: str
    changes: tuple[str, ...]
    """Changes, one phrase each."""
    waits: bool
    """Nothing is recorded until `Session.accept_calibration` is called with this event."""

    @property
    def text(self) -> str:
        """Sentence for people."""
        return (
            f"calibration of {self.serial_number} changed since its last drop in this survey: "
            f"{'; '.join(self.changes)}"
        )


@dataclass(frozen=True, slots=True)
class InstrumentLost:
    """The instrument is gone; the session waits for it."""

    reason: str
    time_utc: datetime.datetime

    @classmethod
    def of(cls, item: Disconnected) -> "InstrumentLost":
        """Return the event for a message of the driver."""
        return cls(item.reason, item.time_utc)


@dataclass(frozen=True, eq=False, slots=True)
class LiveSamples:
    """Samples as they stream, for a live display."""

    samples: Samples
    identity: Identity
    drop_load: float
    """Load above rest that starts a drop, N."""


@dataclass(frozen=True, slots=True)
class InstrumentStatus:
    """State of the instrument and of the link."""

    status: Status
    counters: Mapping[str, float | None]
    """Counts of discarded items by name, and the drift of the clock."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The load at rest is known: the detection finds drops from now on."""


@dataclass(frozen=True, slots=True)
class SensorCheck:
    """Zero and span of the load cell, noise of every channel."""

    details: Mapping[str, Any]
    """Details as recorded: zero_n, span_ratio, noise by channel."""
    faults: tuple[str, ...]
    """Faults, one sentence each; empty: none."""


@dataclass(frozen=True, eq=False, slots=True)
class SavedDrop:
    """A drop of the survey with its traces, which the view does not keep."""

    point: str
    """Name of its test point."""
    view: DropView
    """The screened drop."""
    drop: Drop
    """Traces."""
    file: str = ""
    """Path of the drop for its results."""
    spare: str | None = None
    """Folder that keeps it because the survey's own does not take it; None: the survey has it."""
    received: float | None = None
    """Monotonic clock when its last sample had come from the instrument, s; None: in a replay."""

    @property
    def number(self) -> int:
        """Number within the point."""
        return self.view.number

    @property
    def record(self) -> int | None:
        """Number within the survey; None: it is not saved by this session."""
        return self.view.record

    @property
    def setup(self) -> PointSetup:
        """Declared setup."""
        return self.view.setup

    @property
    def screening(self) -> Screening:
        """Screening by its record and by the drops before it."""
        assert self.view.screening is not None
        return self.view.screening


@dataclass(frozen=True, eq=False, slots=True)
class DropSaved:
    """A drop is safe: it is acknowledged with this. (In a replay it was safe before.)"""

    saved: SavedDrop
    identical: bool | None = None
    """In a replay: whether the traces are the recorded ones, bit for bit."""


@dataclass(frozen=True, eq=False, slots=True)
class DropNotSaved:
    """A drop is NOT safe: the disk did not take it; it is kept in memory and tried again."""

    point: str
    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class SurveyFilesChanged:
    """Files of the survey were removed, its folder cannot be written, or all is well again."""

    text: str
    """Sentence for people."""
    safe: bool
    """Everything acknowledged is in the survey's own folder again."""


@dataclass(frozen=True, slots=True)
class DropNotPublished:
    """A drop has no file of its own yet; it is safe in the journal."""

    point: str
    number: int
    reason: str

    @property
    def text(self) -> str:
        """Sentence for people."""
        return (
            f"drop {self.point}/{self.number} has no file of its own yet (it is safe in the "
            f"journal; pfwd recover makes the file): {self.reason}"
        )


@dataclass(frozen=True, eq=False, slots=True)
class DropAnalysed:
    """Modulus of a drop, or the reason why it has none."""

    saved: SavedDrop
    delay: float | None
    """Time from the last sample of the drop to now, s; None: in a replay."""
    result: DropResult
    curves: TimeHistories | None
    """Time histories for a display; None when the analysis failed."""
    full: bool
    """Result of the full search; a quick answer came before."""
    final: bool
    """No other answer follows."""


@dataclass(frozen=True, eq=False, slots=True)
class PointDiagnosed:
    """Diagnosis of a point with the drops that it has now."""

    point: str
    result: DiagnosisResult


@dataclass(frozen=True, slots=True)
class Rebounded:
    """The hammer bounced after a drop."""

    point: str
    number: int
    delay: float
    """Time after the trigger of the drop, s."""
    peak_load: float
    """Peak load, N."""


@dataclass(frozen=True, slots=True)
class PointBegan:
    """Further drops belong to this test point, on request."""

    point: str


@dataclass(frozen=True, slots=True)
class JobReported:
    """Job of the survey, at the start and after each change."""

    job: Job
    differences: tuple[str, ...] = ()
    """Differences of a request from the job of the survey, one sentence each."""


@dataclass(frozen=True, eq=False, slots=True)
class PointReported:
    """A point that the survey holds already."""

    point: PointView
    """The point; its job is that of the listener."""
    is_replayed: bool = False
    """Its drops come again, one by one, in a replay."""


@dataclass(frozen=True, slots=True)
class Edited:
    """An edit of a point or of a drop is safe; nothing recorded has changed."""

    what: str
    """Kind of the edit, as in `pfwd.files.editing.Edit`."""
    value: Any
    point: str | None
    """Name of the point; None: it is about a drop."""
    number: int | None
    """Number of the drop within the survey."""


@dataclass(frozen=True, slots=True)
class TableBuilding:
    """A response table of the model is being built, once for a plate and a Poisson's ratio."""

    what: str
    fraction: float


@dataclass(frozen=True, slots=True)
class Notice:
    """Message for people."""

    text: str
    serious: bool = False
    details: str = field(default="", repr=False)
    """Details for the log."""
    kind: str = ""
    """Kind of a notice that an instrument can cause as often as it likes: a session reports only
    some of a kind, see `Repeats`. Empty: it is always reported."""


@dataclass(frozen=True, slots=True)
class BatteryLow(Notice):
    """The instrument reports a low battery."""


@dataclass(frozen=True, slots=True)
class StorageLow(Notice):
    """The disk is filling, or has room again."""

    drops_remaining: int | None = 0
    """Approximate number of drops for which there is room; None: there is room again."""


SessionEvent = (
    InstrumentReady
    | CalibrationChanged
    | InstrumentLost
    | LiveSamples
    | InstrumentStatus
    | Ready
    | SensorCheck
    | DropSaved
    | DropNotSaved
    | SurveyFilesChanged
    | DropNotPublished
    | DropAnalysed
    | PointDiagnosed
    | Rebounded
    | PointBegan
    | JobReported
    | PointReported
    | Edited
    | TableBuilding
    | Notice
)


N_REPORTED_FIRST = 5
"""Number of notices of a kind that are reported one by one, because each may be news."""

REPEAT_INTERVAL = 60.0
"""s; shortest time between later reports of a kind, each with the number since the last one. An
instrument can send a hundred thousand messages a second: a day of them is less than 1500 lines."""


class Repeats:
    """Limits for repeated notices, for each kind by itself: a flood of one kind hides no other.

    Parameters
    ----------
    clock : callable
        Seconds, for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._reported: dict[str, int] = {}
        self._last: dict[str, float] = {}
        self._unreported: dict[str, int] = {}

    def due(self, kind: str) -> int | None:
        """Return the number of unreported notices of the kind; None: this one is not reported
        either."""
        now = self._clock()
        reported = self._reported.get(kind, 0)
        if reported >= N_REPORTED_FIRST and now - self._last[kind] < REPEAT_INTERVAL:
            self._unreported[kind] = self._unreported.get(kind, 0) + 1
            return None
        self._reported[kind], self._last[kind] = reported + 1, now
        return self.take(kind)

    def take(self, kind: str) -> int:
        """Return the number of unreported notices of a kind, and forget them."""
        return self._unreported.pop(kind, 0)

    def rest(self) -> dict[str, int]:
        """Return the number of unreported notices of each kind, and forget them."""
        unreported, self._unreported = self._unreported, {}
        return unreported
