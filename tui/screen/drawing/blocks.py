"""Blocks of lines: one beside the other, and tables whose columns give way instead of numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

from tui.screen.drawing.lines import Cell, Line, TextRole, cell, line, pad, shorten, width_of, wrap


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of a table."""

    title: str
    rank: int
    """The highest goes first when there is no room."""
    left: bool = False
    """Text stands at the left, numbers at the right."""
    free: bool = False
    """Free text, which takes what room is left and may be shortened."""


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row of a table."""

    texts: tuple[str, ...]
    role: TextRole = "text"
    chosen: bool = False
    key: object = None
    """What it stands for."""


GAP = 2


def table_lines(columns: Sequence[TableColumn], rows: Sequence[TableRow], width: int) -> list[Line]:
    """A table with its titles, as many columns as fit; every number whole."""
    shown = list(range(len(columns)))
    widths = [
        max([len(column.title), *(len(row.texts[place]) for row in rows)])
        for place, column in enumerate(columns)
    ]
    least = [6 if column.free else widths[place] for place, column in enumerate(columns)]

    def total() -> int:
        return 1 + sum(least[place] for place in shown) + GAP * (len(shown) - 1)

    while len(shown) > 1 and total() > width:
        shown.remove(max(shown, key=lambda place: columns[place].rank))
    spare = width - total()
    for place in shown:
        if columns[place].free:
            given = min(widths[place], least[place] + max(0, spare))
            spare -= given - least[place]
            widths[place] = given
    lines = [_table_row([column.title for column in columns], columns, shown, widths, "dim", False)]
    for row in rows:
        lines.append(_table_row(row.texts, columns, shown, widths, row.role, row.chosen))
    return [pad(row, width) for row in lines]


def _table_row(
    texts: Sequence[str],
    columns: Sequence[TableColumn],
    shown: Sequence[int],
    widths: Sequence[int],
    role: TextRole,
    chosen: bool,
) -> Line:
    parts = []
    for place in shown:
        text = texts[place]
        if columns[place].free:
            text = shorten(text, widths[place])
        left = columns[place].left or columns[place].free
        parts.append(text.ljust(widths[place]) if left else text.rjust(widths[place]))
    mark = "▶" if chosen else " "
    return (Cell(mark + (" " * GAP).join(parts), "cursor" if chosen else role),)


def window(count: int, chosen: int | None, room: int) -> range:
    """Which of so many rows are shown, so that the chosen one is among them; the newest last."""
    if count <= room:
        return range(count)
    last = count if chosen is None else min(count, max(room, chosen + 1))
    return range(max(0, last - room), last)


def beside(
    left: Sequence[Line], right: Sequence[Line], left_width: int, rows: int, gap: str = " │ "
) -> list[Line]:
    """Two blocks side by side, of so many rows."""
    lines: list[Line] = []
    for row in range(rows):
        shown = left[row] if row < len(left) else ()
        other = right[row] if row < len(right) else ()
        lines.append((*pad(shown, left_width), Cell(gap, "axis"), *other))
    return lines


def headed(head: Line, said: str, width: int) -> list[Line]:
    """A head with what was said beside it; a sentence is never cut, it takes lines of its own."""
    if width_of([*head, Cell(said)]) + 2 <= width:
        return [(*head, Cell(f"  {said}", "warn"))] if said else [head]
    return [head, *[line(" ", cell(text, "warn")) for text in wrap(said, width - 2)[:3]]]


def exactly(lines: Sequence[Line], rows: int) -> list[Line]:
    """So many lines: empty ones added, or the last ones left out."""
    return [*lines[:rows], *[()] * max(0, rows - len(lines))]


def centred(lines: Sequence[Line], width: int) -> list[Line]:
    """A block in the middle of a width."""
    widest = max((width_of(row) for row in lines), default=0)
    indent = max(0, (width - widest) // 2)
    return [(Cell(" " * indent), *row) for row in lines]
