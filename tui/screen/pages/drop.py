"""Drop page: everything about one drop, and fits with other settings."""

from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.analysis.options import AnalysisOptions
from tui.screen.drawing.drop_figures import curves_of, default_span
from tui.screen.drawing.lines import Line
from tui.screen.pages.dialogs import RefitDialog
from tui.screen.pages.drop_view import FIGURE_NAMES, DropPageState, drop_lines
from tui.screen.pages.page import Page
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import Refit

ZOOM_FACTOR = 1.6
MIN_SPAN_S = 5e-4
CURSOR_STEPS = 100
"""Number of steps of the cursor across the plot."""


class DropPage(Page):
    """Page with the traces, the fit and all results of one drop."""

    NAME = "drop"
    HELP = (
        "Everything about one drop. Left and right move a cursor; its values are shown below the "
        "plots, z and x zoom around it. r fits the drop with other settings: the result in force "
        "stays, the trial fit is stored with it, m switches between them. v looks for the causes "
        "of the residual of this drop."
    )
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("left/right", "cursor"),
        ("z/x", "zoom"),
        ("tab", "plot"),
        ("up/down", "drop"),
        ("escape", "back"),
        ("?", "help"),
        ("r", "refit"),
        ("m", "result"),
        ("v", "causes"),
        ("s", "sensor"),
        ("d", "discard"),
        ("u", "undo"),
        ("a", "all"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "cursor(-1)", "Cursor to the left"),
        Binding("right", "cursor(1)", "Cursor to the right"),
        Binding("shift+left", "cursor(-10)", "Cursor far to the left"),
        Binding("shift+right", "cursor(10)", "Cursor far to the right"),
        Binding("z", "zoom(1)", "Zoom in"),
        Binding("x", "zoom(-1)", "Zoom out"),
        Binding("a", "all", "Whole record"),
        Binding("tab", "panel", "Next plot", priority=True),
        Binding("up", "neighbour(-1)", "Drop before"),
        Binding("down", "neighbour(1)", "Drop after"),
        Binding("s", "sensor", "Next sensor"),
        Binding("r", "refit", "Fit with other settings"),
        Binding("m", "result", "Next result"),
        Binding("v", "effects", "Causes of the residual"),
        Binding("d", "discard", "Discard or restore"),
        Binding("pageup", "text(-5)", "Text up"),
        Binding("pagedown", "text(5)", "Text down"),
        Binding("escape", "back", "Back"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.span: tuple[float, float] | None = None
        self.cursor: float | None = None
        """Time at the cursor, s; None: there is no cursor."""
        self.panel = ""
        self.sensor = 0
        self.result_index = 0
        """Result on the page: 0 the one in force, then the trial fits."""
        self.first = 0
        """First line of the text on the page."""
        self._requested: set[tuple[str, int]] = set()

    @property
    def drop(self) -> ScreenDrop | None:
        """Drop on the page."""
        state = self.pfwd.state
        if self.pfwd.selected_drop is None:
            return state.last
        point, number = self.pfwd.selected_drop
        return state.drop(point, number)

    @property
    def refit(self) -> Refit | None:
        """Trial fit on the page; None: the result in force."""
        drop = self.drop
        if drop is None or not 0 < self.result_index <= len(drop.memory.refits):
            return None
        return drop.memory.refits[self.result_index - 1]

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the page."""
        app, drop = self.pfwd, self.drop
        if drop is not None:
            self._fetch(drop)
        view = DropPageState(
            drop,
            app.state,
            app.units,
            app.glyphs,
            app.message,
            self.KEYS,
            self.refit,
            self.span,
            self.cursor,
            self.panel,
            self.sensor,
            self.first,
            app.busy_text(),
        )
        return drop_lines(view, width, height)

    def _fetch(self, drop: ScreenDrop) -> None:
        """Request traces and curves that are not in memory, once."""
        key = drop.point, drop.number
        if key in self._requested or (drop.memory.curves is not None and drop.saved is not None):
            return
        if drop.awaits_modulus or (drop.saved is not None and drop.status == "rejected"):
            return
        if drop.saved is not None and drop.is_refined:
            return  # its result is still to come
        self._requested.add(key)
        if drop.saved is None:
            self._requested.discard(key)
        self.pfwd.fits.fetch(drop)

    def _window(self) -> tuple[float, float]:
        drop = self.drop
        if self.span is not None:
            return self.span
        if drop is None:
            return 0.0, 1.0
        curves, _ = curves_of(drop, self.refit)
        if curves is not None:
            return default_span(curves)
        if drop.saved is not None and drop.saved.drop.time.size:
            return max(float(drop.saved.drop.time[0]), -5e-3), float(drop.saved.drop.time[-1])
        return 0.0, 1.0

    def action_cursor(self, step: int) -> None:
        """Move the cursor along the time axis by hundredths of the window."""
        start, end = self._window()
        now = self.cursor if self.cursor is not None else start + 0.3 * (end - start)
        self.cursor = min(max(now + step * (end - start) / CURSOR_STEPS, start), end)
        self.draw()

    def action_zoom(self, direction: int) -> None:
        """Zoom in or out around the cursor."""
        start, end = self._window()
        centre = self.cursor if self.cursor is not None else (start + end) / 2
        factor = 1 / ZOOM_FACTOR if direction > 0 else ZOOM_FACTOR
        before, after = (centre - start) * factor, (end - centre) * factor
        if before + after < MIN_SPAN_S:
            return
        low, high = self._full_span()
        self.span = max(low, centre - before), min(high, centre + after)
        self.draw()

    def _full_span(self) -> tuple[float, float]:
        drop = self.drop
        if drop is None or drop.saved is None or not drop.saved.drop.time.size:
            return self._window()
        return float(drop.saved.drop.time[0]), float(drop.saved.drop.time[-1])

    def action_all(self) -> None:
        """Show the whole record."""
        self.span = self._full_span()
        self.draw()

    def action_panel(self) -> None:
        """Show the next plot by itself; after the last one all plots."""
        names = ("", *FIGURE_NAMES)
        self.panel = names[(names.index(self.panel) + 1) % len(names)]
        self.draw()

    def action_sensor(self) -> None:
        """Show deflection and residual of the next sensor."""
        drop = self.drop
        count = len(drop.saved.drop.channels) if drop is not None and drop.saved is not None else 1
        self.sensor = (self.sensor + 1) % max(1, count)
        self.draw()

    def action_neighbour(self, step: int) -> None:
        """Go to another drop of the point."""
        drop = self.drop
        if drop is None:
            return
        numbers = sorted(self.pfwd.state.drops_of(drop.owner))
        place = numbers.index(drop.number) + step
        if 0 <= place < len(numbers):
            self.pfwd.selected_drop = drop.point, numbers[place]
            self.result_index, self.first, self.span = 0, 0, None
        self.draw()

    def action_result(self) -> None:
        """Show the next result: the one in force, then each fit with other settings."""
        drop = self.drop
        self.result_index = (
            (self.result_index + 1) % (len(drop.memory.refits) + 1) if drop is not None else 0
        )
        refit = self.refit
        if refit is not None and refit.curves is None:
            self.pfwd.show_message("the curves of this fit are not stored; r fits again")
        self.draw()

    def action_text(self, rows: int) -> None:
        """Scroll the text beside or below the plots by this number of rows."""
        self.first = max(0, self.first + rows)
        self.draw()

    def action_discard(self) -> None:
        """Discard the drop, or restore it."""
        self.pfwd.edits.discard(self.drop)

    def action_effects(self) -> None:
        """Start the diagnosis of this drop in a process of its own."""
        drop = self.drop
        if drop is None or drop.saved is None or not drop.saved.file:
            self.pfwd.show_message("there is no file of this drop yet")
            return
        self.pfwd.diagnoses.start(drop.saved.file)

    def action_refit(self) -> None:
        """Open the dialog for the settings of a trial fit."""
        drop = self.drop
        if drop is None or drop.saved is None:
            self.pfwd.show_message("the drop is being read; try again in a moment")
            return
        if drop.saved.screening.status == "rejected":
            self.pfwd.show_message("a rejected drop cannot be fitted")
            return
        self.app.push_screen(RefitDialog(), self._refit)

    def _refit(self, options: AnalysisOptions | None) -> None:
        drop = self.drop
        if options is None or drop is None or drop.saved is None:
            return
        self.pfwd.fits.refit(drop.saved, options, options.label)

    def action_back(self) -> None:
        """Go back to the measure page."""
        self.pfwd.action_page("measure")
