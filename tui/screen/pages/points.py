"""Points page: every point of the survey, their profile, and the drops of one point."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.digits import MISSING
from pfwd.errors import OptionError
from pfwd.facts import fact_of_modulus, fact_of_value
from pfwd.files.editing import Edit, parse_position
from pfwd.judging import PointView
from pfwd.procedures import PointProgress, Verdict
from pfwd.units import Units
from tui.output import counted
from tui.screen.drawing.lines import (
    Line,
    TableColumn,
    TableRow,
    TextRole,
    cell,
    head_with_message,
    line,
    pad_rows,
    shorten,
    table_lines,
    window,
)
from tui.screen.drawing.profile import Bar, profile_lines
from tui.screen.lines_view import LinesView
from tui.screen.pages.dialogs import PointDialog, TextDialog
from tui.screen.pages.drop_texts import (
    drop_columns,
    drop_row,
    point_summary,
)
from tui.screen.pages.measure_view import key_lines
from tui.screen.pages.page import Page
from tui.screen.pages.setup_form import typed_target_fault
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.stations import point_name_error, point_name_question

_OTHER_MODULUS = "other modulus"
"""Column of the fitted modulus that is not judged."""

_POINT_TABLE_COLUMNS = (
    TableColumn("point", 0, is_text=True, is_flexible=True),
    TableColumn("drops", 2),
    TableColumn("judged", 0),
    TableColumn("95 %", 3),
    TableColumn("target", 4),
    TableColumn("status", 1, is_text=True),
    TableColumn(_OTHER_MODULUS, 3),
    TableColumn("position", 5, is_text=True),
    TableColumn("notes", 6, is_flexible=True),
)

MIN_PROFILE_ROWS, MAX_PROFILE_ROWS = 18, 30
"""Rows of the profile: fewer are hard to read, more show nothing new."""

MIN_DROPS_ROWS = 6
"""Smallest number of free rows below the points for the drops of the chosen point."""


class PointsPage(Page):
    """Page of all points; enter opens a point, then one of its drops."""

    NAME = "points"
    HELP = (
        "Every point of the survey with its judged value and verdict, and the profile of the line "
        "in the order of measuring. Enter opens a point, then a drop. Changes made here (name, "
        "position, target, note, discarded or moved drops) are added to the survey; recorded data "
        "stay as they are, and u takes a change of a drop back."
    )
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("up/down", "choose"),
        ("enter", "open"),
        ("escape", "back"),
        ("1", "measure"),
        ("?", "help"),
        ("m", "target"),
        ("o", "position"),
        ("a", "name"),
        ("e", "note"),
        ("s", "slip"),
        ("d", "discard"),
        ("w", "move"),
        ("u", "undo"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "choose(-1)", "Choose the one before"),
        Binding("down", "choose(1)", "Choose the one after"),
        Binding("pageup", "choose(-10)", "Ten before"),
        Binding("pagedown", "choose(10)", "Ten after"),
        Binding("home", "choose(-100000)", "The first"),
        Binding("end", "choose(100000)", "The last"),
        Binding("enter", "open", "Open"),
        Binding("escape", "back", "Back"),
        Binding("d", "discard", "Discard or restore"),
        Binding("m", "target", "Target of the point"),
        Binding("o", "position", "Position of the point"),
        Binding("a", "name", "Another name for the point"),
        Binding("e", "note", "Note"),
        Binding("s", "slip", "Slip of the point: one page to sign"),
        Binding("w", "move", "Move the drop to another point"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.point = ""
        """Name of the chosen point; empty: the point that is being measured."""
        self.drop: int | None = None
        """Number of the chosen drop; None: the points are shown."""

    @property
    def names(self) -> list[str]:
        """Names of the points, in their order."""
        return list(self.pfwd.state.points)

    @property
    def chosen(self) -> PointView:
        """Point of the chosen row, by default the point that is being measured."""
        state = self.pfwd.state
        return state.points.get(self.point) or state.current

    @property
    def drops(self) -> dict[int, ScreenDrop]:
        """Drops of the chosen point by their number."""
        return self.pfwd.state.drops_of(self.chosen)

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the page."""
        body = self._points if self.drop is None else self._drops
        title = line(cell(f" Points of {shorten(self.pfwd.source.title, width - 30)} ", "title"))
        receiver = self.pfwd.position()
        if receiver is not None:
            title = (*title, cell(f"  {receiver.text}", "good" if receiver.is_good else "warn"))
        head = head_with_message(title, self.pfwd.message, width)
        keys = key_lines(self.KEYS, width, 2)
        room = height - len(head) - len(keys)
        return [*head, *pad_rows(body(width, room), room), *keys]

    def _points(self, width: int, room: int) -> list[Line]:
        app, names = self.pfwd, self.names
        if not names:
            return [(), line(cell(" no point yet", "dim"))]
        spare = room - len(names) - 3
        drops = self._drops_below(width, spare - MIN_PROFILE_ROWS)
        free_rows = min(MAX_PROFILE_ROWS, spare - len(drops))
        profile_rows = max(room // 3, free_rows) if room >= 16 else 0
        chosen = names.index(self.chosen.name) if self.chosen.name in names else 0
        visible = window(len(names), chosen, max(1, room - profile_rows - 2))
        rows = [
            self._row(app.state.points[names[place]], app.units, chosen=place == chosen)
            for place in visible
        ]
        job = app.state.job
        quantity = job.quantity.dimension
        unit = app.units.unit(quantity)
        judged = job.quantity.label
        titles = {
            "judged": f"{judged} {unit}",
            "target": f"target {unit}",
            _OTHER_MODULUS: f"{job.quantity.other_fitted.label}, not judged",
        }
        columns = [
            dataclasses.replace(column, title=titles.get(column.title, column.title))
            for column in _POINT_TABLE_COLUMNS
        ]
        table = table_lines(columns, rows, width)
        bars = [self._bar(app.state.points[name], name == names[chosen]) for name in names]
        target = app.units.value(quantity, app.state.progress.target)
        title = f"{judged} along the line, {unit}"
        profile = profile_lines(bars, width, profile_rows, title, target)
        return [*pad_rows([*table, *drops], room - profile_rows - 1), (), *profile]

    def _drops_below(self, width: int, room: int) -> list[Line]:
        """Return the last drops of the chosen point, as many as fit below the points."""
        point = self.chosen
        drops = self.drops
        numbers = sorted(drops)
        if room < MIN_DROPS_ROWS or not numbers:
            return []
        state, units = self.pfwd.state, self.pfwd.units
        rows = [
            drop_row(state, drops[number], units, chosen=False)
            for number in numbers[-max(0, room - 3) :]
        ]
        heading = line(" ", *point_summary(state, point, units, width - 1))
        return [(), heading, *table_lines(drop_columns(state.job.quantity, units), rows, width)]

    def _row(self, point: PointView, units: Units, *, chosen: bool) -> TableRow:
        state = self.pfwd.state
        place = point.position
        progress = point.progress
        judged = fact_of_value(progress.value)
        value, ends = units.value_and_ends(judged)
        unjudged = fact_of_modulus(progress.modulus, state.job.quantity.other_fitted)
        texts = {
            "point": cell(point.shown_name).text,
            "drops": str(len(state.drops_of(point))),
            "judged": value,
            "95 %": MISSING if judged.note or not ends else ends,
            "target": units.text(state.job.quantity.dimension, progress.target),
            "status": status_of(point, progress),
            _OTHER_MODULUS: units.show(unjudged),
            "position": f"{place[0]:.6f}, {place[1]:.6f}" if place else MISSING,
            "notes": cell("; ".join(point.notes)).text or MISSING,
        }
        role: TextRole = "dim" if point.discarded else "text"
        return TableRow(tuple(texts[column.title] for column in _POINT_TABLE_COLUMNS), role, chosen)

    def _bar(self, point: PointView, chosen: bool) -> Bar:
        state = self.pfwd.state
        judged = None if point.discarded else point.progress.value
        quantity = state.job.quantity.dimension
        value = self.pfwd.units.value(quantity, None if judged is None else judged.value)
        return Bar(cell(point.shown_name).text, value, "measured", chosen)

    def _drops(self, width: int, room: int) -> list[Line]:
        app, point = self.pfwd, self.chosen
        drops = self.drops
        numbers = sorted(drops)
        place = numbers.index(self.drop) if self.drop in numbers else 0
        rows = [
            drop_row(app.state, drops[numbers[at]], app.units, chosen=at == place)
            for at in window(len(numbers), place, max(1, room - 5))
        ]
        columns = drop_columns(app.state.job.quantity, app.units)
        heading = line(cell(f" point {point.shown_name}", "strong"))
        summary = line(" ", *point_summary(app.state, point, app.units, width - 1))
        return [(), heading, summary, (), *table_lines(columns, rows, width)]

    def action_choose(self, step: int) -> None:
        """Choose the point, or inside a point the drop, this number of rows further down."""
        if self.drop is None:
            names = self.names
            if names:
                now = names.index(self.chosen.name) if self.chosen.name in names else 0
                self.point = names[min(max(now + step, 0), len(names) - 1)]
        else:
            numbers = sorted(self.drops)
            if numbers:
                now = numbers.index(self.drop) if self.drop in numbers else 0
                self.drop = numbers[min(max(now + step, 0), len(numbers) - 1)]
        self.draw()

    def action_open(self) -> None:
        """Open the chosen point, then the chosen drop."""
        point = self.chosen
        if self.drop is None:
            self.point = point.name
            self.drop = max(self.drops, default=None)
            if self.drop is None:
                self.pfwd.show_message("this point has no drops yet")
            self.draw()
            return
        self.pfwd.open_drop(self.drops.get(self.drop))

    def action_back(self) -> None:
        """Go back to the points, then to the measure page."""
        if self.drop is not None:
            self.drop = None
            self.draw()
        else:
            self.pfwd.action_page("measure")

    def action_discard(self) -> None:
        """Discard or restore the chosen drop, or the point."""
        point = self.chosen
        if self.drop is not None:
            self.pfwd.edits.discard(self.drops.get(self.drop))
            return
        kind = "restore" if point.discarded else "discard"
        if self.pfwd.edits.add(Edit(kind, None), point=point.name):
            self.pfwd.show_message(f"point {point.shown_name}: {kind}; d again takes it back")

    def action_target(self) -> None:
        """Open the dialog for the target of the point."""
        units, procedure = self.pfwd.units, self.pfwd.state.procedure
        quantity = procedure.quantity.dimension
        unit = units.unit(quantity)

        def check(text: str) -> str:
            if not _positive(text):
                return f"a number > 0, in {unit}"
            return typed_target_fault(units.si(quantity, float(text)), procedure, units)

        now = units.text(quantity, self.chosen.target, 4)
        self._ask(
            f"Target of point {self.chosen.shown_name}, {unit}",
            "" if now == MISSING else now,
            check,
            lambda text: Edit("target", units.si(quantity, float(text))),
        )

    def action_position(self) -> None:
        """Open the dialog for the position of the point."""
        place = self.chosen.position
        self._ask(
            f"Position of point {self.chosen.shown_name}: latitude, longitude in degrees",
            f"{place[0]}, {place[1]}" if place else "",
            _position_error,
            lambda text: Edit("position", parse_position(text)),
        )

    def action_name(self) -> None:
        """Open the dialog for the name of the point."""
        self._ask(
            f"Name of point {self.chosen.shown_name}",
            self.chosen.shown_name,
            lambda text: "" if 0 < len(text.strip()) <= 64 else "1 to 64 characters",
            lambda text: Edit("name", text.strip()),
        )

    def action_move(self) -> None:
        """Open the dialog that moves the chosen drop to another point."""
        drop = None if self.drop is None else self.drops.get(self.drop)
        if drop is None:
            self.pfwd.show_message("enter goes into the point; there w moves the chosen drop")
            return

        def take(name: str | None) -> None:
            if name:
                self.pfwd.edits.move(drop, name.strip())

        names = self.pfwd.state.names_in_use()
        dialog = PointDialog(
            f"Move drop {drop.number} of point {self.chosen.shown_name} to the point",
            self._targets_of_move(),
            check=point_name_error,
            question=lambda name: point_name_question(name, names),
        )
        self.app.push_screen(dialog, take)

    def _targets_of_move(self) -> list[tuple[str, str]]:
        """Return the points and stations to which a drop can be moved, each with a remark."""
        state = self.pfwd.state
        points = {
            point.shown_name: counted(len(state.drops_of(point)), "drop")
            for point in state.points.values()
            if point.name != self.chosen.name
        }
        current_names = (self.chosen.name, self.chosen.shown_name)
        stations = {
            station.name: "station without drops"
            for station in state.job.stations
            if station.name not in current_names
        }
        return list((points | stations | points).items())

    def action_slip(self) -> None:
        """Ask for the signature of the slip of the chosen point, then write it."""
        self.pfwd.ask_for_slip(self.chosen)

    def action_note(self) -> None:
        """Open the dialog for a note on the drop or the point."""
        drop = None if self.drop is None else self.drops.get(self.drop)
        subject = f"drop {drop.number}" if drop else f"point {self.chosen.shown_name}"
        check = "1 to 500 characters"

        def take(text: str | None) -> None:
            if not text:
                return
            edit = Edit("note", text)
            if drop is not None:
                self.pfwd.edits.add(edit, drop=drop)
            else:
                self.pfwd.edits.add(edit, point=self.chosen.name)

        dialog = TextDialog(
            f"Note on {subject}", check=lambda text: "" if 0 < len(text.strip()) <= 500 else check
        )
        self.app.push_screen(dialog, take)

    def _ask(
        self,
        title: str,
        value: str,
        check: Callable[[str], str],
        edit: Callable[[str], Edit],
    ) -> None:
        name = self.chosen.name

        def take(text: str | None) -> None:
            if text is not None:
                self.pfwd.edits.add(edit(text), point=name)

        self.app.push_screen(TextDialog(title, value, check=check), take)

    def on_lines_view_clicked(self, event: LinesView.Clicked) -> None:
        """Choose the row that was clicked."""
        row = self.view.text.split("\n")[event.row].replace("▶", " ").strip()
        if self.drop is None:
            for name in self.names:
                if row.startswith(self.pfwd.state.points[name].shown_name):
                    self.point = name
        elif row.split(" ")[0].isdigit():
            self.drop = int(row.split(" ")[0])
        self.draw()


def status_of(point: PointView, progress: PointProgress) -> str:
    """Return the verdict of a complete point, the drops made of another, or DISCARDED."""
    if point.discarded:
        return "DISCARDED"
    if not progress.complete:
        total = progress.measured_wanted
        return f"{progress.measured_done}" + (f" of {total}" if total is not None else "")
    return "done" if progress.verdict is Verdict.NONE else progress.verdict.value.upper()


def _positive(text: str) -> bool:
    try:
        return 0 < float(text) < 1e9
    except ValueError:
        return False


def _position_error(text: str) -> str:
    try:
        parse_position(text)
    except OptionError:
        return "as 48.1374, 11.5755: degrees, north and east positive"
    return ""
