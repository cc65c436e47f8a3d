"""Every way to the verdicts of a random survey gives the same ones."""

import csv
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import pfwd
from pfwd.export.export import export_survey
from pfwd.files.opening import survey_content
from pfwd.judging import PointView, point_views
from pfwd.procedures import PointProgress
from pfwd.report import formatting, gathering
from pfwd.report.blocks import Mark
from pfwd.report.certificate_blocks import points_table
from pfwd.report.point_facts import verdict_of
from pfwd.report.template import point_values
from pfwd.report.texts import load_texts
from pfwd.session.events import SurveyChanged
from pfwd.session.live_view import CompletePoints
from pfwd.session.measure import replay
from pfwd_device.recording import read_survey
from tests.pfwd.judging.stories import PlayedSession, story_of, with_results
from tests.pfwd.report.surveys import RecordedInversion
from tests.records import known
from tui.output import counted
from tui.screen.opened.rows import OpenedSurvey
from tui.screen.session.state import SessionState


@contextmanager
def surveys() -> Iterator[Path]:
    """Temporary folder for a survey and for the caches of its readers."""
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        patch.setenv("PFWD_CACHE", os.path.join(place, "cache"))
        yield Path(place)


def read(folder: Path) -> dict[str, PointView]:
    """The points of a survey as they are judged when it is read, by the name of their drops."""
    survey = read_survey(folder)
    return dict(zip((p.name for p in survey.points), point_views(survey), strict=True))


# The live session, the log, sessions that go on, the replay and `pfwd open`.


def check_sessions(story: list[Any], cut: int) -> None:
    """Play a story as two sessions; the second continues the survey of the first."""
    with surveys() as place:
        session = PlayedSession(place / "s")
        session.play(story[:cut])
        check_session(session)
        session.restart()
        session.play(story[cut:])
        check_session(session)
        points = read(session.folder)
        check_replay(session.folder, points)
        check_opened(session.folder, points)


def check_session(session: PlayedSession) -> None:
    """Compare the events of a session with the survey that it wrote."""
    points = read(session.folder)
    for name, point in points.items():
        live = session.state.view.points[name]
        assert live.progress == point.progress, "on the screen"
        if point.progress.complete:
            assert name in session.last_lines
    for name, line in session.last_lines.items():
        _same_line(line, points[name], "log")


def _same_line(line: Mapping[str, Any], point: PointView, where: str) -> None:
    """The line of a complete point. Which drops take part, and why, may change with a later drop
    while what is compared here stays: then there is no new line."""
    progress = point.progress
    assert (line["complete"], line["verdict"]) == (progress.complete, progress.verdict), where
    assert (line["target"], line["value"]) == (progress.target, progress.as_dict()["value"]), where
    assert (line["value"] or {}).get("value") == (progress.value and progress.value.value), where


def check_replay(folder: Path, points: Mapping[str, PointView]) -> None:
    """Compare the points, lines and screen of ``replay --live``."""
    complete_points: list[PointView] = []
    complete, state = CompletePoints(complete_points.append), SessionState()

    def listen(event: Any) -> None:
        if isinstance(event, SurveyChanged):
            complete.take(event)
        state.take(event)

    replay(folder, listen)
    complete.rest()
    lines = {point.name: point.as_json() for point in complete_points}
    measured = {point.name for point in read_survey(folder).points if point.drops}
    for name, point in points.items():
        if name not in measured:  # a replay has nothing to begin it with
            continue
        assert state.view.points[name].progress == point.progress, "replay --live"
        assert (name in lines) >= point.progress.complete
        if name in lines:
            _same_line(lines[name], point, "replay")


def check_opened(folder: Path, points: Mapping[str, PointView]) -> None:
    """Compare the points of ``pfwd open``, judged and from its cache."""
    opened, reopened = OpenedSurvey(folder), OpenedSurvey(folder)
    opened.read()
    opened.judge(lambda _rows: None)
    cached = known(reopened.from_cache())
    for rows in (opened.rows, cached):
        assert [row.name for row in rows] == list(points)
        for row in rows:
            progress = points[row.name].progress
            value = progress.value
            assert (row.verdict, row.target) == (progress.verdict, progress.target), "opened"
            assert row.value == (value and value.value)
            assert (row.low, row.high) == ((value and value.interval) or (None, None))
            # A drop that is used may have no modulus.
            drops = "" if value is None else counted(value.drops, "drop")
            assert drops in row.origin
            assert bool(row.origin) == (value is not None)


# Reports and exports.


def check_documents(story: list[Any]) -> None:
    """Measure a survey and compare its report, its exports and what scripts read.

    All formats in columns have the same rows; the tests of each format check its columns.
    """
    with surveys() as place:
        session = PlayedSession(place / "s")
        session.play(with_results(story))
        points = read(session.folder)
        by_title = {point.shown_name: point.progress for point in points.values()}
        check_report(session.folder, by_title)
        for form in ("points", "jsonl", "survey"):
            export_survey(session.folder, form, place / form)
        with (place / "points").open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        assert [row["point"] for row in rows] == list(by_title)
        lines = (place / "jsonl").read_text(encoding="utf-8").splitlines()
        for row in (*rows, *map(json.loads, lines), *pfwd.open(session.folder).to_dict()["drops"]):
            assert_same_verdict(row, by_title[str(row["point"])])
        packed = point_views(survey_content(place / "survey"))
        assert [point.progress for point in packed] == [p.progress for p in points.values()]


def check_report(folder: Path, by_title: Mapping[str, PointProgress]) -> None:
    """Compare ``report --json``, the table of the first page and a filled workbook."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gathering, "curves_of", lambda *_: None)  # takes long, and judges nothing
        # A rebound has no result, also where the larger drop was moved away later.
        RecordedInversion(patch)
        report = gathering.gather(folder)
    texts = load_texts("en")
    table = points_table(report, texts)
    for point, cells in zip(report.points, table.rows, strict=True):
        progress = by_title[point.shown_name]
        assert point.progress == progress, "reported"
        assert point.progress.as_dict() == progress.as_dict()
        (mark,) = (cell for cell in cells if isinstance(cell, Mark))
        assert mark.kind == progress.verdict == verdict_of(point)
        # A column without any value is left out.
        value = formatting.value_of(progress.value, texts)
        assert value in cells or value == formatting.NO_VALUE
        assert formatting.target_of(progress.target, report.procedure.quantity, texts) in cells
        assert_same_verdict(point_values(point), progress)


def assert_same_verdict(row: Mapping[str, Any], progress: PointProgress) -> None:
    """Compare verdict, value with its interval, and target, as numbers or as texts."""
    value = progress.value
    low, high = (None, None) if value is None or value.interval is None else value.interval
    expected = {
        "value": value and value.value,
        "interval_low": low,
        "interval_high": high,
        "target": progress.target,
    }
    assert row["verdict"] == progress.verdict.value
    for key, number in expected.items():
        assert (None if row[key] in ("", None) else float(row[key])) == number, key


# Some stories every day, many more in the slow run.
NUMBERS = [*range(12), *(pytest.param(n, marks=pytest.mark.slow) for n in range(12, 160))]


@pytest.mark.parametrize("number", NUMBERS)
def test_live_logged_resumed_replayed_and_opened_verdicts_agree(number: int) -> None:
    story = story_of(number)
    check_sessions(story, 7 * number % (len(story) + 1))


@pytest.mark.parametrize("number", NUMBERS)
def test_reported_and_exported_it_is_the_same(number: int) -> None:
    check_documents(story_of(number))
