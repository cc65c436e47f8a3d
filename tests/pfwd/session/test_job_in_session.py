"""The job of a survey in a measuring session: kept from the first drop on, and kept on."""

from pathlib import Path
from typing import Any

import pytest

from pfwd.errors import OptionError
from pfwd.judging import JobRequest, Station, job_of, point_views
from pfwd.procedures import find_procedure, plain_procedure
from pfwd.session.events import DropSaved, JobReported, SurveyChanged
from pfwd.session.live_view import CompletePoints
from pfwd.session.measure import replay
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd.session.setup_file import MeasuringSetup, parse_setup, with_procedure
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import Log, ScriptedFeed, connected
from tests.pfwd.session.measured import drops, record

MNDOT = with_procedure(MeasuringSetup(), find_procedure("mndot"))


def session(folder: Path, peaks: tuple[float, ...], run: int = 1, **plan: Any) -> Log:
    return record(folder, connected(), drops(*peaks, run=run), **plan)


def test_the_job_is_stored_with_the_first_drop(tmp_path: Path) -> None:
    request = JobRequest(target=6e-4, step_m=20.0, operator="A. Miller")
    session(tmp_path / "s", (8000.0,), setup=MNDOT, job=request)
    survey = read_survey(tmp_path / "s")
    job = job_of(survey)
    assert (job.procedure_in_force.name, job.target, job.step_m) == ("mndot", 6e-4, 20.0)
    assert (job.operator, job.device) == ("A. Miller", "T-1")
    assert survey.drops[0].read().declared["operator"] == "A. Miller"
    assert job.time_zone[0] in "+-"


def test_a_survey_that_is_continued_keeps_procedure_and_target(tmp_path: Path) -> None:
    folder, full = tmp_path / "s", (8000.0,) * 3
    session(folder, full, 1, setup=MNDOT, job=JobRequest(target=6e-4))
    log = session(folder, full, 2)
    statuses = [event.saved.screening.status for event in log.of(DropSaved)]
    assert statuses == ["measured"] * 3, "three seated the plate before"
    (point,) = point_views(read_survey(folder))
    assert point.progress.verdict == "pass"
    assert log.of(JobReported)[0].differences == ()
    events = [event for event in read_survey(folder).events if event["event"] == "procedure"]
    assert len(events) == 1, "what is kept already is not said again"


def test_a_list_of_stations_begins_with_its_first(tmp_path: Path) -> None:
    request = JobRequest(stations=(Station("12+300", 12_300.0), Station("12+320", 12_320.0)))
    log = session(tmp_path / "s", (8000.0,), job=request)
    assert log.of(DropSaved)[0].saved.point == "12+300"
    log = session(tmp_path / "s", (8000.0,), 2, point="12+320")
    assert log.of(DropSaved)[0].saved.point == "12+320", "what is named counts"


def test_another_procedure_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    session(folder, (8000.0,), 1, setup=MNDOT, job=JobRequest(target=6e-4))
    second = with_procedure(MeasuringSetup(), find_procedure("mchw-885"))
    log = session(folder, (8000.0,), 2, setup=second, job=JobRequest(target=4e7))
    assert log.of(JobReported)[0].differences == (
        "the procedure of the survey was mndot, now it is mchw-885",
        "the target of the survey was 0.6 mm, now it is 40 MPa",
    )
    assert job_of(read_survey(folder)).procedure_in_force.name == "mchw-885"


def test_a_setup_that_contradicts_the_stored_procedure_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    session(folder, (8000.0,), 1, setup=MNDOT)
    with pytest.raises(OptionError, match="procedure mndot of the survey: seating_drops"):
        session(folder, (8000.0,), 2, setup=parse_setup("seating_drops = 1", "setup"))


def test_the_default_procedure_is_for_new_surveys(tmp_path: Path) -> None:
    session(tmp_path / "new", (8000.0,), default_procedure=plain_procedure())
    assert job_of(read_survey(tmp_path / "new")).procedure_in_force.name == "plain"
    session(tmp_path / "old", (8000.0,), 1)
    session(tmp_path / "old", (8000.0,), 2, default_procedure=plain_procedure())
    assert job_of(read_survey(tmp_path / "old")).procedure is None


def test_a_change_of_the_job_is_stored(tmp_path: Path) -> None:
    log = Log()
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        feed = ScriptedFeed(connected(), drops(8000.0))
        measuring = Session(feed, log, SessionPlan(options=None), writer)
        measuring.ask(lambda it: it.change_job(JobRequest(target=4e7)))
        measuring.run()
    assert log.of(JobReported)[-1].job.target == 4e7
    assert job_of(read_survey(tmp_path / "s")).target == 4e7


@pytest.mark.parametrize("edit", [None, ("discard", 4), ("target", 1e-4), ("discard", None)])
def test_a_replay_agrees_with_the_survey(tmp_path: Path, edit: tuple[str, Any] | None) -> None:
    folder = tmp_path / "s"
    session(folder, (8000.0,) * 7, setup=MNDOT, job=JobRequest(target=6e-4))
    if edit is not None:
        edited, value = edit
        with SurveyWriter.open(folder, publish=False) as writer:
            if edited == "discard" and value is not None:
                writer.edit("discard", "wrong place", number=value)
            else:
                writer.edit(edited, value, point="1")
    views: list[Any] = []
    complete, log = CompletePoints(views.append), Log()
    replay(folder, log)
    for event in log.of(SurveyChanged):
        complete.take(event)
    (point,) = point_views(read_survey(folder))
    replayed = views[-1].as_json()
    compaction = {"compaction": replayed["compaction"]}
    assert replayed == point.as_json() | compaction, "drop 7 came after it"
