"""The application: one session, its state, the pages that show it."""

import asyncio
import contextlib
import dataclasses
import datetime
import signal
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from textual import events
from textual.app import App, SystemCommand
from textual.binding import Binding, BindingType
from textual.screen import Screen

from pfwd.errors import DeviceError, SurveyError
from pfwd.files.moving import moved_to
from pfwd.judging import JobRequest
from pfwd.judging.view import read_points
from pfwd.procedures import Verdict
from pfwd.session.events import (
    CalibrationChanged,
    DropAnalysed,
    DropNotPublished,
    DropNotSaved,
    DropSaved,
    Edited,
    JobReported,
    Notice,
    PointDiagnosed,
    SurveyFilesChanged,
)
from pfwd.session.plan import SessionPlan
from pfwd.session.position import FIX_NAMES, PositionReceiver
from tui.output import clean
from tui.screen.drawing.glyphs import Glyphs, glyphs_of_terminal
from tui.screen.looks import LOOKS, Look
from tui.screen.pages import PAGES, make_page
from tui.screen.pages.dialogs import Question
from tui.screen.pages.help import HelpPage
from tui.screen.pages.measure import MeasurePage
from tui.screen.pages.page import Page
from tui.screen.session.diagnosis import Diagnoses
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.drop_state import DropState
from tui.screen.session.event_log import log_event
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import (
    DiagnosisFinished,
    DropRead,
    Refit,
    ScreenEvent,
    SessionEnded,
    SurveyRead,
)
from tui.screen.session.sources import (
    SessionSource,
    change_speed,
    pace_text,
    pause_or_go_on,
    step_drop,
)
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import StatusWord, status_of
from tui.screen.session.survey_edits import SurveyEdits
from tui.screen.settings import ScreenSettings, save_settings
from tui.screen.units import UNITS_BY_NAME, Units

UPDATES_PER_S = 12.0
"""Per second; a timer that is late now and then still gives ten."""

LEAVE_TIMEOUT_S = 25.0
"""s that leaving waits for the last analyses."""

MESSAGE_S = 8.0
"""s."""

SOUNDS: Mapping[Verdict, tuple[float, ...]] = {
    Verdict.PASS: (0.0, 0.15, 0.3),
    Verdict.FAIL: (0.0, 0.8, 1.6),
    Verdict.UNDECIDED: (0.0, 0.15, 0.8, 0.95),
    Verdict.NONE: (0.0, 0.15),
}
"""When the bell rings for a point that is done, s: three quick ones, three slow ones, two pairs;
told apart without a look. A drop rings once, a rejected one twice."""


class PfwdApp(App[int]):
    """The live screen.

    Parameters
    ----------
    source : SessionSource
    settings : ScreenSettings, optional
    target : float, optional
        Of points that have none, Pa.
    glyphs : Glyphs, optional
        None: what the terminal is likely to have.
    save : callable, optional
        Keeps changed settings.
    local_time : callable, optional
        For pictures that look alike.
    """

    CSS_PATH = str(Path(__file__).with_name("screen.tcss"))  # of a subclass elsewhere too
    TITLE = "PFWD"
    ENABLE_COMMAND_PALETTE = True
    BINDINGS: ClassVar[list[BindingType]] = [
        *(Binding(entry.key, f"page('{entry.name}')", entry.title) for entry in PAGES),
        Binding("question_mark,f1", "help", "Help"),
        Binding("u", "undo", "Undo"),
        Binding("t", "theme", "Dark or daylight"),
        Binding("l", "large", "Large type"),
        Binding("b", "ring", "Bell on or off"),
        Binding("i", "units", "SI or US customary"),
        Binding("space", "pause", "Pause or go on"),
        Binding("full_stop", "step", "One drop of a replay"),
        Binding("plus,equals_sign", "speed(1)", "Faster"),
        Binding("minus", "speed(-1)", "Slower"),
        Binding("q,ctrl+q", "leave", "Leave"),
        Binding("ctrl+c", "leave", "Leave", priority=True),
    ]

    def __init__(
        self,
        source: SessionSource,
        settings: ScreenSettings | None = None,
        target: float | None = None,
        glyphs: Glyphs | None = None,
        save: Callable[[ScreenSettings], bool] = save_settings,
        local_time: Callable[[], datetime.datetime] = datetime.datetime.now,
    ) -> None:
        super().__init__()
        self.source = source
        self.settings = settings or ScreenSettings()
        self.state = SessionState(
            source.plan.setup.procedure or source.plan.default_procedure,
            source.plan.job.target if target is None else target,
        )
        self.state.waits_for_first_modulus = source.plan.options is not None
        self.state.recorded = source.pace is not None
        self.runner = SessionRunner(source)
        self.runner.add_listener(log_event)
        self.edits = SurveyEdits(source, self.runner, self.show_message, self._in_thread)
        self.fits = DropFits(source, self.runner, self.state, self.show_message, self._in_thread)
        self.diagnoses = Diagnoses(source, self.runner, self.state, self.show_message)
        self.glyphs = glyphs or glyphs_of_terminal()
        self.drawn = 0
        """How often the page was drawn."""
        self._save = save
        self._local_time = local_time
        self._leaving = False
        self._asking = False
        self._message = ("", 0.0)
        self._unsafe: set[tuple[str, int]] = set()
        self._asked_calibration: CalibrationChanged | None = None
        self._sounded: dict[str, str] = {}
        self._drawn_for: tuple[Any, ...] = ()
        self.shown_drop: tuple[str, int] | None = None
        """Point and number of the drop that the drop page shows."""
        for look in LOOKS.values():
            self.register_theme(look.theme)

    # What the pages ask.

    @property
    def look(self) -> Look:
        """The theme."""
        return LOOKS[self.settings.theme]

    @property
    def units(self) -> Units:
        """Of the screen."""
        return UNITS_BY_NAME[self.settings.units]

    @property
    def message(self) -> str:
        """What was said last, as long as it is news."""
        text, until = self._message
        return text if time.monotonic() < until else ""

    def clock(self) -> str:
        """The time of day."""
        return self._local_time().strftime("%H:%M:%S")

    def word(self) -> StatusWord:
        """What is going on."""
        now = time.monotonic()
        at = self.runner.pulse_at
        return status_of(self.state, now, None if at is None else now - at, self.coordinates())

    def position(self) -> ReceiverStatus | None:
        """Where the instrument stands and how sure that is, for the head; None: no receiver."""
        receiver = self.source.plan.position
        if not isinstance(receiver, PositionReceiver):
            return None
        fix = receiver.latest()
        if fix is None:
            return ReceiverStatus(
                f"GPS no fix: {receiver.record().get('fault')}", "", is_good=False
            )
        seen = "" if fix.satellites is None else f" {fix.satellites} sat"
        good = receiver.warning() is None
        poor = "" if good else f" HDOP {fix.hdop:g}"
        quality = FIX_NAMES.get(fix.quality, "fix")
        place = f"{fix.latitude:.5f}, {fix.longitude:.5f}"
        return ReceiverStatus(f"GPS {quality}{seen}{poor}", place, good)

    def coordinates(self) -> tuple[float, float] | None:
        """Latitude and longitude now, degrees; None: not known."""
        receiver = self.source.plan.position
        fix = receiver.latest() if isinstance(receiver, PositionReceiver) else None
        return None if fix is None else (fix.latitude, fix.longitude)

    def pace_text(self) -> str:
        """How fast a replay goes."""
        return pace_text(self.source.pace)

    def busy_text(self) -> str:
        """What is under way besides measuring."""
        if self.diagnoses.file:
            return f"diagnosing {Path(self.diagnoses.file).name} ..."
        return "fitting ..." if self.fits.n_running else ""

    def show_message(self, text: str) -> None:
        """One line for the operator, for a while."""
        self._message = clean(text), time.monotonic() + MESSAGE_S

    # Life.

    def on_mount(self) -> None:
        """Show the first page, then start what is slow."""
        self.theme = self.look.theme.name
        self.push_screen(MeasurePage())
        self.set_interval(1 / UPDATES_PER_S, self._tick)
        self.call_after_refresh(self._begin)
        # The loop of Windows takes no signals, and none does outside the main thread: there the
        # program ends by its keys.
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
            loop = asyncio.get_running_loop()
            loop.add_signal_handler(signal.SIGTERM, self._end_by_signal)

    def _begin(self) -> None:
        self.read_contents()
        self.runner.start()

    def _end_by_signal(self) -> None:
        self.run_worker(self._leave(), exclusive=True, group="leave")

    def read_contents(self) -> None:
        """Read the survey in a thread."""
        folder = self.source.survey
        if folder is None or not folder.is_dir():
            return
        self._in_thread(lambda: self._read(folder), "contents")

    def _in_thread(self, work: Callable[[], None], group: str) -> None:
        self.run_worker(work, thread=True, group=group, exit_on_error=False)

    def _read(self, folder: Path) -> None:
        try:
            points = read_points(folder)
        except (SurveyError, DeviceError, OSError) as err:
            if self.state.session is None and not self.source.writes:
                self.runner.put(Notice(str(err), serious=True))
            return
        self.runner.put(SurveyRead(points, drops=self.source.writes))

    def _tick(self) -> None:
        come = self.runner.take()
        for event in come:
            self._take(event)
        judging = (DropAnalysed, DropSaved, Edited, PointDiagnosed)
        if any(isinstance(event, judging) for event in come):
            self._sound_verdict()
        # While the application ends, the clock may tick once more without a screen.
        page = self.screen if self.screen_stack else None
        if not isinstance(page, Page):
            return
        trace = self.runner.trace.samples if page.NAME == "measure" else 0
        now = (page, self.state.version, trace, self.word(), self.message, self.clock())
        if now != self._drawn_for or self.drawn == 0:
            self._drawn_for = now
            self.drawn += 1
            page.draw()

    def _take(self, event: ScreenEvent) -> None:
        self.state.take(event)
        match event:
            case DropSaved(one):
                self._ring(2 if one.screening.status == "rejected" else 1)
                if (one.point, one.number) in self._unsafe:
                    self._unsafe.discard((one.point, one.number))
                    self.show_message(f"drop {one.number} is safe now")
            case DropNotSaved(point, number, reason):
                self._ring(2)
                self._unsafe.add((point, number))
                self.show_message(f"drop {number} is NOT SAFE: {reason}")
            case SurveyFilesChanged(text, safe):
                if not safe:
                    self._ring(2)
                self.show_message(text)
            case DropNotPublished():
                self.show_message(event.text)
            case Notice(text):
                self.show_message(text)
            case CalibrationChanged():
                self._on_calibration(event)
            case PointDiagnosed(name, result):
                self.diagnoses.on_point(name, result, self.units)
            case Edited(value=value):
                if moved_to(value) is not None:  # a drop is there or gone at another point
                    self.read_contents()
                self.diagnoses.verdicts.pop(self.state.point, None)
            case DropRead(one):
                self.fits.on_read(one)
            case SessionEnded(_, error):
                if error:
                    self.show_message(error)
            case Refit(_, number, label, result):
                self.fits.on_refitted(number, label, result, self.units)
            case DiagnosisFinished():
                self.diagnoses.on_diagnosed(event, self.units)

    def _on_calibration(self, event: CalibrationChanged) -> None:
        """Ask before anything is recorded with another calibration."""
        self.show_message(event.text)
        if not event.waits or event == self._asked_calibration:
            return
        self._ring(2)
        self._asked_calibration = event

        def answer(sure: bool | None) -> None:
            self._asked_calibration = None
            if sure:
                self.runner.request(lambda session: session.accept_calibration(event))
            else:
                self._end_by_signal()

        question = f"{event.text}. Record with the new calibration?"
        self.push_screen(Question(question, "record", "end the measurement"), answer)

    def _ring(self, times: int) -> None:
        self._sound(tuple(0.25 * count for count in range(times)))

    def _sound(self, at: tuple[float, ...]) -> None:
        """Ring the bell at these times from now, s."""
        if not self.settings.bell:
            return
        for seconds in at:
            if seconds:
                self.set_timer(seconds, self.bell)
            else:
                self.bell()

    def _sound_verdict(self) -> None:
        """A sound of its own for each verdict, once the point is done and nothing is computed."""
        state = self.state
        progress = state.progress
        if self.source.pace is not None or not progress.complete or progress.next_kind is not None:
            self._sounded.pop(state.point, None)
            return
        if any(drop.awaits_modulus or not drop.final for drop in state.current_drops.values()):
            return
        if self._sounded.get(state.point) != progress.verdict.value:
            self._sounded[state.point] = progress.verdict.value
            self._sound(SOUNDS[progress.verdict])

    # Pages.

    def action_page(self, name: str) -> None:
        """Go to a page; the measure page stays below all others."""
        if isinstance(self.screen, Page) and name == self.screen.NAME:
            return
        while len(self.screen_stack) > 2:
            self.pop_screen()
        if name != "measure":
            self.push_screen(make_page(name))

    def open_drop(self, drop: DropState | None, *, refit: bool = False) -> None:
        """Show everything about a drop."""
        if drop is None:
            self.show_message("there is no drop yet")
            return
        self.shown_drop = drop.point, drop.number
        self.action_page("drop")
        if refit:
            page = self.screen
            start = getattr(page, "action_refit", None)
            if start is not None:
                self.call_after_refresh(start)

    def action_undo(self) -> None:
        """Take the last discard, restore or move back."""
        self.edits.undo()

    def on_paste(self, event: events.Paste) -> None:
        """What is pasted is no row of keys: it goes into a field, or nowhere."""
        event.stop()
        self.show_message("pasted text is not taken for keys")

    def action_help(self) -> None:
        """Help for this page."""
        if isinstance(self.screen, Page) and not isinstance(self.screen, HelpPage):
            self.push_screen(HelpPage(self.screen))

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """The command palette: every key of this page and of all pages."""
        seen = set()
        for node, binding, enabled, _ in screen.active_bindings.values():
            if not binding.description or not enabled or binding.description in seen:
                continue
            seen.add(binding.description)
            yield SystemCommand(
                binding.description,
                f"key {binding.key}",
                partial(self.call_later, self.run_action, binding.action, node),
            )

    # Settings.

    def change(self, **values: Any) -> None:
        """Change settings, keep them, and show it."""
        self.settings = dataclasses.replace(self.settings, **values)
        self.theme = self.look.theme.name
        if not self._save(self.settings):
            self.show_message("the settings could not be saved; they hold until you leave")
        self.redraw()

    def redraw(self) -> None:
        """Draw the page on top anew."""
        self._drawn_for = ()
        if isinstance(self.screen, Page):
            self.screen.draw()

    def action_theme(self) -> None:
        """The other theme."""
        self.change(theme="daylight" if self.settings.theme == "dark" else "dark")

    def action_large(self) -> None:
        """Large type, or not."""
        self.change(large=not self.settings.large)

    def action_units(self) -> None:
        """The other units."""
        self.change(units="us" if self.settings.units == "si" else "si")

    def action_ring(self) -> None:
        """Bell on or off."""
        self.change(bell=not self.settings.bell)
        self.show_message("bell on" if self.settings.bell else "bell off")

    # A replay.

    def action_pause(self) -> None:
        """Pause a replay, or go on."""
        if self.source.pace is not None:
            pause_or_go_on(self.source.pace)
            self.redraw()

    def action_step(self) -> None:
        """One drop more."""
        if self.source.pace is not None:
            step_drop(self.source.pace)
            self.redraw()

    def action_speed(self, step: int) -> None:
        """Faster or slower."""
        if self.source.pace is not None:
            change_speed(self.source.pace, step)
            self.redraw()

    # Leaving.

    def action_leave(self) -> None:
        """Leave; asks only when something would be lost."""
        if self._leaving:  # a second time: at once, what was acknowledged is safe
            self._finish()
            return
        if self._asking:
            return
        danger = self._danger()
        if not danger:
            self._end_by_signal()
            return
        self._asking = True
        self.push_screen(Question(danger, "leave", "stay"), self._answered)

    def _answered(self, sure: bool | None) -> None:
        self._asking = False
        if sure:
            self._end_by_signal()

    def _danger(self) -> str:
        """What would be lost by leaving now."""
        if self.state.n_unsaved:
            return f"{self.state.n_unsaved} drop(s) are only in memory and would be lost. Leave?"
        return str(getattr(self.screen, "unsaved", "") or "")

    async def _leave(self) -> None:
        self._leaving = True
        self.show_message("ending: the last drop is made safe; q again leaves at once")
        self.redraw()
        pace = self.source.pace
        if pace is not None:
            pace.go_on()
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, lambda: self.runner.stop(LEAVE_TIMEOUT_S))
        self._finish()

    def _finish(self) -> None:
        self.diagnoses.stop()
        self.fits.close()
        for event in self.runner.take():
            self.state.take(event)
        self.exit(self.state.exit_status)

    def restart(self, plan: SessionPlan, url: str) -> None:
        """Go on with another plan: the session ends when the drop in hand is safe."""
        self.show_message("the session begins anew with this setup")
        self.run_worker(self._restart(plan, url), exclusive=True, group="restart")

    async def _restart(self, plan: SessionPlan, url: str) -> None:
        loop = asyncio.get_running_loop()
        if not await loop.run_in_executor(None, lambda: self.runner.stop(LEAVE_TIMEOUT_S)):
            self.show_message("the session has not ended yet; the setup was not taken")
            return
        self.source.plan = plan
        if url:
            self.source.url = url
        said = JobRequest(procedure=plan.setup.procedure).over(plan.job)
        self.state.take(JobReported(self.state.job.with_request(said.news(self.state.job))))
        self.runner.start()
        self.redraw()
