"""A widget that shows lines of cells, and redraws only those that have changed."""

from collections.abc import Sequence

from rich.segment import Segment
from textual.geometry import Region
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from tui.screen.drawing.glyphs import BRAILLE, Glyphs
from tui.screen.drawing.lines import Line
from tui.screen.looks import DARK, Look


class LinesView(Widget, can_focus=True):
    """Shows what it is given; no text in it is ever read as mark-up."""

    DEFAULT_CSS = "LinesView { width: 1fr; height: 1fr; }"

    class Clicked(Message):
        """A row was clicked."""

        def __init__(self, row: int, column: int) -> None:
            super().__init__()
            self.row = row
            self.column = column

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._shown: list[Line] = []
        self._look: Look = DARK
        self._glyphs: Glyphs = BRAILLE

    def show(self, lines: Sequence[Line], look: Look, glyphs: Glyphs) -> int:
        """Show lines; how many of them have changed."""
        new = list(lines)
        if look is not self._look or glyphs != self._glyphs or len(new) != len(self._shown):
            self._look, self._glyphs, self._shown = look, glyphs, new
            self.refresh()
            return len(new)
        changed = [
            row for row, pair in enumerate(zip(self._shown, new, strict=True)) if pair[0] != pair[1]
        ]
        self._shown = new
        if changed:
            width = self.size.width
            self.refresh(*[Region(0, row, width, 1) for row in changed])
        return len(changed)

    @property
    def text(self) -> str:
        """What is shown, as plain text."""
        return "\n".join("".join(piece.text for piece in row).rstrip() for row in self._shown)

    def render_line(self, y: int) -> Strip:
        """One line for the terminal."""
        width = self.size.width
        styles = self._look.styles
        cells = self._shown[y] if y < len(self._shown) else ()
        segments = [
            Segment(self._glyphs.to_terminal(part.text), styles[part.role]) for part in cells
        ]
        return Strip(segments).adjust_cell_length(width, styles["text"])

    def on_click(self, event: object) -> None:
        """Tell the page where."""
        row, column = getattr(event, "y", 0), getattr(event, "x", 0)
        self.post_message(self.Clicked(row, column))
