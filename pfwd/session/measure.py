"""Measurement and replay in one call: open source and survey, run the session, close both.

A script measures with::

    from pfwd.session.measure import measure

    measure("/dev/ttyUSB0", "site-12", print)
"""

import contextlib
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_survey, is_survey_file, spare_folder
from pfwd.files.opening import survey_content
from pfwd.files.output_path import refuse_bad_place
from pfwd.judging import Job, job_of
from pfwd.procedures import NO_PROCEDURE
from pfwd.session.events import SessionNotice
from pfwd.session.live import LiveFeed, random_stream
from pfwd.session.plan import session_job
from pfwd.session.replay import Pace, capture_feed, survey_feed
from pfwd.session.session import Ending, Listener, Session, SessionPlan
from pfwd.session.setup_file import MeasuringSetup
from pfwd.session.survey_recorder import report_file_changes
from pfwd_device.recording import CaptureWriter, Survey, SurveyPoint, SurveyWriter, read_survey

_STOPPING = [number for number in signal.Signals if number.name in ("SIGINT", "SIGTERM", "SIGHUP")]
"""Signals that end a session; Windows has no SIGHUP."""

Control = Callable[[Session], AbstractContextManager[object]]


def measure(
    url: str,
    survey: str | os.PathLike[str],
    listener: Listener,
    plan: SessionPlan | None = None,
    *,
    capture: bool = False,
    control: Control = nullcontext,
    spare: str | os.PathLike[str] | None = None,
) -> Ending:
    """Measure with an instrument into a new or existing survey.

    Parameters
    ----------
    url : str
        Port of the instrument: /dev/ttyUSB0, COM3, socket://127.0.0.1:4000, ...
    survey : path of a survey, or of a new folder
    listener : callable
        Receives the events, see `pfwd.session.events`.
    plan : SessionPlan, optional
        Point, setup and options; None: the defaults.
    capture : bool
        True: every byte of the link is written to a file in the survey.
    control : callable, optional
        Returns a context for the session, in which it runs; `stopped_by_signals` is one.
    spare : path, optional
        Spare folder for drops that cannot be written to the survey; None: as `spare_folder` chooses
        it.

    Returns
    -------
    Ending

    Raises
    ------
    DeviceError, SurveyError
        If port, survey or setup cannot be used. Acknowledged drops are safe.
    """
    plan = plan or SessionPlan()
    stream = random_stream()
    with closing(LiveFeed(url, plan.setup, capture=capture, first_stream=stream)) as feed:
        if not is_survey(survey):
            feed.open_port()  # a port that cannot be opened leaves no survey behind
        with _open_survey(survey, spare, listener) as writer:
            _report_recovery(writer, listener)
            writer.check_room()
            if capture:
                setup = session_job(plan, writer.contents()).setup
                feed.captured = _open_capture(writer, url, setup, stream)
            try:
                feed.open()
                session = Session(feed, listener, plan, writer)
                with control(session):
                    return session.run()
            finally:
                feed.close()
                if feed.captured is not None:
                    feed.captured.close()
                    if feed.captured.failure:
                        text = f"the capture is incomplete: {feed.captured.failure}"
                        listener(SessionNotice(text, True))


@contextmanager
def _open_survey(
    folder: str | os.PathLike[str], spare: str | os.PathLike[str] | None, listener: Listener
) -> Iterator[SurveyWriter]:
    """Open a survey for writing; report changes of its files by other programs at the end."""
    with contextlib.ExitStack() as ends:
        if not is_survey(folder):
            refuse_bad_place(folder, "--output")
        is_new = not os.path.exists(folder)
        writer = SurveyWriter.open(folder, spare=spare_folder(spare))
        if is_new:
            ends.callback(_remove_if_unused, writer)  # called last
        ends.callback(report_file_changes, writer, listener)
        ends.enter_context(writer)
        yield writer


def _remove_if_unused(writer: SurveyWriter) -> None:
    """Remove a new survey for which no instrument was connected and nothing was stored."""
    if writer.points or any(Path(writer.folder, "captures").glob("*")):
        return
    if all(event.get("event") == "lost" for event in read_survey(writer.folder).events):
        shutil.rmtree(writer.folder, ignore_errors=True)


def _report_recovery(writer: SurveyWriter, listener: Listener) -> None:
    for text in writer.recovery.actions:
        listener(SessionNotice(f"recovery of {writer.folder}: {text}"))
    for text in writer.recovery.damaged:
        listener(SessionNotice(f"damage in {writer.folder}: {text}", serious=True))


def _open_capture(
    writer: SurveyWriter, url: str, setup: MeasuringSetup, first_stream: int
) -> CaptureWriter:
    header = {
        "url": url,
        "dialect": setup.device.dialect,
        "setup_text": setup.text,
        "procedure_text": setup.procedure.text if setup.procedure is not None else "",
        "first_stream": first_stream,
    }
    return writer.open_capture("link", header)


def replay(
    recording: str | os.PathLike[str],
    listener: Listener,
    *,
    speed: float | Pace = 0.0,
    options: AnalysisOptions | None = None,
    setup: MeasuringSetup | None = None,
    output: str | os.PathLike[str] | None = None,
    drops: int | None = None,
    control: Control = nullcontext,
    spare: str | os.PathLike[str] | None = None,
) -> Ending:
    """Run the drops of a survey, or the bytes of a capture, through a session again.

    Parameters
    ----------
    recording : path of a survey or of a capture
    listener : callable
        Receives the events, see `pfwd.session.events`.
    speed : float or Pace
        Speed over real time; 0: as fast as possible. A `Pace` can be paused and changed meanwhile.
    options : AnalysisOptions, optional
        None: no drop is inverted.
    setup : MeasuringSetup, optional
        Setup for a capture; None: the recorded one.
    output : path of a survey, optional
        Survey to record into; None: nothing is recorded.
    drops : int, optional
        Number of drops after which the replay ends; None: at the end of the recording.
    control, spare : optional
        As for `measure`.

    Returns
    -------
    Ending

    Raises
    ------
    DeviceError, SurveyError
        If recording, setup or output cannot be used.
    """
    path, points = Path(recording), tuple[SurveyPoint, ...]()
    plan = SessionPlan(options=options, drops=drops)
    if is_survey(path) or is_survey_file(path):
        if setup is not None:
            raise SurveyError(refusal("--setup", "a capture to use it with", "a survey"))
        survey = survey_content(path)
        for text in survey.damage:
            listener(SessionNotice(text, serious=True))
        feed, reader = survey_feed(survey, speed), None
        if output is None or not is_survey(output):  # an existing survey has its own
            plan = replace(plan, job=_job_of(survey, listener).as_request())
        points = tuple(survey.points)
    elif path.is_file():
        feed, used, reader = capture_feed(path, speed, setup)
        plan = replace(plan, setup=used)
    else:
        hint = "name a folder that pfwd log or pfwd import has made"
        raise SurveyError(refusal(str(path), "a survey or a capture", "none", hint))
    with nullcontext() if output is None else _open_survey(output, spare, listener) as writer:
        session = Session(feed, listener, plan, writer, points)
        with control(session):
            ending = session.run()
        if writer is not None:
            targets = {point.name: point.target for point in points}
            for point in writer.contents().points:
                if point.target is None and (target := targets.get(point.name)) is not None:
                    writer.edit("target", target, point=point.name)
    for text in reader.damage if reader is not None else ():
        listener(SessionNotice(f"{path}: damaged: {text}", serious=True))
    return ending


def _job_of(survey: Survey, listener: Listener) -> Job:
    """Return the job of a survey, without a procedure that cannot be read, which is reported."""
    try:
        return job_of(survey)
    except SurveyError as err:
        listener(SessionNotice(str(err), serious=True))
        return replace(job_of(survey, NO_PROCEDURE), procedure=None)


@contextmanager
def stopped_by_signals(session: Session) -> Iterator[None]:
    """End the session at the first SIGINT, SIGTERM or SIGHUP, once the current drop is saved.

    A second signal ends the program at once. SIGHUP is sent when the terminal is closed; a program
    that was started with ``nohup`` goes on.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[signal.Signals, Any] = {}

    def stop(number: int, _frame: FrameType | None) -> None:
        session.stop()
        for signal_number, handler in before.items():
            signal.signal(signal_number, handler)

    for signal_number in _STOPPING:
        if signal.getsignal(signal_number) is not signal.SIG_IGN:
            before[signal_number] = signal.signal(signal_number, stop)
    try:
        yield
    finally:
        for signal_number, handler in before.items():
            signal.signal(signal_number, handler)
