"""State of a session after its events: device, points, drops. No widget, no thread."""

import datetime
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from pfwd.judging import DropView, Job, PointView, SurveyView
from pfwd.judging.advice import ACTIONABLE_EFFECTS, advice_on_drop, advice_on_point
from pfwd.judging.view import NO_SETUP
from pfwd.message_groups import text_of
from pfwd.procedures import Kind, PointDrop, PointProgress, Procedure, plain_procedure
from pfwd.session.events import (
    BatteryLow,
    DropAnalysed,
    DropNotSaved,
    DropSaved,
    DropsWaiting,
    InstrumentLost,
    InstrumentReady,
    InstrumentStatus,
    JobReported,
    NotReady,
    PointBegan,
    Ready,
    SensorCheck,
    SessionNotice,
    StorageLow,
    SurveyChanged,
    SurveyFilesChanged,
    SurveyRead,
    TableBuilding,
)
from pfwd.session.plan import Ending
from tui.screen.session.device_state import Device, device_of, lost_samples
from tui.screen.session.screen_drop import (
    EMPTY_MEMORY,
    DropInMemory,
    ScreenDrop,
    excluded_sensor_numbers,
    sensor_residuals,
)
from tui.screen.session.screen_events import (
    DiagnosisFinished,
    DropRead,
    Refit,
    ScreenEvent,
    SessionEnded,
    SessionStarted,
)

MAX_NOTICES = 200
"""Number of messages in the help page; the log has all."""

MAX_DROPS_WITH_TRACES = 40
"""Number of drops whose traces stay in memory; others are read again when they are opened."""


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
        """Survey as the session published it last."""
        self.device = Device()
        self.point = ""
        self.saved_at = 0.0
        """Monotonic clock when the newest drop was stored, s; 0: it was read from the survey."""
        self.unsafe: dict[tuple[str, int], str] = {}
        """Drops that are not on the disk, by point and number, with the reason."""
        self.notices: deque[tuple[datetime.datetime, SessionNotice]] = deque(maxlen=MAX_NOTICES)
        self.building: TableBuilding | None = None
        self.setup: Any = None
        self.diagnoses: dict[str, DiagnosisFinished] = {}
        """Requested diagnoses by file."""
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
        self._clock = clock
        self._last: tuple[str, int] | None = None
        self._memory: dict[tuple[str, int], DropInMemory] = {}
        """Drops with traces in memory, in the order in which these came."""

    @property
    def points(self) -> Mapping[str, PointView]:
        """Points of the survey by their names as recorded with their drops."""
        return self.view.points

    @property
    def current(self) -> PointView:
        """Point that is being measured; its name is empty before the first point."""
        return self.points.get(self.point) or PointView(self.point, job=self.job)

    @property
    def last(self) -> ScreenDrop | None:
        """Newest drop."""
        return None if self._last is None else self.drop(*self._last)

    @property
    def current_drops(self) -> dict[int, ScreenDrop]:
        """Drops of the current point by their number."""
        return self.drops_of(self.current)

    def drops_of(self, point: PointView) -> dict[int, ScreenDrop]:
        """Return the drops of a point by their number."""
        drops = {view.number: self._on_disk(point, view) for view in point.drops}
        numbers = [number for name, number in self.unsafe if name == point.name]
        return drops | {number: self._in_memory_alone(point, number) for number in numbers}

    def drop(self, point: str, number: int) -> ScreenDrop | None:
        """Return a drop by its point and number."""
        owner = self.points.get(point) or PointView(point, job=self.job)
        if (point, number) in self.unsafe:
            return self._in_memory_alone(owner, number)
        view = owner.drop(number)
        return None if view is None else self._on_disk(owner, view)

    def _on_disk(self, point: PointView, view: DropView) -> ScreenDrop:
        return ScreenDrop(point, view, self._memory.get((point.name, view.number), EMPTY_MEMORY))

    def _in_memory_alone(self, point: PointView, number: int) -> ScreenDrop:
        view = DropView(PointDrop(number, Kind.MEASURED), 0.0, NO_SETUP)
        return ScreenDrop(point, view, unsafe=self.unsafe[point.name, number])

    @property
    def job(self) -> Job:
        """Job of the survey: procedure, target, stations."""
        return self.view.job

    @property
    def procedure(self) -> Procedure:
        """Procedure that judges the points."""
        return self.job.procedure_in_force

    def advice(self, drop: ScreenDrop | None) -> list[str]:
        """Return sentences of advice on a drop, and on its point once that is complete."""
        if drop is None or not drop.safe or drop.discarded:
            return []
        point, result = drop.owner, drop.result
        further_drops = [view for view in point.drops if view.number != drop.number]
        residual = None
        if result is not None and result.explained is False and not drop.saturated:
            residual = result.contact_residual_rms_over_peak
        advice = advice_on_drop(
            self.job,
            drop.view,
            further_drops,
            contact_residual=residual,
            survey_residuals=() if residual is None else self._survey_residuals_without(drop),
            sensor_residuals=sensor_residuals(drop),
            excluded_sensors=excluded_sensor_numbers(drop),
        )
        progress = point.progress
        if progress.complete:
            loads = {view.number: view.facts.peak_load for view in point.drops}
            advice += advice_on_point(progress, loads)
        diagnoses = [
            result
            for diagnosis in self.diagnoses.values()
            for result in diagnosis.results
            if str(result.point) in (point.name, point.shown_name)
        ]
        if point.diagnosis is not None:
            diagnoses.append(point.diagnosis)
        on_effects = [
            effect.advice
            for result in diagnoses
            for effect in result.effects
            if effect.advice and effect.name in ACTIONABLE_EFFECTS
        ]
        return list(dict.fromkeys([*advice, *on_effects]))

    def _survey_residuals_without(self, excluded: ScreenDrop) -> list[float]:
        """Return the contact residuals of all drops but one, over their peaks."""
        return [
            residual
            for point in self.points.values()
            for view, facts in zip(point.drops, point.facts, strict=True)
            if view is not excluded.view and facts.kind not in (Kind.REJECTED, Kind.DISCARDED)
            if view.result is not None
            and (residual := view.result.contact_residual_rms_over_peak) is not None
        ]

    @property
    def progress(self) -> PointProgress:
        """Progress of the point that is being measured."""
        return self.current.progress

    @property
    def n_unsaved(self) -> int:
        """Number of drops that are not on the disk."""
        return len(self.unsafe)

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
        match event:
            case SurveyChanged(view, _, cause):
                self.view = view
                if isinstance(cause, SurveyRead) and not self.point and cause.points:
                    self.point = cause.points[-1].name
                if self._last is None:
                    self._last = self._newest()
            case JobReported(_, differences):
                for text in differences:
                    self._on_notice(SessionNotice(text, serious=True))
            case InstrumentReady():
                self.device = device_of(event, self.device)
                self.setup = event.setup
                for text in self.device.warnings:
                    self._on_notice(SessionNotice(text))
            case InstrumentLost(reason):
                self.device.connected = self.device.ready = False
                self.device.lost_reason = reason
            case InstrumentStatus():
                self._on_status(event)
            case NotReady(reason):
                self.device.ready, self.device.not_ready_reason = False, reason
            case Ready():
                self.device.ready, self.device.not_ready_reason = True, ""
            case SensorCheck(_, faults):
                self.device.check_faults = tuple(map(text_of, faults))
            case DropSaved(saved):
                key = saved.point, saved.number
                self.unsafe.pop(key, None)
                self.point, self._last, self.saved_at = saved.point, key, self._clock()
                self._remember(key, DropInMemory(saved))
            case DropNotSaved(point, number, reason):
                self.unsafe[point, number] = reason
                self.point, self._last, self.saved_at = point, (point, number), 0.0
            case SurveyFilesChanged(text):
                self.files_trouble = text
                self._on_notice(event)
            case DropAnalysed():
                self._on_analysed(event)
            case PointBegan(name):
                self.point = name
                self._last, self.saved_at = self._newest(), 0.0
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
                    self.point = event.point
                self._last, self.saved_at = self._newest(), 0.0
            case SessionEnded():
                self.session, self.ended = None, event
                self.device.connected = self.device.ready = False
                self.building = None
            case DropRead():
                self._on_read(event)
            case Refit(fault=fault):
                if fault:
                    self._on_notice(SessionNotice(f"drop {event.number}: {fault}", serious=True))
                else:
                    self._on_refit(event)
            case DiagnosisFinished(file, _, error, not_stored):
                self.diagnoses[file] = event
                if reason := error or not_stored:
                    self._on_notice(SessionNotice(reason, serious=True))

    def names_in_use(self) -> set[str]:
        """Names of the points that have drops, and of the stations of the job."""
        points = [point for point in self.points.values() if self.drops_of(point)]
        return {
            *(point.name for point in points),
            *(point.shown_name for point in points),
            *(station.name for station in self.job.stations),
        }

    def drops_in_order(self) -> Iterable[ScreenDrop]:
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

    def _on_analysed(self, event: DropAnalysed) -> None:
        key = event.saved.point, event.saved.number
        memory = self._memory.get(key)
        if memory is None:
            return
        results, curves = memory.results, event.curves or memory.curves
        if event.result.has_ground:
            results = (*results, event.result)
        delay = event.delay if memory.delay is None else memory.delay
        self._memory[key] = replace(memory, results=results, curves=curves, delay=delay)

    def _on_read(self, event: DropRead) -> None:
        results = tuple(result for result in event.results if not result.is_trial)
        key = event.saved.point, event.saved.number
        refits = tuple(
            Refit(*key, result.refit or "", result, None)
            for result in event.results
            if result.is_trial
        )
        self._remember(key, DropInMemory(event.saved, None, results, refits))

    def _on_refit(self, event: Refit) -> None:
        """Add a fit with other settings to its drop, or the curves of the result in force."""
        key = event.point, event.number
        memory = self._memory.get(key, EMPTY_MEMORY)
        if event.label:
            refits = [refit for refit in memory.refits if refit.label != event.label]
            memory = replace(memory, refits=(*refits, event))
        elif event.curves is not None:
            memory = replace(memory, curves=event.curves)
            if not memory.results and event.result is not None:
                memory = replace(memory, results=(event.result,))
        self._memory[key] = memory

    def _remember(self, key: tuple[str, int], memory: DropInMemory) -> None:
        self._memory.pop(key, None)
        self._memory[key] = memory
        stored = [
            name
            for name, drop in self._memory.items()
            if name != self._last and (drop.saved is None or drop.saved.record is not None)
        ]
        for name in stored[: max(0, len(self._memory) - MAX_DROPS_WITH_TRACES)]:
            del self._memory[name]

    def _newest(self) -> tuple[str, int] | None:
        """Return the drop of the current point with the highest number."""
        numbers = [drop.number for drop in self.current.drops]
        return (self.point, max(numbers)) if numbers else None
