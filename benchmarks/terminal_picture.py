"""Picture of a terminal screen, drawn cell by cell, identical on every computer.

Letters are from the font in matplotlib. Braille dots, blocks and lines are drawn as shapes, because
few fonts have the dots. Neither a browser nor a terminal is needed.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.color import Color
from rich.style import Style

CELL_WIDTH, CELL_HEIGHT = 8.0, 17.0
"""Size of a cell, pixels."""

FONT_SIZE = CELL_WIDTH * 2048 / 1233
"""Size of the font, pixels; letters of DejaVu Sans Mono are 1233 of 2048 units wide, as a cell."""

DOTS = ((0x01, 0, 0), (0x02, 0, 1), (0x04, 0, 2), (0x40, 0, 3),
        (0x08, 1, 0), (0x10, 1, 1), (0x20, 1, 2), (0x80, 1, 3))  # fmt: skip
"""Bit, column and row of each dot of a braille character."""

EIGHTHS = " ▁▂▃▄▅▆▇█"

STROKES = {
    "─": (1, 1, 0, 0),
    "│": (0, 0, 1, 1),
    "┤": (1, 0, 1, 1),
    "┼": (1, 1, 1, 1),
}
"""Directions of the lines from the centre (left, right, up, down), 1 if there is a line."""

FOREGROUND, BACKGROUND = "#e6e6e6", "#101418"


@dataclass(frozen=True, slots=True)
class Run:
    """Adjacent characters of one style in a line of the screen."""

    column: int
    text: str
    foreground: str
    background: str
    bold: bool
    underline: bool


def runs_of(segments: Iterable[tuple[str, Style | None]]) -> list[Run]:
    """Return the runs of a line of styled text."""
    runs, column = [], 0
    for text, style in segments:
        text_style = style or Style()
        fore, back = _hex(text_style.color, FOREGROUND), _hex(text_style.bgcolor, BACKGROUND)
        if text_style.reverse:
            fore, back = back, fore
        runs.append(
            Run(column, text, fore, back, bool(text_style.bold), bool(text_style.underline))
        )
        column += len(text)
    return runs


def _hex(color: Color | None, default: str) -> str:
    if color is None or color.is_default:
        return default
    red, green, blue = color.get_truecolor()
    return f"#{red:02x}{green:02x}{blue:02x}"


def save_picture(lines: Sequence[Sequence[Run]], columns: int, path: Path) -> None:
    """Write a picture of the screen as .svg or .png, by the suffix of the path."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "pfwd"  # the same screen gives the same file
    width, height = columns * CELL_WIDTH, len(lines) * CELL_HEIGHT
    figure = plt.figure(figsize=(width / 72, height / 72), dpi=144)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.axis("off")
    back = lines[0][0].background if lines and lines[0] else BACKGROUND
    figure.patch.set_facecolor(_commonest(lines) or back)
    shapes = _Shapes(axes)
    for row, runs in enumerate(lines):
        for run in runs:
            _draw_run(shapes, axes, run, row, figure.get_facecolor())
    shapes.finish()
    metadata = {"Date": None} if path.suffix == ".svg" else {}
    figure.savefig(path, metadata=metadata, facecolor=figure.get_facecolor())
    plt.close(figure)
    if path.suffix == ".svg":
        path.write_text(_shorter(path.read_text(encoding="utf-8")), encoding="utf-8")


def _shorter(svg: str) -> str:
    """Return the SVG text with coordinates rounded to a tenth, and short names of the letters."""

    def rounded(match: re.Match[str]) -> str:
        return re.sub(r"-?\d+\.\d+", _tenth, match[0])

    svg = re.sub(r' d="[^"]*"|translate\([^)]*\)', rounded, svg)
    svg = svg.replace("DejaVuSansMono-", "g")
    return re.sub(r"\n +", "\n", svg)


def _tenth(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")


def _commonest(lines: Sequence[Sequence[Run]]) -> str | None:
    counts: dict[str, int] = {}
    for runs in lines:
        for run in runs:
            counts[run.background] = counts.get(run.background, 0) + len(run.text)
    return max(counts, key=lambda color: counts[color]) if counts else None


class _Shapes:
    """Rectangles by colour.

    Each colour is drawn as one path, because a picture has thousands of rectangles.
    """

    def __init__(self, axes: Any) -> None:
        self._axes = axes
        self._below: dict[str, list[tuple[float, float, float, float]]] = {}
        self._above: dict[str, list[tuple[float, float, float, float]]] = {}

    def add(self, color: str, x: float, y: float, w: float, h: float, *, below: bool) -> None:
        """Add a rectangle."""
        (self._below if below else self._above).setdefault(color, []).append((x, y, w, h))

    def finish(self) -> None:
        """Draw the rectangles."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Outline

        for order, shapes in ((0, self._below), (2, self._above)):
            for color, boxes in shapes.items():
                points, codes = [], []
                for x, y, w, h in boxes:
                    points += [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
                    codes += [1, 2, 2, 2, 79]
                patch = PathPatch(Outline(points, codes), color=color, lw=0, zorder=order)
                self._axes.add_patch(patch)


def _draw_run(shapes: _Shapes, axes: Any, run: Run, row: int, ground: Any) -> None:
    from matplotlib.colors import to_hex

    x, y = run.column * CELL_WIDTH, row * CELL_HEIGHT
    if run.background != to_hex(ground):
        shapes.add(run.background, x, y, len(run.text) * CELL_WIDTH, CELL_HEIGHT, below=True)
    for start, words in _words(shapes, run, x, y):
        axes.text(
            x + start * CELL_WIDTH,
            y + 0.76 * CELL_HEIGHT,
            words,
            color=run.foreground,
            family="DejaVu Sans Mono",
            size=FONT_SIZE,
            weight="bold" if run.bold else "normal",
            ha="left",
            va="baseline",
            zorder=3,
            parse_math=False,
        )
    if run.underline:
        length = len(run.text) * CELL_WIDTH
        shapes.add(run.foreground, x, y + 0.9 * CELL_HEIGHT, length, 1.0, below=False)


def _words(shapes: _Shapes, run: Run, x: float, y: float) -> list[tuple[int, str]]:
    """Return column and text of the letters in a run; other characters are drawn as shapes."""
    words: list[tuple[int, str]] = []
    for place, letter in enumerate(run.text):
        drawn = _shape(shapes, letter, run.foreground, x + place * CELL_WIDTH, y)
        if drawn or letter == " ":
            continue
        if words and words[-1][0] + len(words[-1][1]) == place:
            words[-1] = words[-1][0], words[-1][1] + letter
        else:
            words.append((place, letter))
    return words


def _shape(shapes: _Shapes, letter: str, color: str, x: float, y: float) -> bool:
    """Draw a character as a shape; return False if it has to be drawn as a letter."""
    w, h = CELL_WIDTH, CELL_HEIGHT
    code = ord(letter)
    if 0x2800 <= code < 0x2900:
        size = 2.2
        for bit, column, line in DOTS:
            if code - 0x2800 & bit:
                at = x + (column + 0.5) * w / 2, y + (line + 0.5) * h / 4
                shapes.add(color, at[0] - size / 2, at[1] - size / 2, size, size, below=False)
        return True
    if letter in EIGHTHS and letter != " ":
        part = EIGHTHS.index(letter) / 8
        shapes.add(color, x, y + h * (1 - part), w, h * part, below=False)
        return True
    if letter in STROKES:
        to_left, to_right, to_top, to_bottom = STROKES[letter]
        centre = x + w / 2, y + h / 2
        if to_left or to_right:
            start, end = (x if to_left else centre[0]), (x + w if to_right else centre[0])
            shapes.add(color, start, centre[1] - 0.5, end - start, 1.0, below=False)
        if to_top or to_bottom:
            start, end = (y if to_top else centre[1]), (y + h if to_bottom else centre[1])
            shapes.add(color, centre[0] - 0.5, start, 1.0, end - start, below=False)
        return True
    return False


def runs_of_app(app: Any) -> list[list[Run]]:
    """Return the lines on the screen of a Textual application, as runs of one style."""
    lines = []
    for strip in app.screen._compositor.render_strips():
        lines.append(runs_of((segment.text, segment.style) for segment in strip))
    return lines
