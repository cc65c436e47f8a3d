"""Pictures of the documentation, drawn from a replay.

A simulated instrument measures three points, the survey is replayed on the screen, and the screen
is drawn.
"""

import asyncio
import datetime
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.output import parse_options
from benchmarks.terminal_picture import runs_of_app, save_picture
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.editing import Edit, edit_survey
from pfwd.judging import JobRequest, Station
from pfwd.procedures import plain_procedure
from pfwd.session.measure import measure
from pfwd.session.plan import SessionPlan
from simulators.instrument import serve
from tui.screen.app import PfwdApp
from tui.screen.drawing.glyphs import BRAILLE
from tui.screen.opened.app import OpenApp
from tui.screen.opened.rows import OpenedSurvey
from tui.screen.session.sources import LiveSource, ReplaySource
from tui.screen.settings import ScreenSettings

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "pictures"
POINTS = {"km 12+300": 58e6, "km 12+325": 39e6, "km 12+350": 47e6}
"""Moduli of the ground, Pa, by the name of the point."""
TARGET = 45e6
DROPS = 6
RATE = 8.0
"""Speed of the simulated instrument over real time; the simulated drops do not depend on it."""
QUIET_S = 160.0
"""Time that the instrument streams after the last drop, s, longer than the screen shows SAFE."""
READY_TIMEOUT_S = 180.0
"""Time within which one replay with all its inversions must be complete, s."""
CLOCK = datetime.datetime(2026, 5, 4, 14, 32, 7)


def run(arguments: list[str]) -> int:
    """Draw into ``--output FOLDER`` (docs/pictures) with ``--format`` svg or png.

    Return the exit status.
    """
    options, report = parse_options(
        "pictures",
        __doc__,
        arguments,
        output=(FOLDER, "folder of the pictures"),
        format=(("svg", "png"), "format of the pictures (svg)"),
        only=(str, "name of the only picture"),
    )
    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="pfwd-pictures-") as folder:
        survey = Path(folder) / "Ring road"
        _measure(survey)
        draws: dict[str, Callable[[Path], None]] = {
            name: partial(_draw, survey, size, settings, keys)
            for name, (size, settings, keys) in PICTURES.items()
        }
        draws["done"] = partial(_draw_complete_point, Path(folder) / "live" / survey.name)
        draws["open"] = partial(_draw_opened, survey, "points")
        draws["open-drops"] = partial(_draw_opened, survey, "drops")
        for name, draw in draws.items():
            if options.only not in (None, name):
                continue
            path = options.output / f"screen-{name}.{options.format}"
            draw(path)
            report.record(picture=str(path), kilobytes=path.stat().st_size / 1e3)
    return 0


def _measure(survey: Path) -> None:
    """Measure three points with three seating and three measured drops each."""
    for name, modulus in POINTS.items():
        scenario = {"base": "default", "soil": {"modulus": modulus}}
        plan = SessionPlan(
            point=name,
            drops=DROPS,
            options=AnalysisOptions(),
            default_procedure=plain_procedure(),
            job=JobRequest(target=TARGET, operator="A. Weber"),
        )
        with serve(scenario, drops=DROPS, rate=RATE, seed=len(name)) as instrument:
            measure(instrument.url, survey, lambda _: None, plan)
    for place, name in enumerate(POINTS):
        where = {"latitude": 48.1374 + 0.0002 * place, "longitude": 11.5755}
        edit_survey(survey, [Edit("position", where)], name)


async def _wait(pilot: Any, holds: Callable[[], bool]) -> None:
    for _ in range(int(READY_TIMEOUT_S / 0.1)):
        if holds():
            return
        await pilot.pause(0.1)
    raise RuntimeError("a picture was not ready in time")


async def _redraw(app: PfwdApp, pilot: Any) -> None:
    app.show_message("")
    app.redraw()
    await pilot.pause()


PICTURES: dict[str, tuple[tuple[int, int], ScreenSettings, tuple[str, ...]]] = {
    "measure": ((120, 40), ScreenSettings(), ()),
    "small": ((80, 24), ScreenSettings(theme="daylight"), ()),
    "large": ((120, 40), ScreenSettings(theme="daylight", large=True), ()),
    "points": ((120, 34), ScreenSettings(), ("2", "down")),
    "drop": ((120, 44), ScreenSettings(), ("3", *["right"] * 8)),
    "diagnosis": ((120, 34), ScreenSettings(), ("4", "enter")),
    "setup": ((80, 24), ScreenSettings(), ("5",)),
}
"""Size, settings and pressed keys of each picture of the screen; without keys: while measuring."""


def _draw(
    survey: Path, size: tuple[int, int], settings: ScreenSettings, keys: tuple[str, ...], path: Path
) -> None:
    measuring = not keys
    source = ReplaySource(survey, 0.0, AnalysisOptions(), paused=measuring)
    pace = source.pace
    assert pace is not None
    n_drops = len(POINTS) * DROPS
    source.title = survey.name
    app = PfwdApp(source, settings, TARGET, BRAILLE, save=lambda _: True, local_time=lambda: CLOCK)

    async def body() -> None:
        async with app.run_test(size=size) as pilot:
            if measuring:  # the last but one drop has just been measured
                for count in range(1, n_drops - 1):
                    pace.step()
                    await _wait(pilot, lambda count=count: _safe(app) >= count)  # type: ignore[misc]
                pace.speed = 1.0
                pace.step()
                await _wait(pilot, lambda: _safe(app) >= n_drops - 1 and _final(app))
                pace.go_on()
            else:
                await _wait(pilot, lambda: app.state.ended is not None)
            if keys:
                await pilot.press(*keys)
                await pilot.pause(0.3)
                await _wait(pilot, lambda: not app.busy_text())
            await _redraw(app, pilot)
            if keys:
                await pilot.pause(0.3)
            save_picture(runs_of_app(app), size[0], path)

    asyncio.run(body())


def _draw_complete_point(survey: Path, path: Path) -> None:
    """Draw a complete point while the instrument is still connected."""
    size = 80, 24
    name, modulus = next(iter(POINTS.items()))
    scenario = {"base": "default", "soil": {"modulus": modulus}, "drops": {"quiet": QUIET_S}}
    stations = tuple(Station(f"km 12+{300 + 25 * n}", 12_300.0 + 25 * n) for n in range(4))
    plan = SessionPlan(
        point=name,
        options=AnalysisOptions(),
        default_procedure=plain_procedure(),
        job=JobRequest(target=TARGET, stations=stations),
    )
    with serve(scenario, drops=DROPS, rate=RATE, seed=len(name)) as instrument:
        source = LiveSource(instrument.url, survey, plan)
        app = PfwdApp(
            source,
            ScreenSettings(bell=False),
            glyphs=BRAILLE,
            save=lambda _: True,
            local_time=lambda: CLOCK,
        )

        async def body() -> None:
            async with app.run_test(size=size) as pilot:
                await _wait(pilot, lambda: app.word().word == "POINT DONE" and _final(app))
                await _redraw(app, pilot)
                save_picture(runs_of_app(app), size[0], path)

        asyncio.run(body())
        source.close()


def _draw_opened(survey: Path, tab: str, path: Path) -> None:
    """Draw a tab of ``pfwd open``; the points with the chosen one below their table."""
    size = (120, 36) if tab == "points" else (120, 24)
    app = OpenApp(OpenedSurvey(survey), ScreenSettings(), BRAILLE)

    async def body() -> None:
        async with app.run_test(size=size) as pilot:
            await _wait(pilot, lambda: app.ready)
            if tab != "points":
                await pilot.press("down", "enter")
            await pilot.pause(1.0)
            save_picture(runs_of_app(app), size[0], path)

    asyncio.run(body())


def _safe(app: PfwdApp) -> int:
    return sum(1 for _ in app.state.drops_in_order())


def _final(app: PfwdApp) -> bool:
    last = app.state.last
    return last is not None and not last.view.awaits_result and last.memory.curves is not None
