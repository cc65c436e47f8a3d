"""Figures, and the letters of verdicts, that are read from metres away: full blocks."""

from tui.screen.drawing.lines import Cell, Line, TextRole

_FORMS = {
    "0": ("████", "█  █", "█  █", "█  █", "████"),
    "1": ("  █ ", " ██ ", "  █ ", "  █ ", " ███"),
    "2": ("████", "   █", "████", "█   ", "████"),
    "3": ("████", "   █", " ███", "   █", "████"),
    "4": ("█  █", "█  █", "████", "   █", "   █"),
    "5": ("████", "█   ", "████", "   █", "████"),
    "6": ("████", "█   ", "████", "█  █", "████"),
    "7": ("████", "   █", "  █ ", " █  ", " █  "),
    "8": ("████", "█  █", "████", "█  █", "████"),
    "9": ("████", "█  █", "████", "   █", "████"),
    ".": (" ", " ", " ", " ", "█"),
    "±": ("  █  ", "█████", "  █  ", "     ", "█████"),
    "<": ("  █", " █ ", "█  ", " █ ", "  █"),
    "-": ("   ", "   ", "███", "   ", "   "),
    "A": ("████", "█  █", "████", "█  █", "█  █"),
    "C": ("████", "█   ", "█   ", "█   ", "████"),
    "D": ("███ ", "█  █", "█  █", "█  █", "███ "),
    "E": ("████", "█   ", "███ ", "█   ", "████"),
    "F": ("████", "█   ", "███ ", "█   ", "█   "),
    "I": ("███", " █ ", " █ ", " █ ", "███"),
    "L": ("█   ", "█   ", "█   ", "█   ", "████"),
    "N": ("█  █", "██ █", "█ ██", "█  █", "█  █"),
    "O": ("████", "█  █", "█  █", "█  █", "████"),
    "P": ("████", "█  █", "████", "█   ", "█   "),
    "S": ("████", "█   ", "████", "   █", "████"),
    "U": ("█  █", "█  █", "█  █", "█  █", "████"),
    " ": ("  ", "  ", "  ", "  ", "  "),
}
ROWS = 5


SIZES: tuple[tuple[int, int], ...] = ((8, 4), (6, 3), (4, 2), (3, 2), (2, 1), (1, 1))
"""Columns and rows of a block, largest first; a cell is about twice as high as wide."""


def digit_lines(text: str, role: TextRole = "strong", wide: int = 2, high: int = 1) -> list[Line]:
    """A number as lines of blocks.

    Parameters
    ----------
    text : str
        Digits, point and minus, and the letters of PASS, FAIL, UNDECIDED and DONE; others are
        left out.
    role : TextRole
    wide, high : int
        Columns and rows of a block.
    """
    forms = [_FORMS[letter] for letter in text if letter in _FORMS]
    lines: list[Line] = []
    for row in range(ROWS):
        parts = ["".join(letter * wide for letter in form[row]) for form in forms]
        lines += [(Cell((" " * wide).join(parts), role),)] * high
    return lines


def digit_width(text: str, wide: int = 2) -> int:
    """Columns that a number takes."""
    forms = [_FORMS[letter] for letter in text if letter in _FORMS]
    return wide * (sum(len(form[0]) for form in forms) + max(0, len(forms) - 1))


def largest_size(text: str, width: int, height: int) -> tuple[int, int] | None:
    """Columns and rows of a block, as large as fits; None: not even the smallest does."""
    for wide, high in SIZES:
        if digit_width(text, wide) <= width and ROWS * high <= height:
            return wide, high
    return None
