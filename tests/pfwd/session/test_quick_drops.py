"""Drops in quick succession of a simulated instrument, and reports on pulses without a drop."""

from pathlib import Path

import pytest

from pfwd.session.events import DropSaved, Rebounded, SessionNotice
from pfwd.session.measure import measure, replay
from pfwd.session.plan import Ending, SessionPlan
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
from tests.pfwd.session.measured import simulated


def test_thirty_drops_in_quick_succession_are_recorded(tmp_path: Path) -> None:
    log = Log()
    drops = {"first": 2.0, "interval": 1.4, "quiet": 1.0, "bounces": [1, 2]}
    items, instrument, _ = simulated({"drops": drops}, 50.0, drops=30, step=0.1)
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        run(ScriptedFeed(items), log, writer)
    saved = log.of(DropSaved)
    assert [event.saved.number for event in saved] == list(range(1, 31))
    assert len(instrument.truth()) == len(read_survey(tmp_path / "s").drops) == 30
    assert {event.saved.screening.status for event in saved} <= {"measured", "seating"}
    assert log.of(Rebounded)
    assert "pulses" not in [event.kind for event in log.of(SessionNotice)]


def test_an_instrument_at_a_port_is_measured(tmp_path: Path) -> None:
    scenario = {"drops": {"first": 1.0, "interval": 2.0, "bounces": [0, 0]}}
    with serve(scenario, listen="tcp://127.0.0.1:0", drops=2, rate=0) as instrument:
        log, plan = Log(), SessionPlan(options=None)
        assert measure(instrument.url, tmp_path / "s", log, plan) is Ending.DONE
    # So fast the shunt may be on when a weight falls, which is reported.
    reported = [event for event in log.of(SessionNotice) if event.kind == "pulses"]
    assert len(read_survey(tmp_path / "s").drops) + len(reported) == 2


def test_an_uncertain_pulse_reaches_the_screen_and_the_survey(tmp_path: Path) -> None:
    log = Log()
    counts = stream(4.0, [(1.0, 8000.0), (1.5, 3000.0)])
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        items = with_gaps(pieces(counts), [(9_990, 200)])  # of the drop only the bounce is there
        run(ScriptedFeed(connected(), began(), items), log, writer)
    (notice,) = (event for event in log.of(SessionNotice) if event.kind == "pulses")
    assert notice.serious
    assert "may be a bounce" in notice.text
    survey = read_survey(tmp_path / "s")
    (event,) = (event for event in survey.events if event["event"] == "pulse")
    assert event["details"]["point"] == "1"
    assert event["details"]["peak_load_n"] == pytest.approx(3000, abs=15)
    assert event["details"]["sample"] == pytest.approx(15_006, abs=5)
    # What was reported when the drop was measured is not reported again by a replay.
    replayed = Log()
    replay(tmp_path / "s", replayed)
    assert "pulses" not in [event.kind for event in replayed.of(SessionNotice)]
    assert [event.identical for event in replayed.of(DropSaved)] == [True]


def test_further_reports_of_pulses_are_counted(tmp_path: Path) -> None:
    log = Log()
    pulses = [(1.0 + number, 8000.0) for number in range(9)]
    counts = stream(11.0, pulses)
    gaps = [(round((at - 0.3) * 10_000), 100) for at, _ in pulses]
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        run(ScriptedFeed(connected(), began(), with_gaps(pieces(counts), gaps)), log, writer)
    assert len(log.of(DropSaved)) == 9
    assert len([event for event in log.of(SessionNotice) if event.kind == "pulses"]) == 5
    assert "4 more messages of the instrument about pulses were not shown" in log.texts
