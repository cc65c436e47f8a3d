"""A complete point, legible and audible from a metre away; keys that meant another drop."""

import time
from pathlib import Path
from typing import Any

import pytest
from textual import events

from pfwd.judging import Job, Station
from pfwd.procedures import Verdict, find_procedure
from pfwd.session.events import DropNotSaved, DropsWaiting, JobReported
from pfwd.session.plan import Ending
from tests.tui.screen.scripted import (
    App,
    QuietSource,
    analysed,
    complete_point,
    deliver,
    play,
    ready,
    report,
    saved,
    status,
    until,
)
from tui.screen.app import SOUNDS
from tui.screen.session.screen_events import SessionEnded
from tui.screen.session.state import SessionState
from tui.screen.session.stations import lot_progress, next_station
from tui.screen.session.status import status_of
from tui.screen.settings import ScreenSettings
from tui.screen.show import leaving_lines

E_LWD = find_procedure("mchw-885")
LOT = Job(
    procedure=E_LWD,
    target=60e6,
    stations=(
        Station("12+300", 12_300.0, 48.1, 11.5),
        Station("12+320", 12_320.0, 48.1, 11.5003),
        Station("12+340", 12_340.0, 48.1, 11.5006),
    ),
)


@pytest.fixture
def app() -> App:
    return App(settings=ScreenSettings(bell=False))


async def test_the_judged_quantity_is_in_large_digits(app: App, pilot: Any) -> None:
    await deliver(app, pilot, JobReported(Job(procedure=E_LWD)), *complete_point()[:4])
    assert "E_LWD, drop 1" in app.text
    assert "not judged: modulus 47.1 MPa (46.5 to 47.7)" in app.text


@pytest.mark.parametrize(
    ("size", "target", "word"),
    [((80, 24), 40e6, "reaches the target"), ((120, 40), 60e6, "misses the target")],
)
async def test_the_verdict_of_a_complete_point_fills_the_screen(
    app: App, pilot: Any, size: tuple[int, int], target: float, word: str
) -> None:
    job = JobReported(Job(procedure=app.state.procedure, target=target))
    await deliver(app, pilot, job, *complete_point())
    app.state.saved_at = time.monotonic() - 60
    app.redraw()
    await pilot.pause()
    for part in (word, "E_eq 47.5 MPa (46.9 to 48.2)", "mean of 3 drops"):
        assert part in app.text
    assert app.text.count("████") > 10
    await pilot.press("up")
    assert "soil on bedrock" in app.text, "a chosen drop is shown"


def test_each_verdict_has_its_sound() -> None:
    assert len(set(SOUNDS.values())) == len(Verdict) == len(SOUNDS)

    async def script(app: App, pilot: Any) -> None:
        job = JobReported(Job(procedure=app.state.procedure, target=40e6))
        *before, last = complete_point()
        await deliver(app, pilot, job, *before)
        rung = app.bells + len(SOUNDS[Verdict.PASS])
        await deliver(app, pilot, last)
        await until(pilot, lambda: app.bells == rung)
        assert app._sounded == {"7": "pass"}
        await deliver(app, pilot, status())
        assert app.bells == rung, "the verdict rings once"

    play(App(), script)


async def test_a_failed_fit_has_no_result(app: App, pilot: Any) -> None:
    failed = analysed(1, modulus=None, reason="no table")
    await deliver(app, pilot, ready(), saved(1), failed)
    assert "NO FIT: no table" in " ".join(app.text.split())
    assert "no result yet" in app.text


async def test_not_safe_ends_once_the_drop_is_stored(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), DropNotSaved("7", 1, "the disk is full"))
    assert "drop 1 is NOT SAFE" in app.message
    await deliver(app, pilot, saved(1))
    assert app.message == "drop 1 is safe now"


async def test_discard_applies_to_the_drop_on_the_terminal(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), saved(1), analysed(1))
    app.state.saved_at = time.monotonic() - 60
    await deliver(app, pilot, saved(2), analysed(2))  # while the finger was on its way
    await pilot.press("d")
    assert app.message == "drop 2 has just come: d again discards it"
    assert app.requests == []
    await pilot.press("d")
    assert app.requests == [("discard", "by the operator", None, 2)]


async def test_pasted_text_is_ignored(app: App, pilot: Any) -> None:
    await deliver(app, pilot, ready(), saved(1), analysed(1))
    app.post_message(events.Paste("dqn"))
    await until(pilot, lambda: app.message == "pasted text is ignored: it is not typed as keys")
    assert app.is_running
    assert app.requests == []


def test_earlier_losses_of_an_instrument_are_not_counted() -> None:
    state = SessionState(clock=lambda: 1.0)
    before = status()
    for overruns, lost in ((5350, 0), (5353, 3)):
        counters = dict(before.counters) | {"instrument_overruns": overruns}
        report(state, ready(), type(before)(before.status, counters))
        assert state.device.lost_samples == lost


@pytest.mark.parametrize(
    ("measured", "position", "current", "text"),
    [
        ({"12+300"}, None, "12+300", "next: 12+320, 20 m ahead"),
        ({"12+300"}, (48.1, 11.50058), "12+300", "next: 12+340, 1 m ahead"),
        ({"12+340", "12+320"}, None, "12+340", "next: 12+300, 40 m back"),
    ],
)
def test_the_next_station_by_the_list_and_by_the_receiver(
    measured: set[str], position: tuple[float, float] | None, current: str, text: str
) -> None:
    station = next_station(LOT, measured, position, current)
    assert station is not None
    assert station.text == text


def test_a_complete_lot_has_no_next_station() -> None:
    assert next_station(LOT, {station.name for station in LOT.stations}) is None
    assert lot_progress(LOT, {"12+300"}) == "1 of 3 stations"


def test_a_complete_point_gives_the_next_station() -> None:
    state = SessionState(clock=lambda: 1.0)
    report(state, JobReported(LOT), *complete_point(point="12+300"))
    ahead = "next: 12+320, 20 m ahead; there press n"
    assert status_of(state, 100.0).action == ahead
    report(state, JobReported(Job(procedure=E_LWD, step_m=20.0)))
    assert status_of(state, 100.0).action == ahead
    report(state, JobReported(Job(procedure=E_LWD)))
    assert status_of(state, 100.0).action == "walk to the next point and press n"


@pytest.mark.parametrize("drops", [6, 5])
def test_the_verdict_stays_when_the_instrument_has_ended(app: App, drops: int) -> None:
    async def script(app: App, pilot: Any) -> None:
        job = JobReported(Job(procedure=app.state.procedure, target=40e6))
        *events, last = complete_point()
        await deliver(app, pilot, job, *(events if drops == 6 else events[:-1]))
        if drops == 6:
            await deliver(app, pilot, last)
        await deliver(app, pilot, SessionEnded(Ending.DONE))
        assert "END" in app.text
        assert ("target at least 40.0 MPa" in app.text) == (drops == 6)

    play(app, script, (80, 24))


def test_leaving_prints_a_summary_and_the_next_commands(tmp_path: Path) -> None:
    source = QuietSource(tmp_path / "Ring road")

    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, *complete_point())
        first, second = leaving_lines(app.state, app.source)
        assert first.endswith("Ring road: 1 point, 6 drops, all on the disk")
        assert "pfwd open" in second
        assert "-o report.html" in second
        await deliver(app, pilot, DropsWaiting("drops wait: 2", serious=True))
        assert leaving_lines(app.state, app.source)[1] == "drops wait: 2"

    play(App(source, ScreenSettings(bell=False)), script)
