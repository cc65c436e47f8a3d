"""The session in its thread: its events, its failures, its retries."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfwd.errors import DeviceError, RecordingError, SurveyError
from pfwd.session.events import Ready, SessionNotice
from pfwd.session.plan import Ending, SessionPlan
from tests.tui.screen.scripted import QuietSource, samples
from tui.screen.session import runner as runner_module
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import SessionEnded, SessionStarted


class Failing(QuietSource):
    """Fails a number of times, then is a quiet session."""

    def __init__(self, error: Exception, times: int = 1) -> None:
        super().__init__()
        self.error, self.times = error, times

    def run(self, listener: Any, control: Any) -> Ending:
        if self.starts < self.times:
            self.starts += 1
            raise self.error
        return super().run(listener, control)


def wait(holds: Callable[[], bool], seconds: float = 10.0) -> None:
    until = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < until, "it did not come"
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner_module, "PORT_RETRY_S", 0.05)


def events_of(source: Any, count: int) -> list[Any]:
    runner = SessionRunner(source)
    runner.start()
    wait(lambda: runner.waiting >= count)
    runner.stop(5.0)
    assert not runner.running
    return runner.take()


def test_a_missing_port_and_a_locked_survey_are_retried() -> None:
    missing = DeviceError("/dev/ttyUSB0: expected a port, got none; is the cable in?")
    locked = RecordingError("another program writes it")
    for error, no_device in ((missing, True), (locked, False)):
        first, second, third, *_ = events_of(Failing(error, times=2), 3)
        assert (first.error, first.no_device) == (str(error), no_device)
        assert first.retry is not None
        assert [type(event) for event in (second, third)] == [SessionEnded, SessionStarted]


def test_errors_of_data_and_program_end_the_session_with_a_sentence(
    caplog: pytest.LogCaptureFixture,
) -> None:
    (end,) = events_of(Failing(SurveyError("survey: expected a survey, got none")), 1)
    assert (end.retry, end.error) == (None, "survey: expected a survey, got none")
    (end,) = events_of(Failing(ZeroDivisionError("division by zero")), 1)
    assert "unexpected error: ZeroDivisionError" in end.error
    assert "\n" not in end.error
    assert "Traceback" in caplog.text


def test_a_stop_before_the_session_starts_is_obeyed() -> None:
    source = QuietSource()
    runner = SessionRunner(source)
    entered, may_run = threading.Event(), threading.Event()
    run = source.run

    def run_late(listener: Any, control: Any) -> Ending:
        entered.set()
        may_run.wait(5)
        return run(listener, control)

    source.run = run_late  # type: ignore[method-assign]
    runner.start()
    entered.wait(5)
    assert not runner.stop(0.0)
    may_run.set()
    assert runner.stop(5.0)


@pytest.mark.parametrize(("threshold", "pulse"), [(400.0, 420.0), (2000.0, 2100.0), (100.0, 105.0)])
def test_a_pulse_exceeds_the_drop_load_of_the_session(threshold: float, pulse: float) -> None:
    runner = SessionRunner(QuietSource())
    for number, load in enumerate((0.0, 0.95 * threshold, pulse)):
        assert runner.pulse_at is None
        event = samples(first=1000 * number, drop_load=threshold)
        event.samples.counts[-50, 0] = round(load)  # a count is a newton
        runner._listen(event)
    assert runner.pulse_at is not None
    assert runner.waiting == 0, "samples do not fill the mailbox"
    assert runner.trace.samples == 3000
    assert runner.trace.envelope().load.max() == pytest.approx(pulse)


def test_a_display_that_fails_does_not_end_the_measurement(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    runner = SessionRunner(QuietSource())

    def broken(_event: Any) -> None:
        raise ValueError("no")

    monkeypatch.setattr(runner.trace, "feed", broken)
    runner._listen(samples())
    (notice,) = runner.take()
    assert isinstance(notice, SessionNotice)
    assert "ValueError" in caplog.text
    runner.add_listener(broken)
    runner._listen(Ready())
    assert runner.take() == [Ready()]


def test_requests_without_a_session_are_refused() -> None:
    runner = SessionRunner(QuietSource())
    assert not runner.request(lambda session: session.set_point("8"))
    assert not runner.trigger()


def test_attributes_of_the_sources(tmp_path: Path) -> None:
    from tui.screen.session.sources import DemoSource, LiveSource, ReplaySource

    plan = SessionPlan()
    assert LiveSource("/dev/ttyUSB0", tmp_path, plan).writes
    assert DemoSource("default", tmp_path, plan).writes
    viewed = ReplaySource(tmp_path, 1.0, None)
    assert not viewed.writes
    assert viewed.survey == tmp_path
    assert ReplaySource(tmp_path, 1.0, None, output=tmp_path / "new").writes
