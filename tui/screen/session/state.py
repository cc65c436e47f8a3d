"""State of a session after its events: device, points, drops. No widget, no thread."""

import datetime
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from pfwd.analysis.results import DiagnosisResult
from pfwd.judging import Job, PointView, SurveyView, value_of_drop
from pfwd.judging.advice import ACTIONABLE_EFFECTS, advice_on_drop, advice_on_point
from pfwd.procedures import Kind, PointProgress, PointValue, Procedure, plain_procedure
from pfwd.session.events import (
    BatteryLow,
    CalibrationChanged,
    DiagnosisAwaited,
    DropAnalysed,
    DropNotPublished,
    DropNotSaved,
    DropSaved,
    DropsWaiting,
    Edited,
    InstrumentLost,
    InstrumentReady,
    InstrumentStatus,
    JobReported,
    LiveSamples,
    NotReady,
    PointBegan,
    PointDiagnosed,
    PointReported,
    Ready,
    Rebounded,
    SensorCheck,
    SessionNotice,
    StorageLow,
    SurveyFilesChanged,
    TableBuilding,
)
from pfwd.session.live_view import apply_event, with_stored
from pfwd.session.plan import Ending
from tui.screen.session.device_state import Device, device_of, lost_samples
from tui.screen.session.drop_state import (
    DropState,
    add_read,
    add_refit,
    add_result,
    add_stored,
    excluded_sensor_numbers,
    saved_drop,
    sensor_residuals,
)
from tui.screen.session.screen_events import (
    DiagnosisFinished,
    DropRead,
    Refit,
    ScreenEvent,
    SessionEnded,
    SessionStarted,
    SurveyRead,
)

MAX_NOTICES = 200
"""Number of messages in the help page; the log has all."""

MAX_DROPS_WITH_TRACES = 40
"""Number of drops whose traces stay in memory; others are read again when they are opened."""

_JUDGING_EVENTS = (
    JobReported,
    PointReported,
    DropSaved,
    DropAnalysed,
    PointDiagnosed,
    DiagnosisAwaited,
    Edited,
)
"""Events that can change the verdict of a point."""


class SessionState:
    """State of a session as all pages show it.

    Parameters
    ----------
    procedure : Procedure, optional
        By default the declared number of seating drops, then measured drops.
    target : float, optional
        Target of points without their own, Pa.
    clock : callable
        Monotonic clock, s.
    """

    def __init__(
        self,
        procedure: Procedure | None = None,
        target: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.view = SurveyView(Job(procedure=procedure or plain_procedure(), target=target))
        """Survey, judged by its own job once that is known."""
        self.device = Device()
        self.drops: dict[str, dict[int, DropState]] = {}
        """Drops by the name of their point and by their number."""
        self.point = ""
        self.last: DropState | None = None
        """Newest drop."""
        self.notices: deque[tuple[datetime.datetime, SessionNotice]] = deque(maxlen=MAX_NOTICES)
        self.building: TableBuilding | None = None
        self.setup: Any = None
        self.diagnoses: dict[str, DiagnosisFinished] = {}
        """Requested diagnoses by file."""
        self.diagnosed: dict[str, DiagnosisResult] = {}
        """Diagnoses made while measuring, by point."""
        self.session: Any = None
        """Session that runs; None: there is none."""
        self.ended: SessionEnded | None = None
        self.drops_remaining: int | None = None
        """Number of drops for which the disk has room, once that is low."""
        self.files_trouble = ""
        """Reason why drops are not in the folder of the survey; empty: all are."""
        self.drops_waiting = ""
        """Report of drops that wait in the instrument since the end of the session; empty: none."""
        self.recorded = False
        """True if drops come from a recording."""
        self.version = 0
        """Counter of changes; the page is drawn again when it has grown."""
        self.waits_for_first_modulus = True
        self._clock = clock
        self._with_traces: deque[DropState] = deque()

    @property
    def points(self) -> Mapping[str, PointView]:
        """Points of the survey by their names as recorded with their drops."""
        return self.view.points

    @property
    def current(self) -> PointView:
        """Point that is being measured; its name is empty before the first point."""
        return self.points.get(self.point) or PointView(self.point, job=self.job)

    @property
    def current_drops(self) -> dict[int, DropState]:
        """Drops of the current point by their number."""
        return self.drops_of(self.current)

    def drops_of(self, point: PointView) -> dict[int, DropState]:
        """Return the drops of a point by their number."""
        return self.drops.get(point.name, {})

    @property
    def job(self) -> Job:
        """Job of the survey: procedure, target, stations."""
        return self.view.job

    @property
    def procedure(self) -> Procedure:
        """Procedure that judges the points."""
        return self.job.procedure_in_force

    def advice(self, drop: DropState | None) -> list[str]:
        """Return sentences of advice on a drop, and on its point once that is complete."""
        if drop is None or drop.point not in self.points or drop.discarded:
            return []
        point = self.points[drop.point]
        facts = point.drop(drop.number)
        if facts is None:
            return []
        further_drops = [view for view in point.drops if view.number != drop.number]
        result = drop.result
        residual = None
        if result is not None and result.explained is False and not drop.saturated:
            residual = result.contact_residual_rms_over_peak
        advice = advice_on_drop(
            self.job,
            facts,
            further_drops,
            contact_residual=residual,
            survey_residuals=() if residual is None else self._survey_residuals_without(drop),
            sensor_residuals=sensor_residuals(drop),
            excluded_sensors=excluded_sensor_numbers(drop),
        )
        progress = point.progress
        if progress.complete:
            views = (facts, *further_drops)
            loads = {view.facts.number: view.facts.peak_load for view in views}
            advice += advice_on_point(progress, loads)
        diagnoses = [
            result
            for diagnosis in self.diagnoses.values()
            for result in diagnosis.results
            if str(result.point) in (point.name, point.shown_name)
        ]
        if point.name in self.diagnosed:
            diagnoses.append(self.diagnosed[point.name])
        on_effects = [
            effect.advice
            for result in diagnoses
            for effect in result.effects
            if effect.advice and effect.name in ACTIONABLE_EFFECTS
        ]
        return list(dict.fromkeys([*(item.text for item in advice), *on_effects]))

    def _survey_residuals_without(self, excluded: DropState) -> list[float]:
        """Return the contact residuals of all drops but one, over their peaks."""
        return [
            residual
            for drop in self.drops_in_order()
            if drop is not excluded and drop.status != "rejected" and not drop.discarded
            if drop.result is not None
            and (residual := drop.result.contact_residual_rms_over_peak) is not None
        ]

    def value_of(self, drop: DropState | None) -> PointValue | None:
        """Return the quantity that the procedure judges, for one drop; None: not known."""
        if drop is None:
            return None
        point = self.points.get(drop.point)
        facts = None if point is None else point.drop(drop.number)
        return None if facts is None else value_of_drop(self.job, facts)

    @property
    def progress(self) -> PointProgress:
        """Progress of the point that is being measured."""
        return self.current.progress

    def exclusion_reason(self, drop: DropState) -> str:
        """Return why a measured drop is excluded from the mean of its point; empty: it is not."""
        if drop.status != "measured" or drop.discarded:
            return ""
        owner = self.points.get(drop.point)
        excluded = owner.progress.excluded if owner is not None else ()
        return next(
            (exclusion.reason for exclusion in excluded if exclusion.number == drop.number), ""
        )

    @property
    def n_unsaved(self) -> int:
        """Number of drops that are not on the disk."""
        return sum(not drop.safe for drop in self.drops_in_order())

    @property
    def exit_status(self) -> int:
        """Exit status of the program if it ended now."""
        ended = self.ended
        if ended is None:
            return 0
        if ended.ending is None:
            return 1 if ended.retry is None else 0
        return {Ending.DONE: 0, Ending.UNSAVED: 1, Ending.LOST: 3}[ended.ending]

    def take(self, event: ScreenEvent) -> None:
        """Update the state by an event of the session or of the screen."""
        self.version += 1
        changed = None
        if isinstance(event, _JUDGING_EVENTS):
            self.view, changed = apply_event(self.view, event)
        self._take(event)
        if isinstance(event, JobReported):
            for point in self.points.values():
                self._classify_drops(point)
        elif changed is not None:
            self._classify_drops(self.points[changed])

    def _classify_drops(self, point: PointView) -> None:
        """Set the views of the drops of a point, and their kinds, which depend on each other."""
        progress = point.progress
        drops = self.drops_of(point)
        for view in point.drops:
            if view.number in drops:
                drops[view.number].view = view
                drops[view.number].withheld = progress.withheld
                drops[view.number].diagnosed = point.counting_diagnosis
        reasons = {drop.number: drop.reason for drop in progress.excluded}
        for number, kind in progress.kinds:
            drop = drops.get(number)
            if drop is None:
                continue
            if kind is Kind.DISCARDED:
                continue
            drop.status = kind.value
            if kind is Kind.REJECTED and not drop.reason:
                drop.reason = reasons.get(number, "").removeprefix("rejected: ")

    def _take(self, event: ScreenEvent) -> None:
        match event:
            case JobReported(_, differences):
                for text in differences:
                    self._on_notice(SessionNotice(text, serious=True))
            case InstrumentReady():
                self.device = device_of(event, self.device)
                self.setup = event.setup
                for text in self.device.warnings:
                    self._on_notice(SessionNotice(text))
            case CalibrationChanged() | DropNotPublished():
                self._on_notice(SessionNotice(event.text, serious=True))
            case InstrumentLost(reason):
                self.device.connected = self.device.ready = False
                self.device.lost_reason = reason
            case LiveSamples():
                pass  # they are drawn from their envelope
            case InstrumentStatus():
                self._on_status(event)
            case NotReady(reason):
                self.device.ready, self.device.not_ready_reason = False, reason
            case Ready():
                self.device.ready, self.device.not_ready_reason = True, ""
            case SensorCheck(_, faults):
                self.device.check_faults = faults
            case DropSaved():
                self._on_saved(event)
            case DropNotSaved(point, number, reason):
                drop = self._drop(point, number)
                drop.safe, drop.reason = False, reason
                self.point, self.last = point, drop
            case SurveyFilesChanged(text):
                self.files_trouble = text
                self._on_notice(SessionNotice(text, serious=True))
            case DropAnalysed():
                add_result(self._drop(event.saved.point, event.saved.number), event)
            case PointDiagnosed(name, result):
                self.diagnosed[name] = result
            case Rebounded():
                self._drop(event.point, event.number).rebounds.append(event.peak_load)
            case PointBegan(name):
                self._begin_point(name)
                self.last = self._newest()
            case Edited(number=record):
                edited = None if record is None else self.drop_of_record(record)
                if edited is not None and event.what == "restore":
                    # The reason of a moved drop is that it was moved.
                    screening = None if edited.saved is None else edited.saved.screening
                    edited.reason = "" if screening is None else screening.reason or ""
            case TableBuilding():
                self.building = event if event.fraction < 1 else None
            case BatteryLow():
                self.device.battery_low = True
                self._on_notice(event)
            case StorageLow(drops_remaining=count):
                self.drops_remaining = count
                self._on_notice(event)
            case DropsWaiting(text):
                self.drops_waiting = text
                self._on_notice(event)
            case SessionNotice():
                self._on_notice(event)
            case SessionStarted():
                self.session, self.ended, self.drops_waiting = event.session, None, ""
                self.device.lost_reason = ""
                if event.point:
                    self._begin_point(event.point)
                self.last = self._newest()
            case SessionEnded():
                self.session, self.ended = None, event
                self.device.connected = self.device.ready = False
                self.building = None
            case SurveyRead():
                self._on_contents(event)
            case DropRead(saved):
                drop = self._drop(saved.point, saved.number)
                add_read(drop, event)
                self._remember(drop)
            case Refit(fault=fault):
                drop = self._drop(event.point, event.number)
                if fault:
                    self._on_notice(SessionNotice(f"drop {event.number}: {fault}", serious=True))
                else:
                    add_refit(drop, event)
            case DiagnosisFinished(file, _, error):
                self.diagnoses[file] = event
                if error:
                    self._on_notice(SessionNotice(error, serious=True))

    def names_in_use(self) -> set[str]:
        """Names of the points that have drops, and of the stations of the job."""
        points = [point for point in self.points.values() if self.drops_of(point)]
        return {
            *(point.name for point in points),
            *(point.shown_name for point in points),
            *(station.name for station in self.job.stations),
        }

    def drop_of_record(self, record: int) -> DropState | None:
        """Return a drop by its number within the survey."""
        return next((drop for drop in self.drops_in_order() if drop.record == record), None)

    def drops_in_order(self) -> Iterable[DropState]:
        """Yield all drops, point by point."""
        for point in self.points.values():
            yield from self.drops_of(point).values()

    def _on_status(self, event: InstrumentStatus) -> None:
        self.device.battery = event.status.battery_v
        self.device.temperature = event.status.temperature_c
        if self.device.overruns_before is None:
            self.device.overruns_before = event.counters.get("instrument_overruns") or 0
        before = self.device.overruns_before
        self.device.lost_samples = lost_samples(event.counters, before)

    def _on_notice(self, event: SessionNotice) -> None:
        self.notices.append((datetime.datetime.now(), event))

    def _drop(self, point: str, number: int) -> DropState:
        self._add_point(point)
        return self.drops.setdefault(point, {}).setdefault(number, DropState(point, number))

    def _on_saved(self, event: DropSaved) -> None:
        saved = event.saved
        self._drop(saved.point, saved.number)
        fresh = saved_drop(event, self._clock())
        fresh.final = fresh.status == "rejected" or not self.waits_for_first_modulus
        self.drops[saved.point][saved.number] = fresh
        self.point, self.last = saved.point, fresh
        self._remember(fresh)

    def _remember(self, drop: DropState) -> None:
        self._with_traces.append(drop)
        while len(self._with_traces) > MAX_DROPS_WITH_TRACES:
            old = self._with_traces.popleft()
            if old is not self.last and old.record is not None:
                old.saved = old.curves = None

    def _on_contents(self, event: SurveyRead) -> None:
        self.view = with_stored(self.view, event.points, is_replayed=not event.drops)
        for stored in event.points:
            for drop in stored.drops:
                state = self.drops.get(stored.name, {}).get(drop.number)
                if state is None and event.drops:
                    state = self._drop(stored.name, drop.number)
                    state.final = True
                if state is not None:
                    add_stored(state, drop)
            if event.drops:
                drops = self.drops_of(stored)
                self.drops[stored.name] = {number: drops[number] for number in sorted(drops)}
            self._classify_drops(self.points[stored.name])
        if event.drops:
            stored_first = {point.name: self.points[point.name] for point in event.points}
            self.view = replace(self.view, points=stored_first | {**self.points})
        if not self.point and event.points:
            self.point = event.points[-1].name
        if self.last is None and self.point:
            self.last = self._newest()

    def _begin_point(self, name: str) -> None:
        self.point = name
        self._add_point(name)

    def _add_point(self, name: str) -> None:
        if name not in self.points:
            self.view = self.view.with_points([PointView(name)])

    def _newest(self) -> DropState | None:
        """Return the drop of the current point with the highest number."""
        return max(self.current_drops.values(), key=lambda drop: drop.number, default=None)
