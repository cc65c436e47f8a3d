"""What a screen needs of a session: requests from another thread, a pace, what a survey holds."""

import threading
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
from pfwd.session.measure import replay
from pfwd.session.plan import SessionPlan
from pfwd.session.replay import Pace
from pfwd.session.session import Session
from pfwd.session.stored_drops import add_result, recorded_drop, stored_results
from pfwd_device.errors import RecordingError
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import result_of
from tests.pfwd.scripted_feed import (
    Log,
    ScriptedFeed,
    began,
    connected,
    pieces,
    stream,
)
from tests.records import read

TWO_DROPS = [pieces(stream(3.0, [(1.0, 8000.0)]), 7), pieces(stream(3.0, [(1.0, 7000.0)]), 8)]


def measured(folder: Path, *between: Any, options: Any = None) -> tuple[Log, Session]:
    """A survey of two drops; `between` is called between them with the session."""
    log = Log()
    with SurveyWriter.open(folder, publish=False) as writer:
        holder: list[Session] = []
        steps = [lambda act=act: holder[0].ask(act) for act in between]
        feed = ScriptedFeed(connected(), began(7), TWO_DROPS[0], steps, began(8), TWO_DROPS[1])
        holder.append(Session(feed, log, SessionPlan(options=options), writer))
        holder[0].run()
    return log, holder[0]


def test_requests_are_done_in_the_thread_of_the_session(tmp_path: Path) -> None:
    threads: list[int] = []

    def act(session: Session) -> None:
        threads.append(threading.get_ident())
        session.edit(Edit("discard", "by hand"), number=1)
        session.edit(Edit("target", 45e6), point="1")
        session.set_point("P 2")

    log, _ = measured(tmp_path / "s", act)
    assert threads == [threading.get_ident()]
    assert log.of(PointBegan) == [PointBegan("P 2")]
    assert [(one.what, one.number, one.point) for one in log.of(Edited)] == [
        ("discard", 1, None),
        ("target", None, "1"),
    ]
    survey = read_survey(tmp_path / "s")
    assert [drop.discarded for drop in survey.drops] == [True, False]
    assert [drop.point for drop in survey.drops] == ["1", "P 2"]
    assert survey.points[0].target == 45e6


def test_what_cannot_be_done_is_told_and_ends_nothing(tmp_path: Path) -> None:
    log, _ = measured(tmp_path / "s", lambda session: session.edit(Edit("note", "x"), point="no"))
    assert any("expected one of the survey's points" in one.text for one in log.of(SessionNotice))
    assert len(log.of(DropSaved)) == 2


def test_a_replay_is_not_edited(tmp_path: Path) -> None:
    measured(tmp_path / "s")
    log = Log()

    class Asking:
        def __init__(self, session: Session) -> None:
            session.ask(lambda it: it.edit(Edit("note", "x"), point="1"))

        def __enter__(self) -> None: ...

        def __exit__(self, *_: object) -> None: ...

    replay(tmp_path / "s", log, control=Asking)
    assert any("got a replay" in one.text for one in log.of(SessionNotice))


def test_a_paused_replay_waits_and_steps_drop_by_drop(tmp_path: Path) -> None:
    measured(tmp_path / "s")
    pace = Pace(paused=True)
    log = Log()
    seen: list[int] = []

    class Steering:
        def __init__(self, session: Session) -> None:
            self.session = session
            self.thread = threading.Thread(target=self.steer)

        def steer(self) -> None:
            pause = threading.Event()
            pause.wait(0.3)
            seen.append(len(log.of(DropSaved)))
            pace.step()
            pause.wait(0.7)
            seen.append(len(log.of(DropSaved)))
            pace.go_on()

        def __enter__(self) -> None:
            self.thread.start()

        def __exit__(self, *_: object) -> None:
            self.thread.join()

    replay(tmp_path / "s", log, speed=pace, control=Steering)
    assert seen == [0, 1]
    assert len(log.of(DropSaved)) == 2
    assert all(one.identical for one in log.of(DropSaved))


def test_a_step_ends_with_its_drop() -> None:
    pace = Pace(paused=True)
    assert not pace.flows
    pace.step()
    assert pace.flows
    assert pace.may_begin()
    assert pace.flows  # the drop that has begun goes on to its end
    assert not pace.may_begin()
    assert not pace.flows
    pace.go_on()
    assert pace.may_begin()
    pace.pause()
    assert not pace.flows


def test_the_pace_is_changed_on_the_way() -> None:
    from pfwd.session.feeds import Ended
    from pfwd.session.replay import Pause, RecordedFeed

    slept: list[float] = []
    pace = Pace(2.0)
    feed = RecordedFeed([Pause(1.0), Ended()], pace, slept.append)
    assert feed.next(0.25) is None  # half of the recorded second
    pace.speed = 0.5
    assert feed.next(0.5) is None  # a quarter
    pace.speed = 0.0
    assert isinstance(feed.next(0.1), Ended)
    assert slept == [0.25, 0.5]


def test_the_survey_is_told_with_its_last_result_that_counts(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    measured(folder)
    whole = read(DropResult, result_of(1, 2e7))
    add_result(folder, 1, read(DropResult, result_of(1, 1e7)))
    add_result(folder, 1, whole)
    add_result(folder, 1, DropResult(modulus_pa=5e7))  # damaged
    add_result(folder, 1, replace(whole, modulus_pa=9e7, refit="half-space"))
    (point,) = read_points(folder)
    first, second = point.drops
    assert (first.number, first.record, len(first.source.results)) == (1, 1, 4)
    assert first.last_result == whole
    assert second.last_result is None
    assert [one.modulus_pa for one in stored_results(folder, 1)] == [9e7, 1e7, 2e7]


def test_a_damaged_result_is_none(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    measured(folder)
    add_result(folder, 1, DropResult(modulus_pa=1e7))
    (file,) = (folder / "results").glob("*.json")
    file.write_text("{")
    assert read_points(folder)[0].drops[0].last_result is None


def test_a_recorded_drop_comes_with_its_setup_and_its_judgement(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    measured(folder, lambda it: it.edit(Edit("declared", {"poisson_ratio": 0.4}), point="1"))
    one = recorded_drop(folder, 2)
    assert (one.point, one.number, one.record) == ("1", 2, 2)
    assert one.setup.poisson_ratio == 0.4
    assert one.screening.status == "measured"
    assert one.view.own.peak_load == pytest.approx(7000, rel=0.01)
    assert one.view.own.peak_deflection is not None
    with pytest.raises(SurveyError, match="expected drop 9"):
        recorded_drop(folder, 9)


def test_a_survey_that_is_written_takes_no_result_from_outside(tmp_path: Path) -> None:
    measured(tmp_path / "s")
    with (
        SurveyWriter.open(tmp_path / "s", publish=False),
        pytest.raises(RecordingError, match="the only program that writes"),
    ):
        add_result(tmp_path / "s", 1, {})


def test_a_point_is_where_the_receiver_was_unless_somebody_said_otherwise(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    said: list[dict[str, Any]] = [
        {"source": "nmea", "fault": "the receiver has no fix"},
        {"source": "nmea", "latitude": 48.2, "longitude": 11.6},
    ]

    class Receiver:
        def record(self) -> dict[str, Any]:
            return said.pop(0)

    log = Log()
    with SurveyWriter.open(folder, publish=False) as writer:
        feed = ScriptedFeed(connected(), began(7), TWO_DROPS[0], began(8), TWO_DROPS[1])
        Session(feed, log, SessionPlan(options=None, position=Receiver()), writer).run()
    recorded = [event.saved.view.metadata["position"] for event in log.of(DropSaved)]
    assert list(map(place_in, recorded)) == [None, Place(48.2, 11.6)]
    view = log.of(SurveyChanged)[-1].view
    assert view.points["1"].position == (48.2, 11.6)
    assert read_points(folder)[0].position == (48.2, 11.6)
    with SurveyWriter.open(folder) as writer:
        writer.edit("position", {"latitude": 1.0, "longitude": 2.0}, point="1")
    assert read_points(folder)[0].position == (1.0, 2.0)
