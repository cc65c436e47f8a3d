"""What all pages share: lines that fill the terminal, and keys."""

from collections.abc import Sequence
from typing import ClassVar, cast

from textual.app import ComposeResult
from textual.screen import Screen

from tui.screen.drawing.lines import Line
from tui.screen.pages.host import Host
from tui.screen.widgets.lines_view import LinesView

LEAST_WIDTH, LEAST_HEIGHT = 40, 10
"""Below this nothing useful fits."""


class Page(Screen[None]):
    """A screen made of lines."""

    NAME: ClassVar[str] = ""
    HELP: ClassVar[str] = ""
    """What this page is for, in a few sentences."""
    KEYS: ClassVar[Sequence[tuple[str, str]]] = ()
    """Keys and what they do, most important first, for the last line and for the help."""

    def compose(self) -> ComposeResult:
        """The lines."""
        yield LinesView(id="lines")

    @property
    def pfwd(self) -> Host:
        """The application."""
        return cast(Host, self.app)

    @property
    def view(self) -> LinesView:
        """The widget with the lines."""
        return self.query_one("#lines", LinesView)

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """What is shown now."""
        raise NotImplementedError

    def draw(self) -> None:
        """Show what is to be shown now; nothing before the page is made."""
        if not self.query("#lines"):
            return
        size = self.view.size
        if size.width and size.height:
            self.view.show(self.lines(size.width, size.height), self.pfwd.look, self.pfwd.glyphs)

    def on_screen_resume(self) -> None:
        """Back on top."""
        self.call_after_refresh(self.draw)

    def on_resize(self) -> None:
        """Another size."""
        self.call_after_refresh(self.draw)
