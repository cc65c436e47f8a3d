"""Asks with which settings a drop is fitted anew; checked as they are chosen."""

from collections.abc import Callable
from typing import Any, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Label, Select

from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import OptionError

_CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "layers": ("layers", ("1", "2", "3", "4", "auto")),
    "model": ("model", ("layer", "half-space")),
    "load": ("load", ("measured", "half-sine")),
    "plate": ("plate", ("rigid-rough", "rigid-smooth", "published")),
    "sensors": ("sensors", ("all", "centre")),
    "method": ("method", ("mpga", "least-squares")),
    "elastic": ("viscosity", ("fitted", "none (elastic)")),
}
_OPEN = "as declared"
_CHOSEN: dict[str, Callable[[str], Any]] = {
    "elastic": lambda value: value.startswith("none"),
    "layers": lambda value: value if value == "auto" else int(value),
}
"""What a word stands for, where it is not said as it is shown."""


class RefitDialog(ModalScreen[AnalysisOptions | None]):
    """Settings of one fit."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "cancel", "Back"),
        Binding("ctrl+s", "take", "Fit"),
    ]

    def compose(self) -> ComposeResult:
        """A choice a line."""
        with VerticalScroll(classes="dialog"):
            yield Label("Fit this drop with other settings", classes="dialog-title")
            for name, (title, values) in _CHOICES.items():
                with Horizontal(classes="field"):
                    yield Label(title, classes="field-name")
                    yield Select(
                        [(value, value) for value in (_OPEN, *values)],
                        value=_OPEN,
                        allow_blank=False,
                        compact=True,
                        id=name,
                    )
            for name, title in (("depth", "bedrock, m"), ("ratio", "Poisson's ratio")):
                with Horizontal(classes="field"):
                    yield Label(title, classes="field-name")
                    yield Input(id=name, compact=True, placeholder=_OPEN)
            yield Label("ctrl+s fits, escape goes back", id="remark")
            yield Button("Fit", id="fit", compact=True)

    def on_mount(self) -> None:
        """Begin with the model."""
        self.query_one("#model", Select).focus()

    def options(self) -> AnalysisOptions:
        """What is chosen.

        Raises
        ------
        OptionError
            If it contradicts itself.
        """
        chosen: dict[str, Any] = {}
        for name in _CHOICES:
            value = self.query_one(f"#{name}", Select).value
            if value == _OPEN:
                continue
            chosen[name] = _CHOSEN[name](str(value)) if name in _CHOSEN else value
        depth = self.query_one("#depth", Input).value.strip()
        if depth:
            chosen["bedrock_depth"] = depth if depth in ("unknown", "none") else _number(depth)
        ratio = self.query_one("#ratio", Input).value.strip()
        if ratio:
            chosen["poisson_ratio"] = _number(ratio)
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
        """Check what is chosen."""
        self._check()

    def on_input_changed(self) -> None:
        """Check what is typed."""
        self._check()

    def on_input_submitted(self) -> None:
        """Take it."""
        self.action_take()

    def on_button_pressed(self) -> None:
        """Take it."""
        self.action_take()

    def action_take(self) -> None:
        """Take it when it is right."""
        options = self._check()
        if options is not None:
            self.dismiss(options)

    def action_cancel(self) -> None:
        """Nothing is fitted."""
        self.dismiss(None)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(f"expected a number, got {ascii(text)[:20]}") from None
