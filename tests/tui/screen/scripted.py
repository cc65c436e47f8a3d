"""Events with stated contents, and sources without events."""

import asyncio
import dataclasses
import datetime
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np

from inversion.notices import Notice, codes, text_notice
from inversion.result import TimeHistories
from pfwd.analysis.drop_facts import unbroken_peaks
from pfwd.analysis.results import DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd.judging import DropView, PointView, SurveyView, drop_from_traces
from pfwd.procedures import Kind, PointDrop
from pfwd.session.events import (
    CalibrationChanged,
    DropAnalysed,
    DropSaved,
    InstrumentReady,
    InstrumentStatus,
    LiveSamples,
    SavedDrop,
)
from pfwd.session.live_view import apply_event
from pfwd.session.plan import Ending, SessionPlan
from pfwd_device.acquisition.items import Samples
from pfwd_device.drop import Channel, Drop
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import Status
from tests.pfwd import scripted_feed
from tests.pfwd.scripted_feed import GEOPHONE, LOAD
from tests.tui.results import result
from tui.screen.app import PfwdApp
from tui.screen.drawing.glyphs import BRAILLE, Glyphs
from tui.screen.opened.app import OpenApp
from tui.screen.session.screen_drop import DropInMemory, ScreenDrop
from tui.screen.session.state import SessionState
from tui.screen.settings import ScreenSettings

NOON = datetime.datetime(2026, 5, 4, 12, 0, 7)
SETUP = PointSetup(plate_radius=0.15, plate_mass=10.0, poisson_ratio=0.35, seating_drops=3)
IDENTITY = dataclasses.replace(
    scripted_feed.IDENTITY,
    serial_number="T-1042",
    channels=(
        dataclasses.replace(LOAD, due=datetime.date(2027, 3, 2)),
        dataclasses.replace(GEOPHONE, sensitivity=1.0),
    ),
)


def ready(
    identity: Identity = IDENTITY, *, restarted: bool = False, **more: Any
) -> InstrumentReady:
    fields: dict[str, Any] = {"differences": (), "warnings": ()} | more
    return InstrumentReady(
        "/dev/ttyUSB0", identity, SETUP, fields["differences"], fields["warnings"], restarted
    )


def status(lost: float = 0, battery: float | None = 7.4) -> InstrumentStatus:
    device_status = Status(1, battery, 21.0, 0, True)
    return InstrumentStatus(
        device_status, {"samples_lost": lost, "instrument_overruns": 0, "drift": None}
    )


def samples(first: int = 0, *, drop_load: float = 400.0) -> LiveSamples:
    """Return samples of 0.1 s without load."""
    counts = np.zeros((1000, 2), np.int32)
    utc = NOON.replace(tzinfo=datetime.UTC)
    return LiveSamples(Samples(7, first, counts, False, 0.0, utc), IDENTITY, drop_load)


def drop(number: int, peak: float = 9900.0) -> Drop:
    time = np.arange(-200, 1000) / 10_000
    pulse = np.where((time > 0) & (time < 0.0133), np.sin(np.pi * time / 0.0133), 0.0)
    pulse *= 1 + 1e-9 * number  # measured drops are never the same
    return Drop(number, time, peak * pulse, (Channel(0.0, "displacement", 6.4e-4 * pulse),))


def saved_drop(
    number: int = 1,
    point: str = "7",
    *,
    status: str = "measured",
    reason: str | None = None,
    record: int | None = None,
    marks: tuple[str | Notice, ...] = (),
    load: float = 9900.0,
) -> SavedDrop:
    # Drops are judged by their own records.
    traces = drop(number, 1100.0 if status == "rejected" else load)
    view = drop_from_traces(
        traces,
        SETUP,
        record=number if record is None else record,
        peaks=unbroken_peaks(traces),
        metadata={"marks": codes(text_notice(m) if isinstance(m, str) else m for m in marks)},
        awaits_result=status != "rejected",
    )
    screening = Screening(status, reason and text_notice(reason))  # type: ignore[arg-type]
    file = f"survey/drops/drop-{number:06d}.h5"
    return SavedDrop(point, dataclasses.replace(view, screening=screening), traces, file)


def saved(number: int = 1, point: str = "7", **more: Any) -> DropSaved:
    return DropSaved(saved_drop(number, point, **more))


def stored_drop(number: int, result: DropResult | None, **more: Any) -> DropView:
    """A drop of the survey with its last result."""
    drop = DropView(PointDrop(number, Kind.MEASURED), 0.0, SETUP, **more)
    return drop.with_result(result)


def curves() -> TimeHistories:
    drop_record = drop(1)
    observed = drop_record.channels[0].values
    return TimeHistories(
        drop_record.time,
        drop_record.load,
        drop_record.load,
        observed[None, :],
        0.99 * observed[None, :],
        np.zeros(1),
        np.array([observed.max()]),
        0.04,
        0.0133,
    )


def analysed(
    number: int = 1,
    point: str = "7",
    *,
    full: bool = True,
    record: int | None = None,
    kind: str = "measured",
    **more: Any,
) -> DropAnalysed:
    drop_record = saved_drop(number, point, record=record, status=kind)
    result_of_drop = result(**more)
    drawn = curves() if result_of_drop.modulus_pa is not None else None
    return DropAnalysed(drop_record, 0.2, result_of_drop, drawn, full, full)


def screen_drop(
    *results: DropResult, saved: SavedDrop | None = None, curves: TimeHistories | None = None
) -> ScreenDrop:
    """The only drop of its point, with its last result in force."""
    saved = saved or saved_drop()
    view = saved.view.with_result(results[-1]) if results else saved.view
    return ScreenDrop(PointView("7", (view,)), view, DropInMemory(saved, curves, results))


def report(state: SessionState, *events: Any) -> None:
    """Apply events to a state, each followed by the survey that a session would publish."""
    for event in events:
        state.take(event)
        if (change := apply_event(state.view, event)) is not None:
            state.take(change)


class Session:
    """Replaces a session and records the requests."""

    def __init__(self, point: str = "7") -> None:
        self.point = point
        self.requests: list[tuple[Any, ...]] = []
        self.stopped = threading.Event()
        self.listener: Callable[[Any], None] = lambda _: None

    def ask(self, request: Callable[["Session"], None]) -> None:
        request(self)

    def set_point(self, name: str) -> None:
        self.requests.append(("point", name))

    def edit(self, edit: Any, *, point: str | None = None, number: int | None = None) -> None:
        self.requests.append((edit.what, edit.value, point, number))

    def move_drop(self, number: int, to: str) -> None:
        self.requests.append(("move", number, to))

    def change_job(self, request: Any) -> None:
        self.requests.append(("job", request.declared()))

    def continue_survey(self, view: SurveyView) -> None:
        self.view = view

    def report(self, event: Any) -> None:
        self.listener(event)
        if (change := apply_event(self.view, event)) is not None:
            self.view = change.view
            self.listener(change)

    def keep_result(self, number: int, result: Any) -> None:
        self.requests.append(("result", number, result))

    def accept_calibration(self, event: CalibrationChanged) -> None:
        self.requests.append(("calibration", event))

    def trigger(self) -> None:
        self.requests.append(("trigger",))

    def stop(self) -> None:
        self.stopped.set()


class QuietSource:
    """A session that sends no events until it is stopped."""

    pace = None
    writes = True

    def __init__(self, survey: Path | None = None, *, title: str = "Ring road km 12") -> None:
        self.title, self.survey = title, survey
        self.plan = SessionPlan()
        self.url = "/dev/ttyUSB0"
        self.session = Session()
        self.starts = 0

    def run(self, listener: Any, control: Any) -> Ending:
        self.starts += 1
        self.session.stopped.clear()
        self.session.listener = listener
        with control(self.session):
            self.session.stopped.wait(60)
        return Ending.DONE

    def close(self) -> None:
        pass


class App(PfwdApp):
    """Application without differences from run to run; it counts bells and stores settings."""

    source: Any

    def __init__(
        self,
        source: Any = None,
        settings: ScreenSettings | None = None,
        glyphs: Glyphs = BRAILLE,
        **more: Any,
    ) -> None:
        self.stored: list[ScreenSettings] = []

        def save(settings: ScreenSettings) -> bool:
            self.stored.append(settings)
            return True

        super().__init__(
            source or QuietSource(),
            settings,
            glyphs=glyphs,
            save=save,
            local_time=lambda: NOON,
            **more,
        )
        self.bells = 0

    def bell(self) -> None:
        self.bells += 1

    @property
    def text(self) -> str:
        """Text on the terminal, of any page and dialog."""
        return terminal_text(self)

    @property
    def words(self) -> str:
        """Text on the terminal without frames and line breaks."""
        return " ".join(self.text.replace("│", " ").split())

    @property
    def page_name(self) -> str:
        return getattr(self.screen, "NAME", "")

    @property
    def requests(self) -> list[tuple[Any, ...]]:
        """Requests to the session."""
        requests: list[tuple[Any, ...]] = self.source.session.requests
        return requests


def terminal_text(app: Any) -> str:
    """Return the text on the terminal of an application."""
    strips = app.screen._compositor.render_strips()
    return "\n".join("".join(part.text for part in strip).rstrip() for strip in strips)


Script = Callable[[Any, Any], Awaitable[None]]


def play(app: Any, script: Script, size: tuple[int, int] = (120, 40)) -> Any:
    """Run a script against an application, without a terminal."""

    def is_ready() -> bool:
        if isinstance(app, OpenApp):
            return app.ready
        return app.state.session is not None or app.state.ended is not None

    async def body() -> None:
        async with app.run_test(size=size) as pilot:
            await until(pilot, is_ready)
            await script(app, pilot)

    asyncio.run(body())
    return app


async def until(pilot: Any, holds: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait until a condition holds."""
    for _ in range(int(seconds / 0.01)):
        if holds():
            return
        await pilot.pause(0.01)
    raise AssertionError("it did not come")


async def deliver(app: App, pilot: Any, *events: Any) -> None:
    """Apply events and draw the page."""
    for event in events:
        app.runner.report(event)
    app._tick()  # as its clock does, twelve times a second
    assert not app.runner.waiting
    app.redraw()
    await pilot.pause()


def complete_point(point: str = "7", load: float = 9900.0) -> list[Any]:
    """Three seating and three measured drops with this peak load, N."""
    events: list[Any] = [ready(), status()]
    for number in range(1, 7):
        kind = "seating" if number <= 3 else "measured"
        events += [
            saved(number, point, status=kind, load=load),
            analysed(number, point, modulus=47e6 + 1e5 * number),
        ]
    return events
