"""Every page, driven by keys, with events of a session that is not there."""

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
from tests.tui.screen.scripted import (
    App,
    QuietSource,
    analysed,
    complete_point,
    curves,
    deliver,
    play,
    ready,
    result,
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

SIZES = [(80, 24), (120, 40), (200, 60)]


@pytest.mark.parametrize("size", SIZES)
async def test_the_measure_page_follows_the_session(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
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


def test_a_safe_drop_rings_once_and_a_rejected_drop_twice() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, ready(), saved(1))
        assert app.bells == 1
        await deliver(app, pilot, saved(2, status="rejected", reason="false trigger"))
        await until(pilot, lambda: app.bells == 3)
        await pilot.press("b")
        await deliver(app, pilot, saved(3))
        assert app.bells == 3

    app = play(App(), script)
    assert [settings.bell for settings in app.stored] == [False]


async def test_discarding_goes_to_the_session_and_can_be_undone(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("up", "d")
    assert app.source.session.requests == [("discard", "by the operator", None, 5)]  # type: ignore[attr-defined]
    await pilot.press("u")
    assert app.source.session.requests[1] == ("restore", None, None, 5)  # type: ignore[attr-defined]
    await pilot.press("u")
    assert len(app.source.session.requests) == 2  # type: ignore[attr-defined]
    app.redraw()
    await pilot.pause()
    assert "nothing to take back" in app.text


async def test_undo_restores_the_moved_drop_before_an_earlier_discard(app: App, pilot: Any) -> None:
    requests = app.source.session.requests  # type: ignore[attr-defined]
    await deliver(app, pilot, *complete_point())
    await pilot.press("up", "d")
    assert requests == [("discard", "by the operator", None, 5)]
    await pilot.press("2", "enter", "w", "8", "enter")
    assert requests[1:] == [("move", 6, "8")]
    await pilot.press("u")
    assert requests[2:] == [("restore", None, None, 6)]
    await pilot.press("u")
    assert requests[3:] == [("restore", None, None, 5)]


async def test_an_undone_move_clears_the_drop(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2", "enter")
    await deliver(app, pilot, Edited("discard", {MOVED_TO: {"point": "8", "drop": 1}}, None, 6))
    assert "moved to" in app.text
    await deliver(app, pilot, Edited("restore", None, None, 6))
    assert "moved to" not in app.text


def stations_job(*names: str) -> JobReported:
    return JobReported(
        Job(procedure=plain_procedure(), stations=tuple(Station(name) for name in names))
    )


@pytest.mark.parametrize("size", SIZES)
async def test_moving_a_drop_offers_the_points(app: App, pilot: Any, size: tuple[int, int]) -> None:
    requests = app.source.session.requests  # type: ignore[attr-defined]
    await deliver(app, pilot, stations_job("7", "8", "9"), saved(1, "6"), *complete_point())
    await pilot.press("2", "enter", "w")
    await pilot.pause()
    assert str(app.screen.query_one("#points", Label).content).splitlines() == [
        "  6  1 drop",
        "  8  station without drops",
        "  9  station without drops",
    ]
    await pilot.press("up", "down", "down", "up", "up", "down")
    assert app.screen.query_one("#text", Input).value == "6"
    assert "▶ 6  1 drop" in str(app.screen.query_one("#points", Label).content)
    await pilot.press("enter")
    assert requests == [("move", 6, "6")]


async def test_a_moved_drop_has_the_same_word_on_every_page(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await deliver(app, pilot, Edited("discard", {MOVED_TO: {"point": "8", "drop": 1}}, None, 6))
    pages = [app.text]
    await pilot.press("2", "enter")
    pages.append(app.text)
    await pilot.press("enter")
    pages.append(app.text)
    for page in pages:
        assert "MOVED" in page
        assert "moved to point 8, drop 1" in page
        assert "DISCARDED" not in page
        assert "rejected" not in page.lower()


@pytest.mark.parametrize("size", SIZES)
async def test_the_points_page_names_all_its_keys(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2")
    foot = " ".join(app.text.splitlines()[-2:])
    for key, effect in PointsPage.KEYS:
        assert f"{key} {effect}" in foot


async def test_a_refused_move_cannot_be_undone(app: App, pilot: Any) -> None:
    requests = app.source.session.requests  # type: ignore[attr-defined]
    await deliver(app, pilot, *complete_point())
    await pilot.press("2", "enter", "w", "7", "enter")
    app.redraw()
    await pilot.pause()
    assert "drop 6 is at point 7 already" in app.text
    await deliver(app, pilot, Edited("discard", None, None, 6))
    await pilot.press("w", "8", "enter")
    app.redraw()
    await pilot.pause()
    assert "drop 6 is discarded" in app.text
    await pilot.press("u")
    assert requests == []


async def test_the_next_point_is_named_by_counting_on(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("n")
    assert app.screen.query_one("#text", Input).value == "8"
    await pilot.press("enter")
    assert app.source.session.requests == [("point", "8")]  # type: ignore[attr-defined]
    await deliver(app, pilot, PointBegan("8"))
    assert "no drops at this point yet" in app.text
    await pilot.press("n", "backspace", "enter")
    assert "1 to 64 characters" in app.text
    await pilot.press("escape")
    assert len(app.source.session.requests) == 1  # type: ignore[attr-defined]


async def test_a_name_similar_to_an_existing_point_needs_confirmation(app: App, pilot: Any) -> None:
    requests = app.source.session.requests  # type: ignore[attr-defined]
    await deliver(app, pilot, *complete_point("12+360"))
    await deliver(app, pilot, PointBegan("12+360"))
    await pilot.press("n", *"12+36", "enter")
    await pilot.pause()
    assert "12+36 is new, but 12+360 exists. Begin it?" in app.text
    await pilot.press("n")
    assert app.screen.query_one("#text", Input).value == "12+36"
    assert requests == []
    await pilot.press("enter", "y")
    await pilot.pause()
    assert requests == [("point", "12+36")]
    await pilot.press("n", *"12+380", "enter")
    assert requests[1:] == [("point", "12+380")], "nothing that is like it"
    await pilot.press("2", "enter", "w", *"12+3600", "enter")
    await pilot.pause()
    assert "12+3600 is new, but 12+360 exists" in app.text
    await pilot.press("y")
    await pilot.pause()
    assert requests[2:] == [("move", 6, "12+3600")]


async def test_a_proposed_name_needs_no_confirmation(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point("1"), *complete_point("9"), PointBegan("9"))
    await pilot.press("n", "enter")
    assert app.source.session.requests == [("point", "10")]  # type: ignore[attr-defined]


async def test_a_drop_can_be_recorded_by_hand(app: App, pilot: Any) -> None:
    await pilot.press("g")
    assert app.source.session.requests == [("trigger",)]  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", SIZES)
def test_a_changed_calibration_needs_a_single_confirmation(size: tuple[int, int]) -> None:
    change = "sensitivity of centre is -57.6 V per m/s, was 28.8 V per m/s"
    event = CalibrationChanged(f"calibration of T-1042 changed: {change}", waits=True)

    async def accepted(app: App, pilot: Any) -> None:
        await deliver(app, pilot, event, event)
        await until(pilot, lambda: "y record" in app.text)
        assert "-57.6" in app.text
        await pilot.press("y")
        await until(pilot, lambda: "y record" not in app.text)  # nor a second question
        assert app.source.session.requests == [("calibration", event)]  # type: ignore[attr-defined]
        assert any(change in notice.text for _, notice in app.state.notices)

    async def refused(app: App, pilot: Any) -> None:
        await deliver(app, pilot, event)
        await until(pilot, lambda: "y record" in app.text)
        await pilot.press("enter")  # the safe answer
        await until(pilot, app.source.session.stopped.is_set)  # type: ignore[attr-defined]
        assert app.source.session.requests == []  # type: ignore[attr-defined]

    play(App(), accepted, size)
    play(App(), refused, size)


async def test_a_calibration_that_was_accepted_beforehand_is_only_named(
    app: App, pilot: Any
) -> None:
    event = CalibrationChanged("zero of load is 1 V, was 0 V")
    before = len(app.screen_stack)
    await deliver(app, pilot, event)
    assert len(app.screen_stack) == before
    assert "zero of load is 1 V" in app.text


def contents() -> SurveyRead:
    first = [stored_drop(n, result(40e6 + n * 1e6), record=n) for n in range(1, 4)]
    points = (
        PointView(
            "6",
            first,
            45e6,
            title="km 12+300",
            place={"latitude": 48.1, "longitude": 11.5, "source": "edited"},
        ),
        PointView("7"),
    )
    return SurveyRead(points)


@pytest.mark.parametrize("size", SIZES)
async def test_the_points_page_goes_from_point_to_drop(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
    await deliver(app, pilot, contents(), *complete_point())
    await pilot.press("2")
    await pilot.pause()
    app.redraw()
    await pilot.pause()
    assert "km 12+300" in app.text
    assert "E_eq along the line" in app.text or size[1] < 30
    await pilot.press("home", "enter")
    await pilot.pause()
    assert "point km 12+300" in app.text
    await pilot.press("escape", "end", "enter", "up", "enter")
    await pilot.pause()
    assert "Drop 5 of point 7" in app.text


async def test_edits_of_a_point_reach_the_session(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2", "m", *"50", "enter")
    await pilot.press("o", *"48.1,11.5", "enter")
    await pilot.press("e", *"wet", "enter")
    await pilot.press("a", *"B1", "enter")
    await pilot.press("d")
    assert app.source.session.requests == [  # type: ignore[attr-defined]
        ("target", 50e6, "7", None),
        ("position", {"latitude": 48.1, "longitude": 11.5}, "7", None),
        ("note", "wet", "7", None),
        ("name", "B1", "7", None),
        ("discard", None, "7", None),
    ]


@pytest.mark.parametrize(
    ("units", "typed", "message"),
    [
        ("si", "0.45", "expected a modulus of 2 to 10000 MPa, got 0.45 MPa;"),
        ("us", "45000", "expected a modulus of 0.29008 to 1450.4 ksi, got"),
    ],
)
def test_a_target_that_no_drop_can_reach_is_refused_while_it_is_typed(
    units: Any, typed: str, message: str
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("2", "m", *typed, "enter")
        await pilot.pause()
        assert message in app.text
        assert app.source.session.requests == []  # type: ignore[attr-defined]

    play(App(settings=ScreenSettings(units=units)), script)


def test_the_setup_takes_no_modulus_for_a_deflection() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, ready())
        await pilot.press("5")
        await until(pilot, lambda: bool(app.screen.query("#target")))
        app.screen.query_one("#target", Input).value = "45"
        app.screen.query_one("#procedure", Select).value = "mndot"
        await pilot.pause()
        await pilot.press("ctrl+s")
        await pilot.pause()
        message = "got 45 mm; did you mean a modulus? procedure mndot judges a deflection in mm"
        assert message in " ".join(app.text.split())
        assert app.source.starts == 1  # type: ignore[attr-defined]

    play(App(), script, (80, 24))


async def test_a_wrong_position_is_marked_while_it_is_typed(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2", "o", *"99,11", "enter")
    assert "degrees" in app.text
    assert app.source.session.requests == []  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", SIZES)
async def test_the_drop_page_shows_everything_of_a_drop(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("enter")
    await pilot.pause()
    on_page = " ".join(app.text.replace("│", " ").split())
    for part in ("Drop 6 of point 7", "result in force", "modulus 47.6 MPa (47.0 to 48.2)"):
        assert part in on_page
    help_text = on_page
    for _ in range(8):
        await pilot.press("pagedown")
        await pilot.pause()
        help_text += " " + " ".join(app.text.replace("│", " ").split())
    for part in ("viscosity", "correlation", "seed 0", "results", "v looks for them"):
        assert part in help_text
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
    drop = app.state.current_drops[6]
    assert drop.modulus == 47.6e6
    assert ("result", 6, trial) in app.source.session.requests  # type: ignore[attr-defined]
    await pilot.press("m")
    await pilot.pause()
    assert "trial fit: half-space" in app.text
    await pilot.press("m")
    await pilot.pause()
    assert "result in force" in app.text


async def test_the_refit_dialog_has_words_for_its_choices(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("enter", "r")
    await until(pilot, lambda: bool(app.screen.query("#method")))
    prompts = [
        str(prompt)
        for name in ("model", "plate", "method")
        for prompt, _ in app.screen.query_one(f"#{name}", Select)._options
    ]
    assert {"soil on bedrock", "rigid plate without slip", "full search"} < set(prompts)
    assert not {"layer", "rigid-rough", "mpga"} & set(prompts)


async def test_the_refit_dialog_refuses_contradictions(app: App, pilot: Any) -> None:
    requests: list[Any] = []
    app.fits.refit = lambda binding, options, label: requests.append((binding.number, label))  # type: ignore[method-assign]
    await deliver(app, pilot, *complete_point())
    await pilot.press("r")
    await until(pilot, lambda: bool(app.screen.query("#model")))
    app.screen.query_one("#model", Select).value = "half-space"
    app.screen.query_one("#depth", Input).value = "1.2"
    await pilot.pause()
    await pilot.press("ctrl+s")
    remark = app.screen.query_one("#remark", Label)
    assert "one of the two" in str(remark.content)
    assert requests == []
    app.screen.query_one("#depth", Input).value = "none"
    await pilot.pause()
    await pilot.press("ctrl+s")
    await pilot.pause()
    assert requests == [(6, "half-space, bedrock none")]


@pytest.mark.parametrize(("chosen", "layers"), [("3", 3), ("auto", "auto")])
async def test_a_trial_fit_with_layers(
    app: App, pilot: Any, chosen: str, layers: int | str
) -> None:
    requests: list[Any] = []
    app.fits.refit = lambda _, options, label: requests.append((options.layers, label))  # type: ignore[method-assign]
    await deliver(app, pilot, *complete_point())
    await pilot.press("r")
    await until(pilot, lambda: bool(app.screen.query("#layers")))
    app.screen.query_one("#layers", Select).value = chosen
    await pilot.pause()
    await pilot.press("ctrl+s")
    await pilot.pause()
    assert requests == [(layers, f"{chosen} layers")]


RECORD = {
    "file": "survey",
    "point": "7",
    "device": "T-1042",
    "drops": [4, 5, 6],
    "rejected": [],
    "plate": "rigid-rough",
    "plate_radius_m": 0.15,
    "poisson_ratio": 0.35,
    "verdict": "explained",
    "corrected": True,
    "noise_rms_m": 1e-6,
    "before": {
        "model": "half-space",
        "modulus_pa": 55.2e6,
        "modulus_sd_pa": 1e6,
        "residual_over_noise": 12.0,
        "residual_rms_over_peak": 0.04,
        "contact_residual_rms_over_peak": 0.03,
    },
    "after": {
        "model": "layer",
        "modulus_pa": 47.3e6,
        "modulus_sd_pa": 0.5e6,
        "residual_over_noise": 0.9,
        "residual_rms_over_peak": 0.004,
        "contact_residual_rms_over_peak": 0.003,
    },
    "effects": [
        {
            "name": "geophone_response",
            "scope": "device",
            "value": 11.0,
            "sd": 0.2,
            "unit": "Hz",
            "parameters": [{"name": "frequency", "value": 11.0, "sd": 0.2, "unit": "Hz"}],
            "evidence": 120.0,
            "alternatives": ["lag"],
            "advice": "calibrate the geophone",
        }
    ],
    "held_out": None,
    "warnings": [],
}


@pytest.mark.parametrize("size", SIZES)
def test_the_diagnosis_page_shows_the_table_and_the_device(
    size: tuple[int, int], tmp_path: Path
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("4")
        await pilot.pause()
        assert "Enter diagnoses" in app.text
        second = {**RECORD, "point": "8", "verdict": "clean"}  # the screen has no drops of it
        results = tuple(read(DiagnosisResult, record) for record in (RECORD, second))
        await deliver(app, pilot, DiagnosisFinished(str(tmp_path), results))
        for part in ("EXPLAINED", "55.2", "47.3", "geophone response"):
            assert part in app.text
        await pilot.press("1", "up")
        app.redraw()
        await pilot.pause()
        on_page = " ".join(app.text.replace("│", " ").split())
        assert "EXPLAINED, found geophone response" in on_page

    play(App(QuietSource(tmp_path)), script, size)


@pytest.mark.parametrize("size", SIZES)
def test_the_diagnosis_page_shows_progress(
    size: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = Task[Any]()
    monkeypatch.setattr(Jobs, "submit", lambda *_, **__: task)

    async def script(app: App, pilot: Any) -> None:
        await pilot.press("4", "enter")
        task.take_progress(TaskProgress("each point by itself", "12+320", 4, 12))
        await until(pilot, lambda: "4 of 12 points" in app.text)
        page = " ".join(app.text.split())
        assert "point 12+320" in page
        assert "each point by itself" in page
        assert "s so far" in page
        assert "k stops the diagnosis" in page
        assert "███" in page

    play(App(QuietSource(tmp_path)), script, size)


@pytest.mark.parametrize("size", SIZES)
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
    assert len(summaries) == (1 if size == SIZES[0] else 2)
    for summary in summaries:
        # The verdict follows the judged value; the modulus, if it fits, is marked.
        judged = r"point: E_vd [\d.]+.* MPa.*, mean of 3  (PASS|FAIL|UNDECIDED)"
        assert re.search(judged, summary)
        assert ("modulus" in summary) == ("not judged: modulus" in summary)
    table = next(row for row in measure.splitlines() if row.startswith(" drop  kind"))
    assert table.index("E_vd MPa") < table.index("E MPa, not judged")
    for words in ("noise alone", "peak method"):
        assert words not in measure
    titles = next(row for row in points.splitlines() if row.startswith(" point  "))
    assert "E_vd MPa" in titles
    assert " E MPa" not in titles


async def test_the_modulus_that_is_not_judged_has_a_column(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("2")
    titles = next(row for row in app.text.splitlines() if row.startswith(" point  "))
    assert titles.count("MPa") == 2, "judged value and target"
    assert "E_eq MPa" in titles
    assert "modulus, not judged" in titles


def test_a_failed_diagnosis_is_a_sentence(tmp_path: Path) -> None:
    async def script(app: App, pilot: Any) -> None:
        await pilot.press("4")
        await deliver(
            app, pilot, DiagnosisFinished(str(tmp_path), (), "the diagnosis failed: no table")
        )
        assert "the diagnosis failed: no table" in app.text

    play(App(QuietSource(tmp_path)), script)


@pytest.mark.parametrize("size", SIZES)
async def test_the_setup_page_checks_entries(app: App, pilot: Any, size: tuple[int, int]) -> None:
    await deliver(app, pilot, ready())
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#poisson_ratio")))
    field = app.screen.query_one("#poisson_ratio", Input)
    field.focus()
    await pilot.press(*"0.7")
    await pilot.pause()
    assert field.has_class("wrong")
    assert "expected a number >= 0 and < 0.5" in app.text
    await pilot.press("ctrl+s")
    assert app.source.starts == 1  # type: ignore[attr-defined]
    field.value = "0.4"
    await pilot.pause()
    assert not field.has_class("wrong")
    await pilot.press("ctrl+s")
    await until(pilot, lambda: app.source.starts == 2)  # type: ignore[attr-defined]
    assert app.source.plan.setup.declared["poisson_ratio"] == 0.4


def test_the_setup_is_typed_in_the_units_of_the_screen() -> None:
    async def script(app: App, pilot: Any) -> None:
        await pilot.press("5")
        await until(pilot, lambda: bool(app.screen.query("#plate_radius_m")))
        app.screen.query_one("#plate_radius_m", Input).value = "6"
        app.screen.query_one("#target", Input).value = "7"
        await pilot.press("ctrl+s")
        await until(pilot, lambda: app.source.starts == 2)  # type: ignore[attr-defined]
        assert app.source.plan.setup.declared["plate_radius_m"] == pytest.approx(0.1524)
        await until(pilot, lambda: app.state.job.target == pytest.approx(7 * 6894757.293168))

    play(App(settings=ScreenSettings(units="us")), script)


async def test_stations_are_chosen_with_their_targets(app: App, pilot: Any, tmp_path: Path) -> None:
    file = tmp_path / "lot 2.csv"
    file.write_text("name;target\n12+320;0,5\n12+340;\n", encoding="utf-8")
    await deliver(app, pilot, ready())
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#stations")))
    app.screen.query_one("#procedure", Select).value = "mndot"
    field = app.screen.query_one("#stations", Input)
    field.value = str(tmp_path)
    await pilot.pause()
    assert field.has_class("wrong")
    assert "stations: expected a file" in app.text
    second = tmp_path / "other.csv"
    second.write_text("name;lane\n12+320;left\n", encoding="utf-8")
    field.value = str(second)
    await pilot.pause()
    assert not field.has_class("wrong")
    assert "columns not used: 'lane'" in " ".join(app.text.split())
    second.write_text("name;Ziel\n12+320;0,5\n", encoding="utf-8")
    field.value = f" {second}"
    await pilot.pause()
    assert field.has_class("wrong")
    assert "expected a column target, in mm, got 'Ziel'" in " ".join(app.text.split())
    field.value = f"'{file}'"  # as a terminal gives a file that is dropped on it
    await pilot.pause()
    assert not field.has_class("wrong")
    await pilot.press("ctrl+s")
    await until(pilot, lambda: app.source.starts == 2)  # type: ignore[attr-defined]
    requests = app.source.plan.job.stations
    assert requests is not None
    assert [(it.name, it.target) for it in requests] == [("12+320", 0.5e-3), ("12+340", None)]
    await until(pilot, lambda: app.state.job.stations == requests)
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#stations")))
    field = app.screen.query_one("#stations", Input)
    assert field.placeholder == "empty: the 2 stations of the survey"
    assert field.value == ""


async def test_the_setup_page_offers_the_shipped_procedures(app: App, pilot: Any) -> None:
    await deliver(app, pilot, *complete_point())
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#procedure")))
    app.screen.query_one("#procedure", Select).value = "tp-bf-stb-b8.3"
    await pilot.pause()
    await pilot.press("ctrl+s")
    await until(pilot, lambda: app.source.starts == 2)  # type: ignore[attr-defined]
    await until(pilot, lambda: app.state.procedure.name != "plain")
    app.redraw()
    await pilot.pause()
    assert "tp-bf-stb-b8.3" in app.text
    assert "E_vd" in app.text


async def test_leaving_the_setup_needs_confirmation_after_changes(app: App, pilot: Any) -> None:
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#operator")))
    await pilot.press("escape")
    assert app.screen.NAME == "measure"  # type: ignore[attr-defined]
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#operator")))
    app.screen.query_one("#operator", Input).value = "Ada"
    await pilot.press("escape")
    await pilot.pause()
    assert "not in force yet" in app.text
    await pilot.press("enter")
    assert app.screen.NAME == "setup"  # type: ignore[attr-defined]
    await pilot.press("escape", "y")
    assert app.screen.NAME == "measure"  # type: ignore[attr-defined]


def help_of(key: str, app: App) -> str:
    texts: list[str] = []

    async def script(app: App, pilot: Any) -> None:
        if key != "1":
            await pilot.press(key)
        await pilot.press("f1")
        for _ in range(8):
            await pilot.pause()
            texts.append(app.text)
            await pilot.press("pagedown")

    play(app, script)
    return "\n".join(texts)


def test_the_help_names_the_status_words_and_the_keys_as_the_page_does() -> None:
    page = help_of("1", App())
    for word in WORDS:
        assert re.search(rf"^ +{word}  ", page, re.MULTILINE), word
    assert re.search(r"^ +\*  after a number: the data do not support it", page, re.MULTILINE)
    assert re.search(r"^ +q  Leave", page, re.MULTILINE)
    assert "^q" not in page
    for others in ("Points: up/down choose", "Drop: left/right cursor", "Setup: ctrl+s put in"):
        assert others in page  # the keys of all pages
    assert "Measure: " not in page
    recording = QuietSource()
    recording.pace = Pace(1.0)  # type: ignore[assignment]
    replay = help_of("1", App(recording))
    for replay_key in ("Pause or go on", "One drop of a replay", "Faster"):
        assert replay_key not in page
        assert replay_key in replay


def test_every_status_word_has_a_meaning() -> None:
    source = inspect.getsource(status_module)
    words = set(re.findall(r'StatusWord\(\s*"([A-Z ]+)"', source))
    assert words | {"NO DEVICE", "NOT READY"} == set(WORDS)


@pytest.mark.parametrize("key", ["1", "2", "3", "4"])
def test_every_page_has_its_help_with_its_keys(key: str) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point(), SessionNotice("the instrument started anew"))
        await pilot.press(key)
        await pilot.pause()
        page_keys = {
            binding.description for _, binding, _, _ in app.screen.active_bindings.values()
        }
        toolkit = {"Focus Next", "Focus Previous", "Copy selected text"}
        await pilot.press("question_mark")
        await pilot.pause()
        help_text = ""
        for _ in range(8):
            help_text += app.text
            await pilot.press("pagedown")
            await pilot.pause()
        for text in page_keys - toolkit:
            assert text in help_text
        assert not [text for text in toolkit if text in help_text], (
            "ctrl+c leaves, it copies nothing"
        )
        assert "the instrument started anew" in help_text
        await pilot.press("escape")
        assert app.screen.NAME != "help"  # type: ignore[attr-defined]

    play(App(), script, (80, 24))


async def test_the_palette_runs_the_actions_of_keys(app: App, pilot: Any) -> None:
    await pilot.press("ctrl+p")
    await pilot.pause()
    await pilot.press(*"daylight")
    await pilot.pause()
    await pilot.press("enter")
    await until(pilot, lambda: app.settings.theme == "daylight")


def test_theme_type_and_units_change_at_once_and_are_stored() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("t", "l", "i")
        await pilot.pause()
        assert "ksi" in app.text
        assert app.theme == "pfwd-daylight"

    app = play(App(), script)
    assert app.stored[-1] == ScreenSettings("daylight", "us", large=True)


class Replayed(QuietSource):
    """A quiet recording."""

    writes = False

    def __init__(self) -> None:
        super().__init__(title="replay of survey")
        self.pace = Pace(1.0)  # type: ignore[assignment]
        self.url = ""


def test_a_replay_is_paused_stepped_and_sped_up() -> None:
    async def script(app: App, pilot: Any) -> None:
        pace = app.source.pace
        assert pace is not None
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

    play(App(Replayed()), script)


def test_leaving_ends_the_session_without_a_question_if_all_is_safe() -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("q")
        await until(pilot, lambda: app.source.session.stopped.is_set())  # type: ignore[attr-defined]

    app = play(App(), script)
    assert app.return_value == 0


def test_a_closed_console_of_windows_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """The event loop of Windows has no signal handlers; SIGINT comes when the window is closed."""

    def refuse(*_: object) -> None:
        raise NotImplementedError

    async def close_window(app: App, pilot: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        await until(pilot, lambda: app.source.session.stopped.is_set())  # type: ignore[attr-defined]

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
    assert not app.source.session.stopped.is_set()  # type: ignore[attr-defined]
    await pilot.press("q", "y")
    await until(pilot, lambda: app.source.session.stopped.is_set())  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", SIZES)
async def test_messages_are_not_cut_on_any_page(
    app: App, pilot: Any, size: tuple[int, int]
) -> None:
    sentence = (
        "diagnosis: EXPLAINED by geophone response and bedrock: 55.2 → 47.3 MPa, residual 0.4 %"
    )
    await deliver(app, pilot, *complete_point())
    for key in "234":
        await pilot.press(key)
        app.show_message(sentence)
        app.redraw()
        await pilot.pause()
        assert sentence in " ".join(app.text.split()), f"page {key}"


def test_the_points_page_shows_drops_and_positions_where_there_is_room() -> None:
    async def script(app: App, pilot: Any) -> None:
        stored, place = saved_drop(7), {"latitude": 48.1374, "longitude": 11.5755}
        view = dataclasses.replace(stored.view, metadata={"position": place})
        coordinates = dataclasses.replace(stored, view=view)
        await deliver(app, pilot, *complete_point(), DropSaved(coordinates))
        await pilot.press("2")
        await pilot.pause()
        assert "48.137400, 11.575500" in app.text
        assert sum("measured" in row for row in app.text.split("\n")) >= 4, "the drops of the point"

    play(App(), script, (120, 40))


async def test_leaving_a_changed_procedure_asks(app: App, pilot: Any) -> None:
    await pilot.press("5")
    await until(pilot, lambda: bool(app.screen.query("#procedure")))
    app.screen.query_one("#procedure", Select).value = "mndot"
    await pilot.pause()
    await pilot.press("escape")
    await pilot.pause()
    assert "not in force yet" in app.text


def test_a_terminal_of_ascii_gets_nothing_else() -> None:
    """The frames, fields and bars of the toolkit included."""

    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        await pilot.press("n")
        await until(pilot, lambda: "enter begins the point" in app.text, 5.0)
        assert app.text.isascii(), app.text
        await pilot.press("escape")
        for page in PAGES:
            await pilot.press(page.key)
            await until(pilot, lambda name=page.name: getattr(app.screen, "NAME", "") == name, 5.0)
            await pilot.pause()
            assert app.text.isascii(), app.text

    play(App(glyphs=ASCII), script)
