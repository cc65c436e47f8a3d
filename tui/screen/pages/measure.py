"""Measure page."""

import time
from collections.abc import Mapping, Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.judging.stations import next_name
from pfwd.procedures.point import UNSUPPORTED_MARK
from tui.screen.drawing.lines import Line
from tui.screen.lines_view import LinesView
from tui.screen.pages.dialogs import TextDialog
from tui.screen.pages.measure_view import (
    FULL_HEIGHT,
    FULL_WIDTH,
    MEASURE_PLOTS,
    MeasureView,
    measure_lines,
)
from tui.screen.pages.page import Page
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.stations import next_station, point_name_error, point_name_question
from tui.screen.session.status import WORDS

MIN_VIEW_S = 0.7
"""Time that an operator needs to see a new drop and press a key, s. A key pressed earlier was meant
for the drop before."""


class MeasurePage(Page):
    """Page of the running measurement: status, instruction, last drop, point."""

    NAME = "measure"
    HELP = (
        "The word at the top is the status of the measurement, from READY (lift the weight) to "
        "POINT DONE; the text after it says what to do next. Below are the live load and velocity, "
        "the last drop with its fit, and the drops of this point. A drop appears when it is safe "
        "on the disk. Its modulus comes at once from a quick fit and is then refined. Discarding "
        "only marks a drop: u takes it back."
    )
    WORDS: ClassVar[Mapping[str, str]] = {
        **WORDS,
        UNSUPPORTED_MARK: "after a number: the data do not support it, and it decides no verdict",
    }
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("n", "next point"),
        ("d", "discard"),
        ("u", "undo"),
        ("enter", "open"),
        ("?", "help"),
        ("2", "points"),
        ("q", "leave"),
        ("s", "slip"),
        ("r", "refit"),
        ("tab", "trace"),
        ("5", "setup"),
        ("up/down", "choose"),
        ("g", "record now"),
        ("l", "large"),
        ("t", "theme"),
    )
    REPLAY_KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("space", "pause"),
        (".", "step"),
        ("+/-", "speed"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "choose(-1)", "Choose the drop before"),
        Binding("down", "choose(1)", "Choose the drop after"),
        Binding("escape", "newest", "Look at the newest drop"),
        Binding("tab", "panel", "Next trace", priority=True),
        Binding("n", "next_point", "Next point"),
        Binding("d", "discard", "Discard the drop"),
        Binding("enter", "open", "Open the drop"),
        Binding("s", "slip", "Slip of the point: one page to sign"),
        Binding("r", "refit", "Fit the drop with other settings"),
        Binding("g", "record_now", "Record a drop now"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.chosen: int | None = None
        self.panel = ""
        self._drop_on_screen: ScreenDrop | None = None
        """Drop on the terminal."""
        self._discard_candidate: tuple[str, int] | None = None
        """Point and number of a drop that had just come when `d` was pressed."""

    @property
    def drop(self) -> ScreenDrop | None:
        """Drop whose traces and result are on the page: the chosen one, else the newest."""
        state = self.pfwd.state
        if self.chosen is None:
            return state.last
        return state.current_drops.get(self.chosen)

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the page."""
        app = self.pfwd
        if self.chosen is not None and self.chosen not in app.state.current_drops:
            self.chosen = None
        keys = list(self.KEYS)
        if app.source.pace is not None:  # points and drops of a recording are fixed
            keys = [*self.REPLAY_KEYS, *(key for key in keys if key[0] not in ("n", "g"))]
        view = MeasureView(
            app.state,
            app.word(),
            app.units,
            app.glyphs,
            app.runner.trace.envelope(),
            app.clock(),
            app.source.title,
            keys,
            self.chosen,
            self.panel,
            app.settings.large,
            app.pace_text(),
            app.message,
            app.diagnoses.verdicts.get(app.state.point, ""),
            app.position(),
            app.coordinates(),
        )
        self._drop_on_screen = self.drop
        return measure_lines(view, width, height)

    def action_choose(self, step: int) -> None:
        """Choose the drop before (-1) or after (1) the one on the page."""
        state = self.pfwd.state
        numbers = sorted(state.current_drops)
        if not numbers:
            return
        last = self.pfwd.state.last
        now = self.chosen if self.chosen is not None else last.number if last else numbers[-1]
        place = numbers.index(now) if now in numbers else len(numbers) - 1
        if self.chosen is None and step > 0:
            return
        self.chosen = numbers[min(max(place + step, 0), len(numbers) - 1)]
        self.draw()

    def action_newest(self) -> None:
        """Show the newest drop again, also when further drops come."""
        self.chosen = None
        self.draw()

    def action_panel(self) -> None:
        """Show the next plot on a small terminal; the full page has all of them."""
        size = self.view.size
        if size.width >= FULL_WIDTH and size.height >= FULL_HEIGHT:
            return
        now = MEASURE_PLOTS.index(self.panel) if self.panel else MEASURE_PLOTS.index("deflection")
        self.panel = MEASURE_PLOTS[(now + 1) % len(MEASURE_PLOTS)]
        self.draw()

    def action_discard(self) -> None:
        """Discard the drop on the terminal, or restore it.

        A drop that has just come was not seen yet when the key was pressed: `d` is needed again.
        """
        drop = self._drop_on_screen
        if (
            drop is not None
            and self.chosen is None
            and time.monotonic() - self.pfwd.state.saved_at < MIN_VIEW_S
            and self._discard_candidate != (drop.point, drop.number)
        ):
            self._discard_candidate = drop.point, drop.number
            self.pfwd.show_message(f"drop {drop.number} has just come: d again discards it")
            return
        self._discard_candidate = None
        self.pfwd.edits.discard(drop)

    def action_open(self) -> None:
        """Open the page of the drop."""
        self.pfwd.open_drop(self.drop)

    def action_refit(self) -> None:
        """Open the page of the drop and the dialog for a trial fit."""
        self.pfwd.open_drop(self.drop, refit=True)

    def action_slip(self) -> None:
        """Ask for the signature of the slip of this point, then write it."""
        self.pfwd.ask_for_slip(self.pfwd.state.current)

    def action_record_now(self) -> None:
        """Record a drop now, without a trigger by the load."""
        if self.pfwd.source.pace is not None or not self.pfwd.runner.trigger():
            self.pfwd.show_message("there is no instrument to record")

    def action_next_point(self) -> None:
        """Open the dialog for the name of the next point."""
        if not self.pfwd.source.writes or self.pfwd.source.pace is not None:
            self.pfwd.show_message("a replay has its own points")
            return
        state = self.pfwd.state
        names = {point.shown_name for point in state.points.values()}
        station = next_station(state.job, names, self.pfwd.coordinates())
        proposed = next_name(state.current.shown_name, names, state.job.step_m)
        if station is not None:
            proposed = station.station.name
        dialog = TextDialog(
            "Next point",
            proposed,
            check=point_name_error,
            question=lambda name: (
                "" if name == proposed else point_name_question(name, state.names_in_use())
            ),
            hint="enter begins the point, escape goes back",
        )
        self.app.push_screen(dialog, self._begin_point)

    def _begin_point(self, name: str | None) -> None:
        if name is None:
            return
        if not self.pfwd.runner.request(lambda session: session.set_point(name)):
            self.pfwd.show_message("no session runs; the point was not started")

    def on_lines_view_clicked(self, event: LinesView.Clicked) -> None:
        """Choose the drop that was clicked."""
        row = self.view.text.split("\n")[event.row] if event.row >= 0 else ""
        first = row.replace("▶", " ").split()
        if first and first[0].isdigit() and int(first[0]) in self.pfwd.state.current_drops:
            self.chosen = int(first[0])
            self.draw()
