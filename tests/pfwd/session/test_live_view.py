"""Survey that a session publishes: what an event changes, and what the views share."""

from pathlib import Path

from pfwd.analysis.result_store import last_diagnosis
from pfwd.analysis.results import DiagnosisResult
from pfwd.judging import PointView, SurveyView
from pfwd.session.events import PointBegan, Rebounded, SurveyChanged, SurveyRead
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import Log, Publisher, ScriptedFeed, connected, run
from tests.pfwd.session.measured import drops
from tests.records import read


def measured(folder: Path, point: str, before: SurveyView | None = None) -> Log:
    log = Log()
    with SurveyWriter.open(folder, publish=False) as writer:
        feed = ScriptedFeed(connected(), drops(8000.0, run=int(point)))
        session = Session(feed, log, SessionPlan(options=None, point=point), writer)
        if before is not None:
            session.continue_survey(before)
        session.run()
    return log


def test_views_share_all_points_and_drops_that_an_event_does_not_change(tmp_path: Path) -> None:
    first = measured(tmp_path / "s", "1").of(SurveyChanged)[-1].view
    assert [drop.number for drop in first.points["1"].drops] == [1]
    publisher = Publisher()
    publisher.view = first
    publisher(PointBegan("2"))
    assert publisher.view.points["1"] is first.points["1"]
    publisher(Rebounded("1", 1, 0.5, 2000.0))
    (drop,) = publisher.view.points["1"].drops
    assert drop.rebounds == (2000.0,)
    assert drop.metadata is first.points["1"].drops[0].metadata


def test_a_session_continues_the_survey_of_the_previous_session(tmp_path: Path) -> None:
    before = measured(tmp_path / "s", "1").of(SurveyChanged)[-1].view
    log = measured(tmp_path / "s", "2", before)
    changes = log.of(SurveyChanged)
    assert list(changes[0].view.points) == ["1", "2"], "before it measures anything"
    assert [len(point.drops) for point in changes[-1].view.points.values()] == [1, 1]


def test_a_requested_diagnosis_is_stored_by_the_session_that_writes(tmp_path: Path) -> None:
    diagnosis = read(DiagnosisResult, {"drops": [1], "verdict": "clean"})
    log = Log()
    feed = ScriptedFeed(connected(), drops(8000.0))
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        run(feed, log, writer, point="1")
        feed.session.keep_diagnosis(1, diagnosis)
    assert log.of(SurveyChanged)[-1].view.points["1"].diagnosis is diagnosis
    (point,) = read_survey(tmp_path / "s").points
    stored = last_diagnosis(point)
    assert (stored.drops, stored.verdict) == ((1,), "clean")


def test_stored_points_precede_the_current_point() -> None:
    publisher = Publisher()
    publisher(PointBegan("3"))
    publisher(SurveyRead((PointView("1"), PointView("2"))))
    assert list(publisher.view.points) == ["1", "2", "3"]
