"""Every page, driven by keys, with the events of a scripted session."""

import asyncio
import dataclasses
import inspect
import re
import signal
from pathlib import Path
from typing import Any

import pytest
from textual.widgets import Input, Label, Select

from pfwd.analysis.results import DiagnosisResult
from pfwd.files.editing import MOVED_TO
from pfwd.jobs import Jobs, Task, TaskProgress
from pfwd.judging import Job, PointView, Station
from pfwd.procedures import find_procedure, plain_procedure
from pfwd.session.events import (
    CalibrationChanged,
    DropNotSaved,
    DropSaved,
    Edited,
    JobReported,
    PointBegan,
    Ready,
    SessionNotice,
    SurveyRead,
)
from pfwd.session.replay import Pace
from tests.records import read
from tests.tui.results import result
from tests.tui.screen.scripted import (
    App,
    QuietSource,
    analysed,
    complete_point,
    curves,
    deliver,
    play,
    ready,
    saved,
    saved_drop,
    status,
    stored_drop,
    until,
)
from tui.screen.drawing.glyphs import ASCII
from tui.screen.pages import PAGES
from tui.screen.pages.points import PointsPage
from tui.screen.session import status as status_module
from tui.screen.session.screen_events import DiagnosisFinished, Refit
from tui.screen.session.status import WORDS
from tui.screen.settings import ScreenSettings

SMALL = (80, 24)
MOVED_AWAY = Edited("discard", {MOVED_TO: {"point": "8", "drop": 1}}, None, 6)


async def redraw(app: App, pilot: Any) -> None:
    app.redraw()
    await pilot.pause()


async def widget_exists(app: App, pilot: Any, selector: str) -> None:
    await until(pilot, lambda: bool(app.screen.query(selector)))


async def open_setup(app: App, pilot: Any) -> None:
    await pilot.press("5")
    await widget_exists(app, pilot, "#stations")


async def fill(app: App, pilot: Any, **values: str) -> None:
    """Write values into the fields of a page or dialog."""
    for name, value in values.items():
        app.screen.query_one(f"#{name}").value = value  # type: ignore[attr-defined]
    await pilot.pause()


async def apply_setup(app: App, pilot: Any) -> None:
    """Put the setup in force, which restarts the session."""
    starts = app.source.starts
    await pilot.press("ctrl+s")
    await until(pilot, lambda: app.source.starts == starts + 1)


def test_the_measure_page_follows_the_session() -> None:
    async def script(app: App, pilot: Any) -> None:
        assert "WAITING" in app.text
        await deliver(app, pilot, ready(), status(), Ready())
        assert "READY" in app.text
        assert "T-1042" in app.text
        await deliver(app, pilot, saved(1, status="seating"))
        assert "COMPUTING" in app.text
        await deliver(app, pilot, analysed(1, full=False, kind="seating"))
        assert "SAFE" in app.text
        assert "47.3" in app.text
        await deliver(app, pilot, *complete_point())
        await until(pilot, lambda: "POINT DONE" in app.text)  # after SAFE

    play(App(), script, SMALL)


async def test_a_safe_drop_rings_once_and_a_rejected_drop_twice(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), saved(1))
    assert app.bells == 1
    await deliver(app, pilot, saved(2, status="rejected", reason="false trigger"))
    await until(pilot, lambda: app.bells == 3)
    await pilot.press("b")
    await deliver(app, pilot, saved(3))
    assert app.bells == 3
    assert [settings.bell for settings in app.stored] == [False]


async def test_undo_restores_the_last_moved_or_discarded_drop(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("up", "d", "2", "enter", "w", "8", "enter", "u", "u", "u")
    assert app.requests == [
        ("discard", "by the operator", None, 5),
        ("move", 6, "8"),
        ("restore", None, None, 6),
        ("restore", None, None, 5),
    ]
    await redraw(app, pilot)
    assert "nothing to take back" in app.text


async def test_a_moved_drop_has_the_same_word_on_every_page(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point(), MOVED_AWAY)
    pages = [app.text]
    for keys in (["2", "enter"], ["enter"]):
        await pilot.press(*keys)
        pages.append(app.text)
    for page in pages:
        assert "MOVED" in page
        assert "moved to point 8, drop 1" in page
        assert "DISCARDED" not in page
        assert "rejected" not in page.lower()
    await deliver(app, pilot, Edited("restore", None, None, 6))
    assert "moved to" not in app.text


async def test_moving_a_drop_offers_the_points(app: App, pilot: Any) -> None:
    job = Job(procedure=plain_procedure(), stations=tuple(map(Station, "789")))
    await deliver(app, pilot, JobReported(job), saved(1, "6"), *complete_point())
    await pilot.press("2", "enter", "w")
    await pilot.pause()
    points = app.screen.query_one("#points", Label)
    assert str(points.content).splitlines() == [
        "  6  1 drop",
        "  8  station without drops",
        "  9  station without drops",
    ]
    await pilot.press("up", "down", "down", "up", "up", "down")
    assert app.screen.query_one("#text", Input).value == "6"
    assert "▶ 6  1 drop" in str(points.content)
    await pilot.press("enter")
    assert app.requests == [("move", 6, "6")]


async def test_a_refused_move_cannot_be_undone(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2", "enter", "w", "7", "enter")
    await redraw(app, pilot)
    assert "drop 6 is at point 7 already" in app.text
    await deliver(app, pilot, Edited("discard", None, None, 6))
    await pilot.press("w", "8", "enter")
    await redraw(app, pilot)
    assert "drop 6 is discarded" in app.text
    await pilot.press("u")
    assert app.requests == []


async def test_the_proposed_name_of_the_next_point_counts_on(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point("1"), *complete_point("9"), PointBegan("9"))
    await pilot.press("n", "enter")
    assert app.requests == [("point", "10")], "though 1 is similar"
    await deliver(app, pilot, PointBegan("10"))
    assert "no drops at this point yet" in app.text
    await pilot.press("n", "backspace", "backspace", "enter")
    assert "1 to 64 characters" in app.text
    await pilot.press("escape")
    assert len(app.requests) == 1


async def test_a_name_similar_to_an_existing_point_needs_confirmation(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point("12+360"), PointBegan("12+360"))
    await pilot.press("n", *"12+36", "enter")
    await pilot.pause()
    assert "12+36 is new, but 12+360 exists. Begin it?" in app.text
    await pilot.press("n")
    assert app.screen.query_one("#text", Input).value == "12+36"
    assert app.requests == []
    await pilot.press("enter", "y")
    await pilot.pause()
    await pilot.press("n", *"12+380", "enter")
    assert app.requests == [("point", "12+36"), ("point", "12+380")], "380 is not similar"
    await pilot.press("2", "enter", "w", *"12+3600", "enter")
    await pilot.pause()
    await pilot.press("y")
    await pilot.pause()
    assert app.requests[2:] == [("move", 6, "12+3600")]


def test_a_changed_calibration_needs_a_single_confirmation() -> None:
    change = "sensitivity of centre is -57.6 V per m/s, was 28.8 V per m/s"
    event = CalibrationChanged(f"calibration of T-1042 changed: {change}", waits=True)

    async def accept(app: App, pilot: Any) -> None:
        pages = len(app.screen_stack)
        await deliver(app, pilot, dataclasses.replace(event, waits=False))
        assert len(app.screen_stack) == pages, "it was accepted on the command line"
        assert "-57.6" in app.text
        await deliver(app, pilot, event, event)
        await until(pilot, lambda: "y record" in app.text)
        assert "-57.6" in app.text
        await pilot.press("y")
        await until(pilot, lambda: "y record" not in app.text)  # nor a second question
        assert app.requests == [("calibration", event)]
        assert any(change in notice.text for _, notice in app.state.notices)

    async def refuse(app: App, pilot: Any) -> None:
        await deliver(app, pilot, event)
        await until(pilot, lambda: "y record" in app.text)
        await pilot.press("enter")  # the safe answer
        await until(pilot, app.source.session.stopped.is_set)
        assert app.requests == []

    play(App(), accept, SMALL)
    play(App(), refuse, SMALL)


async def test_the_points_page_goes_from_point_to_drop(app: App, pilot: Any) -> None:
    drops = [stored_drop(n, result(40e6 + n * 1e6), record=n) for n in range(1, 4)]
    stored = saved_drop(7)
    place = {"position": {"latitude": 48.1374, "longitude": 11.5755}}
    located = dataclasses.replace(stored, view=dataclasses.replace(stored.view, metadata=place))
    survey = SurveyRead((PointView("6", drops, 45e6, title="km 12+300"), PointView("7")))
    await deliver(app, pilot, survey, *complete_point(), DropSaved(located))
    await pilot.press("2")
    await redraw(app, pilot)
    for part in ("km 12+300", "E_eq along the line", "48.137400, 11.575500"):
        assert part in app.text
    assert sum("measured" in row for row in app.text.split("\n")) >= 4, "the drops of the point"
    await pilot.press("home", "enter")
    await pilot.pause()
    assert "point km 12+300" in app.text
    await pilot.press("escape", "end", "enter", "up", "enter")
    await pilot.pause()
    assert "Drop 6 of point 7" in app.text


async def test_keys_reach_the_session(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("g", "2", "m", *"50", "enter")
    await pilot.press("o", *"48.1,11.5", "enter")
    await pilot.press("e", *"wet", "enter")
    await pilot.press("a", *"B1", "enter")
    await pilot.press("d")
    assert app.requests == [
        ("trigger",),
        ("target", 50e6, "7", None),
        ("position", {"latitude": 48.1, "longitude": 11.5}, "7", None),
        ("note", "wet", "7", None),
        ("name", "B1", "7", None),
        ("discard", None, "7", None),
    ]


@pytest.mark.parametrize(
    ("units", "keys", "word"),
    [
        ("us", ["m", *"45000"], "1450.4 ksi"),
        ("si", ["m", "0"], "a number > 0, in MPa"),
        ("si", ["o", *"99,11"], "degrees"),
    ],
)
def test_an_impossible_entry_is_refused_while_it_is_typed(
    units: Any, keys: list[str], word: str
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("2", *keys, "enter")
        await pilot.pause()
        assert word in app.text
        assert app.requests == []

    play(App(settings=ScreenSettings(units=units)), script)


async def test_the_drop_page_shows_the_result_and_the_curves(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("enter")
    await pilot.pause()
    for part in ("Drop 6 of point 7", "result in force", "modulus 47.6 MPa (47.0 to 48.2)"):
        assert part in app.words
    text = app.words
    for _ in range(8):
        await pilot.press("pagedown")
        await pilot.pause()
        text += app.words
    for part in ("viscosity", "correlation", "seed 0", "results", "v looks for them"):
        assert part in text
    await pilot.press("right", "right")
    await pilot.pause()
    assert "residual -" in app.text
    before = app.text
    await pilot.press("z")
    await pilot.pause()
    assert app.text != before
    await pilot.press("tab", "tab", "tab", "tab")
    await pilot.pause()
    assert "spectrum" in app.text
    await pilot.press("up")
    await pilot.pause()
    assert "Drop 5 of point 7" in app.text


async def test_a_trial_fit_does_not_replace_the_result_in_force(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("3")
    trial = result(39e6, refit="half-space")
    await deliver(app, pilot, Refit("7", 6, "half-space", trial, curves()))
    assert app.state.current_drops[6].modulus == 47.6e6
    assert ("result", 6, trial) in app.requests
    for text in ("trial fit: half-space", "result in force"):
        await pilot.press("m")
        await pilot.pause()
        assert text in app.text


async def test_the_refit_dialog_starts_a_fit_without_contradictions(app: App, pilot: Any) -> None:
    fits: list[Any] = []
    app.fits.refit = lambda binding, options, label: fits.append(  # type: ignore[method-assign]
        (binding.number, options.layers, label)
    )
    await deliver(app, pilot, *complete_point())
    await pilot.press("r")
    await widget_exists(app, pilot, "#model")
    prompts = {
        str(prompt)
        for name in ("model", "plate", "method")
        for prompt, _ in app.screen.query_one(f"#{name}", Select)._options
    }
    assert {"soil on bedrock", "rigid plate without slip", "full search"} < prompts
    assert not {"layer", "rigid-rough", "mpga"} & prompts
    await fill(app, pilot, model="half-space", depth="1.2")
    await pilot.press("ctrl+s")
    assert "one of the two" in str(app.screen.query_one("#remark", Label).content)
    assert fits == []
    await fill(app, pilot, depth="none")
    await pilot.press("ctrl+s")
    for layers in ("3", "auto"):
        await pilot.press("r")
        await widget_exists(app, pilot, "#layers")
        await fill(app, pilot, layers=layers)
        await pilot.press("ctrl+s")
    await pilot.pause()
    assert fits == [
        (6, None, "half-space, bedrock none"),
        (6, 3, "3 layers"),
        (6, "auto", "auto layers"),
    ]


def fitted_state(modulus: float) -> dict[str, Any]:
    return {"model": "layer", "modulus_pa": modulus, "residual_rms_over_peak": 0.004}


DIAGNOSIS = {
    "file": "survey",
    "point": "7",
    "device": "T-1042",
    "drops": [4, 5, 6],
    "verdict": "explained",
    "before": fitted_state(55.2e6),
    "after": fitted_state(47.3e6),
    "effects": [
        {"name": "geophone_response", "scope": "device", "value": 11.0, "sd": 0.2, "unit": "Hz"}
    ],
}


@pytest.mark.parametrize("size", [SMALL, (200, 60)])
def test_the_diagnosis_page_shows_the_table_and_the_device(
    size: tuple[int, int], tmp_path: Path
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("4")
        await pilot.pause()
        assert "Enter diagnoses" in app.text
        second = {**DIAGNOSIS, "point": "8", "verdict": "clean"}  # the screen has no drops of it
        results = tuple(read(DiagnosisResult, record) for record in (DIAGNOSIS, second))
        await deliver(app, pilot, DiagnosisFinished(str(tmp_path), results))
        for part in ("EXPLAINED", "55.2", "47.3", "geophone response"):
            assert part in app.text
        await pilot.press("1", "up")
        await redraw(app, pilot)
        assert "EXPLAINED, found geophone response" in app.words
        await pilot.press("4")
        await deliver(app, pilot, DiagnosisFinished(str(tmp_path), (), "no table of plates"))
        assert "no table of plates" in app.text

    play(App(QuietSource(tmp_path)), script, size)


def test_the_diagnosis_page_shows_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task[Any]()
    monkeypatch.setattr(Jobs, "submit", lambda *_, **__: task)

    async def script(app: App, pilot: Any) -> None:
        await pilot.press("4", "enter")
        task.take_progress(TaskProgress("each point by itself", "12+320", 4, 12))
        await until(pilot, lambda: "4 of 12 points" in app.text)
        parts = ("point 12+320", "each point by itself", "s so far", "k stops the diagnosis", "███")
        assert [part for part in parts if part not in app.words] == []

    play(App(QuietSource(tmp_path)), script, SMALL)


def row_of(page: str, start: str) -> str:
    """Return the first row of a page with this start."""
    return next(row for row in page.splitlines() if row.startswith(start))


@pytest.mark.parametrize("size", [SMALL, (120, 40)])
async def test_only_the_judged_value_has_a_verdict(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
    procedure = find_procedure("tp-bf-stb-b8.3")
    job = JobReported(Job(procedure=procedure, target=45e6))
    await deliver(app, pilot, job, *complete_point(load=7070.0))
    await pilot.press("up")
    measure = app.text
    await pilot.press("2")
    points = app.text
    pages = [*measure.splitlines(), *points.splitlines()]
    summaries = [row for row in pages if row.startswith(" point: E_vd")]
    assert len(summaries) == (1 if size == SMALL else 2)
    for summary in summaries:
        # The verdict follows the judged value; the modulus, if it fits, is marked.
        judged = r"point: E_vd [\d.]+.* MPa.*, mean of 3  (PASS|FAIL|UNDECIDED)"
        assert re.search(judged, summary)
        assert ("modulus" in summary) == ("not judged: modulus" in summary)
    table = row_of(measure, " drop  kind")
    assert table.index("E_vd MPa") < table.index("E MPa, not judged")
    for words in ("noise alone", "peak method"):
        assert words not in measure
    titles = row_of(points, " point  ")
    assert "E_vd MPa" in titles
    assert " E MPa" not in titles


async def test_the_points_page_names_its_columns_and_keys(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2")
    titles = row_of(app.text, " point  ")
    assert titles.count("MPa") == 2, "judged value and target"
    assert "E_eq MPa" in titles
    assert "modulus, not judged" in titles
    foot = " ".join(app.text.splitlines()[-2:])
    for key, effect in PointsPage.KEYS:
        assert f"{key} {effect}" in foot


def test_the_setup_page_checks_entries_and_applies_them() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await open_setup(app, pilot)
        field = app.screen.query_one("#poisson_ratio", Input)
        field.focus()
        await pilot.press(*"0.7")
        await pilot.pause()
        assert field.has_class("wrong")
        assert "expected a number >= 0 and < 0.5" in app.text
        await pilot.press("ctrl+s")
        await fill(app, pilot, poisson_ratio="0.4", target="45", procedure="mndot")
        assert not field.has_class("wrong")
        await pilot.press("ctrl+s")
        await pilot.pause()
        assert "procedure mndot judges a deflection in mm" in app.words
        assert app.source.starts == 1
        await fill(app, pilot, target="", procedure="tp-bf-stb-b8.3")
        await apply_setup(app, pilot)
        assert app.source.plan.setup.declared["poisson_ratio"] == 0.4
        await until(pilot, lambda: app.state.procedure.name == "tp-bf-stb-b8.3")
        await redraw(app, pilot)
        assert "tp-bf-stb-b8.3" in app.text
        assert "E_vd" in app.text

    play(App(), script, SMALL)


def test_the_setup_is_typed_in_the_units_of_the_screen() -> None:
    async def script(app: App, pilot: Any) -> None:
        await open_setup(app, pilot)
        await fill(app, pilot, plate_radius_m="6", target="7")
        await apply_setup(app, pilot)
        assert app.source.plan.setup.declared["plate_radius_m"] == pytest.approx(0.1524)
        await until(pilot, lambda: app.state.job.target == pytest.approx(7 * 6894757.293168))

    play(App(settings=ScreenSettings(units="us")), script)


async def test_stations_are_chosen_with_their_targets(app: App, pilot: Any, tmp_path: Path) -> None:
    file, second = tmp_path / "lot 2.csv", tmp_path / "other.csv"
    file.write_text("name;target\n12+320;0,5\n12+340;\n", encoding="utf-8")
    second.write_text("name;lane\n12+320;left\n", encoding="utf-8")
    await open_setup(app, pilot)
    field = app.screen.query_one("#stations", Input)
    await fill(app, pilot, procedure="mndot", stations=str(tmp_path))
    assert field.has_class("wrong")
    assert "stations: expected a file" in app.text
    await fill(app, pilot, stations=str(second))
    assert not field.has_class("wrong")
    assert "columns not used: 'lane'" in app.words
    # A terminal quotes the name of a file that is dropped on it.
    await fill(app, pilot, stations=f" '{file}'")
    assert not field.has_class("wrong")
    await apply_setup(app, pilot)
    stations = app.source.plan.job.stations
    assert [(it.name, it.target) for it in stations] == [("12+320", 0.5e-3), ("12+340", None)]
    await until(pilot, lambda: app.state.job.stations == stations)
    await open_setup(app, pilot)
    field = app.screen.query_one("#stations", Input)
    assert field.placeholder == "empty: the 2 stations of the survey"
    assert field.value == ""


@pytest.mark.parametrize(("field", "value"), [("operator", "Ada"), ("procedure", "mndot")])
async def test_leaving_the_setup_needs_confirmation_after_changes(
    app: App, pilot: Any, field: str, value: str
) -> None:
    await open_setup(app, pilot)
    await pilot.press("escape")
    assert app.page_name == "measure"
    await open_setup(app, pilot)
    await fill(app, pilot, **{field: value})
    await pilot.press("escape")
    await pilot.pause()
    assert "not in force yet" in app.text
    await pilot.press("enter")
    assert app.page_name == "setup"
    await pilot.press("escape", "y")
    assert app.page_name == "measure"


async def help_text(app: App, pilot: Any) -> str:
    """Open the help, read it to its end and leave it."""
    await pilot.press("f1")
    texts: list[str] = []
    for _ in range(8):
        await pilot.pause()
        texts.append(app.text)
        await pilot.press("pagedown")
    await pilot.press("escape")
    return "\n".join(texts)


def test_the_help_names_the_status_words_and_the_keys_as_the_page_does() -> None:
    pages: list[str] = []

    async def script(app: App, pilot: Any) -> None:
        pages.append(await help_text(app, pilot))

    play(App(), script)
    play(App(Replay()), script)
    page, replay = pages
    for word in WORDS:
        assert re.search(rf"^ +{word}  ", page, re.MULTILINE), word
    assert re.search(r"^ +\*  after a number: the data do not support it", page, re.MULTILINE)
    assert re.search(r"^ +q  Leave", page, re.MULTILINE)
    assert "^q" not in page
    for title in ("Points: up/down choose", "Drop: left/right cursor", "Setup: ctrl+s put in"):
        assert title in page  # the keys of all pages
    assert "Measure: " not in page
    for replay_key in ("Pause or go on", "One drop of a replay", "Faster"):
        assert replay_key not in page
        assert replay_key in replay


def test_every_status_word_has_a_meaning() -> None:
    source = inspect.getsource(status_module)
    words = set(re.findall(r'StatusWord\(\s*"([A-Z ]+)"', source))
    assert words | {"NO DEVICE", "NOT READY"} == set(WORDS)


def test_every_page_has_its_help_with_its_keys() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point(), SessionNotice("the instrument restarted"))
        toolkit = {"Focus Next", "Focus Previous", "Copy selected text"}
        for key in "1234":
            await pilot.press(key)
            await pilot.pause()
            name = app.page_name
            bindings = app.screen.active_bindings.values()
            page_keys = {binding.description for _, binding, _, _ in bindings} - toolkit
            text = await help_text(app, pilot)
            assert [description for description in page_keys if description not in text] == []
            assert not [description for description in toolkit if description in text], (
                "ctrl+c leaves, it copies nothing"
            )
            assert "the instrument restarted" in text
            assert app.page_name == name

    play(App(), script, SMALL)


async def test_the_palette_runs_the_actions_of_keys(app: App, pilot: Any) -> None:
    await pilot.press("ctrl+p")
    await pilot.pause()
    await pilot.press(*"daylight")
    await pilot.pause()
    await pilot.press("enter")
    await until(pilot, lambda: app.settings.theme == "daylight")


async def test_theme_type_and_units_change_at_once_and_are_stored(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("t", "l", "i")
    await pilot.pause()
    assert "ksi" in app.text
    assert app.theme == "pfwd-daylight"
    assert app.stored[-1] == ScreenSettings("daylight", "us", large=True)


class Replay(QuietSource):
    """A quiet recording."""

    writes = False
    url = ""

    def __init__(self) -> None:
        super().__init__(title="replay of survey")
        self.pace = Pace(1.0)  # type: ignore[assignment]


def test_a_replay_is_paused_stepped_and_sped_up() -> None:
    async def script(app: App, pilot: Any) -> None:
        pace = app.source.pace
        await pilot.press("space")
        await pilot.pause()
        assert pace.paused
        assert "PAUSED" in app.text
        await pilot.press("full_stop")
        assert pace.flows
        assert pace.may_begin()
        assert not pace.may_begin()
        await pilot.press("plus")
        assert pace.speed == 2.0
        await pilot.press("minus", "minus")
        assert pace.speed == 0.5
        await pilot.press("space")
        assert not pace.paused

    play(App(Replay()), script)


def test_leaving_ends_the_session_without_a_question_if_all_is_safe() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("q")
        await until(pilot, app.source.session.stopped.is_set)

    app = play(App(), script)
    assert app.return_value == 0


def test_a_closed_console_of_windows_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """The event loop of Windows has no signal handlers; SIGINT comes when the window is closed."""

    def refuse(*_: object) -> None:
        raise NotImplementedError

    async def close_window(app: App, pilot: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        await until(pilot, app.source.session.stopped.is_set)

    loop = asyncio.SelectorEventLoop
    monkeypatch.setattr(loop, "add_signal_handler", refuse, raising=False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        app = play(App(), close_window)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert app.return_value == 0


async def test_leaving_asks_when_a_drop_is_only_in_memory(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), DropNotSaved("7", 1, "no room"))
    assert "NOT SAFE" in app.text
    await pilot.press("q")
    await pilot.pause()
    assert "would be lost" in app.text
    await pilot.press("enter")
    assert not app.source.session.stopped.is_set()
    await pilot.press("q", "y")
    await until(pilot, app.source.session.stopped.is_set)


def test_messages_are_not_cut_on_any_page() -> None:
    sentence = (
        "diagnosis: EXPLAINED by geophone response and bedrock: 55.2 → 47.3 MPa, residual 0.4 %"
    )

    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        for key in "234":
            await pilot.press(key)
            app.show_message(sentence)
            await redraw(app, pilot)
            assert sentence in " ".join(app.text.split()), f"page {key}"

    play(App(), script, SMALL)


def test_a_terminal_of_ascii_receives_ascii_only() -> None:
    """The frames, fields and bars of the toolkit included."""

    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("n")
        await until(pilot, lambda: "enter begins the point" in app.text, 5.0)
        assert app.text.isascii(), app.text
        await pilot.press("escape")
        for page in PAGES:
            await pilot.press(page.key)
            await until(pilot, lambda name=page.name: app.page_name == name, 5.0)
            await pilot.pause()
            assert app.text.isascii(), app.text

    play(App(glyphs=ASCII), script)
