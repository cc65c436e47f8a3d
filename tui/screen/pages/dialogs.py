"""Small questions on top of a page."""

from collections.abc import Callable
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Input, Label

from tui.output import clean


class TextDialog(ModalScreen[str | None]):
    """Asks for a line of text, checked as it is typed.

    Parameters
    ----------
    title : str
    value : str
        To begin with.
    check : callable
        What is wrong with a text; empty: nothing.
    question : callable
        What has to be answered with yes before a text is taken; empty: nothing.
    hint : str
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "cancel", "Back")]

    def __init__(
        self,
        title: str,
        value: str = "",
        *,
        check: Callable[[str], str] = lambda _: "",
        question: Callable[[str], str] = lambda _: "",
        hint: str = "enter takes it, escape goes back",
    ) -> None:
        super().__init__()
        self._title, self._value, self._check, self._hint = title, value, check, hint
        self._question = question

    def compose(self) -> ComposeResult:
        """A title, a line, what is wrong with it."""
        with Vertical(classes="dialog"):
            yield Label(Content(clean(self._title)), classes="dialog-title")
            yield Input(clean(self._value), id="text", select_on_focus=True)
            yield Label(Content(self._hint), id="remark")

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check what is typed."""
        fault = self._check(event.value)
        self.query_one("#remark", Label).update(Content(fault or self._hint))
        self.query_one("#text", Input).set_class(bool(fault), "wrong")

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Take it when it is right, and meant."""
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
        """Nothing is taken."""
        self.dismiss(None)


class Question(ModalScreen[bool]):
    """Yes or no; y and n, or enter for the safe answer."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "Yes"),
        Binding("n,escape,enter", "answer(False)", "No"),
    ]

    def __init__(self, text: str, yes: str, no: str) -> None:
        super().__init__()
        self._text, self._yes, self._no = text, yes, no

    def compose(self) -> ComposeResult:
        """The question."""
        with Vertical(classes="dialog"):
            yield Label(Content(clean(self._text)), classes="dialog-title")
            yield Label(Content(f"y {self._yes}     n {self._no}"))

    def action_answer(self, sure: bool) -> None:
        """Tell it."""
        self.dismiss(sure)
