"""The toolkit's table for rows of plain text: a page of them within the answer to a key."""

from collections.abc import Sequence
from typing import ClassVar

from rich.cells import cell_len, set_cell_size
from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual.binding import Binding, BindingType
from textual.widgets import DataTable


class PlainTable(DataTable[Text], inherit_bindings=False):
    """A table whose cells are one line of text each, never read as mark-up."""

    # Enter means the same on every tab, and is named among the keys; the toolkit's table hides it.
    BINDINGS: ClassVar[list[BindingType]] = [
        key for key in DataTable.BINDINGS if not (isinstance(key, Binding) and key.key == "enter")
    ]

    def fill(self, rows: Sequence[tuple[str, Sequence[str]]]) -> None:
        """Other rows in place of all: a key and the cells of each."""
        self.clear()
        for place, column in enumerate(self.ordered_columns):
            wide = max((cell_len(cells[place]) for _, cells in rows), default=0)
            column.auto_width = False  # measuring every cell takes longer than drawing it
            column.width = max(wide, cell_len(column.label.plain))
        for key, cells in rows:
            self.add_row(*map(Text, cells), key=key or None)

    def change(self, key: str, cells: Sequence[str]) -> None:
        """Other cells in the row with this key."""
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
        """One cell; the toolkit takes ten times as long, since a cell of it may be anything."""
        if row_index < 0 or column_index < 0:
            return super()._render_cell(
                row_index, column_index, base_style, width, cursor=cursor, hover=hover
            )
        own, after = self._get_styles_to_render_cell(
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
        shown = set_cell_size(text.plain, max(0, width - 2 * self.cell_padding))
        return [[Segment(f"{edge}{shown}{edge}", base_style + where + own + after)]]
