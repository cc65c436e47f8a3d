"""Table and line of keys of the toolkit, faster where rows are plain text and keys stay."""

from collections.abc import Sequence
from typing import Any, ClassVar

from rich.cells import cell_len, set_cell_size
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual import events
from textual.binding import Binding, BindingType
from textual.screen import Screen
from textual.widgets import DataTable, Footer


class PlainTable(DataTable[Text], inherit_bindings=False):
    """Table whose cells are one line of text each, never interpreted as mark-up."""

    # Enter has one meaning on every tab and is listed among the keys; the toolkit's table hides it.
    BINDINGS: ClassVar[list[BindingType]] = [
        key for key in DataTable.BINDINGS if not (isinstance(key, Binding) and key.key == "enter")
    ]

    def fill(self, rows: Sequence[tuple[str, Sequence[str]]]) -> None:
        """Replace all rows; each has a key and its cells."""
        self.clear()
        for place, column in enumerate(self.ordered_columns):
            width = max((cell_len(cells[place]) for _, cells in rows), default=0)
            column.auto_width = False  # measuring every cell takes longer than drawing it
            column.width = max(width, cell_len(column.label.plain))
        for key, cells in rows:
            self.add_row(*map(Text, cells), key=key or None)

    @property
    def needed_width(self) -> int:
        """Columns that all columns and the scroll bar take."""
        columns = sum(column.width + 2 * self.cell_padding for column in self.ordered_columns)
        return columns + self.scrollbar_size_vertical

    def change(self, key: str, cells: Sequence[str]) -> None:
        """Replace the cells of the row with this key."""
        for column, text in zip(self.ordered_columns, cells, strict=True):
            self.update_cell(key, column.key, Text(text))
            column.width = max(column.width, cell_len(text))

    def _render_cell(
        self,
        row_index: int,
        column_index: int,
        base_style: Style,
        width: int,
        cursor: bool = False,
        hover: bool = False,
    ) -> list[list[Segment]]:
        """Return the segments of a cell, ten times as fast as the toolkit does for any content."""
        if row_index < 0 or column_index < 0:
            return super()._render_cell(
                row_index, column_index, base_style, width, cursor=cursor, hover=hover
            )
        base, after = self._get_styles_to_render_cell(
            False,
            False,
            False,
            hover,
            cursor,
            self.show_cursor,
            self._show_hover_cursor,
            self.cursor_foreground_priority == "css",
            self.cursor_background_priority == "css",
        )
        where = Style.from_meta({"row": row_index, "column": column_index})
        text = self.get_row_at(row_index)[column_index]
        edge = " " * self.cell_padding
        plain = set_cell_size(text.plain, max(0, width - 2 * self.cell_padding))
        return [[Segment(f"{edge}{plain}{edge}", base_style + where + base + after)]]


MIN_WIDTH_ALL_KEYS = 104
"""Smallest width with room for all keys and the palette, columns. Below it the keys stand closer
and the palette, which ctrl+p opens nevertheless, is not listed."""


class KeysLine(Footer):
    """Last line of the screen, with the keys that can be pressed now.

    The toolkit builds its line again whenever the focus moves, which takes 25 ms and happens three
    times for a change of the tab; this one is built only for other keys.
    """

    DEFAULT_CSS = """
    KeysLine.-compact FooterKey.-command-palette { display: none; }
    """

    _key_texts: tuple[tuple[str, str, bool], ...] = ()

    def on_resize(self, event: events.Resize) -> None:
        """Set the keys closer on a narrow terminal."""
        self.compact = event.size.width < MIN_WIDTH_ALL_KEYS

    def bindings_changed(self, screen: Screen[Any]) -> None:
        """Build the line again if a key, its text or its state has changed."""
        texts = tuple(
            (key, active.binding.description, active.enabled)
            for key, active in screen.active_bindings.items()
            if active.binding.show
        )
        if texts == self._key_texts or not screen.app.app_focus:
            return
        self._key_texts = texts
        super().bindings_changed(screen)
