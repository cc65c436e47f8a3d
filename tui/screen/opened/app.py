"""Application of ``pfwd open``: points, profile, map, drops, comparison and job of a survey."""

import contextlib
import shlex
from collections.abc import Sequence
from typing import Any, ClassVar

from textual import events, on
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.content import Content
from textual.filter import LineFilter
from textual.timer import Timer
from textual.widgets import DataTable, Input, Label, TabbedContent, TabPane
from textual.widgets._tabs import Underline

from pfwd.digits import significant
from pfwd.errors import DeviceError, SurveyError
from pfwd.message_groups import text_of
from pfwd.units import SI
from tui.output import clean, counted, say
from tui.screen.command_process import run_command
from tui.screen.drawing.glyphs import Glyphs, glyphs_of_terminal
from tui.screen.drawing.lines import Line, cell, line, wrap
from tui.screen.drawing.plot import stacked_plots
from tui.screen.lines_view import GlyphFilter, LinesView
from tui.screen.opened.plots import STATE_ROLES, map_lines, overlay_figures, profile_lines
from tui.screen.opened.rows import (
    ORDERS,
    OpenedSurvey,
    PointRow,
    display_value,
    in_order,
    judged_cells,
    matching,
    pages,
    shares,
)
from tui.screen.opened.widgets import KeysLine, PlainTable
from tui.screen.pages.dialogs import TextDialog
from tui.screen.settings import ScreenSettings
from tui.screen.themes import THEMES

TABLE_PAGE_ROWS = 48
"""Rows of a page of the table: more than a terminal shows, and filled within 50 ms."""

MAX_PROFILE_POINTS, MIN_PROFILE_POINTS = 100_000, 8
"""Largest and smallest number of points in the profile."""

_TABLE_COLUMNS = {
    "title": "point",
    "drops": "drops",
    "value": "judged",
    "interval": "95 %",
    "target": "target",
    "verdict": "verdict",
    "modulus": "E MPa",
    "chainage_m": "chainage",
    "use": "diagnosed",
    "unexplained": "unexplained",
    "notes": "notes",
}
"""Titles of the table of points by their keys; a click on a title sorts by its key where rows have
such an order."""

MIN_WIDTH_BESIDE, MIN_HEIGHT_BELOW = 150, 36
"""Smallest terminal with the chosen point beside the table, columns, and below it, rows."""

MAX_TABLE_SHARE = 0.66
"""Largest share of the width that the table takes beside the chosen point."""

MIN_POINT_ROWS = 16
"""Rows that the chosen point has below the table at least."""

POINT_DELAY_S = 0.12
"""Time that the cursor rests on a row before the traces of its point are read, s."""


class Plot(LinesView):
    """Widget for plots that `OpenApp` draws again when its size changes."""

    def __init__(self, name: str) -> None:
        super().__init__(id=name)

    def on_resize(self, _event: events.Resize) -> None:
        """Have the plots of the tab on the screen drawn for the new size."""
        app = self.app
        if isinstance(app, OpenApp):
            app.draw_plots()


class OpenApp(App[int]):
    """Textual application of ``pfwd open``: tabs with the points of a recorded survey.

    Parameters
    ----------
    survey : OpenedSurvey
    settings : ScreenSettings, optional
    glyphs : Glyphs, optional
        By default those of the terminal.
    """

    TITLE = "PFWD"
    CSS = """
    Screen { background: $background; color: $foreground; }
    #head, #said { height: 1; width: 100%; padding: 0 1; }
    #filter { display: none; border: none; height: 1; background: $surface; }
    #filter.shown { display: block; }
    TabbedContent { height: 1fr; }
    TabPane { padding: 0; }
    #drops-table { height: 40%; }
    #points-split.beside { layout: horizontal; }
    #points-split.beside #points-plot { border-left: solid $foreground 40%; }
    #points-split.below #points-plot { border-top: solid $foreground 40%; }
    #points-plot { display: none; }
    .beside #points-plot, .below #points-plot { display: block; }
    #compare-table { height: 8; }
    TextDialog { align: center middle; background: $background 60%; }
    .dialog { width: 64; max-width: 96%; height: auto; padding: 1 2; border: heavy $foreground;
              background: $surface; }
    .dialog Label { width: 100%; height: auto; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("slash", "filter", "Find"),
        Binding("s", "sort", "Sort"),
        Binding("enter", "open", "Drops", show=True, priority=False),
        Binding("p", "tab('profile')", "Profile"),
        Binding("m", "tab('map')", "Map"),
        Binding("c", "compare", "Compare"),
        Binding("j", "tab('job')", "Job"),
        Binding("n", "page(1)", "Next page", show=False),
        Binding("b", "page(-1)", "Page before", show=False),
        Binding("plus,equals_sign", "zoom(0.5)", "Zoom in", show=False),
        Binding("minus", "zoom(2.0)", "Zoom out", show=False),
        Binding("left", "step(-1)", "Point before", show=False),
        Binding("right", "step(1)", "Point after", show=False),
        Binding("r", "report", "Report"),
        Binding("x", "export", "Export"),
        Binding("escape,1", "to_points", "Points", show=False),
        Binding("q", "leave", "Leave"),
        Binding("ctrl+q,ctrl+c", "leave", "Leave", show=False),
    ]

    def __init__(
        self,
        survey: OpenedSurvey,
        settings: ScreenSettings | None = None,
        glyphs: Glyphs | None = None,
    ) -> None:
        super().__init__()
        self.opened = survey
        self.settings = settings or ScreenSettings()
        self.glyphs = glyphs or glyphs_of_terminal()
        self._glyph_filter = GlyphFilter(self.glyphs)
        self.order, self.falling = ORDERS[0], False
        self.filter_text = ""
        self.page = 0
        self.chosen = ""
        """Name of the chosen point."""
        self.marked: list[str] = []
        """Names of the points to compare, at most two."""
        self.window = MAX_PROFILE_POINTS
        """Number of points in the profile."""
        self.visible_rows: list[PointRow] = []
        """Rows that match the filter, in order."""
        self.ready = False
        """True once everything is read and judged."""
        self._places: dict[str, int] = {}
        self._overlays: dict[str, tuple[Sequence[Any], Sequence[str]]] = {}
        """Curves and faults of the plots of drops, by plot, to be drawn again for another size."""
        self._point_drawn = ""
        """Name of the point whose traces are drawn beside the table; empty: none."""
        self._point_timer: Timer | None = None
        self._counts = ""
        """Number of points in each state, in words; empty: to be counted."""
        self.animation_level = "none"  # a tab is shown at once
        for theme in THEMES.values():
            self.register_theme(theme.theme)

    def get_line_filters(self) -> list[LineFilter]:
        """Return the filters of the toolkit, and the one for characters that the terminal lacks."""
        glyph_filters = [self._glyph_filter] if self._glyph_filter.enabled else []
        return [*super().get_line_filters(), *glyph_filters]

    def compose(self) -> ComposeResult:
        """Yield the head, the filter, the tabs, the message and the keys."""
        yield Label("", id="head", markup=False)
        # Disabled until it is shown: else a key typed while the page begins goes into it.
        hint = "name, note, pass, fail, undecided, <40, >60"
        yield Input(placeholder=hint, id="filter", disabled=True)
        with TabbedContent(id="tabs"):
            with TabPane("Points", id="points"), Container(id="points-split"):
                yield PlainTable(id="points-table", cursor_type="row", zebra_stripes=True)
                yield Plot("points-plot")
            with TabPane("Profile", id="profile"):
                yield Plot("profile-plot")
            with TabPane("Map", id="map"):
                yield Plot("map-plot")
            with TabPane("Drops", id="drops"):
                yield PlainTable(id="drops-table", cursor_type="row")
                yield Plot("drops-plot")
            with TabPane("Compare", id="compare"):
                yield PlainTable(id="compare-table", cursor_type="none")
                yield Plot("compare-plot")
            with TabPane("Job", id="job"):
                yield LinesView(id="job-lines")
        yield Label("", id="said", markup=False)
        yield KeysLine()

    def on_mount(self) -> None:
        """Show the empty table first, then read the survey."""
        self.theme = THEMES[self.settings.theme].theme.name
        table = self.query_one("#points-table", PlainTable)
        self._name_columns(table)
        drops = self.query_one("#drops-table", PlainTable)
        drops.add_columns(
            "drop", "counts as", "load kN", "deflection mm", "E MPa", "residual", "why"
        )
        compare = self.query_one("#compare-table", PlainTable)
        compare.add_columns("", "first", "second")
        table.focus()
        self._head("reading ...")
        self.call_after_refresh(self._begin)

    def _begin(self) -> None:
        self.run_worker(self._read, thread=True, group="read", exit_on_error=False)

    def _read(self) -> None:
        try:
            if self.opened.from_cache() is not None:
                self._call(self._show_rows)
                cached = list(self.opened.rows)
                self.opened.read()
                self.opened.rows = cached
            else:
                self.opened.read()
                self._call(self._show_rows)
                self.opened.judge(lambda rows: self._call(self._update, rows))
        except (SurveyError, DeviceError, OSError) as err:
            self._call(self.show_message, str(err))
            return
        self._call(self._show_all)

    def _call(self, function: Any, *values: Any) -> None:
        """Call a function in the thread of the application, from a thread that reads files."""
        with contextlib.suppress(RuntimeError):  # the application has ended
            self.call_from_thread(function, *values)

    def _show_all(self) -> None:
        from tui.job_lines import job_lines

        self.ready = True
        self._counts = ""
        self._show_rows()
        lines = [line(cell(f" {clean(text)}")) for text in job_lines(self.opened.job)]
        self._show(self.query_one("#job-lines", LinesView), lines)
        remarks = self.opened.remarks
        if remarks:
            more = f" ({len(remarks)} remarks; all are listed when you leave)"
            self.show_message(remarks[0] + (more if len(remarks) > 1 else ""))

    # The table of points.

    def _show_rows(self) -> None:
        """Fill the table of points with a page of the rows that match the filter, sorted."""
        self.visible_rows = in_order(
            matching(self.opened.rows, self.filter_text), self.order, falling=self.falling
        )
        self.page = min(self.page, pages(len(self.visible_rows), TABLE_PAGE_ROWS) - 1)
        table = self.query_one("#points-table", PlainTable)
        part = self.visible_rows[self.page * TABLE_PAGE_ROWS : (self.page + 1) * TABLE_PAGE_ROWS]
        self._name_columns(table)
        table.fill([(row.name, self._shown_cells(row, table)) for row in part])
        self._places = {row.name: place for place, row in enumerate(part)}
        if self.chosen in self._places:
            table.move_cursor(row=self._places[self.chosen], animate=False)
        elif part:
            self.chosen = part[0].name
        self._size_table()
        self._head()
        self.draw_plots()
        self._request_point()

    def _name_columns(self, table: PlainTable) -> None:
        """Give the table the columns that its rows need, with their titles."""
        titles = table_titles(self.opened.rows)
        shown = {str(column.key.value): column.label.plain for column in table.ordered_columns}
        if shown != titles:
            table.clear(columns=True)
            table.add_columns(*((title, key) for key, title in titles.items()))

    def _shown_cells(self, row: PointRow, table: PlainTable) -> list[str]:
        cells = _cells(row)
        return [cells[str(column.key.value)] for column in table.ordered_columns]

    def _update(self, rows: Sequence[PointRow]) -> None:
        """Replace rows of the table of points by rows that have been judged since."""
        self._counts = ""
        if self.filter_text or self.order != ORDERS[0]:
            self._show_rows()
            return
        table = self.query_one("#points-table", PlainTable)
        judged = {row.name: row for row in rows}
        self.visible_rows = [judged.get(row.name, row) for row in self.visible_rows]
        for row in rows:
            if row.name in self._places:
                table.change(row.name, self._shown_cells(row, table))
        self._head()
        self.draw_plots()

    def on_resize(self, event: events.Resize) -> None:
        """Show the chosen point beside the table, below it, or not at all, as there is room."""
        split = self.query_one("#points-split", Container)
        is_wide = event.size.width >= MIN_WIDTH_BESIDE
        split.set_class(is_wide, "beside")
        split.set_class(not is_wide and event.size.height >= MIN_HEIGHT_BELOW, "below")
        self._size_table()
        self.call_after_refresh(self._request_point)

    def _size_table(self) -> None:
        """Set the size of the table of points: no more than its rows and columns need."""
        split = self.query_one("#points-split", Container)
        table = self.query_one("#points-table", PlainTable)
        table.styles.width, table.styles.height = "1fr", "1fr"
        if split.has_class("beside"):
            needed = table.needed_width
            table.styles.width = min(needed, int(MAX_TABLE_SHARE * self.size.width))
        elif split.has_class("below"):
            room = self.size.height - MIN_POINT_ROWS - 6
            table.styles.height = min(table.row_count + 2, room)

    def _request_point(self) -> None:
        """Read the traces of the chosen point once the cursor rests on it."""
        if self._point_timer is not None:
            self._point_timer.stop()
            self._point_timer = None
        # The call may come late, when the application ends and has no plots any more.
        is_shown = any(plot.display for plot in self.query("#points-plot"))
        if is_shown and self.chosen != self._point_drawn and self.opened.survey is not None:
            self._point_timer = self.set_timer(POINT_DELAY_S, self._read_point)

    def _read_point(self) -> None:
        name = self.chosen

        def draw() -> None:
            point = self.opened.view(name)
            drops = [] if point is None else point.drops
            traces = overlay_figures([(str(drop.number), drop.source) for drop in drops])
            self._call(self._show_point, name, *traces)

        self.run_worker(draw, thread=True, group="point", exclusive=True, exit_on_error=False)

    def _show_point(self, name: str, figures: Sequence[Any], faults: Sequence[str]) -> None:
        self._point_drawn = name
        self._overlays["#points-plot"] = figures, faults
        self.draw_plots()

    def _head(self, message: str = "") -> None:
        rows = self.opened.rows
        if not self._counts:
            self._counts = ", ".join(f"{count} {state}" for state, count in shares(rows))
        counts = self._counts
        sheet = pages(len(self.visible_rows), TABLE_PAGE_ROWS)
        parts = [self.opened.folder.name or ".", counted(len(rows), "point"), counts]
        if len(self.visible_rows) != len(rows):
            parts.append(f"{len(self.visible_rows)} by the filter")
        if sheet > 1:
            parts.append(f"page {self.page + 1} of {sheet} (n, b)")
        if self.order != ORDERS[0]:
            parts.append(f"by {self.order.removesuffix('_m')}{' falling' if self.falling else ''}")
        text = message or " · ".join(part for part in parts if part)
        self.query_one("#head", Label).update(Content(clean(text)), layout=False)

    def show_message(self, text: str) -> None:
        """Show a line of text above the keys, until the next one."""
        self.query_one("#said", Label).update(Content(clean(text)), layout=False)

    @on(DataTable.RowHighlighted, "#points-table")
    def _on_row(self, event: DataTable.RowHighlighted) -> None:
        if event.row_key is not None and event.row_key.value is not None:
            self.chosen = event.row_key.value
            self.draw_plots()
            self._request_point()

    @on(DataTable.RowSelected, "#points-table")
    def _on_selected(self, event: DataTable.RowSelected) -> None:
        self.action_open()

    @on(DataTable.HeaderSelected, "#points-table")
    def _on_header(self, event: DataTable.HeaderSelected) -> None:
        key = str(event.column_key.value)
        if key in ORDERS:
            self._sort(key)

    def _sort(self, by: str) -> None:
        self.falling = by == self.order and not self.falling
        self.order = by
        self._show_rows()

    def action_sort(self) -> None:
        """Sort the points by the next of `ORDERS`."""
        place = ORDERS.index(self.order)
        self.order, self.falling = ORDERS[(place + 1) % len(ORDERS)], False
        self._show_rows()

    def action_filter(self) -> None:
        """Show the field in which words filter the points while they are typed."""
        field = self.query_one("#filter", Input)
        field.disabled = False
        field.add_class("shown")
        field.focus()

    @on(Input.Changed, "#filter")
    def _on_filter(self, event: Input.Changed) -> None:
        self.filter_text = event.value
        self.page = 0
        self._show_rows()

    @on(Input.Submitted, "#filter")
    def _on_filter_submitted(self) -> None:
        self.query_one("#points-table", PlainTable).focus()

    def action_page(self, step: int) -> None:
        """Go to another page of the table."""
        last = pages(len(self.visible_rows), TABLE_PAGE_ROWS) - 1
        self.page = min(max(0, self.page + step), last)
        self.chosen = ""
        self._show_rows()

    def action_to_points(self) -> None:
        """Close the filter and go to the points."""
        field = self.query_one("#filter", Input)
        if field.has_class("shown"):
            field.remove_class("shown")
            field.value = ""
        self.action_tab("points")

    # Tabs.

    def action_tab(self, name: str) -> None:
        """Show the tab of this name, as points, profile or map."""
        tabs = self.query_one("#tabs", TabbedContent)
        if tabs.active == name:
            self.call_after_refresh(self.draw_plots)
        # Another tab is drawn once it is activated.
        tabs.active = name
        # The toolkit moves its bar one frame after the page.
        tab, bar = tabs.get_tab(name), tabs.query_one(Underline)
        bar.highlight_start, bar.highlight_end = tab.virtual_region.shrink(
            tab.styles.gutter
        ).column_span
        # Within the same frame: a focus that is lost with its page would paint a second frame.
        self.screen.set_focus(
            self.query_one(f"#{name}-table", PlainTable) if name in ("points", "drops") else None
        )

    @property
    def tab(self) -> str:
        """Name of the tab on the screen; empty while the application ends."""
        tabs = self.query("#tabs").results(TabbedContent)
        return next((str(content.active) for content in tabs), "")

    @on(TabbedContent.TabActivated)
    def _on_tab(self) -> None:
        if self.tab == "drops":
            self._fill_drops()
        self.call_after_refresh(self.draw_plots)

    def draw_plots(self) -> None:
        """Draw the plots of the tab on the screen."""
        match self.tab:
            case "profile":
                view = self.query_one("#profile-plot", Plot)
                first, count, place = self._profile_window()
                size = (view.size.width, view.size.height)
                by_chainage = self.order in ("measured", "chainage_m")
                self._show(
                    view,
                    profile_lines(
                        self.visible_rows,
                        (first, count),
                        place,
                        size,
                        self.glyphs,
                        by_chainage=by_chainage,
                    ),
                )
            case "map":
                view = self.query_one("#map-plot", Plot)
                lines = map_lines(self.visible_rows, self.chosen, view.size.width, view.size.height)
                self._show(view, lines)
            case "points":
                self._draw_point()
            case "drops" | "compare":
                self._draw_overlay(f"#{self.tab}-plot")

    def _show(self, view: LinesView, lines: Sequence[Line]) -> None:
        view.show(lines, THEMES[self.settings.theme])

    def _profile_window(self) -> tuple[int, int, int]:
        names = [row.name for row in self.visible_rows]
        place = names.index(self.chosen) if self.chosen in names else 0
        count = min(self.window, max(1, len(names)))
        first = min(max(0, place - count // 2), max(0, len(names) - count))
        return first, count, place

    def action_zoom(self, factor: float) -> None:
        """Show fewer or more points in the profile."""
        now = min(self.window, max(MIN_PROFILE_POINTS, len(self.visible_rows)))
        self.window = max(MIN_PROFILE_POINTS, min(MAX_PROFILE_POINTS, round(now * factor)))
        self.draw_plots()

    def action_step(self, step: int) -> None:
        """Choose the neighbour of the chosen point, on profile and map."""
        names = [row.name for row in self.visible_rows]
        if names:
            place = names.index(self.chosen) if self.chosen in names else 0
            self.chosen = names[min(max(0, place + step), len(names) - 1)]
            self.draw_plots()

    def _at_cursor(self) -> None:
        """Choose the row of the cursor now; its message may come after the next key."""
        table = self.query_one("#points-table", PlainTable)
        if self.tab == "points" and table.is_valid_row_index(table.cursor_row):
            key = table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value
            self.chosen = key or self.chosen

    def action_open(self) -> None:
        """Show the drops of the chosen point."""
        self._at_cursor()
        if self.opened.survey is None:
            self.show_message("the survey is still being read")
            return
        if self.tab == "drops":
            self._fill_drops()
        else:
            self.action_tab("drops")

    def _fill_drops(self) -> None:
        point = self.opened.view(self.chosen)
        table = self.query_one("#drops-table", PlainTable)
        table.fill([])
        if point is None:
            self.show_message("choose a point first" if self.opened.survey else "still being read")
            return
        progress = point.progress
        kinds = dict(progress.kinds)
        why = {excluded.number: excluded.reason for excluded in progress.excluded}
        rows = []
        for drop, shown in zip(point.drops, point.shown.as_diagnosed.drops, strict=True):
            facts, number = drop.facts, drop.number
            result = shown.result
            modulus = None if result is None else result.modulus_pa
            residual = None if result is None else result.residual_rms_over_peak
            cells = (
                str(number),
                "moved" if drop.moved_to else kinds[number].value if number in kinds else "",
                significant(facts.peak_load and facts.peak_load / 1e3),
                significant(facts.peak_deflection and facts.peak_deflection * 1e3),
                significant(modulus and modulus / 1e6),
                "-" if residual is None else f"{100 * residual:.2g} %",
                clean(text_of(why.get(number)) or "averaged"),
            )
            rows.append((str(number), cells))
        table.fill(rows)
        self.show_message(
            f"point {point.shown_name}: {progress.verdict.word}, {text_of(progress.verdict_reason)}"
        )
        self._overlay("#drops-plot", [(str(drop.number), drop.source) for drop in point.drops])

    def _overlay(self, where: str, drops: Sequence[tuple[str, Any]]) -> None:
        def draw() -> None:
            figures, faults = overlay_figures(drops)
            self._call(self._show_overlay, where, figures, faults)

        self.run_worker(draw, thread=True, group=where, exclusive=True, exit_on_error=False)

    def _show_overlay(self, where: str, figures: Sequence[Any], faults: Sequence[str]) -> None:
        self._overlays[where] = figures, faults
        self._draw_overlay(where)

    def _draw_point(self) -> None:
        """Draw verdict and traces of the chosen point beside or below the table."""
        view = self.query_one("#points-plot", Plot)
        row = next((row for row in self.visible_rows if row.name == self.chosen), None)
        if not view.display or not view.size.width:
            return
        if row is None:
            self._show(view, [])
            return
        if self._point_drawn == self.chosen:
            self._draw_overlay("#points-plot", point_lines(row, view.size.width))
        else:
            self._show(view, point_lines(row, view.size.width))

    def _draw_overlay(self, where: str, heading: Sequence[Line] = ()) -> None:
        """Draw the drops of a plot over each other, below some lines of text."""
        figures, faults = self._overlays.get(where, ((), ()))
        view = self.query_one(where, Plot)
        width, height = view.size.width, view.size.height - len(heading)
        lines: list[Line] = [line(cell(f" {text}", "warn")) for text in faults[:2]]
        if figures and height > 8 and width > 30:
            room = height - len(lines)
            lines += stacked_plots(figures, width, room, self.glyphs, shares=(2, 3))
        self._show(view, [*heading, *lines])

    def action_compare(self) -> None:
        """Mark a point; with a second marked point show the comparison."""
        self._at_cursor()
        if not self.chosen or self.opened.survey is None:
            return
        if self.chosen in self.marked:
            self.marked.remove(self.chosen)
        else:
            self.marked = [*self.marked, self.chosen][-2:]
        if len(self.marked) < 2:
            self.show_message(
                f"marked: {', '.join(self.marked) or 'none'}; c on another one compares"
            )
            return
        self.show_message(" and ".join(self.marked))
        self._fill_comparison()
        self.action_tab("compare")

    def _fill_comparison(self) -> None:
        table = self.query_one("#compare-table", PlainTable)
        table.fill([])
        by_name = {row.name: row for row in self.opened.rows}
        pair = [by_name[name] for name in self.marked if name in by_name]
        if len(pair) < 2:
            return
        titles = table_titles(self.opened.rows)
        cells = [_cells(row) for row in pair]
        compared = [
            key for key in ("title", "value", "interval", "verdict", "modulus") if key in titles
        ]
        rows: list[tuple[str, Sequence[str]]] = [
            (key, (titles[key], *(of[key] for of in cells))) for key in compared
        ]
        values = [display_value(row) for row in pair]
        if values[0] > 0 and values[1] > 0:
            ratio = f"{values[1] / values[0]:.3f}"
            rows.append(("ratio", ("second / first", "", ratio)))
        table.fill(rows)
        drops = [
            (f"{row.title}/{drop.number}", drop.source)
            for row in pair
            if (point := self.opened.view(row.name)) is not None
            for drop in point.drops
            if drop.number in point.progress.used[-1:]
        ]
        self._overlay("#compare-plot", drops)

    # Files.

    def action_report(self) -> None:
        """Ask for the name of a file, then write a report as HTML or PDF."""
        self._ask_file("Report into (.html or .pdf)", f"{self.opened.folder.name}.html", "report")

    def action_export(self) -> None:
        """Ask for the name of a file, then write a table of all drops as CSV."""
        self._ask_file("Export into (.csv)", f"{self.opened.folder.name}.csv", "export")

    def _ask_file(self, title: str, proposal: str, command: str) -> None:
        def take(path: str | None) -> None:
            if path:
                self.run_worker(
                    lambda: self._make(command, path),
                    thread=True,
                    group="file",
                    exit_on_error=False,
                )

        def check(text: str) -> str:
            return "" if text.strip() else "expected the name of a file"

        self.push_screen(TextDialog(title, proposal, check=check), take)

    def _make(self, command: str, path: str) -> None:
        more = ["--format", "table"] if command == "export" else []
        words = [command, str(self.opened.folder), "-o", path, *more]
        self._call(self.show_message, f"pfwd {shlex.join(words)} ...")
        error = run_command(words)
        self._call(self.show_message, error or f"{path} is written")

    def action_leave(self) -> None:
        """Leave the program."""
        self.exit(0)


def table_titles(rows: Sequence[PointRow]) -> dict[str, str]:
    """Return the titles of the columns that rows fill, by the keys of the columns.

    The title of the modulus says that it is not judged.
    """
    titles = dict(_TABLE_COLUMNS)
    judged = [row for row in rows if row.judged]
    if judged:
        quantities = {row.quantity for row in judged}
        if len(quantities) == 1:
            titles["value"] = judged[0].judged_by.label
        if all(row.modulus is None for row in judged):
            titles.pop("modulus")
        elif quantities == {"modulus"}:
            titles["modulus"] = "E_eq MPa, not judged"
        else:
            titles["modulus"] = "E MPa, not judged"
        for key in ("target", "use", "unexplained", "notes"):
            if not any(getattr(row, key) for row in rows):
                titles.pop(key)
        if all(row.low is None for row in rows):
            titles.pop("interval")
        if all(row.state == "-" for row in rows):
            titles.pop("verdict")
    if all(row.chainage_m is None for row in rows):
        titles.pop("chainage_m")
    return titles


def _cells(row: PointRow) -> dict[str, str]:
    """Return the cells of a point by the keys of the columns."""
    return {
        **judged_cells(row),
        "title": clean(row.title),
        "drops": str(row.drops),
        "verdict": row.state,
        "modulus": SI.show(row.modulus_fact, with_unit=False),
        "chainage_m": "-" if row.chainage_m is None else f"{row.chainage_m:.0f}",
        "use": clean(row.use) or "-",
        "unexplained": clean(row.unexplained) or "-",
        "notes": clean(row.notes),
    }


def point_lines(row: PointRow, width: int) -> list[Line]:
    """Return a point in words: its verdict with the reason, its modulus, its diagnosis.

    Parameters
    ----------
    row : PointRow
    width : int
        Columns.
    """
    word = "no verdict" if row.state == "-" else row.state
    state = cell(word, STATE_ROLES.get(row.state, "text"))
    lines: list[Line] = [line(cell(f" {row.title}", "strong"), "  ", state)]
    texts = []
    if row.value is not None:
        texts.append(f"{row.judged_by.words} {SI.show(row.judged_fact)}, {row.origin}")
    if row.target is not None:
        texts.append(f"target {judged_cells(row)['target']}")
    if row.modulus is not None:
        other = "equivalent modulus" if row.quantity == "modulus" else "modulus"
        texts.append(f"not judged: {other} {SI.show(row.modulus_fact)}")
    texts += [text for text in (row.reason, row.diagnosis_text, row.notes) if text]
    for text in texts:
        lines += [line(" ", part) for part in wrap(clean(text), width - 2)]
    return [*lines, ()]


def show_survey(survey: OpenedSurvey, settings: ScreenSettings) -> int:
    """Show a recorded survey until the reader leaves; return the exit status of the program."""
    app = OpenApp(survey, settings)
    app.run()
    for text in app.opened.remarks:
        say(text)
    return app.return_code or 0
