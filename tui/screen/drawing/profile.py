"""Profile of a survey: a bar for each point, with the target as a line."""

from collections.abc import Sequence
from dataclasses import dataclass

from pfwd.digits import significant
from tui.screen.drawing.lines import Cell, Line, TextRole, cell, line
from tui.screen.drawing.plot import tick_text, ticks

MIN_PROFILE_BAR_COLUMNS = 2
"""Smallest width of a bar with its gap, columns."""

_EIGHTHS = " ▁▂▃▄▅▆▇█"


@dataclass(frozen=True, slots=True)
class Bar:
    """Bar for the value of one point, or of one drop, in a bar chart."""

    name: str
    value: float | None
    """Value of the point; None: it was not measured."""
    role: TextRole = "measured"
    chosen: bool = False


def profile_lines(
    bars: Sequence[Bar],
    width: int,
    height: int,
    title: str,
    target: float | None = None,
) -> list[Line]:
    """Return exactly `height` lines: title, bars, and their names below.

    Parameters
    ----------
    bars : sequence of Bar
    width, height : int
    title : str
        Title with the unit.
    target : float, optional
        Target in the unit of the values.
    """
    if height < 4 or width < 24:
        return [()] * height
    gutter = 7
    room = width - gutter
    widest = max([3, *(len(bar.name) for bar in bars)])
    step = max(4, min(widest + 1, 12))
    if len(bars) * step > room:  # narrower bars rather than a part of the points
        step = max(MIN_PROFILE_BAR_COLUMNS, min(step, room // len(bars)))
    max_bars = max(1, room // step)
    chosen = next((place for place, bar in enumerate(bars) if bar.chosen), len(bars) - 1)
    first = min(max(0, chosen - max_bars // 2), max(0, len(bars) - max_bars))
    visible = bars[first : first + max_bars]
    values = [bar.value for bar in visible if bar.value is not None]
    top = max([*values, target or 0.0, 1e-12]) * 1.05
    rows = height - 2
    marks = ticks(0.0, top, max(2, rows // 2))
    gap = marks[1] - marks[0] if len(marks) > 1 else top
    labels = {rows - 1 - int(mark / top * rows): tick_text(mark, gap) for mark in marks}
    aim = None if not target else rows - 1 - int(target / top * rows)
    named = f"   ─── target {significant(target)}" if target else ""
    lines = [line(cell(f" {title}", "strong"), cell(named, "warn"))]
    for row in range(rows):
        label = labels.get(row, "")
        cells = [Cell(f"{label:>{gutter - 2}} {'┤' if label else '│'}", "axis")]
        for bar in visible:
            letter = _block(bar, row, rows, top)
            empty = "─" if row == aim else " "
            body = (letter if letter != " " else empty) * (step - 1)
            role: TextRole = bar.role if letter != " " else "warn"
            cells += [Cell(body, role), Cell(empty, "warn")]
        lines.append(tuple(cells))
    return [*lines, (Cell(" " * gutter), *_names(visible, step, widest, room))]


def _names(bars: Sequence[Bar], step: int, widest: int, room: int) -> list[Cell]:
    """Return the names below the bars; of long names the chosen one and every n-th fits."""
    cells: list[Cell] = []
    if widest < step or step >= 12:
        for bar in bars:
            text = bar.name if len(bar.name) < step else bar.name[-(step - 1) :]
            cells += [Cell(text.center(step - 1), "cursor" if bar.chosen else "text"), Cell(" ")]
        return cells
    chosen = next((place for place, bar in enumerate(bars) if bar.chosen), 0)
    every = -(-(widest + 1) // step)
    used = 0
    for place, bar in enumerate(bars):
        if (place - chosen) % every:
            continue
        start = max(used, min(place * step, room - len(bar.name)))
        cells.append(Cell(" " * (start - used)))
        cells.append(Cell(bar.name, "cursor" if bar.chosen else "text"))
        used = start + len(bar.name) + 1
        cells.append(Cell(" "))
    return cells


def _block(bar: Bar, row: int, rows: int, top: float) -> str:
    if bar.value is None:
        return "?" if row == rows - 1 else " "
    filled = bar.value / top * rows - (rows - 1 - row)
    if filled >= 1:
        return "█"
    if filled <= 0:
        return " "
    return _EIGHTHS[int(filled * 8)]
