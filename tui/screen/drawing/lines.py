"""Lines of text with roles in place of colours, fitted to a width without cutting a number.

Everything that reaches the screen from a device, a file or the operator goes through `cell`, which
leaves no control character and no mark-up in it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
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
"""What a piece of text is; the theme says how it looks."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A piece of a line."""

    text: str
    role: TextRole = "text"


Line = tuple[Cell, ...]


def cell(text: object, role: TextRole = "text") -> Cell:
    """A piece of text from anywhere, harmless."""
    return Cell(clean(text), role)


def line(*parts: Cell | object) -> Line:
    """A line of cells; what is none becomes one."""
    return tuple(part if isinstance(part, Cell) else cell(part) for part in parts)


def width_of(parts: Iterable[Cell]) -> int:
    """Columns that cells take."""
    return sum(cell_len(part.text) for part in parts)


def text_of(parts: Iterable[Cell]) -> str:
    """The bare text."""
    return "".join(part.text for part in parts)


def shorten(text: str, width: int) -> str:
    """Free text, ended by ``..`` where it does not fit; never for numbers."""
    if cell_len(text) <= width:
        return text
    if width < 3:
        return " " * max(0, width)
    head = set_cell_size(text, width - 2).rstrip()
    rest = text[len(head) :]
    word = head.rpartition(" ")[2]
    whole = len(word) < len(head)  # a single word that long can only be cut
    if whole and rest[:1].strip() and any(letter.isdigit() for letter in word + rest.split(" ")[0]):
        # Half a number is another number.
        head = head[: len(head) - len(word)].rstrip()
    return head + ".."


def pad(parts: Line, width: int) -> Line:
    """Filled with blanks to a width."""
    missing = width - width_of(parts)
    return (*parts, Cell(" " * missing)) if missing > 0 else parts


def wrap(text: str, width: int) -> list[str]:
    """Free text on several lines, broken between words."""
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
    """A part of a line that is shown whole or not at all."""

    cells: Line
    rank: int
    """What matters most has the lowest; the highest goes first when there is no room."""


def piece(rank: int, *parts: Cell | object) -> Piece:
    """A piece of cells."""
    return Piece(line(*parts), rank)


def fit(pieces: Sequence[Piece], width: int, gap: str = "  ") -> Line:
    """As many pieces as fit, in their order, the least important left out whole."""
    chosen = [part for part in pieces if width_of(part.cells)]
    while chosen and _total(chosen, gap) > width:
        chosen.remove(max(reversed(chosen), key=lambda part: part.rank))
    return _joined(chosen, gap)


def flow(pieces: Sequence[Piece], width: int, rows: int, gap: str = "  ") -> list[Line]:
    """Pieces on up to so many lines; what does not fit is left out, least important first."""
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


def both_ends(left: Line, right: Line, width: int) -> Line:
    """One line with something at either end; the right one is left out when there is no room."""
    room = width - width_of(left) - width_of(right)
    return (*left, Cell(" " * room), *right) if room >= 1 else left
