"""Widget for lines of cells that redraws changed lines only."""

from collections.abc import Sequence

from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter
from textual.geometry import Region
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Line
from tui.screen.themes import DARK, ScreenTheme


class LinesView(Widget, can_focus=True):
    """Widget that shows lines of cells; their text is never interpreted as mark-up."""

    DEFAULT_CSS = "LinesView { width: 1fr; height: 1fr; }"

    class Clicked(Message):
        """Message: the mouse was clicked in a cell of the widget."""

        def __init__(self, row: int, column: int) -> None:
            super().__init__()
            self.row = row
            self.column = column

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._lines: list[Line] = []
        self._theme: ScreenTheme = DARK

    def show(self, lines: Sequence[Line], theme: ScreenTheme) -> int:
        """Show these lines in place of the former ones; return the number of lines that differ."""
        new = list(lines)
        if theme is not self._theme or len(new) != len(self._lines):
            self._theme, self._lines = theme, new
            self.refresh()
            return len(new)
        changed = [
            row for row, pair in enumerate(zip(self._lines, new, strict=True)) if pair[0] != pair[1]
        ]
        self._lines = new
        if changed:
            width = self.size.width
            self.refresh(*[Region(0, row, width, 1) for row in changed])
        return len(changed)

    @property
    def text(self) -> str:
        """Lines on the screen as plain text."""
        return "\n".join("".join(piece.text for piece in row).rstrip() for row in self._lines)

    def render_line(self, y: int) -> Strip:
        """Return line `y` of the widget as styled text for the toolkit."""
        width = self.size.width
        styles = self._theme.styles
        cells = self._lines[y] if y < len(self._lines) else ()
        segments = [Segment(part.text, styles[part.role]) for part in cells]
        return Strip(segments).adjust_cell_length(width, styles["text"])

    def on_click(self, event: object) -> None:
        """Report the position of a click to the page."""
        row, column = getattr(event, "y", 0), getattr(event, "x", 0)
        self.post_message(self.Clicked(row, column))


class GlyphFilter(LineFilter):
    """Filter of an application that replaces the characters that the terminal lacks, also those of
    the toolkit's own widgets.
    """

    def __init__(self, glyphs: Glyphs) -> None:
        super().__init__(enabled=not glyphs.has_dots)
        self._glyphs = glyphs

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments of a line with replaced characters."""
        show = self._glyphs.to_terminal
        return [Segment(show(text), style, control) for text, style, control in segments]
