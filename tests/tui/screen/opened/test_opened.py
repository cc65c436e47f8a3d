"""`pfwd open`: rows of a survey, its tabs and keys, and the page for a browser."""

import dataclasses
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from rich.style import Style
from textual.geometry import Region
from textual.widgets import DataTable, Input, TabbedContent
from textual.widgets._tabs import Underline

from inversion.notices import text_notice
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import OptionError
from pfwd.facts import fact_of_modulus
from pfwd.judging import point_views
from pfwd.units import SI
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import SETUP, write_judged_survey
from tests.records import complete
from tests.tui.console import pfwd, records
from tests.tui.screen.scripted import terminal_text, until
from tui.diagnosis_lines import diagnosis_sentence, point_cells, survey_lines
from tui.page.server import is_local, parse_place
from tui.screen.drawing.glyphs import BRAILLE
from tui.screen.drawing.lines import text_of
from tui.screen.drawing.plot import plot_lines
from tui.screen.opened.app import OpenApp, Plot, show_survey, table_titles
from tui.screen.opened.plots import map_lines, profile_figure, profile_lines
from tui.screen.opened.rows import (
    OpenedSurvey,
    PointRow,
    in_order,
    matching,
    pages,
    shares,
)
from tui.screen.opened.widgets import KeysLine, PlainTable
from tui.screen.pages.diagnosis import result_row
from tui.screen.settings import ScreenSettings

MODULI = {"0+000": 60e6, "0+020": 40e6, "0+100": 50.2e6, "10": 55e6, "9": 41e6}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PFWD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A survey that no test changes."""
    moduli = {name: (modulus, modulus) for name, modulus in MODULI.items()}
    folder = write_judged_survey(tmp_path_factory.mktemp("opened") / "road", 50e6, moduli)
    with SurveyWriter.open(folder, publish=False) as writer:
        for place, name in enumerate([*MODULI][:4]):  # the last has no position
            position = {"latitude": 48.0 + 1e-4 * place, "longitude": 11.0}
            writer.edit("position", position, point=name)
        writer.edit("note", "wet patch", point="9")
        writer.edit("name", "[b]left[/b] lane", point="9")
    return folder


@pytest.fixture
def changed_survey(survey: Path, tmp_path: Path) -> Path:
    """A survey that a test may change."""
    return Path(shutil.copytree(survey, tmp_path / "road"))


def opened(folder: Path) -> OpenedSurvey:
    opened_survey = OpenedSurvey(folder)
    opened_survey.read()
    opened_survey.judge(lambda _: None)
    return opened_survey


@pytest.fixture(scope="module")
def rows(survey: Path) -> list[PointRow]:
    return opened(survey).rows


@pytest.fixture
def app(survey: Path) -> OpenApp:
    return OpenApp(OpenedSurvey(survey), glyphs=BRAILLE)


def names(rows: list[PointRow]) -> list[str]:
    return [row.name for row in rows]


def test_a_survey_that_was_read_ends_with_status_0(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OpenApp, "run", lambda app: None)
    assert show_survey(opened(survey), ScreenSettings()) == 0


def test_rows_have_the_verdicts_and_positions_of_the_survey(rows: list[PointRow]) -> None:
    assert [row.state for row in rows] == ["PASS", "FAIL", "UNDECIDED", "PASS", "FAIL"]
    assert (rows[2].chainage_m, rows[0].value) == (100.0, 60e6)
    waiting = [
        dataclasses.replace(rows[0], verdict="none"),
        dataclasses.replace(rows[0], judged=False),
    ]
    assert list(shares(waiting)) == [("without a verdict", 1), ("to be judged", 1)]


def test_the_cache_is_valid_until_the_survey_is_changed(changed_survey: Path) -> None:
    result = changed_survey / "results" / "drop-000004-1.json"
    content = result.read_bytes()
    result.write_bytes(content.replace(b'"modulus_pa":4', b'"modulus_pa":9'))
    damaged = opened(changed_survey)
    assert damaged.rows[1].state == "UNDECIDED"
    (remark,) = damaged.remarks
    assert remark.startswith(f"results/{result.name} is damaged")
    result.write_bytes(content)
    assert OpenedSurvey(changed_survey).from_cache() is None
    rows = opened(changed_survey).rows
    assert rows[1].state == "FAIL"
    assert OpenedSurvey(changed_survey).from_cache() == rows
    with SurveyWriter.open(changed_survey, publish=False) as writer:
        writer.edit("target", 70e6, point="10")
    assert OpenedSurvey(changed_survey).from_cache() is None


def test_a_damaged_cache_is_survived(survey: Path, cache: Path) -> None:
    opened(survey)
    (file,) = (cache / "opened").iterdir()
    for text in ("", "{", "[]", '{"key": 1, "rows": []}'):
        file.write_text(text, encoding="utf-8")
        assert OpenedSurvey(survey).from_cache() is None


@pytest.mark.parametrize(
    ("filter_text", "expected"),
    [
        ("", list(MODULI)),
        ("fail", ["0+020", "9"]),
        ("wet", ["9"]),
        ("0+ pass", ["0+000"]),
        (">50.1 <56", ["0+100", "10"]),
        ("<.", []),
    ],
)
def test_rows_match_every_word_of_a_filter(
    rows: list[PointRow], filter_text: str, expected: list[str]
) -> None:
    assert names(matching(rows, filter_text)) == expected


def test_rows_are_sorted_by_each_key(rows: list[PointRow]) -> None:
    assert names(in_order(rows, "value")) == ["0+020", "9", "0+100", "10", "0+000"]
    assert names(in_order(rows[:4], "title")) == ["0+000", "0+020", "0+100", "10"]
    assert names(in_order(rows, "chainage_m", falling=True))[:3] == ["0+100", "0+020", "0+000"]
    assert names(in_order(rows, "measured")) == list(MODULI)
    assert [pages(count, 100) for count in (0, 1, 100, 101)] == [1, 1, 1, 2]


def test_the_map_has_a_mark_for_each_verdict_and_names_without_overlap(
    rows: list[PointRow],
) -> None:
    lines = [text_of(row) for row in map_lines(rows, "10", 60, 20)]
    for mark in ("o", "x", "?", "@", "north up"):
        assert mark in "\n".join(lines)
    for name in names(rows)[:4]:
        assert any(name in row.replace(",", " ").split() for row in lines)
    assert "@ 10" in lines[-1]
    crowded = [
        dataclasses.replace(rows[0], name=str(n), title=f"point {n}", longitude=11 + 1e-5 * n)
        for n in range(30)
    ]
    for row in (text_of(row) for row in map_lines(crowded, "3", 60, 20)[:-1]):
        labels = re.findall(r"point \d+", row)
        assert len(labels) <= 6
        assert all(re.search(rf"(^|[ ox@?·] ){label}( |$)", row) for label in labels)
    assert "no point has a position" in text_of(map_lines([], "", 60, 20)[0])


def test_the_profile_has_separate_points_with_intervals(rows: list[PointRow]) -> None:
    along = [
        dataclasses.replace(row, chainage_m=place, low=row.value - 2e6, high=row.value + 3e6)
        for row, place in zip(rows, (0.0, 20.0, 520.0, 540.0, 560.0), strict=True)
        if row.value is not None
    ]
    figure = profile_figure(along, 0, 5, 1, by_chainage=True)
    interval, target, value = figure.curves
    assert not interval.joined
    assert not value.joined
    assert target.dashed
    assert interval.values[:2] == pytest.approx([58.0, 63.0])
    assert (figure.time_unit, figure.cursor) == ("m", 20.0)
    lines = [text_of(row) for row in plot_lines(figure, 100, 24, BRAILLE)]
    gap = slice(20, 85)  # 20 m to 520 m: the target crosses it, no other line does
    crossing = [row[gap] for row in lines[1:-1] if set(row[gap]) - set(" ─")]
    assert len(crossing) == 1, "the target"
    unknown = [*along[:4], dataclasses.replace(along[4], chainage_m=None)]
    assert profile_figure(unknown, 0, 5, 1, by_chainage=True).time_unit == "point"
    figure = profile_figure(rows, 1, 3, 2)
    assert figure.note == "points 2 to 4 of 5"
    assert (figure.start, figure.end, figure.cursor) == (1.5, 4.5, 3.0)
    empty = [dataclasses.replace(row, value=None) for row in rows]
    (sentence,) = profile_lines(empty, (0, 5), 0, (80, 20), BRAILLE)
    assert "pfwd invert" in text_of(sentence)


async def test_filter_profile_map_drops_and_job_by_keys(app: OpenApp, pilot: Any) -> None:
    assert "2 PASS, 2 FAIL, 1 UNDECIDED" in terminal_text(app)
    await pilot.press("slash", *"fail")
    await until(pilot, lambda: "2 by the filter" in terminal_text(app))
    assert app.query_one("#points-table", DataTable).row_count == 2
    await pilot.press("escape")
    await until(pilot, lambda: app.query_one("#points-table", DataTable).row_count == 5)
    app.query_one("#points-table", DataTable).move_cursor(row=0)
    await pilot.press("down", "p")
    await until(
        pilot, lambda: re.search(r"0\+020: 40.* MPa .*  FAIL", terminal_text(app)) is not None
    )
    await pilot.press("plus", "left", "left")
    assert app.chosen == "0+000", "the first point has no neighbour on the left"
    await pilot.press("right", "right", "m")
    await until(pilot, lambda: "@ 0+100" in terminal_text(app))
    assert app.chosen == "0+100"
    await pilot.press("escape", "enter")
    await until(pilot, lambda: app.tab == "drops")
    await until(pilot, lambda: "seating drop 1 of 1" in terminal_text(app))
    await pilot.press("j")
    await until(pilot, lambda: "procedure  plain" in terminal_text(app))


@pytest.mark.parametrize(
    ("size", "place"), [((200, 60), "right"), ((120, 40), "below"), ((80, 24), "hidden")]
)
async def test_the_chosen_point_is_drawn_if_the_terminal_has_room(
    app: OpenApp, pilot: Any, size: tuple[int, int], place: str
) -> None:
    table, plot = app.query_one("#points-table"), app.query_one("#points-plot", Plot)
    assert plot.display == (place != "hidden")
    if place == "hidden":
        return
    await until(pilot, lambda: "deflection as recorded" in plot.text)
    assert "0+000  PASS" in plot.text
    assert "modulus 60.0 MPa" in plot.text
    assert "target 50" in plot.text
    if place == "right":
        assert plot.region.x > table.region.right - 2
        assert plot.size.width > size[0] / 3
    else:
        assert plot.region.y >= table.region.bottom
        assert table.region.height < size[1] / 3
    await pilot.press("down")
    await until(pilot, lambda: "0+020  FAIL" in plot.text)
    await until(pilot, lambda: "deflection as recorded" in plot.text)


def test_the_table_has_titles_for_the_columns_that_are_filled(rows: list[PointRow]) -> None:
    for quantity, value, modulus in (
        (rows[0].quantity, "E_eq", "E MPa, not judged"),
        ("modulus", "modulus", "E_eq MPa, not judged"),
        ("E_LWD", "E_LWD", "E MPa, not judged"),
    ):
        titles = table_titles([dataclasses.replace(rows[0], quantity=quantity, modulus=40e6)])
        assert (titles["value"], titles["modulus"]) == (value, modulus)
    row = dataclasses.replace(
        rows[0], modulus=None, low=None, high=None, target=None, verdict="none"
    )
    row = dataclasses.replace(row, notes="")
    columns = {"modulus", "interval", "target", "verdict", "use", "unexplained", "notes"}
    assert not columns & set(table_titles([row]))
    diagnosed = dataclasses.replace(rows[0], use="design value", unexplained="0.3 %")
    assert {"interval", "use", "unexplained", "verdict"} <= set(table_titles([row, diagnosed]))


async def test_a_change_of_the_tab_builds_no_line_of_keys(app: OpenApp, pilot: Any) -> None:
    keys = list(app.query_one(KeysLine).children)
    assert "⏎ Drops" in terminal_text(app)  # on the points too, where it is pressed
    for key in ("p", "m", "j", "1", "enter", "1"):
        await pilot.press(key)
        await pilot.pause()
    await pilot.pause()
    assert list(app.query_one(KeysLine).children) == keys
    assert "⏎ Drops" in terminal_text(app)
    await pilot.press("slash")  # letters are typed now and no keys
    await until(pilot, lambda: "p Profile" not in terminal_text(app))


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
async def test_the_last_line_names_every_key(
    app: OpenApp, pilot: Any, size: tuple[int, int]
) -> None:
    await pilot.pause()
    last = terminal_text(app).splitlines()[-1]
    for part in ("/ Find", "s Sort", "⏎ Drops", "c Compare", "r Report", "x Export", "q Leave"):
        assert part in last
    assert ("palette" in last) == (size[0] > 100)


async def test_the_current_tab_is_marked_and_has_the_focus_at_once(
    app: OpenApp, pilot: Any
) -> None:
    bar = app.query_one(Underline)
    for name, focused in (
        ("profile", None),
        ("drops", "drops-table"),
        ("points", "points-table"),
    ):
        app.action_tab(name)
        tab = app.query_one("#tabs", TabbedContent).get_tab(name).virtual_region
        assert tab.x <= bar.highlight_start < bar.highlight_end <= tab.right
        assert (app.focused and app.focused.id) == focused
        await pilot.pause()


async def test_two_points_are_compared(app: OpenApp, pilot: Any) -> None:
    app.action_compare()
    app.query_one("#points-table", DataTable).action_cursor_down()
    app.action_compare()  # before the message of the row: quick keys use the row of the cursor
    assert app.marked == ["0+000", "0+020"]
    await until(pilot, lambda: app.tab == "compare")
    await until(pilot, lambda: "second / first" in terminal_text(app))
    assert "0.667" in terminal_text(app)
    await until(pilot, lambda: "deflection as recorded" in terminal_text(app))
    assert "0+000 and 0+020" in terminal_text(app)


async def test_keys_sort_and_export(app: OpenApp, pilot: Any, tmp_path: Path) -> None:
    table = app.query_one("#points-table", DataTable)
    for expected in ("0+020", "0+000"):  # a second click on the title reverses
        app._sort("value")
        await pilot.pause()
        assert str(table.get_row_at(0)[0]) == expected
    await pilot.press("s")
    assert app.order == "verdict"
    await pilot.press("x")
    await until(pilot, lambda: bool(app.screen.query("#text")))
    app.screen.query_one("#text", Input).value = str(tmp_path / "t.csv")
    await pilot.press("enter")
    await until(pilot, lambda: (tmp_path / "t.csv").exists())


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", ("127.0.0.1", 8765)),
        ("9000", ("127.0.0.1", 9000)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
        ("[::1]:80", ("::1", 80)),
        ("::1", ("::1", 8765)),
        (":9000", ("127.0.0.1", 9000)),
    ],
)
def test_the_address_of_the_server(text: str, place: tuple[str, int]) -> None:
    assert parse_place(text) == place


@pytest.mark.parametrize("text", ["host:port", "a:b:80", "[::1", "host:70000", "[::1]80"])
def test_a_malformed_address_is_refused(text: str) -> None:
    with pytest.raises(OptionError, match="--serve: expected HOST:PORT"):
        parse_place(text)


def test_an_address_of_this_computer_is_local() -> None:
    hosts = ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.1")
    assert [host for host in hosts if is_local(host)] == ["127.0.0.1", "::1", "localhost"]


def test_open_prints_json_and_needs_a_terminal(survey: Path, tmp_path: Path) -> None:
    lines = records(pfwd("open", survey, "--json").out)
    assert [line["verdict"] for line in lines] == ["pass", "fail", "undecided", "pass", "fail"]
    assert "expected a terminal, got a pipe" in pfwd("open", survey).refusal
    assert pfwd("open", tmp_path / "none").status == 1


AFTER = {"modulus_pa": 81.2e6, "modulus_interval_pa": [71.6e6, 112.3e6]}
DIAGNOSIS = {
    "point": "0+000",
    "drops": [1, 2],
    "basis": basis_of(SETUP),
    "verdict": "unexplained",
    "before": {"modulus_pa": 70e6, "modulus_interval_pa": [66e6, 75e6]},
    # The residual contains the noise, the unexplained part does not.
    "after": {**AFTER, "residual_rms_over_peak": 0.0185, "discrepancy_over_peak": 0.0139},
}


@pytest.fixture
def diagnosed_survey(changed_survey: Path) -> Path:
    """A survey with the diagnosis of the first point, and a stale one of the second."""
    first, second = (point.drops[-1].number for point in read_survey(changed_survey).points[:2])
    with SurveyWriter.open(changed_survey, publish=False) as writer:
        writer.save_result(first, complete(DiagnosisResult, DIAGNOSIS), "diagnosis")
        stale = {**DIAGNOSIS, "basis": "0" * 16}
        writer.save_result(second, complete(DiagnosisResult, stale), "diagnosis")
    return changed_survey


def test_screen_and_diagnose_print_the_same_modulus_and_unexplained_part(
    diagnosed_survey: Path,
) -> None:
    survey = diagnosed_survey
    point = next(iter(point_views(read_survey(survey))))
    result, modulus = point.diagnosis_in_force, point.progress.modulus
    assert result is not None
    judged = dataclasses.replace(result, point_modulus=modulus)
    printed = next(row for row in survey_lines([judged]) if row.startswith("0+000"))
    assert "81 (72 to 112)" in printed
    assert "1.4 %" in printed

    opened_row, second = opened(survey).rows[:2]
    assert opened_row.diagnosis_text == "use with care, 1.4 % of the peak unexplained"
    assert second.diagnosis_text == "", "its diagnosis is stale"
    assert SI.show(opened_row.modulus_fact, with_unit=False) == "81 (72 to 112)"
    assert (opened_row.use, opened_row.unexplained) == ("use with care", "1.4 %")
    assert SI.show(fact_of_modulus(point.progress.modulus)) == "81 MPa (72 to 112)"
    page_row = result_row(judged, "0+000", SI, chosen=False).texts
    assert {"81 (72 to 112)", "1.4 %", "UNEXPLAINED"} <= set(page_row)
    assert modulus is not None
    fault = dataclasses.replace(modulus, not_supported=text_notice("the plate was lifted"))
    unsupported = dataclasses.replace(result, point_modulus=fault)
    cells = point_cells("0+000", unsupported)
    page_row = result_row(unsupported, "0+000", SI, chosen=False).texts
    assert (page_row[3], page_row[4]) == (cells.modulus, cells.use) == ("none", "do not use")
    sentence = diagnosis_sentence(result, SI)
    assert "81 MPa (72 to 112), use with care; 1.4 % of the peak unexplained" in sentence


async def test_names_in_cells_are_not_read_as_markup(app: OpenApp, pilot: Any) -> None:
    """No name is mark-up, and the table draws its cells itself: the toolkit's way takes 80 ms."""
    table = app.query_one("#points-table", PlainTable)
    rows = [strip.text for strip in table.render_lines(Region(0, 0, 100, 8))]
    assert any("[b]left[/b] lane" in row for row in rows)
    assert table.ordered_columns[0].width == len("[b]left[/b] lane")
    drawn = table._render_cell(0, 0, Style(), 20)
    assert [segment.text for segment in drawn[0]] == [" 0+000              "]
    assert drawn[0][0].style is not None
    assert drawn[0][0].style.meta == {"row": 0, "column": 0}, "a click finds its cell"


async def test_row_messages_after_the_end_draw_no_plot(app: OpenApp, pilot: Any) -> None:
    await app.query_one("#tabs").remove()
    assert app.tab == ""
    app.draw_plots()


async def test_the_curves_are_drawn_for_another_size_too(app: OpenApp, pilot: Any) -> None:
    await pilot.press("enter")
    plot = app.query_one("#drops-plot", Plot)
    await until(pilot, lambda: "load" in plot.text)
    wide = max(map(len, plot.text.split("\n")))
    await pilot.resize_terminal(160, 40)
    await until(pilot, lambda: max(map(len, plot.text.split("\n"))) > wide + 30)
