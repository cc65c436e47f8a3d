"""Lines of text with roles in place of colours, and tables; a number is never cut to fit.

All text from a device, a file or the operator passes through `cell`, which removes control
characters.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Literal

from rich.cells import cell_len, set_cell_size

from tui.output import clean

TextRole = Literal[
    "text",
    "dim",
    "strong",
    "title",
    "good",
    "bad",
    "warn",
    "load",
    "measured",
    "fitted",
    "residual",
    "axis",
    "cursor",
    "key",
    "ready",
    "busy",
    "alarm",
]
"""Role of a piece of text; the theme gives each role its colours."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Text of one colour and weight within a line."""

    text: str
    role: TextRole = "text"


Line = tuple[Cell, ...]


def cell(text: object, role: TextRole = "text") -> Cell:
    """Return a cell with this text, from which control characters are removed."""
    return Cell(clean(text), role)


def line(*parts: Cell | object) -> Line:
    """Return a line of cells; other values are converted to cells."""
    return tuple(part if isinstance(part, Cell) else cell(part) for part in parts)


def width_of(parts: Iterable[Cell]) -> int:
    """Return the number of columns that cells take."""
    return sum(cell_len(part.text) for part in parts)


def text_of(parts: Iterable[Cell]) -> str:
    """Return the text of cells without their roles."""
    return "".join(part.text for part in parts)


def joined(letters: Iterable[tuple[str, TextRole]]) -> Line:
    """Return a line with one cell for adjacent letters of the same role, which is drawn faster."""
    runs = groupby(letters, key=itemgetter(1))
    return tuple(Cell("".join(letter for letter, _ in run), role) for role, run in runs)


def shorten(text: str, width: int) -> str:
    """Return free text, ended by ``..`` where it does not fit; not to be used for numbers."""
    if cell_len(text) <= width:
        return text
    if width < 3:
        return " " * max(0, width)
    head = set_cell_size(text, width - 2).rstrip()
    rest = text[len(head) :]
    word = head.rpartition(" ")[2]
    has_break = len(word) < len(head)  # a single word that long can only be cut
    if (
        has_break
        and rest[:1].strip()
        and any(letter.isdigit() for letter in word + rest.split(" ")[0])
    ):
        # Half a number is another number.
        head = head[: len(head) - len(word)].rstrip()
    return head + ".."


def pad(parts: Line, width: int) -> Line:
    """Return a line filled with blanks to a width."""
    missing = width - width_of(parts)
    return (*parts, Cell(" " * missing)) if missing > 0 else parts


def wrap(text: str, width: int) -> list[str]:
    """Break free text between words into several lines."""
    lines, now = [], ""
    for word in text.split():
        while cell_len(word) > width > 0:
            if now:
                lines.append(now)
                now = ""
            head = set_cell_size(word, width).rstrip()
            lines.append(head)
            word = word[len(head) :]
        trial = f"{now} {word}" if now else word
        if cell_len(trial) <= width:
            now = trial
        else:
            lines.append(now)
            now = word
    return [*lines, now] if now else lines or [""]


@dataclass(frozen=True, slots=True)
class Piece:
    """Part of a line that is never cut: without room for it, it is dropped."""

    cells: Line
    rank: int
    """Order of importance; the piece with the highest rank is dropped first."""


def piece(rank: int, *parts: Cell | object) -> Piece:
    """Return a `Piece` of some cells or texts; pieces of the highest rank are dropped first."""
    return Piece(line(*parts), rank)


def fit(pieces: Sequence[Piece], width: int, gap: str = "  ") -> Line:
    """Return the pieces that fit on a line, in their order; the highest ranks are dropped."""
    chosen = [part for part in pieces if width_of(part.cells)]
    while chosen and _total(chosen, gap) > width:
        chosen.remove(max(reversed(chosen), key=lambda part: part.rank))
    return _joined(chosen, gap)


def flow(pieces: Sequence[Piece], width: int, rows: int, gap: str = "  ") -> list[Line]:
    """Return pieces on at most `rows` lines; the highest ranks are dropped without room."""
    chosen = [part for part in pieces if width_of(part.cells)]
    while chosen:
        lines: list[list[Piece]] = [[]]
        for part in chosen:
            if lines[-1] and _total([*lines[-1], part], gap) > width:
                lines.append([])
            lines[-1].append(part)
        too_wide = [part for part in chosen if width_of(part.cells) > width]
        if len(lines) <= rows and not too_wide:
            return [_joined(parts, gap) for parts in lines]
        chosen.remove(max(reversed(too_wide or chosen), key=lambda part: part.rank))
    return [()]


def _total(pieces: Sequence[Piece], gap: str) -> int:
    return sum(width_of(part.cells) for part in pieces) + cell_len(gap) * (len(pieces) - 1)


def _joined(pieces: Sequence[Piece], gap: str) -> Line:
    cells: list[Cell] = []
    for part in pieces:
        if cells:
            cells.append(Cell(gap))
        cells += part.cells
    return tuple(cells)


def both_ends(start: Line, end: Line, width: int) -> Line:
    """Return a line with text at both ends; the right one is dropped when there is no room."""
    room = width - width_of(start) - width_of(end)
    return (*start, Cell(" " * room), *end) if room >= 1 else start


@dataclass(frozen=True, slots=True)
class TableColumn:
    """Title, alignment and importance of a column of a table."""

    title: str
    rank: int
    """Order of importance; the column with the highest rank is dropped first."""
    is_text: bool = False
    """Aligned at the left, as text; numbers are aligned at the right."""
    is_flexible: bool = False
    """Free text, which takes the remaining width and may be shortened."""


@dataclass(frozen=True, slots=True)
class TableRow:
    """Texts of a row of a table, one for each column, and how the row is drawn."""

    texts: tuple[str, ...]
    role: TextRole = "text"
    chosen: bool = False


COLUMN_GAP = 2
"""Blank columns between two columns of a table."""


def table_lines(columns: Sequence[TableColumn], rows: Sequence[TableRow], width: int) -> list[Line]:
    """Return a table with its titles; columns without room are dropped, numbers are never cut."""
    visible = list(range(len(columns)))
    widths = [
        max([len(column.title), *(len(row.texts[place]) for row in rows)])
        for place, column in enumerate(columns)
    ]
    min_widths = [6 if column.is_flexible else widths[n] for n, column in enumerate(columns)]

    def total() -> int:
        return 1 + sum(min_widths[place] for place in visible) + COLUMN_GAP * (len(visible) - 1)

    while len(visible) > 1 and total() > width:
        visible.remove(max(visible, key=lambda place: columns[place].rank))
    spare = width - total()
    for place in visible:
        if columns[place].is_flexible:
            widths[place] = min(widths[place], min_widths[place] + max(0, spare))
            spare -= widths[place] - min_widths[place]
    titles = [column.title for column in columns]
    lines = [_table_row(titles, columns, visible, widths, "dim", False)]
    for row in rows:
        lines.append(_table_row(row.texts, columns, visible, widths, row.role, row.chosen))
    return [pad(row, width) for row in lines]


def _table_row(
    texts: Sequence[str],
    columns: Sequence[TableColumn],
    visible: Sequence[int],
    widths: Sequence[int],
    role: TextRole,
    chosen: bool,
) -> Line:
    parts = []
    for place in visible:
        text = texts[place]
        column = columns[place]
        if column.is_flexible:
            text = shorten(text, widths[place])
        is_text = column.is_text or column.is_flexible
        parts.append(text.ljust(widths[place]) if is_text else text.rjust(widths[place]))
    mark = "▶" if chosen else " "
    return (Cell(mark + (" " * COLUMN_GAP).join(parts), "cursor" if chosen else role),)


def window(count: int, chosen: int | None, room: int) -> range:
    """Return the range of rows that fit and contain the chosen one; by default the last ones."""
    if count <= room:
        return range(count)
    last = count if chosen is None else min(count, max(room, chosen + 1))
    return range(max(0, last - room), last)


def join_blocks(
    first: Sequence[Line], second: Sequence[Line], first_width: int, rows: int, gap: str = " │ "
) -> list[Line]:
    """Return two blocks side by side, `rows` high."""
    return [
        (*pad(start, first_width), Cell(gap, "axis"), *end)
        for start, end in zip(pad_rows(first, rows), pad_rows(second, rows), strict=True)
    ]


def head_with_message(head: Line, message: str, width: int) -> list[Line]:
    """Return a head followed by a message; a long message takes up to three lines below."""
    if width_of([*head, Cell(message)]) + 2 <= width:
        return [(*head, Cell(f"  {message}", "warn"))] if message else [head]
    return [head, *[line(" ", cell(text, "warn")) for text in wrap(message, width - 2)[:3]]]


def pad_rows(lines: Sequence[Line], rows: int) -> list[Line]:
    """Return exactly `rows` lines: filled with empty lines, or cut at the end."""
    return [*lines[:rows], *[()] * max(0, rows - len(lines))]


def centred(lines: Sequence[Line], width: int) -> list[Line]:
    """Return a block of lines centred in a width."""
    widest = max((width_of(row) for row in lines), default=0)
    indent = max(0, (width - widest) // 2)
    return [(Cell(" " * indent), *row) for row in lines]
