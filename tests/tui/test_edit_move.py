"""A drop measured under the wrong point, moved."""

from collections.abc import Callable
from pathlib import Path

import pytest

from inversion.notices import text_of
from pfwd.files.editing import Edit
from pfwd.judging import point_views
from pfwd.procedures import Kind
from pfwd.session.events import DropSaved, PointReported, SurveyChanged
from pfwd.session.plan import SessionPlan
from pfwd.session.session import Session
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import write_judged_survey
from tests.pfwd.scripted_feed import Log, ScriptedFeed
from tests.tui.console import pfwd
from tui.cli import main


@pytest.fixture
def survey(tmp_path: Path) -> str:
    """Point 1 contains a seating and a measured drop too many, which belong to point 2."""
    return str(write_judged_survey(tmp_path / "s", 40e6, {"1": (60e6, 61e6, 30e6, 31e6)}))


def edit(survey: str, *options: str) -> int:
    return main(["edit", survey, *options])


def move(survey: str, point: str, drop: int, to: str, *options: str) -> int:
    return edit(survey, "--point", point, "--drop", str(drop), "--move", to, *options)


def counting(survey: str) -> dict[str, list[int]]:
    """Return the numbers within their points of the drops that count."""
    out = (Kind.REJECTED, Kind.DISCARDED)
    return {
        point.name: [number for number, kind in point.progress.kinds if kind not in out]
        for point in point_views(read_survey(survey))
    }


def test_a_moved_drop_counts_at_its_new_point_only(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for drop in (3, 4):
        assert move(survey, "1", drop, "2", "--new-point", "--json") == 0
    first, second = point_views(read_survey(survey))
    assert (first.progress.used, first.progress.verdict) == ((2,), "pass")
    assert (second.name, second.progress.used, second.progress.verdict) == ("2", (2,), "fail")
    reasons = {drop.number: drop.reason for drop in first.progress.excluded}
    assert text_of(reasons[3]).endswith("moved to point 2, drop 1")
    drops = read_survey(survey).drops
    assert [drop.discarded for drop in drops] == [False, False, True, True, False, False]
    assert drops[4].read().metadata["moved_from"] == {"point": "1", "drop": 3, "record": 3}
    assert edit(survey, "--point", "1", "--drop", "2", "--discard") == 0
    capsys.readouterr()
    assert edit(survey) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  drop 3: MOVED: moved to point 2, drop 1" in lines
    assert "  drop 2: DISCARDED" in lines
    assert edit(survey, "--point", "1", "--drop", "3", "--restore") == 0
    assert "drop 3: MOVED" not in capsys.readouterr().out.split("point 2")[0]


def test_a_seating_drop_that_is_moved_away_has_seated_no_surface(survey: str) -> None:
    move(survey, "1", 1, "2", "--new-point")
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
        (["--drop", "3", "--move", "11"], "expected a point (1), got '11'; give --new-point"),
    ],
)
def test_an_impossible_move_is_refused(survey: str, options: list[str], message: str) -> None:
    printed = pfwd("edit", survey, *options)
    assert (printed.status, message in printed.err) == (2, True)
    assert len(read_survey(survey).drops) == 4


def measure(survey: str, point: str, *requests: Callable[[Session], None]) -> Log:
    """Run a session with requests and without drops."""
    log = Log()
    with SurveyWriter.open(survey, publish=False) as writer:
        session = Session(ScriptedFeed(), log, SessionPlan(options=None, point=point), writer)
        for request in requests:
            session.ask(request)
        session.run()
    return log


def test_a_drop_is_moved_while_a_survey_is_measured(survey: str) -> None:
    log = measure(survey, "2", lambda it: it.move_drop(3, "2"), lambda it: it.move_drop(99, "2"))
    report = log.of(PointReported)[-1]
    assert (report.point.name, [drop.number for drop in report.point.drops]) == ("2", [1])
    assert "expected a drop of the survey, got number 99" in log.texts
    assert log.of(DropSaved) == []
    edit(survey, "--point", "2", "--name", "km 1")
    measure(survey, "1", lambda it: it.move_drop(4, "km 1"))
    assert counting(survey) == {"1": [1, 2], "2": [1, 2]}, "a point is found by its title too"


def test_a_restored_drop_counts_once_in_a_session(survey: str) -> None:
    log = measure(
        survey,
        "1",
        lambda it: it.edit(Edit("discard", "by the operator"), number=2),
        lambda it: it.move_drop(3, "2"),
        lambda it: it.edit(Edit("restore"), number=3),
        lambda it: it.edit(Edit("restore"), number=99),
    )
    assert counting(survey) == {"1": [1, 3, 4], "2": []}
    points = log.of(SurveyChanged)[-1].view.points
    kinds = dict(points["1"].progress.kinds)
    assert (kinds[2], kinds[3]) == (Kind.DISCARDED, Kind.MEASURED)
    assert dict(points["2"].progress.kinds)[1] is Kind.REJECTED
    assert "restore: expected a drop of the survey, got number 99" in log.texts


def test_restoring_a_moved_drop_takes_it_from_its_last_point(survey: str) -> None:
    move(survey, "1", 3, "2", "--new-point")
    move(survey, "2", 1, "3", "--new-point")
    assert counting(survey) == {"1": [1, 2, 4], "2": [], "3": [1]}
    assert edit(survey, "--point", "1", "--drop", "3", "--restore") == 0
    assert counting(survey) == {"1": [1, 2, 3, 4], "2": [], "3": []}
    assert move(survey, "1", 3, "2") == 0
    assert counting(survey) == {"1": [1, 2, 4], "2": [2], "3": []}


@pytest.mark.parametrize(("answer", "n_drops"), [("", 4), ("y", 5)])
def test_a_move_to_an_unknown_point_asks_on_a_terminal(
    survey: str, answer: str, n_drops: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tui.commands.edit.on_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: answer)
    assert move(survey, "1", 3, "11") == 0
    assert len(read_survey(survey).drops) == n_drops


def test_the_name_of_a_station_needs_no_confirmation(survey: str) -> None:
    stations = Path(survey).with_suffix(".csv")
    stations.write_text("name\n12+360\n", encoding="utf-8")
    assert main(["job", survey, "--stations", str(stations)]) == 0
    assert move(survey, "1", 2, "12+360") == 0
    assert counting(survey)["12+360"] == [1]
