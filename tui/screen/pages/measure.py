"""The measure page, open all day."""

import time
from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.judging.stations import next_name
from tui.screen.drawing.lines import Line
from tui.screen.pages.dialogs import TextDialog
from tui.screen.pages.measure_view import PANELS, TALL, WIDE, MeasureView, measure_lines
from tui.screen.pages.page import Page
from tui.screen.session.drop_state import DropState
from tui.screen.session.stations import next_station, point_name_error, point_name_question
from tui.screen.widgets.lines_view import LinesView

MIN_VIEW_S = 0.7
"""s; a person does not see a new drop and press a key sooner, so the key was meant for another."""


class MeasurePage(Page):
    """What happens now, what to do next, the last drop, the point."""

    NAME = "measure"
    HELP = (
        "The word at the top says what is going on, beside it what to do next. Below stand the "
        "streaming load and velocity, the last drop with its fit, and the drops of this point. "
        "A drop is shown when it is safe on the disk. Its first modulus comes at once by least "
        "squares and is refined by the full search. Discarding only marks a drop: u takes it back."
    )
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("n", "next point"),
        ("d", "discard"),
        ("u", "undo"),
        ("enter", "open"),
        ("?", "help"),
        ("2", "points"),
        ("q", "leave"),
        ("r", "refit"),
        ("tab", "trace"),
        ("up/down", "choose"),
        ("5", "setup"),
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
        Binding("r", "refit", "Fit the drop with other settings"),
        Binding("g", "record_now", "Record a drop now"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.chosen: int | None = None
        self.panel = ""
        self._shown: DropState | None = None
        """The drop that is on the terminal."""
        self._asked_for: DropState | None = None
        """A drop that had just landed when `d` was pressed."""

    @property
    def drop(self) -> DropState | None:
        """The drop that is looked at."""
        state = self.pfwd.state
        if self.chosen is None:
            return state.last
        return state.current_drops.get(self.chosen)

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """The page."""
        app = self.pfwd
        if self.chosen is not None and self.chosen not in app.state.current_drops:
            self.chosen = None
        keys = list(self.KEYS)
        if app.source.pace is not None:  # a recording has its points and its drops
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
        self._shown = self.drop
        return measure_lines(view, width, height)

    def action_choose(self, step: int) -> None:
        """Another drop of this point."""
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
        """Look at what comes."""
        self.chosen = None
        self.draw()

    def action_panel(self) -> None:
        """The next trace of a small terminal; also leaves the full page as it is."""
        size = self.view.size
        if size.width >= WIDE and size.height >= TALL:
            return
        now = PANELS.index(self.panel) if self.panel else PANELS.index("deflection")
        self.panel = PANELS[(now + 1) % len(PANELS)]
        self.draw()

    def action_discard(self) -> None:
        """Mark the drop that is on the terminal as not to be used.

        One that has just landed was not seen yet by who pressed the key: it is asked for again.
        """
        drop, self._asked_for = self._shown, self._asked_for
        fresh = drop is not None and drop.saved_at > 0
        if (
            drop is not None
            and fresh
            and self.chosen is None
            and time.monotonic() - drop.saved_at < MIN_VIEW_S
            and self._asked_for is not drop
        ):
            self._asked_for = drop
            self.pfwd.show_message(f"drop {drop.number} has just landed: d again discards it")
            return
        self._asked_for = None
        self.pfwd.edits.discard(drop)

    def action_open(self) -> None:
        """Everything about the drop."""
        self.pfwd.open_drop(self.drop)

    def action_refit(self) -> None:
        """With other settings."""
        self.pfwd.open_drop(self.drop, refit=True)

    def action_record_now(self) -> None:
        """Record a drop whatever the load does."""
        if self.pfwd.source.pace is not None or not self.pfwd.runner.trigger():
            self.pfwd.show_message("there is no instrument that could be recorded")

    def action_next_point(self) -> None:
        """Ask for the name of the next point."""
        if not self.pfwd.source.writes or self.pfwd.source.pace is not None:
            self.pfwd.show_message("a replay has its own points")
            return
        state = self.pfwd.state
        known = {point.shown_name for point in state.points.values()}
        station = next_station(state.job, known, self.pfwd.coordinates())
        proposed = next_name(state.current.shown_name, known, state.job.step_m)
        if station is not None:
            proposed = station.station.name
        dialog = TextDialog(
            "Next point",
            proposed,
            check=point_name_error,
            question=lambda name: (
                "" if name == proposed else point_name_question(name, state.names_in_use())
            ),
            hint="enter begins it, escape goes back",
        )
        self.app.push_screen(dialog, self._begin_point)

    def _begin_point(self, name: str | None) -> None:
        if name is None:
            return
        if not self.pfwd.runner.request(lambda session: session.set_point(name)):
            self.pfwd.show_message("no session runs; the point was not begun")

    def on_lines_view_clicked(self, event: LinesView.Clicked) -> None:
        """A click on a drop chooses it."""
        row = self.view.text.split("\n")[event.row] if event.row >= 0 else ""
        first = row.replace("▶", " ").split()
        if first and first[0].isdigit() and int(first[0]) in self.pfwd.state.current_drops:
            self.chosen = int(first[0])
            self.draw()
