"""Application of the live screen: a session, its state, and the pages that show it."""

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
from textual.filter import LineFilter
from textual.screen import Screen

from pfwd.errors import DeviceError, SurveyError
from pfwd.judging import JobRequest, PointView
from pfwd.judging.view import read_points
from pfwd.procedures import Verdict
from pfwd.session.events import (
    CalibrationChanged,
    DiagnosisAwaited,
    DropAnalysed,
    DropNotSaved,
    DropSaved,
    Edited,
    JobReported,
    PointDiagnosed,
    SessionNotice,
    SurveyChanged,
    SurveyFilesChanged,
    SurveyRead,
)
from pfwd.session.plan import SessionPlan
from pfwd.session.position import FIX_NAMES, PositionReceiver
from pfwd.units import UNITS_BY_NAME, Units
from tui.output import clean
from tui.screen.drawing.glyphs import Glyphs, glyphs_of_terminal
from tui.screen.lines_view import GlyphFilter
from tui.screen.pages import PAGES, make_page
from tui.screen.pages.dialogs import Question, TextDialog
from tui.screen.pages.help import HelpPage
from tui.screen.pages.measure import MeasurePage
from tui.screen.pages.page import Page
from tui.screen.session.diagnosis import RequestedDiagnoses, diagnosis_text
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.event_log import log_event
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import (
    DiagnosisFinished,
    DropRead,
    Refit,
    ScreenEvent,
    SessionEnded,
)
from tui.screen.session.slips import SlipWriter, signature_error
from tui.screen.session.sources import (
    SessionSource,
    change_speed,
    pace_text,
)
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import StatusWord, status_of
from tui.screen.session.survey_edits import SurveyEdits
from tui.screen.settings import ScreenSettings, save_settings
from tui.screen.themes import THEMES, ScreenTheme

UPDATES_PER_S = 12.0
"""Updates of the page; with late timers at least ten a second remain."""

LEAVE_TIMEOUT_S = 25.0
"""Time that leaving waits for the last analyses, s."""

MESSAGE_S = 8.0
"""Time that a message is shown, s."""

SOUNDS: Mapping[Verdict, tuple[float, ...]] = {
    Verdict.PASS: (0.0, 0.15, 0.3),
    Verdict.FAIL: (0.0, 0.8, 1.6),
    Verdict.UNDECIDED: (0.0, 0.15, 0.8, 0.95),
    Verdict.NONE: (0.0, 0.15),
}
"""Times at which the bell rings for a complete point, s; each verdict has its own rhythm. A drop
rings once, a rejected drop twice."""


class PfwdApp(App[int]):
    """Textual application of ``pfwd live``, ``pfwd demo`` and ``pfwd replay --live``.

    Parameters
    ----------
    source : SessionSource
    settings : ScreenSettings, optional
    target : float, optional
        Target of points without their own, Pa.
    glyphs : Glyphs, optional
        By default those of the terminal.
    save : callable, optional
        Stores changed settings.
    local_time : callable, optional
        Clock of the head line; a test sets it.
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
        self.state.recorded = source.pace is not None
        self.runner = SessionRunner(source, self.state.view)
        self.runner.add_listener(log_event)
        self.edits = SurveyEdits(source, self.runner, self.show_message, self._in_thread)
        self.fits = DropFits(source, self.runner, self.state, self.show_message, self._in_thread)
        self.slips = SlipWriter(source, self.runner, self.state, self.show_message)
        self.diagnoses = RequestedDiagnoses(source, self.runner, self.state, self.show_message)
        self.glyphs = glyphs or glyphs_of_terminal()
        self._glyph_filter = GlyphFilter(self.glyphs)
        self.drawn = 0
        """Number of times that a page was drawn."""
        self._save = save
        self._local_time = local_time
        self._leaving = False
        self._asking = False
        self._message = ("", 0.0)
        self._open_calibration: CalibrationChanged | None = None
        self._sounded: dict[str, str] = {}
        self._drawn_for: tuple[Any, ...] = ()
        self.selected_drop: tuple[str, int] | None = None
        """Point and number of the drop that the drop page shows."""
        for screen_theme in THEMES.values():
            self.register_theme(screen_theme.theme)

    def get_line_filters(self) -> list[LineFilter]:
        """Return the filters of the toolkit, and the one for characters that the terminal lacks."""
        glyph_filters = [self._glyph_filter] if self._glyph_filter.enabled else []
        return [*super().get_line_filters(), *glyph_filters]

    # Interface for the pages.

    @property
    def screen_theme(self) -> ScreenTheme:
        """Colours of the theme that the operator chose, dark or daylight."""
        return THEMES[self.settings.theme]

    @property
    def units(self) -> Units:
        """Units in which all pages show numbers, SI or US customary."""
        return UNITS_BY_NAME[self.settings.units]

    @property
    def message(self) -> str:
        """Last message to the operator; empty `MESSAGE_S` after it was shown."""
        text, until = self._message
        return text if time.monotonic() < until else ""

    def clock(self) -> str:
        """Return the local time of day as HH:MM:SS."""
        return self._local_time().strftime("%H:%M:%S")

    def word(self) -> StatusWord:
        """Return the status word of the measure page, as READY, with its instruction."""
        now = time.monotonic()
        at = self.runner.pulse_at
        return status_of(self.state, now, None if at is None else now - at, self.coordinates())

    def position(self) -> ReceiverStatus | None:
        """Return the fix of the satellite receiver as text; None: none is connected."""
        receiver = self.source.plan.position
        if not isinstance(receiver, PositionReceiver):
            return None
        fix = receiver.latest()
        if fix is None:
            return ReceiverStatus(
                f"GPS no fix: {receiver.record().get('fault')}", "", is_good=False
            )
        satellites = "" if fix.satellites is None else f" {fix.satellites} sat"
        is_good = receiver.warning() is None
        precision = "" if is_good else f" HDOP {fix.hdop:g}"
        quality = FIX_NAMES.get(fix.quality, "fix")
        place = f"{fix.latitude:.5f}, {fix.longitude:.5f}"
        return ReceiverStatus(f"GPS {quality}{satellites}{precision}", place, is_good)

    def coordinates(self) -> tuple[float, float] | None:
        """Return latitude and longitude of the last fix, degrees; None: no fix."""
        receiver = self.source.plan.position
        fix = receiver.latest() if isinstance(receiver, PositionReceiver) else None
        return None if fix is None else (fix.latitude, fix.longitude)

    def pace_text(self) -> str:
        """Return the speed of a replay in words."""
        return pace_text(self.source.pace)

    def busy_text(self) -> str:
        """Return what runs in the background, a diagnosis or a fit, in words; empty: nothing."""
        if self.diagnoses.task is not None:
            return diagnosis_text(self.diagnoses.file, self.diagnoses.task, time.monotonic())
        return "fitting ..." if self.fits.n_running else ""

    def show_message(self, text: str) -> None:
        """Show a line of text on every page for `MESSAGE_S`."""
        self._message = clean(text), time.monotonic() + MESSAGE_S

    # Start and events.

    def on_mount(self) -> None:
        """Show the first page, then start the session."""
        self.theme = self.screen_theme.theme.name
        self.push_screen(MeasurePage())
        self.set_interval(1 / UPDATES_PER_S, self._tick)
        self.call_after_refresh(self._begin)
        # A loop outside the main thread has no signal handlers: there the program ends by its keys.
        with contextlib.suppress(RuntimeError, ValueError):
            self._handle_signals(asyncio.get_running_loop())

    def _handle_signals(self, loop: asyncio.AbstractEventLoop) -> None:
        try:
            loop.add_signal_handler(signal.SIGTERM, self._end_by_signal)
        except NotImplementedError:  # on Windows, where Ctrl+C is a key and no signal

            def end(*_: object) -> None:
                with contextlib.suppress(RuntimeError):  # the loop has ended
                    loop.call_soon_threadsafe(self._end_by_signal)

            # SIGINT comes when the console window is closed.
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, end)

    def _begin(self) -> None:
        """Start the session, and read the points of the survey in a thread.

        In a replay the session reports them one by one.
        """
        folder = self.source.survey
        if folder is not None and folder.is_dir() and self.source.writes:
            self._in_thread(partial(self._read, folder), "contents")
        self.runner.start()

    def _read(self, folder: Path) -> None:
        # The session reports a survey that cannot be read.
        with contextlib.suppress(SurveyError, DeviceError, OSError):
            self.runner.report(SurveyRead(read_points(folder)))

    def _end_by_signal(self) -> None:
        self.run_worker(self._leave(), exclusive=True, group="leave")

    def _in_thread(self, work: Callable[[], ScreenEvent | None], group: str) -> None:
        """Run slow work in a thread, and take the event that it returns, or its error."""

        def run() -> None:
            try:
                event = work()
            except (SurveyError, DeviceError, OSError) as err:
                event = SessionNotice(str(err), serious=True)
            if event is not None:
                self.runner.put(event)

        self.run_worker(run, thread=True, group=group, exit_on_error=False)

    def _tick(self) -> None:
        new_events = self.runner.take()
        for event in new_events:
            self._take(event)
        judging = (DiagnosisAwaited, DropAnalysed, DropSaved, Edited, PointDiagnosed)
        changes = (event for event in new_events if isinstance(event, SurveyChanged))
        if any(isinstance(change.cause, judging) for change in changes):
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
        unsafe = {*self.state.unsafe}
        self.state.take(event)
        match event:
            case DropSaved(saved):
                self._ring(2 if saved.screening.status == "rejected" else 1)
                if (saved.point, saved.number) in unsafe:
                    self.show_message(f"drop {saved.number} is safe now")
            case DropNotSaved(_, number, reason):
                self._ring(2)
                self.show_message(f"drop {number} is NOT SAFE: {reason}")
            case SurveyFilesChanged(text):
                self._ring(2)
                self.show_message(text)
            case CalibrationChanged():
                self._on_calibration(event)
            case SessionNotice(text):
                self.show_message(text)
            case PointDiagnosed(name, result):
                self.diagnoses.on_point(name, result, self.units)
            case Edited():
                self.diagnoses.verdicts.pop(self.state.point, None)
            case DropRead(saved):
                self.fits.on_read(saved)
            case SessionEnded(_, error):
                if error:
                    self.show_message(error)
            case Refit(_, number, label, result):
                self.fits.on_refitted(number, label, result, self.units)
            case DiagnosisFinished():
                self.diagnoses.on_diagnosed(event, self.units)

    def _on_calibration(self, event: CalibrationChanged) -> None:
        """Ask the operator whether to record with the new calibration of the instrument."""
        self.show_message(event.text)
        if not event.waits or event == self._open_calibration:
            return
        self._ring(2)
        self._open_calibration = event

        def answer(sure: bool | None) -> None:
            self._open_calibration = None
            if sure:
                self.runner.request(lambda session: session.accept_calibration(event))
            else:
                self._end_by_signal()

        question = f"{event.text}. Record with the new calibration?"
        self.push_screen(Question(question, "record", "end the measurement"), answer)

    def _ring(self, times: int) -> None:
        self._sound(tuple(0.25 * count for count in range(times)))

    def _sound(self, at: tuple[float, ...]) -> None:
        """Ring the bell at times from now, s."""
        if not self.settings.bell:
            return
        for seconds in at:
            if seconds:
                self.set_timer(seconds, self.bell)
            else:
                self.bell()

    def _sound_verdict(self) -> None:
        """Ring the rhythm of the verdict once a point is complete and all its drops are fitted."""
        state = self.state
        progress = state.progress
        if state.current.is_verdict_pending:
            return
        if self.source.pace is not None or not progress.complete or progress.next_kind is not None:
            self._sounded.pop(state.point, None)
            return
        if any(drop.awaits_result for drop in state.current.drops):
            return
        if self._sounded.get(state.point) != progress.verdict.value:
            self._sounded[state.point] = progress.verdict.value
            self._sound(SOUNDS[progress.verdict])

    # Pages.

    def action_page(self, name: str) -> None:
        """Go to a page; the measure page stays below all other pages."""
        if isinstance(self.screen, Page) and name == self.screen.NAME:
            return
        while len(self.screen_stack) > 2:
            self.pop_screen()
        if name != "measure":
            self.push_screen(make_page(name))

    def open_drop(self, drop: ScreenDrop | None, *, refit: bool = False) -> None:
        """Open the drop page; with `refit` also its dialog for a fit with other settings."""
        if drop is None:
            self.show_message("there is no drop yet")
            return
        self.selected_drop = drop.point, drop.number
        self.action_page("drop")
        if refit:
            page = self.screen
            start = getattr(page, "action_refit", None)
            if start is not None:
                self.call_after_refresh(start)

    def ask_for_slip(self, point: PointView) -> None:
        """Ask for the signature of the slip of a point, then write the slip."""
        problem = self.slips.obstacle(point)
        if problem:
            self.show_message(problem)
            return

        def take(signature: str | None) -> None:
            if signature is not None:
                self.slips.write(point, signature)

        dialog = TextDialog(
            f"Slip of point {point.shown_name}: typed signature",
            self.state.job.operator or "",
            check=signature_error,
            hint="enter writes it, empty leaves a line to sign on, escape goes back",
        )
        self.push_screen(dialog, take)

    def action_undo(self) -> None:
        """Revert the last discard, restore or move."""
        self.edits.undo()

    def on_paste(self, event: events.Paste) -> None:
        """Refuse pasted text outside a field: it would act as a row of keys."""
        event.stop()
        self.show_message("pasted text is ignored: it is not typed as keys")

    def action_help(self) -> None:
        """Open the help of the page on top."""
        if isinstance(self.screen, Page) and not isinstance(self.screen, HelpPage):
            self.push_screen(HelpPage(self.screen))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable the keys for pause, step and speed where no recording is replayed."""
        if action in ("pause", "step", "speed"):
            return self.source.pace is not None
        return super().check_action(action, parameters)

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """Yield the commands of the palette: every key of this page and of all pages."""
        listed = set()
        for node, binding, enabled, _ in screen.active_bindings.values():
            if not binding.description or not enabled or binding.description in listed:
                continue
            listed.add(binding.description)
            yield SystemCommand(
                binding.description,
                f"key {binding.key}",
                partial(self.call_later, self.run_action, binding.action, node),
            )

    # Settings.

    def change(self, **values: Any) -> None:
        """Change settings, store them, and draw the page again."""
        self.settings = dataclasses.replace(self.settings, **values)
        self.theme = self.screen_theme.theme.name
        if not self._save(self.settings):
            self.show_message("the settings could not be saved; they hold until you leave")
        self.redraw()

    def redraw(self) -> None:
        """Draw the page on top now, also if no value on it has changed."""
        self._drawn_for = ()
        if isinstance(self.screen, Page):
            self.screen.draw()

    def action_theme(self) -> None:
        """Switch between the dark and the daylight theme."""
        self.change(theme="daylight" if self.settings.theme == "dark" else "dark")

    def action_large(self) -> None:
        """Switch between normal and large type."""
        self.change(large=not self.settings.large)

    def action_units(self) -> None:
        """Switch between SI and US customary units."""
        self.change(units="us" if self.settings.units == "si" else "si")

    def action_ring(self) -> None:
        """Switch the bell on or off."""
        self.change(bell=not self.settings.bell)
        self.show_message("bell on" if self.settings.bell else "bell off")

    # A replay.

    def action_pause(self) -> None:
        """Pause a replay, or continue it."""
        if (pace := self.source.pace) is not None:
            if pace.paused:
                pace.go_on()
            else:
                pace.pause()
            self.redraw()

    def action_step(self) -> None:
        """Replay one more drop."""
        if (pace := self.source.pace) is not None:
            if not pace.paused:
                pace.pause()
            pace.step()
            self.redraw()

    def action_speed(self, step: int) -> None:
        """Change the speed of a replay by steps of `REPLAY_SPEEDS`."""
        if self.source.pace is not None:
            change_speed(self.source.pace, step)
            self.redraw()

    # Leaving.

    def action_leave(self) -> None:
        """Leave the program; ask first if drops or typed settings would be lost."""
        if self._leaving:  # pressed again: leave at once, acknowledged drops are safe
            self._finish()
            return
        if self._asking:
            return
        question = str(getattr(self.screen, "unsaved", "") or "")
        if self.state.n_unsaved:
            count = self.state.n_unsaved
            question = f"{count} drop(s) are only in memory and would be lost. Leave?"
        if not question:
            self._end_by_signal()
            return

        def answered(sure: bool | None) -> None:
            self._asking = False
            if sure:
                self._end_by_signal()

        self._asking = True
        self.push_screen(Question(question, "leave", "stay"), answered)

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
        self.diagnoses.close()
        self.fits.close()
        self.slips.close()
        for event in self.runner.take():
            self.state.take(event)
        self.exit(self.state.exit_status)

    def restart(self, plan: SessionPlan, url: str) -> None:
        """Start a new session with another plan, once the current drop is stored."""
        self.show_message("the session starts again with this setup")
        self.run_worker(self._restart(plan, url), exclusive=True, group="restart")

    async def _restart(self, plan: SessionPlan, url: str) -> None:
        loop = asyncio.get_running_loop()
        if not await loop.run_in_executor(None, lambda: self.runner.stop(LEAVE_TIMEOUT_S)):
            self.show_message("the session has not ended yet; the setup was not changed")
            return
        self.source.plan = plan
        if url:
            self.source.url = url
        request = JobRequest(procedure=plan.setup.procedure).over(plan.job)
        self.runner.report(JobReported(self.state.job.with_request(request.news(self.state.job))))
        self.runner.start()
        self.redraw()
