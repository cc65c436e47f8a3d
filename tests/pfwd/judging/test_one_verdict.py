"""One truth per survey: whatever was measured and said, every way to the verdict finds the same."""

import csv
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import Phase, given, settings

from pfwd.export.export import export_survey
from pfwd.export.maps import GPX_NAMESPACE
from pfwd.export.registry import BUILT_IN_FORMATS
from pfwd.facts import fact_of_value
from pfwd.files.opening import survey_content
from pfwd.judging import JobRequest, PointView, point_views
from pfwd.judging.job import target_text
from pfwd.report import formatting, gathering
from pfwd.report.blocks import Mark
from pfwd.report.certificate_blocks import points_table
from pfwd.report.point_facts import verdict_of
from pfwd.report.template import point_values
from pfwd.report.texts import load_texts
from pfwd.session.events import SurveyChanged
from pfwd.session.live_view import CompletePoints
from pfwd.session.measure import replay
from pfwd.units import SI
from pfwd_device.recording import read_survey
from tests.pfwd.judging import stories
from tests.pfwd.judging.stories import Told, whole
from tui.output import counted
from tui.screen.opened.rows import OpenedSurvey
from tui.screen.session.state import SessionState

WITHOUT_VERDICT = {
    "csv": "a folder of trace files, which other programs read",
    "h5": "records of drops and their stored results, which other programs read",
}
"""Formats that have no room for a verdict, and why."""


@contextmanager
def surveys() -> Iterator[Path]:
    """A place for a survey; what pages keep of it goes there, too."""
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        patch.setenv("PFWD_CACHE", os.path.join(place, "cache"))
        yield Path(place)


def read(folder: Path) -> dict[str, PointView]:
    """The points of a survey as they are judged when it is read, by the name of their drops."""
    survey = read_survey(folder)
    return dict(zip((p.name for p in survey.points), point_views(survey), strict=True))


# The live session, the log, sessions that go on, the replay and `pfwd open`.


def check_sessions(story: list[Any], cut: int) -> None:
    """Play a story as two sessions, the second going on with what the first left."""
    with surveys() as place:
        told = Told(place / "s")
        told.play(story[:cut])
        check_session(told)
        told.begin_again()
        told.play(story[cut:])
        check_session(told)
        known = read(told.folder)
        check_replay(told.folder, known)
        check_opened(told.folder, known)


def check_session(told: Told) -> None:
    """What was told while it was measured is what is read afterwards."""
    known = read(told.folder)
    for name, point in known.items():
        live = told.state.view.points[name]
        assert stories.shown(live) == stories.shown(point), "live"
        assert live.progress == point.progress, "on the screen"
        if point.progress.complete:
            assert name in told.last_lines
    for name, line in told.last_lines.items():
        _same_line(line, known[name], "log")


def _same_line(line: Mapping[str, Any], point: PointView, where: str) -> None:
    """The line of a complete point. Which drops take part, and why, may change with a later drop
    while what is compared here stays: then there is no new line."""
    progress = point.progress
    assert (line["complete"], line["verdict"]) == (progress.complete, progress.verdict), where
    assert (line["target"], line["value"]) == (progress.target, progress.as_dict()["value"]), where
    assert (line["value"] or {}).get("value") == (progress.value and progress.value.value), where


def check_replay(folder: Path, known: Mapping[str, PointView]) -> None:
    """Of a replay: the points, the lines and the screen of ``replay --live``."""
    said: list[PointView] = []
    complete, state = CompletePoints(said.append), SessionState()

    def listen(event: Any) -> None:
        if isinstance(event, SurveyChanged):
            complete.take(event)
        state.take(event)

    replay(folder, listen)
    complete.rest()
    lines = {point.name: point.as_json() for point in said}
    measured = {point.name for point in read_survey(folder).points if point.drops}
    for name, point in known.items():
        if name not in measured:  # a replay has nothing to begin it with
            continue
        assert state.view.points[name].progress == point.progress, "replay --live"
        assert (name in lines) >= point.progress.complete
        if name in lines:
            _same_line(lines[name], point, "replay")


def check_opened(folder: Path, known: Mapping[str, PointView]) -> None:
    """Of ``pfwd open``: as it judges the points, and as it keeps them for the next time."""
    opened, again = OpenedSurvey(folder), OpenedSurvey(folder)
    opened.read()
    opened.judge(lambda _rows: None)
    kept = again.from_cache()
    assert kept is not None
    for rows in (opened.rows, kept):
        assert [row.name for row in rows] == list(known)
        for row in rows:
            progress = known[row.name].progress
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
    """Measure a survey, then look into everything that can be made of it."""
    with surveys() as place:
        told = Told(place / "s")
        told.play(whole(story))
        known = read(told.folder)
        check_report(told.folder, known)
        checked = {name for name in BUILT_IN_FORMATS if name not in WITHOUT_VERDICT}
        assert checked == set(EXPORTS), "a new format is compared, or says why it cannot be"
        for form, check in EXPORTS.items():
            if form in NEEDING_DROPS and not any_counts(told.folder):
                continue
            made = place / f"made.{form}"
            export_survey(told.folder, form, made)
            check(made, known)
        check_notebook(told.folder, known)


def check_report(folder: Path, known: Mapping[str, PointView]) -> None:
    """Of a report: ``--json``, the table of its first page, and a workbook that is filled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gathering, "curves_of", lambda *_: None)  # takes long, and judges nothing
        patch.setattr(gathering, "analyse_drop", _refuse)
        report = gathering.gather(folder)
    texts = load_texts("en")
    table = points_table(report, texts)
    by_title = {point.shown_name: point for point in known.values()}
    for point, cells in zip(report.points, table.rows, strict=True):
        progress = by_title[point.shown_name].progress
        assert point.progress == progress, "reported"
        assert point.progress.as_dict() == progress.as_dict()
        (mark,) = (cell for cell in cells if isinstance(cell, Mark))
        assert mark.kind == progress.verdict == verdict_of(point)
        # A column without any value is left out.
        value = formatting.value_of(progress.value, texts)
        assert value in cells or value == formatting.NO_VALUE
        assert formatting.target_of(progress.target, report.procedure.quantity, texts) in cells
        _same(point_values(point), progress, "a filled workbook")


def _refuse(*_: Any) -> Any:
    raise AssertionError("a stored result was there")


def _same(said: Mapping[str, Any], progress: Any, where: str, digits: int | None = None) -> None:
    """Verdict, value with its interval, and target as numbers or as their texts; a workbook keeps
    so many digits."""
    value = progress.value
    low, high = (None, None) if value is None or value.interval is None else value.interval
    expected = {
        "verdict": progress.verdict.value,
        "value": value and value.value,
        "interval_low": low,
        "interval_high": high,
        "target": progress.target,
    }
    found = {key: _number(said[key]) if key != "verdict" else said[key] for key in expected}
    if digits is not None:
        found, expected = (
            {k: _rounded(v, digits) for k, v in d.items()} for d in (found, expected)
        )
    assert found == expected, where


def _rounded(value: Any, digits: int) -> Any:
    return f"{value:.{digits}g}" if isinstance(value, float) else value


def _number(value: Any) -> float | None:
    return None if value in ("", None) else float(value)


def _by_point(
    rows: Any, known: Mapping[str, PointView], where: str, digits: int | None = None
) -> None:
    by_title = {point.shown_name: point.progress for point in known.values()}
    for row in rows:
        _same(row, by_title[str(row["point"])], where, digits)


def _csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _check_table(path: Path, known: Mapping[str, PointView]) -> None:
    rows = _csv(path)
    _by_point(rows, known, "table")
    kinds = {point.shown_name: dict(point.progress.kinds) for point in known.values()}
    for row in rows:
        if row["status"] in ("seating", "measured") and row["discarded"] == "false":
            assert row["status"] == kinds[row["point"]][int(row["drop"])]


def _check_points(path: Path, known: Mapping[str, PointView]) -> None:
    rows = _csv(path)
    assert [row["point"] for row in rows] == [point.shown_name for point in known.values()]
    _by_point(rows, known, "points")


def _check_jsonl(path: Path, known: Mapping[str, PointView]) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    _by_point(map(json.loads, lines), known, "jsonl")


def _check_parquet(path: Path, known: Mapping[str, PointView]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    _by_point(parquet.read_table(path).to_pylist(), known, "parquet")


def _check_geojson(path: Path, known: Mapping[str, PointView]) -> None:
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    _by_point((feature["properties"] for feature in features), known, path.suffix)


def _check_xlsx(path: Path, known: Mapping[str, PointView]) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(path, read_only=True)
    for sheet in ("points", "drops"):
        titles, *rows = book[sheet].iter_rows(values_only=True)
        # The sheet of drops says of its columns of the point that they are these.
        names = [title.lower().replace(" ", "_").removeprefix("point_") for title in titles]
        # Of a row that ends with empty cells these are not there.
        empty = dict.fromkeys(names)
        said = (empty | dict(zip(names, row, strict=False)) for row in rows)
        # The workbook's units are engineering units, whose factors cost the last digits.
        _by_point(map(_in_si, said), known, f"xlsx, {sheet}", digits=12)
    book.close()


def _in_si(row: Mapping[str, Any]) -> dict[str, Any]:
    factor = {"MPa": 1e6, "mm": 1e-3}[row["unit"]]
    names = ("value", "interval_low", "interval_high", "target")
    return {**row} | {name: row[name] and row[name] * factor for name in names}


def _check_gpkg(path: Path, known: Mapping[str, PointView]) -> None:
    raw = pytest.importorskip("pyogrio.raw")
    about, _, _, columns = raw.read(path)
    values = zip(*(column.tolist() for column in columns), strict=True)
    rows = (dict(zip(about["fields"].tolist(), row, strict=True)) for row in values)
    without_nan = ({k: None if v != v else v for k, v in row.items()} for row in rows)
    _by_point(without_nan, known, "gpkg")


def _check_gpx(path: Path, known: Mapping[str, PointView]) -> None:
    kept = [point for point in known.values() if not point.discarded]
    by_title = {point.shown_name: point.progress for point in kept}
    points = list(ElementTree.parse(path).iter(f"{{{GPX_NAMESPACE}}}wpt"))
    assert points or not any(progress.used for progress in by_title.values())
    for point in points:
        progress = by_title[str(point.findtext(f"{{{GPX_NAMESPACE}}}name"))]
        words = str(point.findtext(f"{{{GPX_NAMESPACE}}}desc"))
        assert words.startswith(f"verdict {progress.verdict} ("), "gpx"
        if progress.target is not None:
            assert f"target {target_text(progress.target)}" in words
        if progress.value is not None:
            assert f" = {SI.show(fact_of_value(progress.value))}" in words


def _check_pddx(path: Path, known: Mapping[str, PointView]) -> None:
    by_title = {point.shown_name: point.progress for point in known.values()}
    for section in path.read_text(encoding="utf-8").split("[Test Location")[1:]:
        said = dict(line.split(" = ", 1) for line in section.splitlines() if " = " in line)
        progress = by_title[said["TestComment"]]
        assert said["PointVerdict"] == progress.verdict, "pddx"
        value, target = progress.value, progress.target
        scale = 1e-3 if said.get("PointQuantity") != "deflection" else 1e6
        assert said.get("PointValue") == (None if value is None else f"{value.value * scale:.2f}")
        assert said.get("PointTarget") == (None if target is None else f"{target * scale:.2f}")


def _check_survey(path: Path, known: Mapping[str, PointView]) -> None:
    for point, expected in zip(point_views(survey_content(path)), known.values(), strict=True):
        assert point.progress == expected.progress, "in one file"


EXPORTS = {
    "survey": _check_survey,
    "table": _check_table,
    "points": _check_points,
    "jsonl": _check_jsonl,
    "parquet": _check_parquet,
    "geojson": _check_geojson,
    "points-geojson": _check_geojson,
    "xlsx": _check_xlsx,
    "gpkg": _check_gpkg,
    "gpx": _check_gpx,
    "pddx": _check_pddx,
}
NEEDING_DROPS = ("pddx",)
"""Refused where every drop is discarded."""


def any_counts(folder: Path) -> bool:
    """Whether a drop of the survey is not discarded."""
    points = read_survey(folder).points
    return any(not d.discarded for point in points if not point.discarded for d in point.drops)


def check_notebook(folder: Path, known: Mapping[str, PointView]) -> None:
    """Of what a script has: ``pfwd.open(SURVEY).to_dict()``."""
    import pfwd

    _by_point(pfwd.open(str(folder)).to_dict()["drops"], known, "pfwd.open")


PLAIN = JobRequest(procedure=stories.PROCEDURES[0])
DIFFERED = {
    "a drop is restored where it was moved from": [
        *(("job", "", PLAIN), ("drop", "1", 8000.0, 45e6), ("drop", "1", 8100.0, 45e6)),
        *(("move", 1, "2"), ("restore", 1, None), ("drop", "1", 8000.0, 45e6)),
    ],
    "what a rebound is one of is moved away": [
        *(("job", "", PLAIN), ("drop", "1", 9000.0, 45e6), ("drop", "1", 1600.0, 40e6)),
        *(("drop", "1", 1600.0, 40e6), ("move", 1, "2"), ("drop", "1", 1600.0, 40e6)),
    ],
    "a rebound after the diagnosis": [
        *stories.measured(44e6),
        *(("diagnosis", "1", 41e6), ("drop", "1", 1600.0, None)),
    ],
    "a point that is not complete any more": [
        *(("job", "", PLAIN), *stories.measured(30e6, 3), ("drop", "1", 80000.0, 45e6)),
    ],
    "a value that changes alone": [*stories.measured(30e6), ("drop", "1", 8000.0, 45.5e6)],
    "a point judged by its diagnosis": [*stories.measured(44e6), ("diagnosis", "1", 41e6)],
    "a small drop before a large one": [("drop", "1", 1600.0, 45e6), ("drop", "1", 9000.0, 45e6)],
}
"""Stories that were told in two ways before they were found."""


@pytest.mark.parametrize("story", DIFFERED.values(), ids=DIFFERED.keys())
def test_what_once_differed(story: list[Any]) -> None:
    check_sessions(story, len(story))
    check_documents(story)


def test_a_rebound_does_not_end_a_diagnosis() -> None:
    with surveys() as place:
        told = Told(place / "s")
        told.play(DIFFERED["a rebound after the diagnosis"])
        value = read(told.folder)["1"].progress.value
    assert value is not None
    assert value.value == 41e6


# Everyday some examples; many more in the slow run, and new ones with the profile `explore`.


def test_live_logged_resumed_replayed_and_opened_it_is_one_verdict() -> None:
    _sessions(SOME)


def test_reported_and_exported_it_is_the_same() -> None:
    _documents(SOME)


@pytest.mark.slow
def test_many_sessions_have_one_verdict() -> None:
    _sessions(MANY)


@pytest.mark.slow
def test_many_reports_and_exports_have_the_same() -> None:
    _documents(MANY)


SOME, MANY = 12, 150


def _settings(count: int) -> settings:
    # A story is short enough to be read as it came; to look for a shorter one takes minutes.
    phases = (Phase.explicit, Phase.reuse, Phase.generate)
    return settings(max_examples=count, phases=phases, report_multiple_bugs=False)


def _sessions(count: int) -> None:
    _settings(count)(given(stories.stories, stories.cuts)(check_sessions))()


def _documents(count: int) -> None:
    _settings(count)(given(stories.stories)(check_documents))()
