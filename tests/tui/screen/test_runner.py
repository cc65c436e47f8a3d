"""The session beside the screen: what it tells, how it fails, how it is tried again."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfwd.errors import DeviceError, RecordingError, SurveyError
from pfwd.session.events import Ready, SessionNotice
from pfwd.session.plan import Ending, SessionPlan
from tests.tui.screen.scripted import QuietSource, Session, samples
from tui.screen.session import runner as runner_module
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import SessionEnded, SessionStarted


class Failing(QuietSource):
    """Fails so often, then is a quiet session."""

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


def test_a_missing_port_is_retried() -> None:
    error = DeviceError("/dev/ttyUSB0: expected a port, got none; is the cable in?")
    arrived = events_of(Failing(error, times=2), 3)
    first, second, third, *_ = arrived
    assert isinstance(first, SessionEnded)
    assert first.no_device
    assert first.error == str(error)
    assert isinstance(second, SessionEnded)
    assert isinstance(third, SessionStarted)


def test_a_locked_survey_is_retried() -> None:
    first, second, *_ = events_of(Failing(RecordingError("another program writes it")), 2)
    assert (first.retry is not None, first.no_device) == (True, False)
    assert isinstance(second, SessionStarted)


def test_refused_data_end_the_session_with_a_sentence() -> None:
    (only,) = events_of(Failing(SurveyError("survey: expected a survey, got none")), 1)
    assert (only.retry, only.error) == (None, "survey: expected a survey, got none")


def test_an_unexpected_error_is_a_sentence_with_details_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    (only,) = events_of(Failing(ZeroDivisionError("division by zero")), 1)
    assert "unexpected error: ZeroDivisionError" in only.error
    assert "\n" not in only.error
    assert "Traceback" in caplog.text


def test_a_stop_before_the_session_starts_is_obeyed() -> None:
    source = QuietSource()
    runner = SessionRunner(source)
    entered = threading.Event()
    original = source.run

    def slow(listener: Any, control: Any) -> Ending:
        entered.set()
        time.sleep(0.2)
        return original(listener, control)

    source.run = slow  # type: ignore[method-assign]
    runner.start()
    entered.wait(5)
    source.session = StopsLate()
    assert runner.stop(5.0)


class StopsLate(Session):
    """Is not stopped before it runs: the source clears what came earlier."""


def test_samples_do_not_fill_the_mailbox_and_a_pulse_is_noticed() -> None:
    runner = SessionRunner(QuietSource())
    runner._listen(samples(0.0))
    runner._listen(samples(0.0, first=1000))
    assert runner.pulse_at is None
    runner._listen(samples(9000.0, first=2000))
    runner._listen(samples(0.0, first=3000))
    assert runner.waiting == 0
    assert runner.trace.samples == 4000
    assert runner.trace.envelope().load.max() == pytest.approx(9000.0)


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


@pytest.mark.parametrize(("threshold", "pulse"), [(400.0, 420.0), (2000.0, 2100.0), (100.0, 105.0)])
def test_a_pulse_exceeds_the_drop_load_of_the_session(threshold: float, pulse: float) -> None:
    runner = SessionRunner(QuietSource())

    def listen(load: float, first: int) -> None:
        event = samples(first=first, drop_load=threshold)
        event.samples.counts[-50, 0] = round(load)  # a count is a newton
        runner._listen(event)

    listen(0.0, 0)
    listen(0.95 * threshold, 1000)
    assert runner.pulse_at is None
    listen(pulse, 2000)
    assert runner.pulse_at is not None
