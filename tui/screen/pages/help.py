"""Help of a page: its purpose, every key, and the last messages."""

from collections.abc import Sequence
from typing import Any, ClassVar

from textual.app import App
from textual.binding import Binding, BindingType

from tui.screen.drawing.lines import Line, cell, line, wrap
from tui.screen.pages import PAGES, make_page
from tui.screen.pages.measure_view import key_line
from tui.screen.pages.page import Page

_TOOLKIT_ACTIONS = ("app.focus_next", "app.focus_previous", "screen.copy_text")
"""Actions that the toolkit adds to every page and that have no effect on lines of text."""


class HelpPage(Page):
    """Page with the purpose, the keys and the words of the page that it covers."""

    NAME = "help"
    HELP = "Keys of the page that you came from."
    KEYS: ClassVar[Sequence[tuple[str, str]]] = (("escape", "back"), ("up/down", "scroll"))
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,question_mark,f1,enter,q", "back", "Back"),
        Binding("up", "scroll_by(-1)", "Up"),
        Binding("down", "scroll_by(1)", "Down"),
        Binding("pageup", "scroll_by(-10)", "Page up"),
        Binding("pagedown", "scroll_by(10)", "Page down"),
    ]

    def __init__(self, about: Page) -> None:
        super().__init__()
        self._about = about
        self._first = 0

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the help."""
        text = self._content(width)
        room = height - 2
        self._first = max(0, min(self._first, len(text) - room))
        body = [*text[self._first : self._first + room], *[()] * room][:room]
        title = line(cell(f" Help: {self._about.NAME} ", "title"))
        return [title, *body, key_line(self.KEYS, width)]

    def _content(self, width: int) -> list[Line]:
        lines: list[Line] = [()]
        lines += [line(" ", row) for row in wrap(self._about.HELP, width - 2)]
        lines.append(())
        # The keys of the page stand before those of all pages.
        keys = {**self._keys_of(self._about), **self._keys_of(self.app)}
        for (_, description), displays in keys.items():
            # Of several keys the plain one: the line of keys on the page shows it too.
            key = min(displays, key=lambda display: (display.startswith("^"), len(display)))
            lines.append(line(" ", cell(f"{key:>10}", "key"), f"  {description}"))
        lines += [(), line(cell(" Keys of the other pages", "strong"))]
        for entry in PAGES:
            if entry.name != self._about.NAME:
                keys_of_page = make_page(entry.name).KEYS
                listed = ", ".join(f"{key} {effect}" for key, effect in keys_of_page)
                lines += [line(" ", row) for row in wrap(f"{entry.title}: {listed}", width - 2)]
        if self._about.WORDS:
            lines += [(), line(cell(" Words and marks of the page", "strong"))]
            widest = max(map(len, self._about.WORDS))
            for word, meaning in self._about.WORDS.items():
                first, *more = wrap(meaning, max(20, width - widest - 4))
                lines.append(line(" ", cell(f"{word:>{widest}}", "key"), f"  {first}"))
                lines += [line(" " * (widest + 3), text) for text in more]
        lines += [(), line(cell(" Last messages", "strong"))]
        notices = list(self.pfwd.state.notices)[-20:]
        for when, notice in reversed(notices):
            mark = "! " if notice.serious else "  "
            texts = wrap(f"{when:%H:%M:%S} {mark}{notice.text}", width - 2)
            lines += [line(" ", cell(row, "warn" if notice.serious else "text")) for row in texts]
        if not notices:
            lines.append(line(cell(" none", "dim")))
        folder = self.pfwd.source.survey
        if folder is not None:
            lines += [(), line(cell(f" The log with everything: {folder}/log/pfwd.log", "dim"))]
        return lines

    def _keys_of(self, node: Page | App[Any]) -> dict[tuple[str, str], list[str]]:
        """Return the keys of a page, or of all pages, by action and description."""
        keys: dict[tuple[str, str], list[str]] = {}
        for bindings in node._bindings.key_to_bindings.values():
            for binding in bindings:
                action = binding.action.partition("(")[0]
                is_listed = binding.description and binding.action not in _TOOLKIT_ACTIONS
                if is_listed and node.check_action(action, ()):
                    display = self.app.get_key_display(binding)
                    keys.setdefault((binding.action, binding.description), []).append(display)
        return keys

    def action_back(self) -> None:
        """Close the help."""
        self.app.pop_screen()

    def action_scroll_by(self, rows: int) -> None:
        """Scroll the help by this number of rows."""
        self._first += rows
        self.draw()
