"""Drops in quick succession: through a whole session with a simulated instrument, and reports."""

from pathlib import Path

import pytest

from pfwd.session.events import DropSaved, Rebounded, SessionEvent, SessionNotice
from pfwd.session.measure import measure, replay
from pfwd.session.session import Ending, SessionPlan
from pfwd_device.recording import SurveyWriter, read_survey
from simulators.instrument import serve
from tests.pfwd.scripted_feed import (
    Log,
    ScriptedFeed,
    began,
    connected,
    pieces,
    run,
    stream,
    with_gaps,
)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("bounces", [[0, 0], [1, 2]], ids=["caught", "bouncing"])
def test_of_thirty_drops_every_one_and_a_half_seconds_all_are_recorded(
    tmp_path: Path, bounces: list[int]
) -> None:
    events: list[SessionEvent] = []
    drops = {"first": 2.0, "interval": 1.4, "quiet": 1.0, "bounces": bounces}
    with serve({"drops": drops}, listen="tcp://127.0.0.1:0", drops=30, rate=6) as instrument:
        plan = SessionPlan(options=None)
        assert measure(instrument.url, tmp_path / "s", events.append, plan) is Ending.DONE
    saved = [event for event in events if isinstance(event, DropSaved)]
    assert [event.saved.number for event in saved] == list(range(1, 31))
    assert {event.saved.screening.status for event in saved} <= {"measured", "seating"}
    assert any(isinstance(event, Rebounded) for event in events) is (bounces != [0, 0])
    assert len(read_survey(tmp_path / "s").drops) == 30
    assert [
        event for event in events if isinstance(event, SessionNotice) and event.kind == "pulses"
    ] == []


def test_an_uncertain_pulse_reaches_the_screen_and_the_survey(tmp_path: Path) -> None:
    log = Log()
    counts = stream(4.0, [(1.0, 8000.0), (1.5, 3000.0)])
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        items = with_gaps(pieces(counts), [(9_990, 200)])  # of the drop only the bounce is there
        run(ScriptedFeed(connected(), began(), items), log, writer)
    (notice,) = (event for event in log.of(SessionNotice) if event.kind == "pulses")
    assert notice.serious
    assert notice.text.startswith("point 1: pulse of 3.00 kN at 1.50 s of run 7: ")
    assert "may be a bounce: samples before it are missing" in notice.text
    survey = read_survey(tmp_path / "s")
    (event,) = (event for event in survey.events if event["event"] == "pulse")
    assert event["details"]["point"] == "1"
    assert event["details"]["peak_load_n"] == pytest.approx(3000, abs=15)
    assert event["details"]["sample"] == pytest.approx(15_006, abs=5)
    # What was reported when the drop was measured is not reported again by a replay.
    again: list[SessionEvent] = []
    replay(tmp_path / "s", again.append)
    assert not [
        event for event in again if isinstance(event, SessionNotice) and event.kind == "pulses"
    ]
    assert [event.identical for event in again if isinstance(event, DropSaved)] == [True]


def test_the_reports_of_many_pulses_are_counted(tmp_path: Path) -> None:
    log = Log()
    pulses = [(1.0 + number, 8000.0) for number in range(9)]
    counts = stream(11.0, pulses)
    gaps = [(round((at - 0.3) * 10_000), 100) for at, _ in pulses]
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        run(ScriptedFeed(connected(), began(), with_gaps(pieces(counts), gaps)), log, writer)
    assert len(log.of(DropSaved)) == 9
    assert len([event for event in log.of(SessionNotice) if event.kind == "pulses"]) == 5
    assert "4 more messages of the instrument about pulses were not shown" in log.texts
