"""The diagnosis page: the ladder of the survey, effects of the device over the points."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from textual.binding import Binding, BindingType

from tui.diagnosis_lines import diagnosis_lines
from tui.screen.drawing.blocks import Column, Row, exactly, table_lines, window
from tui.screen.drawing.lines import Line, Role, cell, line, shorten, wrap
from tui.screen.pages.measure_view import key_line
from tui.screen.pages.page import Page
from tui.screen.units import NOTHING, Units, percent

_COLUMNS = (
    Column("point", 0, left=True, free=True),
    Column("verdict", 0, left=True),
    Column("E before", 2),
    Column("E after", 1),
    Column("residual", 4),
    Column("after", 3),
    Column("effects", 5, free=True),
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
    def records(self) -> Sequence[Mapping[str, Any]]:
        """Of the survey, one a point; none before it has run."""
        found = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
        return found.records if found is not None else ()

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """The page."""
        app = self.pfwd
        busy = app.busy_text()
        title = line(cell(" Diagnosis ", "title"), cell(f"  {busy or app.message}", "warn"))
        body = self._body(width, height - 2)
        return [title, *exactly(body, height - 2), key_line(self.KEYS, width)]

    def _body(self, width: int, room: int) -> list[Line]:
        records = self.records
        if not records:
            found = self.pfwd.state.diagnoses.get(str(self.pfwd.source.survey))
            if found is not None and found.error:
                return [(), *[line(" ", cell(one, "bad")) for one in wrap(found.error, width - 2)]]
            hint = (
                "Enter diagnoses all points of the survey that have measured drops. It takes some "
                "seconds a point and runs beside the measurement."
            )
            return [(), *[line(" ", one) for one in wrap(hint, width - 2)]]
        self.place = min(self.place, len(records) - 1)
        names = self.pfwd.diagnoses.names_of_records(len(records))
        device = device_lines(records, self.pfwd.units, width)
        table_room = max(3, (room - len(device)) // 2)
        shown = window(len(records), self.place, table_room - 1)
        rows = [
            record_row(records[at], names[at], self.pfwd.units, chosen=at == self.place)
            for at in shown
        ]
        unit = self.pfwd.units.unit("modulus")
        columns = [
            Column(f"{one.title} {unit}", one.rank) if one.title.startswith("E ") else one
            for one in _COLUMNS
        ]
        ladder = table_lines(columns, rows, width)
        text: list[Line] = [(), line(cell(f" point {names[self.place]}", "strong"))]
        for one in diagnosis_lines(records[self.place])[1:]:
            text += [line(" ", part) for part in wrap(one.strip(), width - 2)]
        left = room - len(ladder) - len(device)
        self.first = max(0, min(self.first, len(text) - left))
        return [*ladder, *device, *text[self.first : self.first + left]]

    def action_run(self) -> None:
        """Diagnose the survey."""
        folder = self.pfwd.source.survey
        if folder is None:
            self.pfwd.say("there is no survey that could be diagnosed")
            return
        self.pfwd.diagnoses.start(str(folder))
        self.draw()

    def action_stop(self) -> None:
        """End it."""
        self.pfwd.diagnoses.stop()

    def action_choose(self, step: int) -> None:
        """Another point."""
        self.place = max(0, min(self.place + step, len(self.records) - 1))
        self.first = 0
        self.draw()

    def action_text(self, rows: int) -> None:
        """The text further up or down."""
        self.first = max(0, self.first + rows)
        self.draw()


_ROLE: dict[str, Role] = {"clean": "good", "explained": "good", "unexplained": "warn"}


def record_row(record: Mapping[str, Any], name: str, units: Units, *, chosen: bool) -> Row:
    """A point as a row of the ladder."""
    before, after = record.get("before") or {}, record.get("after") or {}
    verdict = str(record.get("verdict"))
    effects = ", ".join(str(one["name"]) for one in record.get("effects") or ())
    return Row(
        (
            shorten(cell(name).text, 24),
            verdict.upper(),
            units.text("modulus", before.get("modulus_pa")),
            units.text("modulus", after.get("modulus_pa")),
            percent(before.get("residual_rms_over_peak")),
            percent(after.get("residual_rms_over_peak")),
            cell(effects).text or NOTHING,
        ),
        _ROLE.get(verdict, "text"),
        chosen,
    )


def device_lines(records: Sequence[Mapping[str, Any]], units: Units, width: int) -> list[Line]:
    """Effects of the device with their value at every point that shows them."""
    values: dict[str, list[str]] = {}
    for record in records:
        for effect in record.get("effects") or ():
            if effect.get("scope") != "device":
                continue
            value, sd, unit = effect.get("value"), effect.get("sd"), effect.get("unit")
            if not isinstance(value, int | float) or not math.isfinite(value):
                continue
            sure = f" ± {sd:.2g}" if isinstance(sd, int | float) and math.isfinite(sd) else ""
            shown = "" if unit == "-" else f" {unit}"
            values.setdefault(str(effect["name"]), []).append(f"{value:.4g}{sure}{shown}")
    if not values:
        return []
    lines: list[Line] = [(), line(cell(" effects of the device over the points", "strong"))]
    for name, texts in values.items():
        same = texts[:1] if len(set(texts)) == 1 else texts
        for one in wrap(f"{name}: {'; '.join(same)} ({len(texts)} points)", width - 2):
            lines.append(line(" ", one))
    return lines
