"""Plots as lines of text: curves as dots in character cells, axes with round ticks and units.

A cell holds two dots across and four down (braille), in ASCII one. Each column of dots shows the
range from the least to the largest sample in it, so that no peak is lost. The curve drawn last
gives a cell its role; curves differ by their form as well, solid or dashed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Cell, Line, TextRole, cell, fit, joined, pad, piece

_FIRST_BRAILLE = 0x2800
_BRAILLE_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bit of each dot in the code of a braille cell, (4, 2): row and column."""

DASH_DOTS = 6
"""Length of a dash and of the gap behind it, columns of braille dots."""

_ASCII_MARK: dict[str, str] = {"load": "*", "measured": "*", "fitted": "o", "residual": "."}

FREE_RANGE = 0.06
"""Margin above and below the curves, as a fraction of their range."""


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """Curve of a plot: its points in the units of the axes, its colour and its legend."""

    time: NDArray[np.float64]
    values: NDArray[np.float64]
    role: TextRole
    name: str
    dashed: bool = False
    joined: bool = True
    """Joined by lines; False: separate values, whose name contains their form."""


@dataclass(frozen=True, eq=False, slots=True)
class Figure:
    """Contents of one plot: curves, window, range and cursor."""

    title: str
    unit: str
    curves: tuple[Curve, ...]
    start: float
    """Start of the window, in `time_unit`."""
    end: float
    """End of the window, in `time_unit`."""
    time_unit: str = "ms"
    note: str = ""
    """Text after the title, for example the peak."""
    bottom: float | None = None
    """Lower end of the range, in `unit`; None: fitted to the curves."""
    top: float | None = None
    """Upper end of the range, in `unit`; None: fitted to the curves."""
    cursor: float | None = None
    """Position of the cursor, in `time_unit`."""
    time_axis: bool = True
    min_range: float = 0.0
    """Smallest range, in `unit`: noise should look like noise."""

    @property
    def name(self) -> str:
        """Title without the position of the sensor."""
        return self.title.split(" at ")[0]


def ticks(low: float, high: float, max_count: int) -> list[float]:
    """Return at most `max_count` round numbers in a range.

    Examples
    --------
    >>> ticks(0.0, 9.7, 5)
    [0.0, 2.0, 4.0, 6.0, 8.0]
    """
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low or max_count < 1:
        return []
    rough = (high - low) / max_count
    power = 10.0 ** math.floor(math.log10(rough))
    for factor in (1, 2, 5, 10):
        step = factor * power
        first = math.ceil(low / step - 1e-9)
        count = math.floor(high / step + 1e-9) - first + 1
        if count <= max_count:
            break
    return [round((first + k) * step, 12) for k in range(max(0, count))]


def tick_text(value: float, step: float) -> str:
    """Format a tick with the decimals of its step."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 0
    text = f"{value:.{min(decimals, 6)}f}"
    return "0" if float(text) == 0 else text


def plot_lines(figure: Figure, width: int, height: int, glyphs: Glyphs) -> list[Line]:
    """Return a figure as exactly `height` lines of at most `width` columns."""
    if height < 3 or width < 20:
        return [pad((), width)] * height
    bottom, top = _range(figure)
    inside = height - 1 - (1 if figure.time_axis else 0)
    marks = ticks(bottom, top, max(2, inside // 2))
    step = marks[1] - marks[0] if len(marks) > 1 else (abs(marks[0]) if marks else 1.0) or 1.0
    labels = [tick_text(mark, step) for mark in marks]
    gutter = max([4, *map(len, labels)]) + 1
    columns = width - gutter - 1
    dot_curves = []
    for curve in figure.curves:
        low, high = min_max_columns(
            curve.time,
            curve.values,
            figure.start,
            figure.end,
            columns * dots_per_column(glyphs),
            joined=curve.joined,
        )
        dot_curves.append(DotCurve(low, high, curve.role, curve.dashed))
    body = draw_dots(dot_curves, columns, inside, bottom, top, glyphs, base=0.0)
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
    plots: Sequence[Figure],
    width: int,
    rows: int,
    glyphs: Glyphs,
    shares: Sequence[int] | None = None,
) -> list[Line]:
    """Return plots one below the other.

    Parameters
    ----------
    plots : sequence of Figure
    width, rows : int
        Size of all plots together.
    glyphs : Glyphs
    shares : sequence of int, optional
        Relative heights of the plots; equal heights by default.
    """
    parts = [1] * len(plots) if shares is None else list(shares[: len(plots)])
    lines: list[Line] = []
    for place, figure in enumerate(plots):
        height = (rows - len(lines)) * parts[place] // sum(parts[place:])
        lines += plot_lines(figure, width, height, glyphs)
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
    if high - low < figure.min_range:
        centre = (high + low) / 2
        low, high = centre - figure.min_range / 2, centre + figure.min_range / 2
    if high <= low:
        low, high = -1.0, 1.0
    edge = FREE_RANGE * (high - low)
    bottom = low - edge if figure.bottom is None else figure.bottom
    top = high + edge if figure.top is None else figure.top
    return bottom, top


def _heading(figure: Figure, width: int) -> Line:
    pieces = [piece(0, cell(figure.title, "strong"), f" {figure.unit}")]
    pieces += [piece(1, cell(figure.note))] if figure.note else []
    named = [curve for curve in figure.curves if curve.name]
    if len(named) > 1:
        for curve in named:
            form = "" if not curve.joined else "- - " if curve.dashed else "─── "
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


@dataclass(frozen=True, eq=False, slots=True)
class DotCurve:
    """Range of a curve in each column of dots."""

    low: NDArray[np.float64]
    """Lower end of the range, (n,); NaN where the curve has a gap."""
    high: NDArray[np.float64]
    """Upper end of the range, (n,)."""
    role: TextRole
    dashed: bool = False


def min_max_columns(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    start: float,
    end: float,
    count: int,
    *,
    joined: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the range of a curve in each column of dots.

    Parameters
    ----------
    time, values : (n,) ndarray of float
        Time rises; NaN in values is a gap.
    start, end : float
        Window, in the unit of time.
    count : int
        Number of columns.
    joined : bool
        Extend each range to the neighbouring column, and interpolate between few samples.

    Returns
    -------
    low, high : (count,) ndarray of float
        NaN in columns without a sample.
    """
    low, high = np.full(count, np.nan), np.full(count, np.nan)
    inside = (time >= start) & (time <= end) & np.isfinite(values)
    if count < 1 or end <= start or not inside.any():
        return low, high
    finite_values = values[inside]
    place = np.minimum(((time[inside] - start) / (end - start) * count).astype(int), count - 1)
    if joined and len(finite_values) < 2 * count:  # few samples: straight lines between them
        centres = start + (np.arange(count) + 0.5) * (end - start) / count
        between = (centres >= time[inside][0]) & (centres <= time[inside][-1])
        low[between] = high[between] = np.interp(centres[between], time, values)  # NaN stays NaN
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    columns = place[starts]
    lowest = np.minimum.reduceat(finite_values, starts)
    highest = np.maximum.reduceat(finite_values, starts)
    low[columns] = np.fmin(low[columns], lowest)
    high[columns] = np.fmax(high[columns], highest)
    return _join(low, high) if joined else (low, high)


def _join(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Extend every column to the one before it, so that steep flanks have no gaps."""
    before_low, before_high = low[:-1], high[:-1]
    joined_low, joined_high = low.copy(), high.copy()
    joined_low[1:] = np.where(before_high < low[1:], before_high, low[1:])
    joined_high[1:] = np.where(before_low > high[1:], before_low, high[1:])
    return joined_low, joined_high


def draw_dots(
    curves: Sequence[DotCurve],
    width: int,
    height: int,
    bottom: float,
    top: float,
    glyphs: Glyphs,
    *,
    base: float | None = None,
) -> list[Line]:
    """Return the lines inside the axes of a plot.

    Parameters
    ----------
    curves : sequence of DotCurve
        Each with ``width * dots_per_column(glyphs)`` columns of dots.
    width, height : int
        Number of cells.
    bottom, top : float
        Values at the lower and upper edge.
    glyphs : Glyphs
    base : float, optional
        Value of a thin horizontal line, usually 0.
    """
    across, down = dots_per_column(glyphs), dots_per_row(glyphs)
    rows = height * down
    scale = (rows - 1) / (top - bottom) if top > bottom else 0.0
    bits = np.zeros((height, width), int)
    roles = np.full((height, width), -1, int)
    grid = np.arange(rows)[:, None]
    for index, curve in enumerate(curves):
        count = width * across
        is_finite = np.isfinite(curve.low[:count])
        low = np.where(is_finite, curve.low[:count], 0.0)
        high = np.where(is_finite, curve.high[:count], 0.0)
        lower = np.clip(np.rint((top - low) * scale), -1, rows)
        upper = np.clip(np.rint((top - high) * scale), -1, rows)
        lit = is_finite[None, :] & (grid >= upper[None, :]) & (grid <= lower[None, :])
        if curve.dashed:
            lit[:, (np.arange(count) // (DASH_DOTS * across // 2)) % 2 == 1] = False
        cells = lit.reshape(height, down, width, across)
        if glyphs.has_dots:
            bits |= np.einsum("rdca,da->rc", cells.astype(int), _BRAILLE_BITS)
        roles[cells.any(axis=(1, 3))] = index
    has_base = base is not None and top > bottom
    base_row = row_of(base or 0.0, bottom, top, height, glyphs) if has_base else None
    return [_row(bits[row], roles[row], curves, glyphs, row == base_row) for row in range(height)]


def _row(
    bits: NDArray[np.int_],
    roles: NDArray[np.int_],
    curves: Sequence[DotCurve],
    glyphs: Glyphs,
    is_base: bool,
) -> Line:
    letters: list[tuple[str, TextRole]] = []
    for dots, index in zip(bits.tolist(), roles.tolist(), strict=True):
        if index < 0:
            letters.append(("─" if is_base else " ", "axis"))
        else:
            role = curves[index].role
            letter = chr(_FIRST_BRAILLE + dots) if glyphs.has_dots else _ASCII_MARK.get(role, "*")
            letters.append((letter, role))
    return joined(letters)


def row_of(value: float, bottom: float, top: float, height: int, glyphs: Glyphs) -> int:
    """Return the row of cells of a value; outside the plot when the value is."""
    down = dots_per_row(glyphs)
    return int(np.rint((top - value) / (top - bottom) * (height * down - 1))) // down


def dots_per_column(glyphs: Glyphs) -> int:
    """Return the number of dots that a cell is wide."""
    return 2 if glyphs.has_dots else 1


def dots_per_row(glyphs: Glyphs) -> int:
    """Return the number of dots that a cell is high."""
    return 4 if glyphs.has_dots else 1
