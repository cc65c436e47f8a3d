"""Profile, map and overlays of an opened survey as lines of text."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pfwd.analysis.screening.drops import channels_outward, displacement_of
from pfwd.errors import DeviceError
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Cell, Line, TextRole, cell, line
from tui.screen.drawing.plot import Curve, Figure, plot_lines
from tui.screen.opened.rows import PointRow, display_value

STATE_ROLES: dict[str, TextRole] = {"PASS": "good", "FAIL": "bad", "UNDECIDED": "warn"}
STATE_MARKS = {"PASS": "o", "FAIL": "x", "UNDECIDED": "?"}
"""Marks of the states on the map: colour alone is not enough."""

OVERLAY_ROLES: tuple[TextRole, ...] = ("measured", "fitted", "load", "residual", "good", "bad")
MAX_OVERLAID_DROPS = 12
"""Number of drops in an overlay; more curves cannot be distinguished."""


def profile_figure(
    rows: Sequence[PointRow], first: int, count: int, chosen: int, unit: str
) -> Figure:
    """The value along the line, from one point for so many; the target as a dashed line.

    Parameters
    ----------
    rows : sequence of PointRow
    first, count : int
        Of the window.
    chosen : int
        Place of the row that is looked at.
    unit : str
    """
    part = rows[first : first + count]
    along = np.arange(first + 1, first + 1 + len(part), dtype=float)
    scale = 1e-3 if any(row.unit == "m" for row in part) else 1e6

    def of(name: str) -> Any:
        values = (getattr(row, name) for row in part)
        return np.array([math.nan if v is None else v / scale for v in values], dtype=float)

    curves = [
        Curve(along, of("value"), "measured", "value"),
        Curve(along, of("target"), "warn", "target", dashed=True),
    ]
    note = f"points {first + 1} to {first + len(part)} of {len(rows)}"
    end = first + max(2, len(part))
    return Figure(
        title="along the line",
        unit=unit,
        curves=tuple(curve for curve in curves if np.isfinite(curve.values).any()),
        start=first + 0.5,
        end=end + 0.5,
        time_unit="point",
        note=note,
        cursor=chosen + 1.0 if first <= chosen < first + count else None,
    )


def profile_lines(
    rows: Sequence[PointRow],
    window: tuple[int, int],
    chosen: int,
    size: tuple[int, int],
    glyphs: Glyphs,
) -> list[Line]:
    """The profile with what it shows of the chosen point below."""
    width, height = size
    if not rows:
        return [line(cell(" no point", "dim"))]
    unit = "mm" if any(row.unit == "m" for row in rows) else "MPa"
    figure = profile_figure(rows, *window, chosen, unit)
    lines = plot_lines(figure, width, max(3, height - 2), glyphs)
    row = rows[min(chosen, len(rows) - 1)]
    value = display_value(row)
    shown = "no value" if math.isnan(value) else f"{value:.3g} {unit}"
    said = f" {row.title}: {shown}  {row.state}"
    return [*lines, line(cell(said, "strong")), line(cell(" left/right moves, +/- zooms", "dim"))]


def map_lines(rows: Sequence[PointRow], chosen: str, width: int, height: int) -> list[Line]:
    """Where the points are, seen from above: o passed, x failed, ? undecided, · not judged."""
    placed = [row for row in rows if row.latitude is not None and row.longitude is not None]
    if not placed or height < 4 or width < 10:
        return [line(cell(" no point has a position", "dim"))]
    north = [row.latitude or 0.0 for row in placed]
    east = [row.longitude or 0.0 for row in placed]
    top, left = max(north), min(east)
    shrink = math.cos(math.radians((min(north) + top) / 2))
    # A cell is about twice as high as wide.
    metres = 111_195.0
    tall = max((top - min(north)) * metres, 1.0)
    wide = max((max(east) - left) * metres * shrink, 1.0)
    per_cell = max(wide / (width - 2), tall / (2 * (height - 3)))
    grid: dict[tuple[int, int], PointRow] = {}
    for row, latitude, longitude in zip(placed, north, east, strict=True):
        x = (longitude - left) * metres * shrink / per_cell
        y = (top - latitude) * metres / (2 * per_cell)
        place = (min(height - 3, round(y)), min(width - 2, round(x)))
        before = grid.get(place)
        # Where several fall into one cell the chosen one is seen, then one that failed.
        if before is None or row.name == chosen or (row.state == "FAIL" != before.state):
            grid[place] = row
    lines: list[Line] = []
    for y in range(height - 2):
        cells: list[Cell] = [Cell(" ")]
        for x in range(width - 1):
            found = grid.get((y, x))
            if found is None:
                cells.append(Cell(" "))
            elif found.name == chosen:
                cells.append(cell("@", "cursor"))
            else:
                mark = STATE_MARKS.get(found.state, "·")
                cells.append(cell(mark, STATE_ROLES.get(found.state, "text")))
        lines.append(_joined(cells))
    bar = max(1, round((width - 2) / 5))
    text = (
        f" {'─' * bar} {_length(bar * per_cell)}   o pass  x fail  ? undecided  @ chosen; north up"
    )
    return [*lines, line(cell(text, "dim"))]


def _joined(cells: Sequence[Cell]) -> Line:
    """Neighbours of one role in one cell: fewer parts to draw."""
    found: list[Cell] = []
    for part in cells:
        if found and found[-1].role == part.role:
            found[-1] = Cell(found[-1].text + part.text, part.role)
        else:
            found.append(part)
    return tuple(found)


def _length(metres: float) -> str:
    return f"{metres / 1e3:.3g} km" if metres >= 1000 else f"{metres:.3g} m"


def overlay_figures(drops: Sequence[tuple[str, Any]]) -> tuple[list[Figure], list[str]]:
    """Load and deflection of drops over each other, as recorded; and what could not be read.

    Parameters
    ----------
    drops : sequence of name and SurveyDrop
    """
    loads, depths, faults = [], [], []
    for place, (name, kept) in enumerate(drops[:MAX_OVERLAID_DROPS]):
        role = OVERLAY_ROLES[place % len(OVERLAY_ROLES)]
        dashed = place >= len(OVERLAY_ROLES)
        try:
            drop = kept.read_traces().drop
        except DeviceError as err:
            faults.append(f"drop {name}: {err}")
            continue
        if drop.only_peaks is not None:
            faults.append(f"drop {name} has no traces, only peaks")
            continue
        time = drop.time * 1e3
        loads.append(Curve(time, drop.load / 1e3, role, name, dashed))
        if drop.channels:
            centre = channels_outward(drop)[0]
            moved = displacement_of(centre, drop.time) * 1e6
            depths.append(Curve(time, moved, role, name, dashed))
    if not loads:
        return [], faults
    end = min(40.0, max(float(curve.time[-1]) for curve in loads))
    return [
        Figure("load", "kN", tuple(loads), -2.0, end),
        Figure("deflection as recorded", "µm", tuple(depths), -2.0, end),
    ], faults
