"""A drop measured under the wrong point, moved."""

from pathlib import Path

import pytest

from inversion.notices import text_of
from pfwd.files.editing import Edit
from pfwd.judging import JobRequest, Station, point_views
from pfwd.procedures import Kind
from pfwd.session.events import DropSaved, PointReported, SurveyChanged
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import write_judged_survey
from tests.pfwd.scripted_feed import Log, ScriptedFeed
from tui.cli import main


@pytest.fixture
def survey(tmp_path: Path) -> str:
    """Point 1 holds a seating and a measured drop too many, which belong to point 2."""
    return str(write_judged_survey(tmp_path / "s", 40e6, {"1": (60e6, 61e6, 30e6, 31e6)}))


def edit(survey: str, *options: str) -> int:
    return main(["edit", survey, *options])


def test_it_counts_where_it_belongs_and_nowhere_else(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for drop in ("3", "4"):
        done = edit(survey, "--point", "1", "--drop", drop, "--move", "2", "--new-point", "--json")
        assert done == 0
    capsys.readouterr()
    first, second = point_views(read_survey(survey))
    assert (first.progress.used, first.progress.verdict) == ((2,), "pass")
    assert (second.name, second.progress.used, second.progress.verdict) == ("2", (2,), "fail")
    reasons = {drop.number: drop.reason for drop in first.progress.excluded}
    assert text_of(reasons[3]).endswith("moved to point 2, drop 1")
    drops = read_survey(survey).drops
    assert [drop.discarded for drop in drops] == [False, False, True, True, False, False]
    assert drops[4].read().metadata["moved_from"] == {"point": "1", "drop": 3, "record": 3}


def test_a_moved_drop_is_listed_as_moved(survey: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert edit(survey, "--point", "1", "--drop", "3", "--move", "2", "--new-point") == 0
    assert edit(survey, "--point", "1", "--drop", "4", "--discard") == 0
    capsys.readouterr()
    assert edit(survey) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  drop 3: MOVED: moved to point 2, drop 1" in lines
    assert "  drop 4: DISCARDED" in lines
    assert edit(survey, "--point", "1", "--drop", "3", "--restore") == 0
    assert "MOVED" not in capsys.readouterr().out.split("point 2")[0]


def test_a_seating_drop_that_is_moved_away_seated_nothing(survey: str) -> None:
    edit(survey, "--drop", "1", "--move", "2", "--new-point")
    first, _ = point_views(read_survey(survey))
    assert dict(first.progress.kinds)[2] == "seating"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--move", "1"], "--move: expected a drop, named by --drop, got none"),
        (["--drop", "9", "--move", "1"], "--drop: expected a drop of point 1"),
        (["--drop", "1", "--move", "1"], "expected another point, got '1'"),
        (["--drop", "1", "--move", ""], "expected a name of 1 to 64 characters"),
        (["--drop", "1", "--move", "2", "--note", "x"], "no other edit, got other edits"),
    ],
)
def test_what_cannot_be_moved(
    survey: str, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert edit(survey, *options) == 2
    assert message in capsys.readouterr().err
    assert len(read_survey(survey).drops) == 4


def test_while_it_is_measured(survey: str) -> None:
    log = Log()
    with SurveyWriter.open(survey, publish=False) as writer:
        session = Session(ScriptedFeed(), log, SessionPlan(options=None, point="2"), writer)
        session.ask(lambda it: it.move_drop(3, "2"))
        session.ask(lambda it: it.move_drop(99, "2"))
        session.run()
        assert writer.next_number("2") == 2
    known = log.of(PointReported)[-1]
    assert (known.point.name, [drop.number for drop in known.point.drops]) == ("2", [1])
    assert "expected a drop of the survey, got number 99" in log.texts
    assert log.of(DropSaved) == []
    assert [point.name for point in point_views(read_survey(survey))] == ["1", "2"]


def counting(survey: str) -> dict[str, list[int]]:
    """Numbers within their points of the drops that count."""
    points = point_views(read_survey(survey))
    return {
        point.name: [
            number
            for number, kind in point.progress.kinds
            if kind not in (Kind.REJECTED, Kind.DISCARDED)
        ]
        for point in points
    }


def test_a_move_taken_back_while_it_is_measured_counts_the_drop_once(survey: str) -> None:
    log = Log()
    with SurveyWriter.open(survey, publish=False) as writer:
        session = Session(ScriptedFeed(), log, SessionPlan(options=None, point="1"), writer)
        session.ask(lambda it: it.edit(Edit("discard", "by the operator"), number=2))
        session.ask(lambda it: it.move_drop(3, "2"))
        session.ask(lambda it: it.edit(Edit("restore"), number=3))
        session.ask(lambda it: it.edit(Edit("restore"), number=99))
        session.run()
    assert counting(survey) == {"1": [1, 3, 4], "2": []}
    view = log.of(SurveyChanged)[-1].view
    kinds = dict(view.points["1"].progress.kinds)
    assert (kinds[2], kinds[3]) == (Kind.DISCARDED, Kind.MEASURED)
    assert dict(view.points["2"].progress.kinds)[1] is Kind.REJECTED
    assert "restore: expected a drop of the survey, got number 99" in log.texts


def test_restoring_a_moved_drop_takes_it_from_where_it_is_now(survey: str) -> None:
    edit(survey, "--point", "1", "--drop", "3", "--move", "2", "--new-point")
    edit(survey, "--point", "2", "--drop", "1", "--move", "3", "--new-point")
    assert counting(survey) == {"1": [1, 2, 4], "2": [], "3": [1]}
    assert edit(survey, "--point", "1", "--drop", "3", "--restore") == 0
    assert counting(survey) == {"1": [1, 2, 3, 4], "2": [], "3": []}
    assert edit(survey, "--point", "1", "--drop", "3", "--move", "2", "--new-point") == 0
    assert counting(survey) == {"1": [1, 2, 4], "2": [2], "3": []}


def test_a_move_to_a_renamed_point_finds_it_by_its_title(survey: str) -> None:
    edit(survey, "--point", "1", "--drop", "3", "--move", "2", "--new-point")
    edit(survey, "--point", "2", "--name", "km 1")
    with SurveyWriter.open(survey, publish=False) as writer:
        session = Session(ScriptedFeed(), Log(), SessionPlan(options=None, point="1"), writer)
        session.ask(lambda it: it.move_drop(4, "km 1"))
        session.run()
    assert [point.name for point in read_survey(survey).points] == ["1", "2"]


def test_a_move_to_an_unknown_point_is_refused_without_a_terminal(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    move = ["edit", survey, "--point", "1", "--drop", "3", "--move", "11"]
    assert main(move) == 2
    assert "expected a point (1), got '11'; give --new-point to begin" in capsys.readouterr().err
    assert len(read_survey(survey).drops) == 4
    assert main([*move, "--new-point"]) == 0
    assert main(["job", survey, "--stations", _stations(survey, "12+360")]) == 0
    assert main([*move[:5], "2", "--move", "12+360"]) == 0  # a station is known
    assert counting(survey) == {"1": [1, 4], "11": [1], "12+360": [1]}


@pytest.mark.parametrize(("answer", "n_drops"), [("", 4), ("y", 5)])
def test_a_move_to_an_unknown_point_asks_on_a_terminal(
    survey: str, answer: str, n_drops: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tui.commands.edit.on_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: answer)
    assert edit(survey, "--point", "1", "--drop", "3", "--move", "11") == 0
    assert len(read_survey(survey).drops) == n_drops


def _stations(survey: str, name: str) -> str:
    file = Path(survey).with_suffix(".csv")
    file.write_text(f"name\n{name}\n", encoding="utf-8")
    return str(file)


def test_a_new_point_that_is_part_of_a_station_is_doubted_by_the_session(survey: str) -> None:
    stations = JobRequest(stations=(Station("12+360"), Station("12+380")))
    doubts = []
    for point in ("12+36", "12+360", "7"):
        log = Log()
        plan = SessionPlan(options=None, point=point, job=stations)
        with SurveyWriter.open(survey, publish=False) as writer:
            Session(ScriptedFeed(), log, plan, writer).run()
        doubts.append("is new, but 12+360 exists. Was 12+360 meant?" in log.texts)
    assert doubts == [True, False, False]
