"""Curves as dots in character cells: min/max columns, joined, so that no peak is lost.

A cell holds two dots across and four down (braille). In ASCII it holds one. The curve drawn last
gives a cell its role; which curve is which is told by its form: whole or dashed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Cell, Line, TextRole

_BRAILLE = 0x2800
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Of a dot by its row and column within a cell."""

DASH = 6
"""Dots across that a dash takes, and the gap behind it."""

_ASCII_MARK: dict[str, str] = {"load": "*", "measured": "*", "fitted": "o", "residual": "."}


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """A curve to draw."""

    low: NDArray[np.float64]
    """(n,), least value of each column of dots; NaN: nothing there."""
    high: NDArray[np.float64]
    """(n,), largest."""
    role: TextRole
    dashed: bool = False


def columns_of(
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    start: float,
    end: float,
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest value of a curve in each of so many columns, joined to the neighbour.

    Parameters
    ----------
    time, values : (n,) ndarray of float
        Time rises; NaN in values is a gap.
    start, end : float
        Of the window, in the unit of time.
    count : int
        Columns.

    Returns
    -------
    low, high : (count,) ndarray of float
        NaN where nothing was measured.
    """
    low, high = np.full(count, np.nan), np.full(count, np.nan)
    inside = (time >= start) & (time <= end) & np.isfinite(values)
    if count < 1 or end <= start or not inside.any():
        return low, high
    kept = values[inside]
    place = np.minimum(((time[inside] - start) / (end - start) * count).astype(int), count - 1)
    if len(kept) < 2 * count:  # fewer samples than columns: straight lines between them
        middle = start + (np.arange(count) + 0.5) * (end - start) / count
        between = (middle >= time[inside][0]) & (middle <= time[inside][-1])
        low[between] = high[between] = np.interp(middle[between], time, values)  # NaN stays NaN
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    columns = place[starts]
    least, most = np.minimum.reduceat(kept, starts), np.maximum.reduceat(kept, starts)
    low[columns] = np.fmin(low[columns], least)
    high[columns] = np.fmax(high[columns], most)
    return _join(low, high)


def _join(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Every column reaches to the one before it: steep flanks stay whole."""
    before_low, before_high = low[:-1], high[:-1]
    joined_low, joined_high = low.copy(), high.copy()
    joined_low[1:] = np.where(before_high < low[1:], before_high, low[1:])
    joined_high[1:] = np.where(before_low > high[1:], before_low, high[1:])
    return joined_low, joined_high


def draw(
    traces: Sequence[Trace],
    width: int,
    height: int,
    bottom: float,
    top: float,
    glyphs: Glyphs,
    *,
    base: float | None = None,
) -> list[Line]:
    """Lines of a plot's inside.

    Parameters
    ----------
    traces : sequence of Trace
        With ``width * across(glyphs)`` columns each.
    width, height : int
        Cells.
    bottom, top : float
        Values at the lower and upper edge.
    glyphs : Glyphs
    base : float, optional
        Value of a thin line, usually 0.
    """
    across, down = (2, 4) if glyphs.dots else (1, 1)
    rows = height * down
    scale = (rows - 1) / (top - bottom) if top > bottom else 0.0
    bits = np.zeros((height, width), int)
    roles = np.full((height, width), -1, int)
    grid = np.arange(rows)[:, None]
    for index, trace in enumerate(traces):
        count = width * across
        known = np.isfinite(trace.low[:count])
        low = np.where(known, trace.low[:count], 0.0)
        high = np.where(known, trace.high[:count], 0.0)
        lower = np.clip(np.rint((top - low) * scale), -1, rows)
        upper = np.clip(np.rint((top - high) * scale), -1, rows)
        lit = known[None, :] & (grid >= upper[None, :]) & (grid <= lower[None, :])
        if trace.dashed:
            lit[:, (np.arange(count) // (DASH * across // 2)) % 2 == 1] = False
        cells = lit.reshape(height, down, width, across)
        if glyphs.dots:
            bits |= np.einsum("rdca,da->rc", cells.astype(int), _BITS)
        roles[cells.any(axis=(1, 3))] = index
    known_base = base is not None and top > bottom
    zero = row_of(base or 0.0, bottom, top, height, glyphs) if known_base else None
    return [_row(bits[row], roles[row], traces, glyphs, row == zero) for row in range(height)]


def _row(
    bits: NDArray[np.int_],
    roles: NDArray[np.int_],
    traces: Sequence[Trace],
    glyphs: Glyphs,
    zero: bool,
) -> Line:
    cells: list[Cell] = []
    run, role = "", "axis"
    for column in range(len(roles)):
        index = int(roles[column])
        if index < 0:
            letter, now = ("─" if zero else " "), "axis"
        else:
            now = traces[index].role
            letter = chr(_BRAILLE + int(bits[column])) if glyphs.dots else _ASCII_MARK.get(now, "*")
        if now != role and run:
            cells.append(Cell(run, role))  # type: ignore[arg-type]
            run = ""
        role = now
        run += letter
    cells.append(Cell(run, role))  # type: ignore[arg-type]
    return tuple(cells)


def row_of(value: float, bottom: float, top: float, height: int, glyphs: Glyphs) -> int:
    """The row of cells in which a dot of this value stands; outside of them when it is outside."""
    down = 4 if glyphs.dots else 1
    return int(np.rint((top - value) / (top - bottom) * (height * down - 1))) // down


def across(glyphs: Glyphs) -> int:
    """Columns of dots in a cell."""
    return 2 if glyphs.dots else 1
