"""Setup page: port, plate, procedure, target, operator, units, theme; checked as typed."""

import contextlib
from collections.abc import Sequence
from typing import Any, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.widgets import Button, Input, Label, Select

from pfwd.errors import DeviceError, OptionError
from pfwd.judging import JobRequest
from pfwd.procedures import PLAIN, Procedure, shipped_names
from pfwd.session.events import SessionNotice
from tui.output import clean, counted
from tui.screen.drawing.lines import Line, cell, line
from tui.screen.lines_view import LinesView
from tui.screen.pages.dialogs import Question
from tui.screen.pages.measure_view import key_line
from tui.screen.pages.page import Page
from tui.screen.pages.setup_form import (
    FIELDS,
    FIELDS_BY_NAME,
    OF_JOB,
    Field,
    chosen_procedure,
    error_of,
    form_text,
    job_request,
    plan_with,
    unit_of,
    value_of,
)

_SCREEN_SETTINGS: dict[str, tuple[str, tuple[tuple[str, str], ...]]] = {
    "units": ("units", (("SI (MPa, kN, µm)", "si"), ("US customary (ksi, lbf, mil)", "us"))),
    "theme": ("theme", (("dark", "dark"), ("daylight, high contrast", "daylight"))),
    "large": ("type", (("normal", "no"), ("large", "yes"))),
    "bell": ("bell", (("on", "yes"), ("off", "no"))),
}
_NO_PORT = ""


class SetupPage(Page):
    """Page with the form for port, plate, procedure, target and settings of the screen."""

    NAME = "setup"
    HELP = (
        "Port, plate, ground and procedure of the measurement; an entry here overrides the value "
        "of the instrument. Every entry is checked as it is typed. ctrl+s puts the setup in force: "
        "the session ends when the current drop is safe and starts again at the same point. Units, "
        "theme, type and bell change at once and are stored for next time. ctrl+f lists the ports, "
        "ctrl+p lists commands."
    )
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (
        ("ctrl+s", "put in force"),
        ("tab", "next field"),
        ("ctrl+f", "find ports"),
        ("escape", "back"),
        ("f1", "help"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+s", "take", "Put this setup in force", priority=True),
        Binding("ctrl+f", "find", "Find ports with an instrument", priority=True),
        Binding("escape", "back", "Back"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._units_name = ""

    @property
    def unsaved(self) -> str:
        """Question to ask because leaving would lose typed changes; empty: there are none."""
        return "The changes of the setup are not in force yet. Leave?" if self._changed() else ""

    def compose(self) -> ComposeResult:
        """Yield a line for each field."""
        yield LinesView(id="lines")
        with VerticalScroll(id="form"):
            for field in FIELDS:
                with Horizontal(classes="field"):
                    yield Label(self._title(field), classes="field-name", id=f"title-{field.name}")
                    yield Input(
                        clean(self._now(field)),
                        id=field.name,
                        compact=True,
                        placeholder=self._hint(field),
                        disabled=self._fixed(field),
                    )
                if field.name == "url":
                    with Horizontal(classes="field"):
                        yield Label("found", classes="field-name")
                        yield Select(
                            [("ctrl+f looks for instruments", _NO_PORT)],
                            value=_NO_PORT,
                            allow_blank=False,
                            compact=True,
                            id="found",
                        )
                if field.name == "poisson_ratio":
                    with Horizontal(classes="field"):
                        yield Label("procedure", classes="field-name")
                        yield Select(
                            [(name, name) for name in self._procedures()],
                            value=self._procedure(),
                            allow_blank=False,
                            compact=True,
                            id="procedure",
                        )
            for name, (title, choices) in _SCREEN_SETTINGS.items():
                with Horizontal(classes="field"):
                    yield Label(title, classes="field-name")
                    yield Select(
                        choices,
                        value=self._setting(name),
                        allow_blank=False,
                        compact=True,
                        id=name,
                    )
            yield Button("Put in force (ctrl+s)", id="take", compact=True)
        yield Label("", id="remark")
        yield LinesView(id="keys")

    def _procedures(self) -> list[str]:
        names = [PLAIN, *shipped_names()]
        return names if self._procedure() in names else [self._procedure(), *names]

    def _procedure(self) -> str:
        return self.pfwd.state.procedure.name

    def _judging(self) -> Procedure:
        """Return the procedure chosen in the form."""
        if not self.query("#procedure"):
            return self.pfwd.state.procedure
        name = str(self.query_one("#procedure", Select).value)
        return chosen_procedure(name, {}, self.pfwd.state.procedure)

    def _title(self, field: Field) -> str:
        unit = unit_of(field, self._judging(), self.pfwd.units)
        return f"{field.title}, {unit}" if unit else field.title

    def _hint(self, field: Field) -> str:
        """Return the meaning of an empty field."""
        count = len(self.pfwd.state.job.stations) if field.kind == "file" else 0
        return f"empty: the {counted(count, 'station')} of the survey" if count else field.hint

    def _setting(self, name: str) -> str:
        value = getattr(self.pfwd.settings, name)
        return value if isinstance(value, str) else "yes" if value else "no"

    def _fixed(self, field: Field) -> bool:
        """Return True for fields that a recording or a simulated instrument determines."""
        source = self.pfwd.source
        if field.name == "url":
            return not source.url or source.title == "demo"
        return source.pace is not None and field.name not in OF_JOB

    def _now(self, field: Field) -> str:
        app = self.pfwd
        if field.name == "url":
            return app.source.url
        job, procedure = app.state.job, app.state.procedure
        declared = app.source.plan.setup.declared
        in_force = {
            "measured": procedure.measured_drops,
            "seating_drops": procedure.seating_drops,
            "target": job.target,
            "step_m": job.step_m,
            "operator": job.operator,
        }
        value = in_force.get(field.name)
        if value is None:
            value = declared.get(field.name)
        return form_text(field, value, app.units, procedure)

    def _changed(self) -> bool:
        new_procedure = self.query_one("#procedure", Select).value != self._procedure()
        return new_procedure or any(
            self.query_one(f"#{field.name}", Input).value != clean(self._now(field))
            for field in FIELDS
        )

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the line above the form, with the plate that the session uses."""
        state = self.pfwd.state
        setup = state.setup
        plate = ""
        if setup is not None:
            units = self.pfwd.units
            radius = units.with_unit("length", setup.plate_radius)
            mass = units.with_unit("mass", setup.plate_mass)
            plate = f"  now: plate radius {radius}, mass {mass}"
        return [line(cell(" Setup ", "title"), cell(plate, "dim"))]

    def draw(self) -> None:
        """Draw the title and the keys; the form draws itself."""
        app = self.pfwd
        if not self.query("#keys"):
            return
        self.view.show(self.lines(self.size.width, 1), app.screen_theme)
        keys = self.query_one("#keys", LinesView)
        keys.show([key_line(self.KEYS, self.size.width)], app.screen_theme)
        if app.message:
            self._say(app.message)

    def _say(self, text: str) -> None:
        self.query_one("#remark", Label).update(Content(clean(text)))

    def on_mount(self) -> None:
        """Focus the first field that can be changed."""
        for field in self.query(Input):
            if not field.disabled:
                field.focus()
                break

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show the error of a field while it is typed."""
        field = FIELDS_BY_NAME.get(event.input.id or "")
        if field is None:
            return
        remarks: list[str] = []
        judging = self._judging()
        fault = error_of(field, event.value, self.pfwd.units, judging, remarks.append)
        event.input.set_class(bool(fault), "wrong")
        self._say(f"{field.title}: {fault}" if fault else " ".join(remarks) or field.hint)

    def on_input_submitted(self) -> None:
        """Go to the next field."""
        self.focus_next()

    def on_button_pressed(self) -> None:
        """Put the setup in force."""
        self.action_take()

    def on_select_changed(self, event: Select.Changed) -> None:
        """Apply a setting of the screen at once; copy a chosen port into its field."""
        name = event.select.id or ""
        if name == "found":
            if event.value != _NO_PORT:
                self.query_one("#url", Input).value = str(event.value)
            return
        if name == "procedure":
            target = FIELDS_BY_NAME["target"]
            self.query_one("#title-target", Label).update(Content(self._title(target)))
            return
        if name not in _SCREEN_SETTINGS or event.value == self._setting(name):
            return
        value: Any = str(event.value)
        self.pfwd.change(**{name: value == "yes" if name in ("large", "bell") else value})
        if name == "units":
            self.call_later(self._new_units)

    def _new_units(self) -> None:
        """Show all numbers in the new units; entries that are not in force are reset."""
        for field in FIELDS:
            if field.quantity is None and field.kind != "target":
                continue
            self.query_one(f"#title-{field.name}", Label).update(Content(self._title(field)))
            self.query_one(f"#{field.name}", Input).value = clean(self._now(field))

    def action_find(self) -> None:
        """List the ports and the instruments on them."""
        self._say("looking at all ports ...")
        self.run_worker(self._find, thread=True, group="ports", exit_on_error=False)

    def _find(self) -> None:
        from pfwd.ports import list_ports, probe_ports

        try:
            ports = list_ports()
            probes = probe_ports([port.url for port in ports]) if ports else []
        except (DeviceError, OSError) as err:
            self.app.call_from_thread(self._say, f"the ports could not be listed: {err}")
            return
        entries = []
        for port, probe in zip(ports, probes, strict=True):
            if probe.identity is not None:
                text = f"{probe.identity.model} {probe.identity.serial_number}"
            else:
                text = probe.reason.removeprefix(f"{port.url}: ") or "no answer"
            entries.append((f"{port.url}  {text}", port.url, probe.identity is not None))
        with contextlib.suppress(RuntimeError):  # the page is closed
            self.app.call_from_thread(self._show_ports, entries)

    def _show_ports(self, ports: list[tuple[str, str, bool]]) -> None:
        if not self.is_mounted:
            return
        ordered = sorted(ports, key=lambda port: not port[2])
        options = [(Content(clean(text)), url) for text, url, _ in ordered]
        first = (Content("none" if not options else "choose one"), _NO_PORT)
        self.query_one("#found", Select).set_options([first, *options])
        count = sum(port[2] for port in ports)
        self._say(f"{len(ports)} ports, {count} with an instrument")

    def action_take(self) -> None:
        """Put the setup in force if every field is right."""
        app = self.pfwd
        values: dict[str, Any] = {}
        remarks: list[str] = []
        judging = self._judging()
        for field in FIELDS:
            text = self.query_one(f"#{field.name}", Input).value
            try:
                values[field.name] = value_of(field, text, app.units, judging, remarks.append)
            except ValueError as err:
                self.query_one(f"#{field.name}", Input).focus()
                self._say(f"{field.title}: {err}")
                return
        try:
            procedure = chosen_procedure(judging.name, values, app.state.procedure)
            plan = plan_with(app.source.plan, values, procedure)
        except OptionError as err:
            self._say(str(err))
            return
        job = app.state.job
        same = dict(plan.setup.declared) == dict(app.source.plan.setup.declared)
        same = same and not JobRequest(procedure=procedure).news(job)
        url = str(values["url"] or "")
        if app.source.pace is None and (not same or url != app.source.url):
            app.restart(plan, url)
        else:
            app.edits.change_job(job_request(values).news(job))
        for text in remarks:
            app.runner.put(SessionNotice(text, serious=True))
        app.action_page("measure")

    def action_back(self) -> None:
        """Go back to the measure page; with unsaved changes after a question."""
        if not self.unsaved:
            self.pfwd.action_page("measure")
            return

        def answered(sure: bool | None) -> None:
            if sure:
                self.pfwd.action_page("measure")

        self.app.push_screen(Question(self.unsaved, "leave", "stay"), answered)
