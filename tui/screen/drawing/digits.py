"""Large digits and letters of full blocks, to be read from metres away."""

from tui.screen.drawing.lines import Cell, Line, TextRole

_LETTER_BLOCKS = {
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
    "t": (" █ ", "███", " █ ", " █ ", " ██"),
    "o": ("   ", "   ", "███", "█ █", "███"),
    " ": ("  ", "  ", "  ", "  ", "  "),
}
LETTER_ROWS = 5
"""Height of a letter, blocks."""

BLOCK_SIZES: tuple[tuple[int, int], ...] = ((8, 4), (6, 3), (4, 2), (3, 2), (2, 1), (1, 1))
"""Columns and rows of a block, largest first; a cell is about twice as high as it is wide."""


def digit_lines(text: str, role: TextRole = "strong", wide: int = 2, high: int = 1) -> list[Line]:
    """Return the lines that draw a text in large letters of blocks.

    Parameters
    ----------
    text : str
        Digits, point, minus, the word "to", and the letters of PASS, FAIL, UNDECIDED and DONE;
        others are skipped.
    role : TextRole
    wide, high : int
        Columns and rows of a block.
    """
    forms = [_LETTER_BLOCKS[letter] for letter in text if letter in _LETTER_BLOCKS]
    lines: list[Line] = []
    for row in range(LETTER_ROWS):
        parts = ["".join(letter * wide for letter in form[row]) for form in forms]
        lines += [(Cell((" " * wide).join(parts), role),)] * high
    return lines


def digit_width(text: str, wide: int = 2) -> int:
    """Return the columns that a text takes in large letters."""
    forms = [_LETTER_BLOCKS[letter] for letter in text if letter in _LETTER_BLOCKS]
    return wide * (sum(len(form[0]) for form in forms) + max(0, len(forms) - 1))


def largest_size(text: str, width: int, height: int) -> tuple[int, int] | None:
    """Return columns and rows of the largest block that fits; None: there is no room."""
    for wide, high in BLOCK_SIZES:
        if digit_width(text, wide) <= width and LETTER_ROWS * high <= height:
            return wide, high
    return None
