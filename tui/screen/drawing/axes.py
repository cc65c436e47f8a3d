"""A plot with its axes as lines of text: round ticks, units, the name of every curve."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tui.screen.drawing.canvas import Trace, across, columns_of, draw, row_of
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Cell, Line, TextRole, cell, fit, pad, piece

MARGIN = 0.06
"""Part of the range that stays free above and below a curve."""


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """A curve in the units of the plot."""

    time: NDArray[np.float64]
    values: NDArray[np.float64]
    role: TextRole
    name: str
    dashed: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Figure:
    """What a plot shows."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    start: float
    """Of the window, in `time_unit`."""
    end: float
    time_unit: str = "ms"
    note: str = ""
    """Figures beside the title."""
    bottom: float | None = None
    """Of the range; None: whatever the curves need."""
    top: float | None = None
    cursor: float | None = None
    """Where values are read, in `time_unit`."""
    time_axis: bool = True
    least_range: float = 0.0
    """The range is not made smaller than this: noise should look like noise."""

    @property
    def name(self) -> str:
        """What is shown, without the sensor that it is of."""
        return self.title.split(" at ")[0]


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers in a range, at most so many.

    Examples
    --------
    >>> ticks(0.0, 9.7, 5)
    [0.0, 2.0, 4.0, 6.0, 8.0]
    """
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low or most < 1:
        return []
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    for factor in (1, 2, 5, 10):
        step = factor * power
        first = math.ceil(low / step - 1e-9)
        count = math.floor(high / step + 1e-9) - first + 1
        if count <= most:
            break
    return [round((first + k) * step, 12) for k in range(max(0, count))]


def tick_text(value: float, step: float) -> str:
    """A tick with as many decimals as its step has."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    text = f"{value:.{min(decimals, 6)}f}"
    return "0" if float(text) == 0 else text


def plot_lines(figure: Figure, width: int, height: int, glyphs: Glyphs) -> list[Line]:
    """The figure as exactly `height` lines of at most `width` columns."""
    if height < 3 or width < 20:
        return [pad((), width)] * height
    bottom, top = _range(figure)
    inside = height - 1 - (1 if figure.time_axis else 0)
    marks = ticks(bottom, top, max(2, inside // 2))
    step = marks[1] - marks[0] if len(marks) > 1 else (abs(marks[0]) if marks else 1.0) or 1.0
    labels = [tick_text(mark, step) for mark in marks]
    gutter = max([4, *map(len, labels)]) + 1
    columns = width - gutter - 1
    traces = []
    for curve in figure.curves:
        low, high = columns_of(
            curve.time, curve.values, figure.start, figure.end, columns * across(glyphs)
        )
        traces.append(Trace(low, high, curve.role, curve.dashed))
    body = draw(traces, columns, inside, bottom, top, glyphs, base=0.0)
    places: dict[int, str] = {}
    for mark, label in zip(marks, labels, strict=True):
        row = row_of(mark, bottom, top, inside, glyphs) if top > bottom else 0
        places.setdefault(row, label)
    lines = [_heading(figure, width)]
    cursor = _column(figure, figure.cursor, columns)
    for row, content in enumerate(body):
        label = places.get(row, "")
        frame = Cell(f"{label:>{gutter - 1}} {'┤' if label else '│'}", "axis")
        lines.append((frame, *(_with_cursor(content, cursor))))
    if figure.time_axis:
        lines.append(_time_axis(figure, gutter, columns))
    return lines


def stacked_plots(
    shown: Sequence[Figure],
    width: int,
    rows: int,
    glyphs: Glyphs,
    shares: Sequence[int] | None = None,
) -> list[Line]:
    """Plots one below the other.

    Parameters
    ----------
    shown : sequence of Figure
    width, rows : int
        Of all together.
    glyphs : Glyphs
    shares : sequence of int, optional
        Parts of the rows that each gets; as many for each otherwise.
    """
    parts = [1] * len(shown) if shares is None else list(shares[: len(shown)])
    lines: list[Line] = []
    left = rows
    for place, figure in enumerate(shown):
        given = left * parts[place] // sum(parts[place:])
        lines += plot_lines(figure, width, given, glyphs)
        left -= given
    return lines


def _range(figure: Figure) -> tuple[float, float]:
    lows, highs = [], []
    for curve in figure.curves:
        inside = (curve.time >= figure.start) & (curve.time <= figure.end)
        values = curve.values[inside & np.isfinite(curve.values)]
        if len(values):
            lows.append(float(values.min()))
            highs.append(float(values.max()))
    low, high = min([0.0, *lows]), max([0.0, *highs])
    if high - low < figure.least_range:
        middle = (high + low) / 2
        low, high = middle - figure.least_range / 2, middle + figure.least_range / 2
    if high <= low:
        low, high = -1.0, 1.0
    edge = MARGIN * (high - low)
    bottom = low - edge if figure.bottom is None else figure.bottom
    top = high + edge if figure.top is None else figure.top
    return bottom, top


def _heading(figure: Figure, width: int) -> Line:
    pieces = [piece(0, cell(figure.title, "strong"), f" {figure.unit}")]
    pieces += [piece(1, cell(figure.note))] if figure.note else []
    named = [curve for curve in figure.curves if curve.name]
    if len(named) > 1:
        for curve in named:
            form = "- - " if curve.dashed else "─── "
            pieces.append(piece(2, cell(form + curve.name, curve.role)))
    return fit(pieces, width, "   ")


def _time_axis(figure: Figure, gutter: int, columns: int) -> Line:
    marks = ticks(figure.start, figure.end, max(2, columns // 12))
    step = marks[1] - marks[0] if len(marks) > 1 else 1.0
    letters = [" "] * columns
    end = 0
    for mark in marks:
        text = tick_text(mark, step)
        at = _column(figure, mark, columns)
        if at is None:
            continue
        first = max(0, at - len(text) // 2)
        if first < end or first + len(text) > columns - len(figure.time_unit) - 1:
            continue
        letters[first : first + len(text)] = text
        end = first + len(text) + 2
    unit = figure.time_unit
    letters[columns - len(unit) :] = unit
    return (Cell(" " * (gutter + 1)), Cell("".join(letters), "axis"))


def _column(figure: Figure, at: float | None, columns: int) -> int | None:
    if at is None or not figure.start <= at <= figure.end or figure.end <= figure.start:
        return None
    return min(columns - 1, int((at - figure.start) / (figure.end - figure.start) * columns))


def _with_cursor(content: Line, column: int | None) -> Line:
    if column is None:
        return content
    cells: list[Cell] = []
    position = 0
    for text in content:
        end = position + len(text.text)
        if position <= column < end:
            before, after = text.text[: column - position], text.text[column - position + 1 :]
            letter = text.text[column - position]
            cells += [Cell(before, text.role)] if before else []
            cells.append(Cell("│" if letter in " ─" else letter, "key"))
            cells += [Cell(after, text.role)] if after else []
        else:
            cells.append(text)
        position = end
    return tuple(cells)
