"""The diagnosis page: the ladder of the survey, effects of the device over the points."""

import math
from collections.abc import Sequence
from typing import ClassVar

from textual.binding import Binding, BindingType

from pfwd.analysis.results import DiagnosisResult, FittedState
from pfwd.digits import read_in, rounded
from tui.diagnosis_lines import diagnosis_lines
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
from tui.screen.units import NO_VALUE, Units, percent

_COLUMNS = (
    TableColumn("point", 0, is_text=True, is_flexible=True),
    TableColumn("verdict", 0, is_text=True),
    TableColumn("E before", 2),
    TableColumn("E after", 1),
    TableColumn("residual", 4),
    TableColumn("after", 3),
    TableColumn("effects", 5, is_flexible=True),
)


class DiagnosisPage(Page):
    """What is behind the residuals of the survey."""

    NAME = "diagnosis"
    HELP = (
        "Asks of every point which effect that nobody declared would leave just the residual that "
        "is there, adds it, fits again, and says what that did to the modulus. The ladder shows a "
        "point a line, before and after. Effects of the device are shared by its points and stand "
        "below with their values. It runs beside the measurement, which never waits for it."
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
        """Of the survey, one a point; none before it has run."""
        found = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
        return found.results if found is not None else ()

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """The page."""
        app = self.pfwd
        busy = app.busy_text()
        head = head_with_message(line(cell(" Diagnosis ", "title")), busy or app.message, width)
        room = height - len(head) - 1
        return [*head, *pad_rows(self._body(width, room), room), key_line(self.KEYS, width)]

    def _body(self, width: int, room: int) -> list[Line]:
        results = self.results
        if not results:
            found = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
            if found is not None and found.error:
                return [(), *[line(" ", cell(row, "bad")) for row in wrap(found.error, width - 2)]]
            hint = (
                "Enter diagnoses all points of the survey that have measured drops. It takes some "
                "seconds a point and runs beside the measurement."
            )
            return [(), *[line(" ", row) for row in wrap(hint, width - 2)]]
        self.place = min(self.place, len(results) - 1)
        names = [result.point or f"no. {number}" for number, result in enumerate(results, 1)]
        device = device_lines(results, self.pfwd.units, width)
        table_room = max(3, (room - len(device)) // 2)
        shown = window(len(results), self.place, table_room - 1)
        rows = [
            result_row(results[at], names[at], self.pfwd.units, chosen=at == self.place)
            for at in shown
        ]
        unit = self.pfwd.units.unit("modulus")
        columns = [
            TableColumn(f"{column.title} {unit}", column.rank)
            if column.title.startswith("E ")
            else column
            for column in _COLUMNS
        ]
        ladder = table_lines(columns, rows, width)
        text: list[Line] = [(), line(cell(f" point {names[self.place]}", "strong"))]
        for row in diagnosis_lines(results[self.place])[1:]:
            text += [line(" ", part) for part in wrap(row.strip(), width - 2)]
        left = room - len(ladder) - len(device)
        self.first = max(0, min(self.first, len(text) - left))
        return [*ladder, *device, *text[self.first : self.first + left]]

    def action_run(self) -> None:
        """Diagnose the survey."""
        folder = self.pfwd.source.survey
        if folder is None:
            self.pfwd.show_message("there is no survey that could be diagnosed")
            return
        self.pfwd.diagnoses.start(str(folder))
        self.draw()

    def action_stop(self) -> None:
        """End it."""
        self.pfwd.diagnoses.stop()

    def action_choose(self, step: int) -> None:
        """Another point."""
        self.place = max(0, min(self.place + step, len(self.results) - 1))
        self.first = 0
        self.draw()

    def action_text(self, rows: int) -> None:
        """The text further up or down."""
        self.first = max(0, self.first + rows)
        self.draw()


_ROLE: dict[str, TextRole] = {"clean": "good", "explained": "good", "unexplained": "warn"}


def result_row(result: DiagnosisResult, name: str, units: Units, *, chosen: bool) -> TableRow:
    """A point as a row of the ladder."""
    before, after = result.before or FittedState(), result.after or FittedState()
    verdict = str(result.verdict)
    effects = ", ".join(str(effect.name) for effect in result.effects or ())
    return TableRow(
        (
            shorten(cell(name).text, 24),
            verdict.upper(),
            units.text("modulus", before.modulus_pa),
            units.text("modulus", after.modulus_pa),
            percent(before.residual_rms_over_peak),
            percent(after.residual_rms_over_peak),
            cell(effects).text or NO_VALUE,
        ),
        _ROLE.get(verdict, "text"),
        chosen,
    )


def device_lines(results: Sequence[DiagnosisResult], units: Units, width: int) -> list[Line]:
    """Effects of the device with their value at every point that shows them."""
    values: dict[str, list[str]] = {}
    for result in results:
        for effect in result.effects or ():
            if effect.scope != "device":
                continue
            value, sd = effect.value, effect.sd
            if value is None or not math.isfinite(value):
                continue
            scale, unit = read_in(effect.unit or "")
            spread = scale * sd if sd is not None and math.isfinite(sd) else 0.0
            text = f"{scale * value:.4g}"
            if spread > 0.0:
                text = f"{rounded(scale * value, spread)} ± {rounded(spread, spread)}"
            values.setdefault(str(effect.name), []).append(f"{text} {unit}".rstrip())
    if not values:
        return []
    lines: list[Line] = [(), line(cell(" effects of the device over the points", "strong"))]
    for name, texts in values.items():
        same = texts[:1] if len(set(texts)) == 1 else texts
        points = "1 point" if len(texts) == 1 else f"{len(texts)} points"
        for row in wrap(f"{name}: {'; '.join(same)} ({points})", width - 2):
            lines.append(line(" ", row))
    return lines
