"""Dialogs on top of a page: a line of text, a question, the settings of a fit."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Label, Select

from pfwd.analysis.options import PLATE_WORDS, AnalysisOptions, parse_option
from pfwd.errors import OptionError
from tui.format import word
from tui.output import clean
from tui.screen.drawing.lines import window
from tui.screen.pages.drop_texts import METHOD_TEXTS, MODEL_TEXTS


class TextDialog(ModalScreen[str | None]):
    """Dialog for a line of text that is checked as it is typed.

    Parameters
    ----------
    title : str
    value : str
        Proposed text.
    check : callable
        Returns the error of a text; empty: none.
    question : callable
        Returns a question to confirm before a text is accepted; empty: none.
    hint : str
        Line below the field.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "cancel", "Back")]

    def __init__(
        self,
        title: str,
        value: str = "",
        *,
        check: Callable[[str], str] = lambda _: "",
        question: Callable[[str], str] = lambda _: "",
        hint: str = "enter confirms, escape goes back",
    ) -> None:
        super().__init__()
        self._title, self._value, self._check, self._hint = title, value, check, hint
        self._question = question

    def compose(self) -> ComposeResult:
        """Yield the title, the field and a line for errors."""
        with Vertical(classes="dialog"):
            yield Label(Content(clean(self._title)), classes="dialog-title")
            yield Input(clean(self._value), id="text", select_on_focus=True)
            yield Label(Content(self._hint), id="remark")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show the error of the text while it is typed."""
        fault = self._check(event.value)
        self.query_one("#remark", Label).update(Content(fault or self._hint))
        self.query_one("#text", Input).set_class(bool(fault), "wrong")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Close with the text if it has no error and is confirmed."""
        text = event.value
        if self._check(text):
            return
        question = self._question(text)
        if not question:
            self.dismiss(text)
            return

        def answered(sure: bool | None) -> None:
            if sure:
                self.dismiss(text)

        self.app.push_screen(Question(question, "yes", "no, type it again"), answered)

    def action_cancel(self) -> None:
        """Close without a text."""
        self.dismiss(None)


class PointDialog(TextDialog):
    """Dialog for the name of a point with a list of the points; up and down choose one.

    Parameters
    ----------
    title : str
    points : sequence of (name, remark)
        Points of the list, each with a remark such as its number of drops.
    check, question : callable
        As for `TextDialog`.
    """

    ROWS: ClassVar[int] = 8
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "choose(-1)", "Point before"),
        Binding("down", "choose(1)", "Point after"),
    ]

    def __init__(
        self,
        title: str,
        points: Sequence[tuple[str, str]],
        *,
        check: Callable[[str], str],
        question: Callable[[str], str],
    ) -> None:
        hint = "up/down chooses a point, or type a name; enter confirms, escape goes back"
        super().__init__(title, check=check, question=question, hint=hint)
        self._points = [(clean(name), clean(remark)) for name, remark in points]

    def compose(self) -> ComposeResult:
        """Yield the title, the field, the list of points and a line for errors."""
        with Vertical(classes="dialog"):
            yield Label(Content(clean(self._title)), classes="dialog-title")
            yield Input(id="text")
            yield Label(self._list_of_points(""), id="points")
            yield Label(Content(self._hint), id="remark")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check the name and mark it in the list."""
        super().on_input_changed(event)
        self.query_one("#points", Label).update(self._list_of_points(event.value))

    def _list_of_points(self, name: str) -> Content:
        names = [point for point, _ in self._points]
        place = names.index(name) if name in names else None
        visible = window(len(names), 0 if place is None else place, self.ROWS)
        widest = max(map(len, names), default=0)
        rows = [
            f"{'▶' if at == place else ' '} {names[at]:{widest}}  {self._points[at][1]}"
            for at in visible
        ]
        if len(rows) < len(names):
            rows.append(f"  {len(names)} points")
        return Content("\n".join(rows))

    def action_choose(self, step: int) -> None:
        """Put the name of another point into the field."""
        names = [point for point, _ in self._points]
        if not names:
            return
        field = self.query_one("#text", Input)
        start = -1 if step > 0 else 0
        place = names.index(field.value) if field.value in names else start
        field.value = names[(place + step) % len(names)]
        field.cursor_position = len(field.value)


class Question(ModalScreen[bool]):
    """Dialog with a question answered by y or n; enter gives the safe answer, no."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "Yes"),
        Binding("n,escape,enter", "answer(False)", "No"),
    ]

    def __init__(self, text: str, yes: str, no: str) -> None:
        super().__init__()
        self._text, self._yes, self._no = text, yes, no

    def compose(self) -> ComposeResult:
        """Yield the question and its answers."""
        with Vertical(classes="dialog"):
            yield Label(Content(clean(self._text)), classes="dialog-title")
            yield Label(Content(f"y {self._yes}     n {self._no}"))

    def action_answer(self, sure: bool) -> None:
        """Close the dialog; the result is True for yes."""
        self.dismiss(sure)


_REFIT_CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "layers": ("layers", ("1", "2", "3", "4", "auto")),
    "model": ("ground", ("layer", "half-space")),
    "load": ("load", ("measured", "half-sine")),
    "plate": ("plate", ("rigid-rough", "rigid-smooth", "published")),
    "sensors": ("sensors", ("all", "centre")),
    "method": ("method", ("mpga", "posterior")),
    "elastic": ("viscosity", ("fitted", "none (elastic)")),
}
_CHOICE_WORDS = {**MODEL_TEXTS, **PLATE_WORDS, **METHOD_TEXTS}
"""Words for choices that are values of the JSON output."""

_AS_DECLARED = "as declared"
_CONVERSIONS: dict[str, Callable[[str], Any]] = {
    "elastic": lambda value: value.startswith("none"),
    "layers": partial(parse_option, "layers"),
}
"""Conversions from a choice to the value of the option, where they differ."""


class RefitDialog(ModalScreen[AnalysisOptions | None]):
    """Dialog for the settings of a fit, checked as they are chosen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "cancel", "Back"),
        Binding("ctrl+s", "take", "Fit"),
    ]

    def compose(self) -> ComposeResult:
        """Yield a line for each choice."""
        with VerticalScroll(classes="dialog"):
            yield Label("Fit this drop with other settings", classes="dialog-title")
            for name, (title, values) in _REFIT_CHOICES.items():
                with Horizontal(classes="field"):
                    yield Label(title, classes="field-name")
                    yield Select(
                        [(word(_CHOICE_WORDS, value), value) for value in (_AS_DECLARED, *values)],
                        value=_AS_DECLARED,
                        allow_blank=False,
                        compact=True,
                        id=name,
                    )
            for name, title in (("depth", "bedrock, m"), ("ratio", "Poisson's ratio")):
                with Horizontal(classes="field"):
                    yield Label(title, classes="field-name")
                    yield Input(id=name, compact=True, placeholder=_AS_DECLARED)
            yield Label("ctrl+s fits, escape goes back", id="remark")
            yield Button("Fit", id="fit", compact=True)

    def on_mount(self) -> None:
        """Focus the choice of the model."""
        self.query_one("#model", Select).focus()

    def options(self) -> AnalysisOptions:
        """Return the settings of the fit that are chosen in the dialog.

        Raises
        ------
        OptionError
            If the choices contradict each other.
        """
        chosen: dict[str, Any] = {}
        for name in _REFIT_CHOICES:
            value = self.query_one(f"#{name}", Select).value
            if value == _AS_DECLARED:
                continue
            chosen[name] = _CONVERSIONS[name](str(value)) if name in _CONVERSIONS else value
        depth = self.query_one("#depth", Input).value.strip()
        if depth:
            chosen["bedrock_depth"] = parse_option("bedrock_depth", depth)
        ratio = self.query_one("#ratio", Input).value.strip()
        if ratio:
            chosen["poisson_ratio"] = parse_option("poisson_ratio", ratio)
        return AnalysisOptions(**chosen)

    def _check(self) -> AnalysisOptions | None:
        remark = self.query_one("#remark", Label)
        try:
            options = self.options()
        except OptionError as err:
            remark.update(Content(str(err)))
            return None
        remark.update(Content("ctrl+s fits, escape goes back"))
        return options

    def on_select_changed(self) -> None:
        """Show why the choices contradict each other, if they do."""
        self._check()

    def on_input_changed(self) -> None:
        """Show the error of a number while it is typed."""
        self._check()

    def on_input_submitted(self) -> None:
        """Start the fit."""
        self.action_take()

    def on_button_pressed(self) -> None:
        """Start the fit."""
        self.action_take()

    def action_take(self) -> None:
        """Close with the options if they have no error."""
        options = self._check()
        if options is not None:
            self.dismiss(options)

    def action_cancel(self) -> None:
        """Close without a fit."""
        self.dismiss(None)
