"""A procedure in a measuring session: which drops are seating, what is kept of it, the position."""

from pathlib import Path
from typing import Any

import pytest

from pfwd.analysis.screening.drops import screen_point
from pfwd.errors import OptionError
from pfwd.files.reading import read_points
from pfwd.judging import JobRequest, Station, job_of, point_views
from pfwd.procedures import find_procedure, plain_procedure
from pfwd.session.events import DropSaved, JobReported
from pfwd.session.replay import capture_feed
from pfwd.session.setup_file import MeasuringSetup, parse_setup, read_setup_file, with_procedure
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import Log, ScriptedFeed, connected, run
from tests.pfwd.session.measured import drops, record

PEAKS = (8000.0, 900.0, 8000.0, 8000.0, 8000.0, 8000.0)
"""N; the second one is a knock."""

PROFILE = """
pfwd-procedure = 1
name = "two"
title = "Two and one"
source = "contract"
quantity = "modulus"
[drops]
seating = { value = 2, source = "contract", verified = true }
measured = { value = 1, source = "contract", verified = true }
"""


MNDOT = with_procedure(MeasuringSetup(), find_procedure("mndot"))


def recorded_job(folder: Path, peaks: tuple[float, ...], run: int = 1, **plan: Any) -> Log:
    return record(folder, connected(), drops(*peaks, run=run), **plan)


def statuses(log: Log) -> list[str]:
    return [event.saved.screening.status for event in log.of(DropSaved)]


def test_a_rejected_drop_does_not_count_as_seating(tmp_path: Path) -> None:
    kinds = statuses(recorded_job(tmp_path / "s", PEAKS, setup=MNDOT))
    assert kinds == ["seating", "rejected", "seating", "seating", "measured", "measured"]
    (point,) = read_points(tmp_path / "s")  # the same when the survey is read again
    assert [screening.status for screening in screen_point(point)] == kinds
    parts = enumerate((PEAKS[:2], PEAKS[2:]), 1)
    continued = [recorded_job(tmp_path / "c", part, run, setup=MNDOT) for run, part in parts]
    assert [status for log in continued for status in statuses(log)] == kinds


def test_the_survey_stores_the_text_of_the_procedure(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(PROFILE, encoding="utf-8")
    (tmp_path / "setup.toml").write_text('[procedure]\nfile = "two.toml"\n', encoding="utf-8")
    setup = read_setup_file(tmp_path / "setup.toml")
    kinds = statuses(recorded_job(tmp_path / "s", PEAKS, setup=setup))
    assert kinds[:4] == ["seating", "rejected", "seating", "measured"]
    survey = read_survey(tmp_path / "s")
    (text,) = [each["details"]["text"] for each in survey.events if each["event"] == "procedure"]
    assert text == PROFILE
    assert survey.drops[0].read().declared["procedure"] == "two"


def test_a_capture_is_replayed_by_the_procedure_of_the_command_line(tmp_path: Path) -> None:
    header = {"url": "x", "dialect": "pfwd", "setup_text": "", "procedure_text": PROFILE}
    with SurveyWriter.open(tmp_path / "survey", publish=False) as writer:
        path = writer.open_capture("link", header).path
        # Nothing came: what counts is how it would be read.
    _, setup, _ = capture_feed(path)
    assert (setup.procedure.name, setup.declared["seating_drops"]) == ("two", 2)


def test_on_the_command_line_a_contradiction_is_wrong_usage() -> None:
    with pytest.raises(OptionError, match="--procedure: seating_drops: expected 3"):
        with_procedure(parse_setup("seating_drops = 1", "s"), find_procedure("mndot"))


def test_unverified_numbers_do_not_replace_the_setup_and_equal_ones_are_accepted() -> None:
    for seating_drops, procedure in ((1, "astm-e2583"), (3, "mndot")):
        text = f'seating_drops = {seating_drops}\nprocedure = "{procedure}"'
        assert parse_setup(text, "setup.toml").declared["seating_drops"] == seating_drops


def test_the_job_is_stored_with_the_first_drop(tmp_path: Path) -> None:
    request = JobRequest(target=6e-4, step_m=20.0, operator="A. Miller")
    recorded_job(tmp_path / "s", (8000.0,), setup=MNDOT, job=request)
    survey = read_survey(tmp_path / "s")
    job = job_of(survey)
    assert (job.procedure_in_force.name, job.target, job.step_m) == ("mndot", 6e-4, 20.0)
    assert (job.operator, job.device) == ("A. Miller", "T-1")
    assert survey.drops[0].read().declared["operator"] == "A. Miller"
    assert job.time_zone[0] in "+-"


def test_a_survey_that_is_continued_keeps_procedure_and_target(tmp_path: Path) -> None:
    folder, full = tmp_path / "s", (8000.0,) * 3
    recorded_job(folder, full, 1, setup=MNDOT, job=JobRequest(target=6e-4))
    log = recorded_job(folder, full, 2)
    assert statuses(log) == ["measured"] * 3, "three seated the plate before"
    (point,) = point_views(read_survey(folder))
    assert point.progress.verdict == "pass"
    assert log.of(JobReported)[0].differences == ()
    events = [event for event in read_survey(folder).events if event["event"] == "procedure"]
    assert len(events) == 1, "what is kept already is not said again"


def test_a_list_of_stations_begins_with_its_first(tmp_path: Path) -> None:
    request = JobRequest(stations=(Station("12+300", 12_300.0), Station("12+320", 12_320.0)))
    log = recorded_job(tmp_path / "s", (8000.0,), job=request)
    assert log.of(DropSaved)[0].saved.point == "12+300"
    log = recorded_job(tmp_path / "s", (8000.0,), 2, point="12+320")
    assert log.of(DropSaved)[0].saved.point == "12+320", "what is named counts"


def test_another_procedure_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    recorded_job(folder, (8000.0,), 1, setup=MNDOT, job=JobRequest(target=6e-4))
    second = with_procedure(MeasuringSetup(), find_procedure("mchw-885"))
    log = recorded_job(folder, (8000.0,), 2, setup=second, job=JobRequest(target=4e7))
    assert len(log.of(JobReported)[0].differences) == 2
    assert job_of(read_survey(folder)).procedure_in_force.name == "mchw-885"


def test_a_setup_that_contradicts_the_stored_procedure_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    recorded_job(folder, (8000.0,), 1, setup=MNDOT)
    with pytest.raises(OptionError, match="procedure mndot of the survey: seating_drops"):
        recorded_job(folder, (8000.0,), 2, setup=parse_setup("seating_drops = 1", "setup"))


def test_the_default_procedure_is_for_new_surveys(tmp_path: Path) -> None:
    recorded_job(tmp_path / "new", (8000.0,), default_procedure=plain_procedure())
    assert job_of(read_survey(tmp_path / "new")).procedure_in_force.name == "plain"
    recorded_job(tmp_path / "old", (8000.0,), 1)
    recorded_job(tmp_path / "old", (8000.0,), 2, default_procedure=plain_procedure())
    assert job_of(read_survey(tmp_path / "old")).procedure is None


def test_a_change_of_the_job_is_stored(tmp_path: Path) -> None:
    request = JobRequest(target=4e7)
    act = [lambda: feed.session.ask(lambda session: session.change_job(request))]
    feed, log = ScriptedFeed(act, connected(), drops(8000.0)), Log()
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        run(feed, log, writer)
    assert log.of(JobReported)[-1].job.target == 4e7
    assert job_of(read_survey(tmp_path / "s")).target == 4e7
