"""Services of a session for a screen: requests, the pace of a replay, the content of a survey."""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pfwd.analysis.results import DropResult
from pfwd.errors import SurveyError
from pfwd.files.editing import Edit
from pfwd.judging.places import Place, place_in
from pfwd.judging.view import read_points
from pfwd.session.events import DropSaved, Edited, PointBegan, SessionNotice, SurveyChanged
from pfwd.session.feeds import Ended, RecordedDrop
from pfwd.session.measure import replay
from pfwd.session.replay import Pace, Pause, RecordedFeed, survey_feed
from pfwd.session.session import Session
from pfwd.session.stored_drops import add_result, recorded_drop, stored_results
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import result_of
from tests.pfwd.scripted_feed import Log, ScriptedFeed, connected, run
from tests.pfwd.session.measured import drops, record
from tests.records import read

TWO_DROPS = [drops(8000.0, run=7), drops(7000.0, run=8)]


def measured(folder: Path, *between: Any) -> Log:
    """A survey of two drops; `between` is called between them with the session."""
    log = Log()
    steps = [lambda act=act: feed.session.ask(act) for act in between]
    feed = ScriptedFeed(connected(), TWO_DROPS[0], steps, TWO_DROPS[1])
    with SurveyWriter.open(folder, publish=False) as writer:
        run(feed, log, writer)
    return log


def test_requests_run_in_the_thread_of_the_session(tmp_path: Path) -> None:
    threads: list[int] = []

    def act(session: Session) -> None:
        threads.append(threading.get_ident())
        session.edit(Edit("discard", "by hand"), number=1)
        session.edit(Edit("target", 45e6), point="1")
        session.set_point("P 2")

    log = measured(tmp_path / "s", act)
    assert threads == [threading.get_ident()]
    assert log.of(PointBegan) == [PointBegan("P 2")]
    assert [(each.what, each.number, each.point) for each in log.of(Edited)] == [
        ("discard", 1, None),
        ("target", None, "1"),
    ]
    survey = read_survey(tmp_path / "s")
    assert [drop.discarded for drop in survey.drops] == [True, False]
    assert [drop.point for drop in survey.drops] == ["1", "P 2"]
    assert survey.points[0].target == 45e6


def test_a_refused_request_is_reported_and_the_session_continues(tmp_path: Path) -> None:
    log = measured(tmp_path / "s", lambda session: session.edit(Edit("note", "x"), point="no"))
    assert any("expected one of the survey's points" in each.text for each in log.of(SessionNotice))
    assert len(log.of(DropSaved)) == 2


def test_a_replay_is_not_edited(tmp_path: Path) -> None:
    measured(tmp_path / "s")
    log = Log()

    @contextlib.contextmanager
    def asking(session: Session) -> Iterator[None]:
        session.ask(lambda it: it.edit(Edit("note", "x"), point="1"))
        yield

    replay(tmp_path / "s", log, control=asking)
    assert any("got a replay" in each.text for each in log.of(SessionNotice))


def test_a_paused_replay_waits_and_steps_drop_by_drop(tmp_path: Path) -> None:
    measured(tmp_path / "s")
    pace = Pace()
    pace.pause()
    feed = survey_feed(read_survey(tmp_path / "s"), pace, lambda _: None)

    def drops_before_the_pause() -> int:
        items: list[Any] = []
        while (item := feed.next(0.01)) is not None and not isinstance(item, Ended):
            items.append(item)
        return sum(isinstance(item, RecordedDrop) for item in items)

    assert drops_before_the_pause() == 0
    pace.step()
    assert drops_before_the_pause() == 1
    pace.go_on()
    assert drops_before_the_pause() == 1


def test_the_pace_is_changed_on_the_way() -> None:
    slept: list[float] = []
    pace = Pace(2.0)
    feed = RecordedFeed([Pause(1.0), Ended()], pace, slept.append)
    assert feed.next(0.25) is None  # half of the recorded second
    pace.speed = 0.5
    assert feed.next(0.5) is None  # a quarter
    pace.speed = 0.0
    assert isinstance(feed.next(0.1), Ended)
    assert slept == [0.25, 0.5]


def test_a_point_has_its_last_result_in_force(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    measured(folder)
    complete_result = read(DropResult, result_of(1, 2e7))
    add_result(folder, 1, read(DropResult, result_of(1, 1e7)))
    add_result(folder, 1, complete_result)
    add_result(folder, 1, DropResult(modulus_pa=5e7))  # damaged
    add_result(folder, 1, replace(complete_result, modulus_pa=9e7, refit="half-space"))
    (point,) = read_points(folder)
    first, second = point.drops
    assert (first.number, first.record, len(first.source.results)) == (1, 1, 4)
    assert first.last_result == complete_result
    assert second.last_result is None
    assert [each.modulus_pa for each in stored_results(folder, 1)] == [9e7, 1e7, 2e7]


def test_a_recorded_drop_comes_with_its_setup_and_its_judgement(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    measured(folder, lambda it: it.edit(Edit("declared", {"poisson_ratio": 0.4}), point="1"))
    each = recorded_drop(folder, 2)
    assert (each.point, each.number, each.record) == ("1", 2, 2)
    assert each.setup.poisson_ratio == 0.4
    assert each.screening.status == "measured"
    assert each.view.own.peak_load == pytest.approx(7000, rel=0.01)
    assert each.view.own.peak_deflection is not None
    with pytest.raises(SurveyError, match="expected drop 9"):
        recorded_drop(folder, 9)


def test_the_position_of_a_point_is_the_receiver_s_unless_it_was_edited(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    positions: list[dict[str, Any]] = [
        {"source": "nmea", "fault": "the receiver has no fix"},
        {"source": "nmea", "latitude": 48.2, "longitude": 11.6},
    ]

    class Receiver:
        def record(self) -> dict[str, Any]:
            return positions.pop(0)

    log = record(folder, connected(), *TWO_DROPS, position=Receiver())
    recorded = [event.saved.view.metadata["position"] for event in log.of(DropSaved)]
    assert list(map(place_in, recorded)) == [None, Place(48.2, 11.6)]
    assert log.of(DropSaved)[0].saved.view.metadata["time_local"][-6] in "+-"
    view = log.of(SurveyChanged)[-1].view
    assert view.points["1"].position == (48.2, 11.6)
    assert read_points(folder)[0].position == (48.2, 11.6)
    with SurveyWriter.open(folder) as writer:
        writer.edit("position", {"latitude": 1.0, "longitude": 2.0}, point="1")
    assert read_points(folder)[0].position == (1.0, 2.0)
