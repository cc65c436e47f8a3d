"""Measuring session: detects drops in the samples of a feed, saves them, and has them inverted.

A session runs in the thread that calls `run`, and reports events to its listener in that thread.
The driver of an instrument reads in a thread of its own, and drops are inverted in another process.
"""

import contextlib
import dataclasses
import datetime
import math
import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from inversion.notices import codes
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.errors import OptionError
from pfwd.files.editing import Edit
from pfwd.files.record_marks import MARKS
from pfwd.judging import Job, JobRequest, PointView, SurveyView
from pfwd.judging.drops import RATE_DEVIATION
from pfwd.judging.stations import similar_name
from pfwd.session.buffered_drops import (
    NOT_BUFFERED,
    OFFER_WAIT_S,
    StreamedDrops,
    StreamedItem,
    UnrecordedDrops,
    marks_of_buffered,
    raw_drop_of,
    settings_of,
    trigger_differences,
    trigger_for,
)
from pfwd.session.calibration_change import CalibrationCheck
from pfwd.session.drop_metadata import metadata_of, pulse_event, rebound_of, state_of
from pfwd.session.drop_pipeline import DropPipeline, renumbered
from pfwd.session.edits import apply_edit, apply_move
from pfwd.session.events import (
    BatteryLow,
    CalibrationChanged,
    DropSaved,
    InstrumentLost,
    InstrumentReady,
    InstrumentStatus,
    JobReported,
    LiveSamples,
    NotReady,
    PointBegan,
    PointDiagnosed,
    Ready,
    Repeats,
    SensorCheck,
    SessionEvent,
    SessionNotice,
)
from pfwd.session.feeds import Ended, Feed, FeedItem, ImportedDrop, RecordedDrop
from pfwd.session.live_view import apply_event, point_of_record
from pfwd.session.plan import Ending, SessionPlan, instrument_request, session_job
from pfwd.session.sensor_check import SensorChecker
from pfwd.session.setup_file import response_warnings, setup_of
from pfwd.session.stored_drops import point_event, read_point_event
from pfwd_device.acquisition.detection import (
    DetectionSettings,
    PulseReason,
    PulseReport,
    RawDrop,
    RawRebound,
    ReboundsOver,
)
from pfwd_device.acquisition.detector import DetectedItem, Detector
from pfwd_device.acquisition.items import (
    BufferedDrop,
    Connected,
    Disconnected,
    Gap,
    RateDeviation,
    RepeatedSamples,
    Samples,
    StreamBegan,
    UnusableDrop,
)
from pfwd_device.calibration import calibrate, calibration_warnings, load_channel, sensor_channels
from pfwd_device.drop import Drop
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.identity import Identity
from pfwd_device.recording.record import DropRecord, ReboundRecord, point_name
from pfwd_device.recording.survey_reader import SurveyPoint
from pfwd_device.recording.survey_writer import SurveyWriter
from pfwd_device.wire.messages import Armed, Event, EventKind, Refusal, Status, Trigger

__all__ = ["Ending", "Listener", "Session", "SessionPlan"]

FIRST_POINT = "1"
"""Name of the first point if none is declared."""

FEED_WAIT = 0.02
"""Longest wait for the feed, s, and thereby for the handling of results and requests."""

MAX_UNANSWERED = 4
"""Number of pending analyses above which a replay waits before its next item."""

LAST_ANSWERS = 120.0
"""Longest wait for the last analyses at the end of a session, s."""

STOPPED_ANSWERS = 2.0
"""The same if the session was stopped, s, so that it ends within 5 s: the quick fit takes 0.2 s and
the full search 0.4 s. A drop without a result can be inverted later."""

STOPPED_DROP = 1.0
"""Time that a stopped session waits for the rest of the current drop beyond its length, s. An
instrument that triggers and then sends no samples would otherwise prevent the end."""

TRIGGER_PAUSE = 1.0
"""Shortest time between two triggers by the instrument, s of samples. Nobody presses a button more
often, and each trigger makes a drop."""

BOUNCES_END = 2.5
"""Time after a drop within which an impact is a bounce of the weight, s: nobody lifts it sooner."""

BOUNCE_OVER_DROP = 0.6
"""Largest peak load of a bounce over that of the drop; with rubber springs the first bounce has
half of it."""

Listener = Callable[[SessionEvent], None]


class Session:
    """One measurement or replay.

    Parameters
    ----------
    feed : Feed
    listener : callable
        Receives the events, in the thread of `run`; the session waits for it to return.
    plan : SessionPlan, optional
        None: the defaults.
    writer : SurveyWriter, optional
        Survey to record into; None: nothing is recorded.
    replayed : sequence of SurveyPoint
        Points of the survey that is replayed, each reported before the first of its drops.
    """

    def __init__(
        self,
        feed: Feed,
        listener: Listener,
        plan: SessionPlan | None = None,
        writer: SurveyWriter | None = None,
        replayed: Sequence[SurveyPoint] = (),
    ) -> None:
        self._feed = feed
        self._replayed = {point.name: point for point in replayed}
        self._listener = listener
        self._repeats = Repeats()
        self._stored_events = Repeats()
        plan = plan or SessionPlan()
        job = session_job(plan, None if writer is None else writer.contents())
        self._plan = replace(plan, setup=job.setup)
        self._job, self._job_request = job.recorded, job.request
        self._differences = job.differences
        self._reported_points: set[str] = set()
        stored_points = writer.points if writer is not None else ()
        stations = self.job.stations
        first = stations[0].name if stations else FIRST_POINT
        self._point = self._plan.named_point or (stored_points[-1] if stored_points else first)
        self._view = SurveyView(self.job)
        if writer is not None:
            self._view = self._view.with_points([PointView(self._point)])
        self._pipeline = DropPipeline(
            self.report, self._plan.options, writer, lambda: self._view, live=feed.live
        )
        self._recorder, self._analyses = self._pipeline.recorder, self._pipeline.analyses
        self._stop = False
        self._stop_by = math.inf
        self._operator = False
        self._ended = False
        self._identity: Identity | None = None
        self._connected: Connected | None = None
        self._declared: dict[str, Any] = {}
        self._detector: Detector | None = None
        self._stream: int | None = None
        self._was_ready = self._shunted = False
        self._connection_stored = True
        self._sampled = self._next_trigger = 0
        self._checker: SensorChecker | None = None
        self._last_check: dict[str, Any] | None = None
        self._last_samples: Samples | None = None
        self._rate_deviation: float | None = None
        """True over declared sampling rate minus 1; None: no deviation is known."""
        self._records: list[int] = []
        """Drops since the instrument was connected, by their numbers within the survey."""
        self._status: Status | None = None
        self._unrecorded = UnrecordedDrops(self.report, self._recorder)
        self._calibrations = CalibrationCheck(
            self.report, self._recorder if feed.live else None, self._plan.changed_calibration
        )
        self._unanswered: Connected | None = None
        """Connection whose changed calibration the operator has not accepted yet."""
        self._postponed: list[BufferedDrop | Armed] = []
        """Items that arrived before the operator has accepted the calibration."""
        self._armed: Trigger | None = None
        """Trigger settings of an instrument that detects drops; None: this program detects them."""
        self._streamed = StreamedDrops()
        self._recorded: RecordedDrop | None = None
        self._redetected = True
        self._fell: tuple[datetime.datetime, float, tuple[str, int]] | None = None
        """Time of the last drop, its peak load (N), its point and number."""
        self._interrupted = False
        """True: samples are missing since the last drop."""
        self._requests: queue.SimpleQueue[Callable[[Session], None]] = queue.SimpleQueue()

    @property
    def point(self) -> str:
        """Name of the test point to which the next drop belongs."""
        return self._point

    @property
    def job(self) -> Job:
        """Procedure, targets and stations of the survey, with the changes requested for this
        session.
        """
        return self._job.with_request(self._job_request)

    def change_job(self, request: JobRequest) -> None:
        """Change the job of the survey; another procedure takes effect in the next session.

        Raises
        ------
        RecordingError
            If nothing is recorded, or the survey cannot be written.
        """
        writer = self._writer("job")
        news = request.news(self.job)
        for kind, details in news.events():
            writer.note_event(kind, details)
        self._job = self._job.with_request(news)
        self.report(JobReported(self.job))

    def counters(self) -> dict[str, float | None]:
        """Return the numbers of discarded messages by kind; may be called from any thread."""
        return self._feed.counters()

    def set_point(self, name: str) -> None:
        """Set the test point to which the next drops belong.

        Raises
        ------
        RecordingError
            If the name is not valid.
        """
        self._point = point_name(name)
        self._report_stored_point(self._point)
        if self._recorder is not None and self._declared:
            self._recorder.keep_point(self._point, self._declared)
        self.report(PointBegan(self._point))

    def edit(self, edit: Edit, *, point: str | None = None, number: int | None = None) -> None:
        """Edit a point by its name, or a drop by its number within the survey.

        Raises
        ------
        RecordingError
            If nothing is recorded, there is no such point or drop, or the survey cannot be written.
        """
        for event in apply_edit(self._writer("edit"), edit, point, number):
            self.report(event)
        if edit.what == "discard" and number is not None and self._pipeline.diagnoses is not None:
            self._pipeline.diagnoses.discard(number)

    def move_drop(self, number: int, to: str) -> None:
        """Move a drop, by its number within the survey, to a point: its name, title, or a new name.

        Raises
        ------
        RecordingError
            If nothing is recorded, there is no such drop, or the survey cannot be written.
        OptionError
            If the drop cannot be moved there.
        """
        writer = self._writer("move")
        to, event = apply_move(writer, number, to)
        self.report(event)
        # The moved drop is a new record of the survey, from which the point is read again.
        stored = read_point_event(writer, to)
        if stored is not None:
            self._reported_points.add(to)
            self.report(stored)

    def _writer(self, where: str) -> SurveyWriter:
        """Return the writer of the survey; raise RecordingError if nothing is recorded."""
        if self._recorder is None:
            expected = "expected a session that records, got a replay without output"
            raise RecordingError(f"{where}: {expected}")
        return self._recorder.writer

    def keep_result(self, number: int, result: DropResult) -> None:
        """Save a further result of a drop; earlier results stay.

        Parameters
        ----------
        number : int
            Number of the drop within the survey.
        result : DropResult
        """
        if self._recorder is not None:
            self._recorder.keep_result(number, result)

    def keep_diagnosis(self, number: int, result: DiagnosisResult) -> None:
        """Save a diagnosis that was requested for a point of the survey, and report it.

        Parameters
        ----------
        number : int
            Number, within the survey, of the point's last drop.
        result : DiagnosisResult
        """
        if self._recorder is not None:
            self._recorder.keep_diagnosis(number, result)
        if (point := point_of_record(self._view, number)) is not None:
            self.report(PointDiagnosed(point.name, result))

    def ask(self, request: Callable[["Session"], None]) -> None:
        """Have a function called with this session in the session's thread; may be called from any
        thread.

        A RecordingError or OptionError of the function is reported as a `SessionNotice`.
        """
        self._requests.put(request)

    def stop(self) -> None:
        """End the session once the current drop is saved; may be called from any thread."""
        self._stop = True

    def trigger(self) -> None:
        """Record a drop now, independent of the load; may be called from any thread."""
        self._operator = True

    def run(self) -> Ending:
        """Run the session until the feed ends, the planned drops are measured, or `stop` is called.

        Returns
        -------
        Ending

        Raises
        ------
        SetupError, TraceError
            If the declarations do not fit the instrument.
        OptionError
            If the calibration has changed and the plan refuses that.
        """
        try:
            try:
                ending = self._run()
            except Exception:
                with contextlib.suppress(Exception):  # report the first error, not a consequence
                    self._save_the_rest(lambda: True)
                raise
            self._save_the_rest(lambda: self._stop)
            if self._analyses is not None:
                self._analyses.wait_for_responses(STOPPED_ANSWERS if self._stop else LAST_ANSWERS)
            self._last_diagnoses()
            self._answer_requests()
            self._report_rest()
        finally:
            self._feed.close()
            if self._analyses is not None:
                self._analyses.close()
            if self._pipeline.diagnoses is not None:
                self._pipeline.diagnoses.close()
        return Ending.UNSAVED if self._pipeline.held else ending

    def _last_diagnoses(self) -> None:
        """Wait for pending diagnoses, unless the session was stopped."""
        diagnoses = self._pipeline.diagnoses
        if diagnoses is None:
            return
        until = time.monotonic() + LAST_ANSWERS
        while diagnoses.n_pending and not self._stop and time.monotonic() < until:
            time.sleep(FEED_WAIT)
            diagnoses.take_responses()
        diagnoses.take_responses()
        diagnoses.give_up()

    def _save_the_rest(self, hurry: Callable[[], bool]) -> None:
        self._finish_drop("the session was ended")
        self._record_streamed(math.inf)
        if self._recorder is not None:
            self._recorder.finish(hurry)
        self._pipeline.end_of_rebounds()
        status = self._feed.settle()
        if status is not None:
            self._unrecorded.compare(status, self._identity)
            self._unrecorded.report_waiting(status, self._identity)

    def _report_stored_point(self, name: str) -> None:
        """Report a point with its drops from before this session, once."""
        if self._recorder is None or name in self._reported_points:
            return
        self._reported_points.add(name)
        if name not in self._recorder.writer.points:
            return
        stored = read_point_event(self._recorder.writer, name)
        if stored is not None:
            self._pipeline.add_stored_point(stored.point)
            self.report(stored)

    def _report_similar_point(self) -> None:
        """Warn if the point of the plan is new and its name resembles that of another point.

        One of the two names begins with the other. The screen lets the operator choose instead.
        """
        name = self._plan.named_point
        if name is None or self._recorder is None:
            return
        points = [point for point in self._recorder.writer.contents().points if point.drops]
        names = {each for point in points for each in (point.name, point.title)}
        similar = similar_name(name, names | {station.name for station in self.job.stations})
        if similar is not None:
            text = f"point {name} is new, but {similar} exists. Was {similar} meant? "
            self.report(SessionNotice(text + "pfwd edit --move moves drops", serious=True))

    def _run(self) -> Ending:
        self.report(JobReported(self.job, self._differences))
        if self._recorder is not None and not self._feed.live:
            self._keep_job(self._job_request)
        self._report_similar_point()
        self._report_stored_point(self._point)
        while not self._finished():
            if self._may_go_on():
                item = self._feed.next(FEED_WAIT)
                if item is not None:
                    self._take(item)
            else:
                time.sleep(FEED_WAIT)
            if self._analyses is not None:
                self._analyses.take_responses()
            if self._pipeline.diagnoses is not None:
                self._pipeline.diagnoses.take_responses()
            if self._recorder is not None:
                self._recorder.retry()
            self._answer_requests()
            if self._operator:
                self._operator = False
                self._trigger()
            if self._gave_up():
                return Ending.LOST
        return Ending.DONE

    def _answer_requests(self) -> None:
        while not self._requests.empty():
            try:
                self._requests.get()(self)
            except (RecordingError, OptionError) as err:
                self.report(SessionNotice(str(err), serious=True))

    def _may_go_on(self) -> bool:
        """Return whether the next item may be taken: a replay waits for pending analyses."""
        waiting = self._analyses.n_pending if self._analyses is not None else 0
        return self._feed.live or waiting < MAX_UNANSWERED

    def _finished(self) -> bool:
        if self._ended:
            return True
        if self._stop:
            return self._detector is None or not self._detector.busy or self._waited_enough()
        enough = self._plan.drops is not None and self._pipeline.acknowledged >= self._plan.drops
        # The hammer may still bounce, which belongs to the last drop.
        return enough and self._pipeline.complete

    def _waited_enough(self) -> bool:
        """Return whether a stopped session has waited long enough for the current drop."""
        if self._detector is None or not self._feed.live:
            return False
        now = time.monotonic()
        if math.isinf(self._stop_by):
            self._stop_by = now + self._detector.settings.post_trigger + STOPPED_DROP
        return now >= self._stop_by

    def _gave_up(self) -> bool:
        since = self._feed.lost_since
        if self._plan.give_up is None or since is None:
            return False
        return time.monotonic() - since > self._plan.give_up

    def _trigger(self) -> None:
        if self._detector is None or self._stream is None:
            text = "no drop was triggered, because no samples arrive. Check the connection"
            self.report(SessionNotice(text, kind="no samples"))
        else:
            self._detector.trigger_by_operator()

    def _on_trigger(self) -> None:
        """Record a drop at the instrument's trigger button, unless it triggers too often."""
        if self._stop or (self._detector is not None and self._detector.busy):
            return
        if self._sampled < self._next_trigger:
            text = "the instrument triggered again within a second; the trigger is ignored"
            self.report(SessionNotice(text, kind="triggers"))
            return
        if self._identity is not None and self._stream is not None:
            pause = round(TRIGGER_PAUSE * self._identity.sampling_rate)
            self._next_trigger = self._sampled + pause
        self._trigger()

    def _take(self, item: FeedItem) -> None:
        if self._unanswered is not None and isinstance(item, BufferedDrop | Armed):
            self._postponed.append(item)
            return
        match item:
            case Samples():
                self._on_samples(item)
            case Gap():
                if self._detector is not None and item.stream == self._stream:
                    self._on_detected(self._detector.feed(item))
            case Connected():
                self._on_connected(item)
            case Disconnected():
                self._on_disconnected(item)
            case BufferedDrop():
                self._on_buffered_drop(item)
            case UnusableDrop():
                self._on_unusable(item)
            case Armed():
                self._on_armed(item)
            case RateDeviation():
                self._on_rate_deviation(item)
            case StreamBegan():
                self._finish_drop("the instrument restarted its sampling")
            case RepeatedSamples():
                text = (
                    f"{item.seconds:.1f} s of samples are discarded: their numbers, from "
                    f"{item.first} of run {item.stream} on, were received before. A drop in them "
                    "is not recorded. Disconnect the instrument and connect it again"
                )
                self.report(SessionNotice(text, serious=True, kind="repeated samples"))
            case Status():
                self._status = item
                self.report(InstrumentStatus(item, self._feed.counters()))
                if self._feed.lost_since is None:  # otherwise it may be another instrument
                    self._unrecorded.compare(item, self._identity)
            case Event():
                self._on_event(item)
            case Refusal():
                text = f"the instrument refuses (code {item.code}): {item.text}"
                self.report(SessionNotice(text, serious=True, kind="refusals"))
            case RecordedDrop():
                self._on_recorded(item)
            case ImportedDrop():
                self._on_imported(item)
            case Ended():
                self._finish_drop("the recording ends here")
                self._end_recorded()
                self._ended = True

    def _on_connected(self, item: Connected) -> None:
        # A drop in progress is completed with the calibration with which it began.
        self._finish_drop("the instrument was connected again")
        self._detector, self._unanswered = None, None
        setup = self._plan.setup
        identity = setup.identity_with(item.identity)
        declared, checked = setup.declared_with(identity), setup.setup_with(identity)
        sensor_channels(identity)  # raises before the first drop, not at it
        detector = Detector(identity, setup.device.detection)
        if not self._calibrations.is_accepted(identity):
            self._unanswered = item
            return
        self._detector = detector
        if identity != self._identity:
            self._rate_deviation, self._records = None, []
        self._identity, self._declared = identity, declared
        self._was_ready = self._shunted = False
        self._armed = None
        self._connected, self._connection_stored = item, False
        n_unreported = self._stored_events.due("connected")
        if n_unreported is not None:
            self._keep_connection(n_unreported)
        self.report(
            InstrumentReady(
                item.url,
                identity,
                checked,
                tuple(setup.differences(item.identity)),
                (
                    *calibration_warnings(identity, item.time_utc.date()),
                    *response_warnings(identity),
                ),
                item.reconnected,
            )
        )
        if self._feed.live:
            self._checker = SensorChecker(identity, self._feed.shunt)
        if self._analyses is not None:
            self._analyses.prepare(identity, checked)

    def accept_calibration(self, event: CalibrationChanged) -> None:
        """Accept a changed calibration; must be called in the session's thread, see `ask`."""
        self._calibrations.accepted.add(event)
        if self._unanswered is None or self._calibrations.unanswered != event:
            return  # the connection was lost meanwhile; the next one is accepted without asking
        self._on_connected(self._unanswered)
        postponed, self._postponed = self._postponed, []
        for item in postponed:
            self._take(item)

    def _keep_connection(self, n_unsaved: int) -> None:
        """Save an event for the connection, with the number of earlier ones that were not saved."""
        item, identity = self._connected, self._identity
        self._connection_stored = True
        if self._recorder is None or item is None or identity is None:
            return
        self._recorder.keep_point(self._point, self._declared)
        number = identity.serial_number
        details = {"url": item.url, "serial_number": number, "again": item.reconnected}
        self._recorder.keep_event("connected", details | _count(n_unsaved))
        self._keep_job(self._job_request.over(instrument_request(identity)))

    def _keep_job(self, requested: JobRequest) -> None:
        """Save the requested changes of the job as events of the survey."""
        assert self._recorder is not None
        request = requested.news(self._job)
        for kind, details in request.events():
            self._recorder.keep_event(kind, details)
        self._job, self._job_request = self._job.with_request(request), JobRequest()
        self.report(JobReported(self._job))

    def _on_disconnected(self, item: Disconnected) -> None:
        self._finish_drop("the link was lost")
        self._unanswered = None
        self._checker = None
        n_unsaved = self._stored_events.due("lost")
        if self._recorder is not None and n_unsaved is not None:
            self._recorder.keep_event("lost", {"reason": item.reason} | _count(n_unsaved))
        self.report(InstrumentLost.of(item))

    def _on_event(self, item: Event) -> None:
        if item.kind == EventKind.TRIGGER:
            if self._armed is None:  # otherwise the instrument sends that drop itself
                self._on_trigger()
        elif item.kind == EventKind.END:
            self._finish_drop("the instrument reported the end of its data")
            self._ended = True
        elif item.kind == EventKind.LOW_BATTERY:
            text = f"battery of the instrument is low {item.text}".rstrip()
            self.report(BatteryLow(text, serious=True, kind="battery"))
        elif item.kind == EventKind.BOOT:
            text = f"the instrument restarted {item.text}".rstrip()
            self.report(SessionNotice(text, kind="restarts"))
            if self._feed.lost_since is None:
                self._unrecorded.restart(self._identity)
        elif item.kind == EventKind.STOPPED:
            text = f"the logger stopped by itself: {item.text}; it is started again"
            self.report(SessionNotice(text, serious=True, kind="stops"))

    def _on_rate_deviation(self, item: RateDeviation) -> None:
        """Report a wrong sampling rate: the drops since the connection support no value then."""
        if self._identity is None:
            return
        self._rate_deviation = deviation = item.deviation
        if self._recorder is not None:
            self._recorder.keep_event("sampling_rate", dataclasses.asdict(item))
        declared = self._identity.sampling_rate
        text = (
            f"sampling rate: expected {declared:g} Hz as declared, got "
            f"{declared * (1 + deviation):.5g} Hz by the clock of the {item.clock}. Moduli are "
            f"wrong by {140 * abs(deviation):.1f} %, so drops of this instrument get no verdict. "
            "Correct the rate in the instrument or its setup file, and measure again"
        )
        self.report(SessionNotice(text, serious=True, kind="the sampling rate"))

        def mark_earlier_drops(session: Session) -> None:
            for number in tuple(session._records):
                session.edit(Edit(RATE_DEVIATION, deviation), number=number)

        self.ask(mark_earlier_drops)

    def continue_survey(self, view: SurveyView) -> None:
        """Add the points of an earlier session of the same survey; to be called before `run`."""
        points = [point for name, point in self._view.points.items() if name not in view.points]
        self._view = view.with_job(self.job).with_points(points)

    def report(self, event: SessionEvent) -> None:
        """Report an event to the listener, then the survey if the event changes it.

        Messages of a kind that a connected instrument repeats are limited. Must be called in the
        session's thread, see `ask`.
        """
        if isinstance(event, SessionNotice) and event.kind and self._feed.live:
            n_unreported = self._repeats.due(event.kind)
            if n_unreported is None:
                return
            if n_unreported:
                text = f"{event.text} ({n_unreported} more since the last message of this kind)"
                event = replace(event, text=text)
        if isinstance(event, DropSaved):
            if event.saved.record is not None:
                self._records.append(event.saved.record)
            if (stored := self._replayed.pop(event.saved.point, None)) is not None:
                self.report(point_event(stored, is_replayed=True))
        self._listener(event)
        change = apply_event(self._view, event)
        if change is not None:
            self._view = change.view
            self._listener(change)

    def _report_rest(self) -> None:
        """Report the numbers of messages that were not shown."""
        for kind, count in self._repeats.rest().items():
            text = f"{count} more messages of the instrument about {kind} were not shown"
            self._listener(SessionNotice(text))

    def _on_samples(self, item: Samples) -> None:
        if self._detector is None or self._identity is None:
            return
        if item.stream != self._stream:
            self._finish_drop("the instrument restarted its sampling")
            self._detector.begin(item.stream, item.first)
            self._stream = item.stream
        self._last_samples = item
        self._sampled += len(item.counts)  # counted here: numbers of the instrument may be wrong
        self._record_streamed(self._sampled)
        self._watch_shunt(item)
        self._on_detected(self._detector.feed(item))
        self.report(LiveSamples(item, self._identity, self._detector.drop_load))
        self._check_sensors(item)
        checking = item.shunt or (self._checker is not None and self._checker.due)
        if self._feed.live and self._detector.ready and not checking and not self._was_ready:
            self._was_ready = True
            self.report(Ready())

    def _watch_shunt(self, item: Samples) -> None:
        """Report that the shunt prevents drops, except during the check before the first drop."""
        own_check = self._checker is not None and self._checker.shunt_requested
        if item.shunt and not self._shunted and (self._was_ready or not own_check):
            self.report(NotReady("the shunt is on, so that no drop can be recorded"))
        self._shunted = item.shunt
        self._was_ready = self._was_ready and not item.shunt

    def _check_sensors(self, item: Samples) -> None:
        if self._checker is None or self._detector is None:
            return
        at_rest = not self._detector.busy and self._pipeline.settled
        check = self._checker.feed(item, at_rest=at_rest)
        if check is None:
            return
        details, faults = check
        self._last_check = details | {"faults": codes(faults)}
        if self._recorder is not None:
            self._recorder.keep_check(self._last_check)
        self.report(SensorCheck(details, faults))

    def _on_armed(self, item: Armed) -> None:
        self._armed = item.trigger if item.trigger.on else None
        streams = self._identity is not None and self._identity.streams
        if self._feed.live and self._identity is not None and self._detector is not None:
            requested = trigger_for(self._identity, self._detector.settings)
            if differences := trigger_differences(requested, item.trigger):
                effect = (
                    "missed drops are recorded from its samples" if streams else "it may miss some"
                )
                text = (
                    f"the instrument does not detect drops as requested ({differences}); {effect}"
                )
                self.report(SessionNotice(text, serious=True, kind="trigger settings"))
        if self._armed is not None and not streams and not self._was_ready:
            self._was_ready = True
            self.report(Ready())

    def _on_buffered_drop(self, item: BufferedDrop) -> None:
        """Save a drop that the instrument detected; it may erase the drop afterwards."""
        if self._detector is None or self._identity is None:
            return
        try:
            record = self._buffered_record(item, self._identity, self._detector.settings)
        except SetupError as err:
            self._on_unusable(UnusableDrop(item.offer, str(err)))
            return
        self._streamed.cover(item.offer)
        self._pipeline.end_of_rebounds()
        self._pipeline.take(
            record, item.received, release=lambda: self._feed.acknowledge(item.offer)
        )
        self._pipeline.end_of_rebounds()

    def _buffered_record(
        self, item: BufferedDrop, identity: Identity, settings: DetectionSettings
    ) -> DropRecord:
        """Return the record of a drop that the instrument detected.

        Raises
        ------
        SetupError
            If its settings are invalid, so that the record could not be replayed.
        """
        identity = replace(identity, sampling_rate=item.offer.sampling_rate)
        raw = raw_drop_of(item, self._armed, identity)
        settings = settings_of(item, settings)
        Detector(identity, settings)  # raises SetupError, as a replay would
        time_utc = item.time_utc or datetime.datetime.now(datetime.UTC)
        metadata = metadata_of(raw, identity, settings, time_utc, self._state(), by_instrument=True)
        metadata[MARKS] += codes(marks_of_buffered(item))
        return self._record_of(raw, identity, metadata, self._pipeline.number_for(self._point))

    def _on_unusable(self, item: UnusableDrop) -> None:
        text = (
            f"buffered drop (run and sample {item.offer.stream}/{item.offer.first_sample}) is not "
            f"recorded and stays in the instrument: {item.reason}"
        )
        self.report(SessionNotice(text, serious=True, kind="unusable drops"))

    def _on_recorded(self, item: RecordedDrop) -> None:
        self._finish_drop("the next recorded drop follows")
        self._end_recorded()
        self._identity, self._recorded, self._redetected = item.identity, item, False
        self._declared = dict(item.record.declared)
        setup_of(self._declared, f"drop {item.record.point}")
        self._point = item.record.point
        self._report_stored_point(self._point)
        self._detector = Detector(item.identity, item.settings)
        self._detector.begin(item.stream, item.first, item.at_rest)
        self._stream = item.stream
        if item.operator_trigger is not None:
            self._detector.trigger_by_operator(item.operator_trigger)

    def _end_recorded(self) -> None:
        if not self._redetected and self._recorded is not None:
            record = self._recorded.record
            drop = f"drop {record.point}/{record.drop.number}"
            text = f"replay: {drop} is not detected again in its recorded samples"
            self.report(SessionNotice(text, serious=True))
        self._recorded, self._redetected = None, True

    def _on_imported(self, item: ImportedDrop) -> None:
        self._finish_drop("the next recorded drop follows")
        self._end_recorded()
        record = item.record
        setup_of(record.declared, f"drop {record.point}")
        self._point, self._declared = record.point, dict(record.declared)
        self._report_stored_point(record.point)
        number = self._pipeline.number_for(record.point, record.drop.number)
        self._pipeline.take(renumbered(record, number), source=item)
        self._pipeline.end_of_rebounds()

    def _finish_drop(self, reason: str) -> None:
        if self._detector is not None and self._stream is not None:
            self._on_detected(self._detector.finish(reason))
        self._stream = None
        self._interrupted = True

    def _on_detected(self, detected: list[DetectedItem]) -> None:
        for item in detected:
            assert self._identity is not None
            if isinstance(item, RawRebound) and self._interrupted and self._recorded is None:
                # The detection took a bounce after the interruption for the drop.
                self._record_late(self._time_of(item.trigger), rebound_of(item, self._identity))
                continue
            if self._armed is not None and not (isinstance(item, RawDrop) and item.by_operator):
                self._on_streamed(item)
                continue
            match item:
                case RawDrop():
                    self._on_drop(item)
                case RawRebound():
                    rebound = rebound_of(item, self._identity)
                    self._pipeline.take_rebound(rebound, recorded=self._recorded is not None)
                case ReboundsOver():
                    self._pipeline.end_of_rebounds()
                case PulseReport():
                    self._report_pulse(item)

    def _on_streamed(self, item: DetectedItem) -> None:
        """Let a drop or report wait, because the instrument may have detected the drop itself."""
        assert self._identity is not None
        due = self._sampled + OFFER_WAIT_S * self._identity.sampling_rate
        match item:
            case RawDrop():
                self._on_drop(item, due)
            case RawRebound():
                self._streamed.add_rebound(item.after, rebound_of(item, self._identity))
            case PulseReport():
                self._streamed.add(StreamedItem(item.stream, item.trigger, item.trigger, due, item))

    def _record_streamed(self, sampled: float) -> None:
        """Record the drops in the stream that the instrument has not sent; see `StreamedDrops`."""
        for item in self._streamed.take_due(sampled):
            if isinstance(item.content, PulseReport):
                self._report_pulse(item.content)
                continue
            self._pipeline.end_of_rebounds()
            record = renumbered(item.content, self._pipeline.number_for(item.content.point))
            self._pipeline.take(record, item.received)
            for rebound in item.rebounds:
                self._pipeline.take_rebound(rebound, recorded=False)
            self._pipeline.end_of_rebounds()

    def _report_pulse(self, pulse: PulseReport) -> None:
        """Report a pulse that may be a missed drop, and record it as an event of the survey."""
        if self._recorded is not None or self._identity is None:
            return  # it was reported during the measurement
        if pulse.reason is PulseReason.MAYBE_BOUNCE and self._interrupted:
            return  # it was recorded as a bounce of the drop before the interruption
        details, text = pulse_event(pulse, self._identity, self._point)
        n_unsaved = self._stored_events.due("pulse")
        if self._recorder is not None and n_unsaved is not None:
            self._recorder.keep_event("pulse", details | _count(n_unsaved))
        self.report(SessionNotice(text, serious=True, kind="pulses"))

    def _on_drop(self, raw: RawDrop, due: float | None = None) -> None:
        """Record a drop; with `due` it waits until then for the instrument's own record."""
        assert self._identity is not None
        assert self._detector is not None
        self._pipeline.end_of_rebounds()
        if not self._connection_stored:
            self._keep_connection(self._stored_events.take("connected"))
        identity, source = self._identity, self._recorded
        if source is None:
            number = self._pipeline.number_for(self._point)
            settings = self._detector.settings
            time_utc = self._time_of(raw.first + raw.trigger)
            metadata = metadata_of(raw, identity, settings, time_utc, self._state())
        else:
            if self._redetected:
                drop = f"drop {source.record.point}/{source.record.drop.number}"
                text = f"replay: a second drop is detected in the samples of {drop}; it is ignored"
                self.report(SessionNotice(text, serious=True))
                return
            self._redetected = True
            number = self._pipeline.number_for(self._point, source.record.drop.number)
            metadata = dict(source.record.metadata)
        rebounds = source.record.rebounds if source is not None else ()
        record = self._record_of(raw, identity, metadata, number, rebounds)
        if source is None and self._is_bounce(raw, record.drop):
            return
        live = self._feed.live and self._last_samples is not None
        received = self._last_samples.received if live and self._last_samples else None
        if due is None:
            self._pipeline.take(record, received, source)
            return
        metadata[MARKS].append(NOT_BUFFERED.to_json())
        trigger = raw.first + raw.trigger
        away = np.abs(raw.counts[:, load_channel(identity)] - raw.at_rest.load) > raw.threshold
        last = raw.first + int(np.flatnonzero(away & ~np.isnan(record.drop.load))[-1])
        self._streamed.add(StreamedItem(raw.stream, trigger, last, due, record, received))

    def _state(self) -> dict[str, Any]:
        """Return the state of instrument, link and receiver to record with a drop."""
        state = state_of(self._last_check, self._status, self._feed.counters())
        where = self._plan.position
        if self._rate_deviation is not None:
            state[RATE_DEVIATION] = self._rate_deviation
        return state | ({"position": where.record()} if where is not None else {})

    def _record_of(
        self,
        raw: RawDrop,
        identity: Identity,
        metadata: dict[str, Any],
        number: int,
        rebounds: tuple[ReboundRecord, ...] = (),
    ) -> DropRecord:
        drop = calibrate(number, raw.counts, raw.missing, raw.trigger, identity)
        return DropRecord(self._point, drop, raw.counts, self._declared, metadata, rebounds)

    def _is_bounce(self, raw: RawDrop, drop: Drop) -> bool:
        """Record a bounce with the last drop if the connection was lost between the two.

        Otherwise the detection, which was restarted, would record the bounce as a drop of its own.

        Returns
        -------
        bool
            True: it is a bounce, not a drop.
        """
        now = self._time_of(raw.first + raw.trigger)
        before, interrupted = self._fell, self._interrupted
        peak = float(np.nanmax(drop.load) - np.nanmedian(drop.load))
        self._interrupted = False
        if before is not None and interrupted and not raw.by_operator:
            delay = (now - before[0]).total_seconds()
            point, number = before[2]
            soon = delay < BOUNCES_END and point == self._point
            if soon and peak < BOUNCE_OVER_DROP * before[1]:
                self._interrupted = True  # another bounce may follow
                self._record_late(now, ReboundRecord(delay, peak, raw.first, raw.counts))
                text = (
                    f"the impact after the connection was restored is a bounce of drop "
                    f"{point}/{number} and is recorded with it"
                )
                self.report(SessionNotice(text))
                return True
        self._fell = now, peak, (self._point, drop.number)
        return False

    def _record_late(self, now: datetime.datetime, bounce: ReboundRecord) -> None:
        """Record a bounce with the drop that was detected before the connection was lost."""
        assert self._fell is not None
        delay = max((now - self._fell[0]).total_seconds(), 0.0)
        self._pipeline.take_late_rebound(*self._fell[2], replace(bounce, delay=delay))

    def _time_of(self, index: int) -> datetime.datetime:
        """Return the time of a sample, from the arrival of the last samples."""
        last = self._last_samples
        if last is None or self._identity is None:
            return datetime.datetime.now(datetime.UTC)
        later = last.first + len(last.counts) - index
        return last.time_utc - datetime.timedelta(seconds=later / self._identity.sampling_rate)


def _count(n_unsaved: int) -> dict[str, int]:
    return {"more_before": n_unsaved} if n_unsaved else {}
