"""What the events of a session add up to: device, points, drops. No widget, no thread."""

import datetime
import math
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd_survey.inverting.drop_facts import point_drop
from pfwd_survey.inverting.tasks import Curves
from pfwd_survey.measuring.contents import REFIT_KEY, DropContents, PointContents, peaks_of
from pfwd_survey.measuring.events import (
    DropAnalysed,
    DropNotSaved,
    DropSaved,
    Edited,
    HandedOn,
    InstrumentLost,
    InstrumentReady,
    InstrumentStatus,
    LiveSamples,
    Notice,
    PointBegan,
    Ready,
    Rebounded,
    SensorCheck,
    SessionEvent,
    TableBuilding,
)
from pfwd_survey.measuring.plan import Ending
from pfwd_survey.procedures import Kind, PointDrop, PointProgress, Procedure
from tui.screen.session.procedure import (
    MEASURED,
    SEATING,
    plain_procedure,
    progress_of,
    with_result,
)

MOST_NOTICES = 200
"""Lines that the screen remembers; the log has all."""

USUAL_RADIUS = 0.15
"""m; stands in for the plate before the instrument has said it, when there is no drop to judge."""

MOST_CURVES = 40
"""Drops whose traces stay in memory; older ones are read from the survey when they are opened."""


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

    points: tuple[PointContents, ...]
    drops: bool
    """Whether its drops are to be shown too: in a replay they come one by one."""


@dataclass(frozen=True, eq=False, slots=True)
class DropRead:
    """A drop of the survey with its traces and all its results."""

    one: HandedOn
    results: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True, eq=False, slots=True)
class Refitted:
    """A drop that was fitted anew, with other settings or for its curves alone."""

    point: str
    number: int
    label: str
    """Which settings; empty: for the curves."""
    result: Mapping[str, Any] | None
    curves: Curves | None
    fault: str = ""
    """Why there is no result."""


@dataclass(frozen=True, eq=False, slots=True)
class Diagnosed:
    """What the diagnosis of a file has found."""

    file: str
    records: tuple[Mapping[str, Any], ...]
    """With the keys of ``pfwd diagnose --json``, one a point."""
    error: str = ""


ScreenEvent = (
    SessionEvent | SessionBegan | SessionEnded | ContentsRead | DropRead | Refitted | Diagnosed
)


_NO_JUDGEMENT = (InstrumentStatus, LiveSamples, Notice, Ready, SensorCheck, TableBuilding)
"""Events that come often and change nothing that a procedure judges by: hundreds of points are not
judged anew twice a second."""


@dataclass(slots=True)
class Device:
    """The instrument and its link."""

    url: str = ""
    serial_number: str = ""
    model: str = ""
    firmware: str = ""
    rate: float | None = None
    """Hz."""
    due: datetime.date | None = None
    """The first calibration that expires."""
    battery: float | None = None
    """V."""
    temperature: float | None = None
    lost_samples: int = 0
    connected: bool = False
    lost_reason: str = ""
    ready: bool = False
    """The load at rest is known."""
    battery_low: bool = False
    check_faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(slots=True)
class DropState:
    """A drop."""

    point: str
    number: int
    record: int | None = None
    """Within the survey."""
    status: str = "measured"
    reason: str = ""
    safe: bool = True
    discarded: bool = False
    notes: tuple[str, ...] = ()
    marks: tuple[str, ...] = ()
    one: HandedOn | None = None
    """With its traces; None: they are read when it is opened."""
    curves: Curves | None = None
    """Measured and fitted, of the last answer; None: they are computed when it is opened."""
    results: list[Mapping[str, Any]] = field(default_factory=list)
    """Every answer, in order; the first is never lost."""
    refits: list["Refitted"] = field(default_factory=list)
    """With other settings; the point's mean knows nothing of them."""
    final: bool = False
    """Whether the answer that was waited for is there."""
    peak_load: float = math.nan
    peak_deflection: float = math.nan
    facts: PointDrop | None = None
    """As a procedure sees it; the geophone's response is taken out of its deflection."""
    rebounds: list[float] = field(default_factory=list)
    """Peak loads of the bounces, N."""
    identical: bool | None = None
    came: float = 0.0
    """Monotonic clock when it was safe, s."""
    delay: float | None = None
    """s from its last sample to the first modulus."""

    @property
    def result(self) -> Mapping[str, Any] | None:
        """The last answer."""
        return self.results[-1] if self.results else None

    @property
    def modulus(self) -> float | None:
        """Pa."""
        value = self.result.get("modulus_pa") if self.result else None
        return value if isinstance(value, int | float) and math.isfinite(value) else None

    @property
    def waits(self) -> bool:
        """Whether a first modulus is still to come."""
        return self.safe and not self.results and self.status != "rejected"


@dataclass(frozen=True, slots=True)
class Mean:
    """Of the measured drops of a point."""

    count: int
    modulus: float | None
    """Pa."""
    spread: float | None
    """Standard deviation between drops, Pa; None below two drops."""


@dataclass(slots=True)
class PointState:
    """A test point."""

    name: str
    title: str = ""
    position: tuple[float, float] | None = None
    target: float | None = None
    """Pa."""
    discarded: bool = False
    notes: tuple[str, ...] = ()
    drops: dict[int, DropState] = field(default_factory=dict)

    @property
    def shown_name(self) -> str:
        """What it is called now."""
        return self.title or self.name


class SessionState:
    """Everything the screens show of a session.

    Parameters
    ----------
    procedure : Procedure, optional
        None: seating drops as they are declared, then measured ones.
    target : float, optional
        Of points that have none, Pa.
    clock : callable
        Monotonic, s.
    """

    def __init__(
        self,
        procedure: Procedure | None = None,
        target: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.chosen_procedure = procedure
        self.chosen_target = target
        self.measured = MEASURED
        """Measured drops of a point where no procedure is chosen."""
        self.device = Device()
        self.points: dict[str, PointState] = {}
        self.point = ""
        self.last: DropState | None = None
        """The newest drop."""
        self.notices: deque[tuple[datetime.datetime, Notice]] = deque(maxlen=MOST_NOTICES)
        self.building: TableBuilding | None = None
        self.setup: Any = None
        self.diagnoses: dict[str, Diagnosed] = {}
        """By file."""
        self.session: Any = None
        """The session that runs; None: none does."""
        self.ended: SessionEnded | None = None
        self.storage = ""
        """What there is to say about room on the disk."""
        self.recorded = False
        """Whether drops come from a recording: then nobody has to lift a weight."""
        self.version = 0
        """Grows with every change, so that what is drawn is only drawn anew when it has to be."""
        self.waits_for_first_modulus = True
        self._clock = clock
        self._progress: dict[str, tuple[int, PointProgress]] = {}
        self._judged = 0
        self._with_traces: deque[DropState] = deque()

    @property
    def current(self) -> PointState:
        """The point that drops come to."""
        if not self.point:  # nobody has said yet which it is
            return PointState("")
        return self.points.setdefault(self.point, PointState(self.point))

    @property
    def procedure(self) -> Procedure:
        """The chosen one, or as many seating drops as are declared and then the measured ones."""
        if self.chosen_procedure is not None:
            return self.chosen_procedure
        setup = self.last.one.setup if self.last and self.last.one else self.setup
        return plain_procedure(SEATING if setup is None else setup.seating_drops, self.measured)

    def target_of(self, point: PointState) -> float | None:
        """What a point has to reach, Pa; None: the procedure may still know."""
        return self.chosen_target if point.target is None else point.target

    @property
    def progress(self) -> PointProgress:
        """Of the point that is measured."""
        return self.progress_of(self.current)

    def progress_of(self, point: PointState) -> PointProgress:
        """What the procedure says of a point; computed anew when something has changed."""
        kept = self._progress.get(point.name)
        if kept is not None and kept[0] == self._judged:
            return kept[1]
        drops = [point.drops[number] for number in sorted(point.drops)]
        facts = [
            with_result(one.facts, one.status, one.discarded, one.result)
            for one in drops
            if one.safe and one.facts is not None
        ]
        radius, ratio = self._plate(drops)
        target = self.target_of(point)
        found = progress_of(self.procedure, facts, radius, ratio, target)
        self._progress[point.name] = self._judged, found
        return found

    def mean_of(self, point: PointState) -> Mean:
        """The modulus of a point, over the drops that its procedure uses."""
        used = set(self.progress_of(point).used)
        values = [
            modulus
            for number, one in point.drops.items()
            if number in used and (modulus := one.modulus) is not None
        ]
        if not values:
            return Mean(0, None, None)
        spread = statistics.stdev(values) if len(values) > 1 else None
        return Mean(len(values), statistics.fmean(values), spread)

    def why_left_out(self, drop: DropState) -> str:
        """Why a drop takes no part in the mean of its point; empty: it does, or is no candidate."""
        if drop.status != "measured" or drop.discarded:
            return ""
        owner = self.points.get(drop.point)
        excluded = dict(self.progress_of(owner).excluded) if owner is not None else {}
        return excluded.get(drop.number, "")

    def _plate(self, drops: list[DropState]) -> tuple[float, float | None]:
        """Plate radius, m, and Poisson's ratio of drops."""
        for one in reversed(drops):
            if one.one is not None:
                return one.one.setup.plate_radius, one.one.setup.poisson_ratio
            if one.result and one.result.get("plate_radius_m"):
                return float(one.result["plate_radius_m"]), one.result.get("poisson_ratio")
        if self.setup is not None:
            return self.setup.plate_radius, self.setup.poisson_ratio
        return USUAL_RADIUS, None

    @property
    def held(self) -> int:
        """How many drops the disk has not taken."""
        return sum(not one.safe for point in self.points.values() for one in point.drops.values())

    def take(self, event: ScreenEvent) -> None:
        """Add an event."""
        self.version += 1
        if not isinstance(event, _NO_JUDGEMENT):
            self._judged += 1
        match event:
            case InstrumentReady():
                self._on_ready(event)
            case InstrumentLost(reason):
                self.device.connected = self.device.ready = False
                self.device.lost_reason = reason
            case LiveSamples():
                pass  # they are drawn from their envelope
            case InstrumentStatus():
                self._on_status(event)
            case Ready():
                self.device.ready = True
            case SensorCheck(_, faults):
                self.device.check_faults = faults
            case DropSaved():
                self._on_saved(event)
            case DropNotSaved():
                self._on_not_saved(event)
            case DropAnalysed():
                self._on_analysed(event)
            case Rebounded():
                self._on_rebound(event)
            case PointBegan(name):
                self.point = name
                self.last = self._newest(self.current)
            case Edited():
                self._on_edited(event)
            case TableBuilding():
                self.building = event if event.fraction < 1 else None
            case Notice():
                self._on_notice(event)
            case SessionBegan():
                self._on_began(event)
            case SessionEnded():
                self.session, self.ended = None, event
                self.device.connected = self.device.ready = False
                self.building = None
            case ContentsRead():
                self._on_contents(event)
            case DropRead():
                self._on_read(event)
            case Refitted():
                self._on_refitted(event)
            case Diagnosed(file, _, error):
                self.diagnoses[file] = event
                if error:
                    self._on_notice(Notice(error, serious=True))

    def judge_anew(self) -> None:
        """Procedure or target were changed."""
        self.version += 1
        self._judged += 1

    def drop_of_record(self, record: int) -> DropState | None:
        """By its number within the survey."""
        for point in self.points.values():
            for one in point.drops.values():
                if one.record == record:
                    return one
        return None

    def drops_in_order(self) -> Iterable[DropState]:
        """All of them."""
        for point in self.points.values():
            yield from point.drops.values()

    def _on_began(self, event: SessionBegan) -> None:
        self.session, self.ended = event.session, None
        self.device.lost_reason = ""
        self.point = event.point or self.point
        self.last = self._newest(self.current)

    def _on_ready(self, event: InstrumentReady) -> None:
        identity = event.identity
        dues = [channel.due for channel in identity.channels if channel.due is not None]
        self.device = Device(
            url=event.url,
            serial_number=identity.serial_number,
            model=identity.model,
            firmware=identity.firmware,
            rate=identity.sampling_rate,
            due=min(dues, default=None),
            lost_samples=self.device.lost_samples,
            battery=self.device.battery,
            connected=True,
            warnings=(*event.differences, *event.warnings),
        )
        self.setup = event.setup
        for text in self.device.warnings:
            self._on_notice(Notice(text))

    def _on_status(self, event: InstrumentStatus) -> None:
        self.device.battery = event.status.battery_v
        self.device.temperature = event.status.temperature_c
        self.device.lost_samples = lost_samples(event.counters)

    def _on_notice(self, event: Notice) -> None:
        now = datetime.datetime.now()
        self.notices.append((now, event))
        if event.text.startswith("battery"):
            self.device.battery_low = True
        if "room for" in event.text:
            self.storage = event.text

    def _drop(self, point: str, number: int) -> DropState:
        owner = self.points.setdefault(point, PointState(point))
        if number not in owner.drops:
            owner.drops[number] = DropState(point, number)
        return owner.drops[number]

    def _on_saved(self, event: DropSaved) -> None:
        one = event.one
        drop = self._drop(one.point, one.number)
        known_discarded, notes = drop.discarded, drop.notes
        fresh = DropState(
            one.point,
            one.number,
            record=one.record if one.record is not None else drop.record,
            status=one.screening.status,
            reason=one.screening.reason or "",
            discarded=known_discarded,
            notes=notes,
            marks=event.marks,
            one=one,
            identical=event.identical,
            came=self._clock(),
        )
        self._look_at(fresh, one)
        fresh.final = fresh.status == "rejected" or not self.waits_for_first_modulus
        self.points[one.point].drops[one.number] = fresh
        self.point, self.last = one.point, fresh
        self._remember(fresh)

    @staticmethod
    def _look_at(drop: DropState, one: HandedOn) -> None:
        drop.facts = point_drop(one.drop, one.setup, one.screening)
        drop.peak_load, drop.peak_deflection = peaks_of(one.drop)
        if drop.facts.peak_deflection is not None:
            drop.peak_deflection = drop.facts.peak_deflection

    def _remember(self, drop: DropState) -> None:
        self._with_traces.append(drop)
        while len(self._with_traces) > MOST_CURVES:
            old = self._with_traces.popleft()
            if old is not self.last and old.record is not None:
                old.one = old.curves = None

    def _on_not_saved(self, event: DropNotSaved) -> None:
        drop = self._drop(event.point, event.number)
        drop.safe, drop.reason = False, event.reason
        self.point, self.last = event.point, drop
        self.storage = event.reason

    def _on_analysed(self, event: DropAnalysed) -> None:
        drop = self._drop(event.one.point, event.one.number)
        failed = event.result.get("modulus_pa") is None
        if failed and drop.results:
            # The quick answer stands: a search that failed takes nothing back.
            drop.final = drop.final or event.final
            return
        drop.results.append(event.result)
        drop.final = drop.final or event.final
        if drop.delay is None:
            drop.delay = event.delay
        if failed:
            drop.status = "rejected"
            drop.reason = str(event.result.get("reason") or "the analysis failed")
        if event.curves is not None:
            drop.curves = event.curves

    def _on_rebound(self, event: Rebounded) -> None:
        drop = self._drop(event.point, event.number)
        drop.rebounds.append(event.peak_load)

    def _on_read(self, event: DropRead) -> None:
        one = event.one
        drop = self._drop(one.point, one.number)
        drop.one, drop.record = one, one.record if one.record is not None else drop.record
        self._look_at(drop, one)
        main = [result for result in event.results if REFIT_KEY not in result]
        if not drop.results:
            drop.status, drop.reason = one.screening.status, one.screening.reason or ""
            drop.results = main
        known = {refit.label for refit in drop.refits}
        for result in event.results:
            label = str(result.get(REFIT_KEY) or "")
            if label and label not in known:
                drop.refits.append(Refitted(one.point, one.number, label, result, None))
        self._remember(drop)

    def _on_refitted(self, event: Refitted) -> None:
        drop = self._drop(event.point, event.number)
        if event.fault:
            self._on_notice(Notice(f"drop {event.number}: {event.fault}", serious=True))
        elif event.label:
            drop.refits = [one for one in drop.refits if one.label != event.label]
            drop.refits.append(event)
        elif event.curves is not None:
            drop.curves = event.curves
            if not drop.results and event.result is not None:
                drop.results.append(event.result)

    def _on_edited(self, event: Edited) -> None:
        if event.number is not None:
            drop = self.drop_of_record(event.number)
            if drop is None:
                return
            if event.what in ("discard", "restore"):
                drop.discarded = event.what == "discard"
            elif event.what == "note":
                drop.notes = (*drop.notes, str(event.value))
            return
        if event.point is None:
            return
        point = self.points.setdefault(event.point, PointState(event.point))
        if event.what in ("discard", "restore"):
            point.discarded = event.what == "discard"
        elif event.what == "target":
            point.target = float(event.value) if isinstance(event.value, int | float) else None
        elif event.what == "note":
            point.notes = (*point.notes, str(event.value))
        elif event.what == "name":
            point.title = str(event.value)
        elif event.what == "position" and isinstance(event.value, Mapping):
            point.position = (event.value["latitude"], event.value["longitude"])

    def _on_contents(self, event: ContentsRead) -> None:
        for one in event.points:
            point = self.points.setdefault(one.name, PointState(one.name))
            point.title = one.title
            point.position, point.discarded, point.notes = one.position, one.discarded, one.notes
            point.target = one.target if one.target is not None else point.target
            for kept in one.drops:
                self._on_kept(point, kept, shown=event.drops)
        if event.drops:
            order = [one.name for one in event.points]
            names = [*order, *(name for name in self.points if name not in order)]
            self.points = {name: self.points[name] for name in names}
        if not self.point and event.points:
            self.point = event.points[-1].name
        if self.last is None and self.point:
            self.last = self._newest(self.current)

    def _on_kept(self, point: PointState, kept: DropContents, *, shown: bool) -> None:
        drop = point.drops.get(kept.drop)
        if drop is None:
            if not shown:
                return
            drop = point.drops[kept.drop] = DropState(point.name, kept.drop)
            drop.final = True
        drop.record, drop.discarded, drop.notes = kept.record, kept.discarded, kept.notes
        if kept.result is not None and not drop.results:
            drop.results = [kept.result]
            drop.status = str(kept.result.get("status") or "measured")
            drop.reason = str(kept.result.get("reason") or "")
            drop.peak_load = load_of(kept.result)
            load = drop.peak_load if math.isfinite(drop.peak_load) else None
            drop.facts = PointDrop(drop.number, Kind(drop.status), load)
        elif kept.result is None and drop.one is None:
            drop.status, drop.reason = "rejected", "no result; open it to see why"
        point.drops = dict(sorted(point.drops.items()))

    @staticmethod
    def _newest(point: PointState) -> DropState | None:
        return max(point.drops.values(), key=lambda one: one.number, default=None)


def load_of(result: Mapping[str, Any]) -> float:
    """Peak load of a result, N; NaN when it has none."""
    pulse, radius = result.get("half_sine"), result.get("plate_radius_m")
    if not isinstance(pulse, Mapping) or not isinstance(radius, int | float):
        return math.nan
    pressure = pulse.get("peak_pressure_pa")
    return pressure * math.pi * radius**2 if isinstance(pressure, int | float) else math.nan


def lost_samples(counters: Mapping[str, float | None]) -> int:
    """Samples that did not arrive, wherever they were lost."""
    names = ("samples_lost", "instrument_overruns")
    return int(sum(counters.get(name) or 0 for name in names))
