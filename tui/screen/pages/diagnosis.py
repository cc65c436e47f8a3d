"""Diagnosis page: a table of the points before and after, and effects of the device."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.analysis.response_tables import BUILDING
from pfwd.analysis.results import DiagnosisResult
from pfwd.facts import facts_of_state
from pfwd.judging.verdicts import modulus_in_force
from pfwd.units import Units
from tui.diagnosis_lines import device_lines, diagnosis_lines, point_cells
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
    wrap,
)
from tui.screen.pages.measure_view import key_line
from tui.screen.pages.page import Page

_MODULUS_TITLES = ("before", "E")
"""Titles of the columns with a modulus, to which the unit is added."""

_DIAGNOSIS_COLUMNS = (
    TableColumn("point", 0, is_text=True, is_flexible=True),
    TableColumn("verdict", 3, is_text=True),
    TableColumn("before", 4),
    TableColumn("E", 0),
    TableColumn("use", 1, is_text=True),
    TableColumn("unexplained", 2),
    TableColumn("found", 5, is_text=True, is_flexible=True),
)


class DiagnosisPage(Page):
    """Page with the diagnosis of each point: causes of its residual, modulus."""

    NAME = "diagnosis"
    HELP = (
        "Looks for the causes of the residual at each point: effects of the ground, the contact or "
        "the sensors that were not declared. Each is added to the model, then the point is fitted; "
        "the table shows the modulus before, and the modulus in force with its 95 % interval, its "
        "use and what is unexplained over the peak, an allowance of 0.3 % for the model included. "
        "Effects of the device are the same at all its points and are listed below with "
        "their values. The diagnosis runs in the background; measuring goes on."
    )
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("enter", "run"),
        ("up/down", "choose"),
        ("escape", "back"),
        ("?", "help"),
        ("k", "stop"),
        ("pageup/pagedown", "text"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "run", "Diagnose the survey"),
        Binding("k", "stop", "Stop the diagnosis"),
        Binding("up", "choose(-1)", "Point before"),
        Binding("down", "choose(1)", "Point after"),
        Binding("pageup", "text(-5)", "Text up"),
        Binding("pagedown", "text(5)", "Text down"),
        Binding("escape", "app.page('measure')", "Back"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self.place = 0
        self.first = 0

    @property
    def results(self) -> Sequence[DiagnosisResult]:
        """Diagnoses of the survey, one for each point; empty before the first run."""
        diagnosis = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
        return diagnosis.results if diagnosis is not None else ()

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the page."""
        app = self.pfwd
        busy = app.busy_text()
        head = head_with_message(line(cell(" Diagnosis ", "title")), busy or app.message, width)
        room = height - len(head) - 1
        return [*head, *pad_rows(self._body(width, room), room), key_line(self.KEYS, width)]

    def _body(self, width: int, room: int) -> list[Line]:
        results = self.results
        task = self.pfwd.diagnoses.task
        if task is not None and not results:
            step = task.progress
            bar: tuple[Line, ...] = ()
            if step is not None and step.work != BUILDING:
                bar = (progress_bar(step.count, step.total, width - 2),)
            return [(), *bar, (), line(" Measuring goes on; k stops the diagnosis.")]
        if not results:
            diagnosis = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
            if diagnosis is not None and diagnosis.error:
                return [
                    (),
                    *[line(" ", cell(text, "bad")) for text in wrap(diagnosis.error, width - 2)],
                ]
            hint = (
                "Enter diagnoses all points of the survey that have measured drops. A point takes "
                "10 to 30 seconds with one sensor, and minutes with many. Finished points are "
                "not lost when you stop it; measuring goes on."
            )
            return [(), *[line(" ", row) for row in wrap(hint, width - 2)]]
        self.place = min(self.place, len(results) - 1)
        names = [result.point or f"no. {number}" for number, result in enumerate(results, 1)]
        device: list[Line] = [
            line(" ", part) for text in device_lines(results) for part in wrap(text, width - 2)
        ]
        device[:0] = [()] if device else []
        table_room = max(3, (room - len(device)) // 2)
        visible = window(len(results), self.place, table_room - 1)
        judged = {at: self._judged(results[at]) for at in {*visible, self.place}}
        rows = [
            result_row(judged[at], names[at], self.pfwd.units, chosen=at == self.place)
            for at in visible
        ]
        unit = self.pfwd.units.unit("modulus")
        columns = [
            dataclasses.replace(column, title=f"{column.title} {unit}")
            if column.title in _MODULUS_TITLES
            else column
            for column in _DIAGNOSIS_COLUMNS
        ]
        table = table_lines(columns, rows, width)
        text: list[Line] = [(), line(cell(f" point {names[self.place]}", "strong"))]
        for row in diagnosis_lines(judged[self.place])[1:]:
            text += [line(" ", part) for part in wrap(row.strip(), width - 2)]
        text_rows = room - len(table) - len(device)
        self.first = max(0, min(self.first, len(text) - text_rows))
        return [*table, *device, *text[self.first : self.first + text_rows]]

    def _judged(self, result: DiagnosisResult) -> DiagnosisResult:
        """Return a diagnosis with the modulus in force at its point, as ``pfwd diagnose`` does."""
        points = self.pfwd.state.points.values()
        point = next((point for point in points if point.shown_name == str(result.point)), None)
        return dataclasses.replace(result, point_modulus=modulus_in_force(result, point))

    def action_run(self) -> None:
        """Start the diagnosis of all points in a process of its own."""
        folder = self.pfwd.source.survey
        if folder is None:
            self.pfwd.show_message("there is no survey that could be diagnosed")
            return
        self.pfwd.diagnoses.start(str(folder))
        self.draw()

    def action_stop(self) -> None:
        """Stop the diagnosis."""
        self.pfwd.diagnoses.stop()

    def action_choose(self, step: int) -> None:
        """Choose the point this number of rows further down; its text stands below the table."""
        self.place = max(0, min(self.place + step, len(self.results) - 1))
        self.first = 0
        self.draw()

    def action_text(self, rows: int) -> None:
        """Scroll the text below the table by this number of rows."""
        self.first = max(0, self.first + rows)
        self.draw()


def progress_bar(count: int, total: int, width: int) -> Line:
    """Return a bar that is filled as far as points are diagnosed, with their number."""
    text = f" {count} of {total} points"
    cells = max(0, min(60, width - len(text)))
    filled = cells * count // max(1, total)
    return line(" ", cell("█" * filled, "good"), cell("─" * (cells - filled), "dim"), text)


_ROLE: dict[str, TextRole] = {"clean": "good", "explained": "good", "unexplained": "warn"}


def result_row(result: DiagnosisResult, name: str, units: Units, *, chosen: bool) -> TableRow:
    """Return the row of a point in the table of diagnoses.

    Parameters
    ----------
    result : DiagnosisResult
        With the modulus in force at the point.
    name : str
        Name of the point in the table.
    units : Units
    chosen : bool
        The row is marked, and the text below the table is about its point.
    """
    verdict = str(result.verdict)
    cells = point_cells(name, result, units)
    return TableRow(
        (
            shorten(cell(name).text, 24),
            verdict.upper(),
            units.value_and_ends(facts_of_state(result.before)["modulus"])[0],
            cells.modulus,
            cells.use,
            cells.unexplained,
            cell(cells.effects).text,
        ),
        _ROLE.get(verdict, "text"),
        chosen,
    )
