"""Profile, map and overlays of an opened survey as lines of text."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len

from pfwd.analysis.screening.drops import channels_outward, displacement_of
from pfwd.errors import DeviceError
from pfwd.units import SI
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Line, TextRole, cell, fit, joined, line, piece
from tui.screen.drawing.plot import Curve, Figure, plot_lines
from tui.screen.opened.rows import PointRow

STATE_ROLES: dict[str, TextRole] = {"PASS": "good", "FAIL": "bad", "UNDECIDED": "warn"}
STATE_MARKS = {"PASS": "o", "FAIL": "x", "UNDECIDED": "?"}
"""Marks of the states on the map: colour alone is not enough."""

OVERLAY_ROLES: tuple[TextRole, ...] = ("measured", "fitted", "load", "residual", "good", "bad")
MAX_OVERLAID_DROPS = 12
"""Number of drops in an overlay; more curves cannot be distinguished."""

END_OF_PULSE = 0.05
"""Load over its peak below which the pulse of a drop has ended."""

PULSE_MARGIN, MAX_OVERLAY_MS = 4 / 3, 40.0
"""End of an overlay over the end of the load pulse, and its largest value, ms."""

HALF_MARK_OVER_WIDTH = 0.006
"""Half the length of the mark of a value, as a fraction of the width of the profile."""


def profile_figure(
    rows: Sequence[PointRow],
    first: int,
    count: int,
    chosen: int,
    *,
    by_chainage: bool = False,
) -> Figure:
    """Return a plot of values with intervals over chainage or number; the target is dashed.

    Points are not joined: nothing was measured between them.

    Parameters
    ----------
    rows : sequence of PointRow
    first, count : int
        Window of the rows.
    chosen : int
        Place of the chosen row.
    by_chainage : bool
        Place the points by their chainage, if all points of the window have one.
    """
    part = rows[first : first + count]
    chainages = [row.chainage_m for row in part]
    places = np.arange(first + 1, first + 1 + len(part), dtype=float)
    start, end, unit_along = first + 0.5, first + max(2, len(part)) + 0.5, "point"
    if by_chainage and len(set(chainages)) > 1 and None not in chainages:
        places = np.array(chainages, dtype=float)
        margin = 0.02 * float(np.ptp(places))
        start, end, unit_along = float(places.min()) - margin, float(places.max()) + margin, "m"
    order = np.argsort(places, kind="stable")
    unit, scale = max(part, key=lambda row: row.judged).display_unit

    def values_of(name: str) -> NDArray[np.float64]:
        values = (getattr(part[place], name) for place in order)
        return np.array([math.nan if v is None else v / scale for v in values], dtype=float)

    along = places[order]
    dash = HALF_MARK_OVER_WIDTH * (end - start)
    dashes = (along[:, None] + np.array([-dash, 0.0, dash])).ravel()
    ends = np.stack([values_of("low"), values_of("high")], axis=1).ravel()
    curves = [
        Curve(np.repeat(along, 2), ends, "axis", "│ 95 %", joined=False),
        Curve(along, values_of("target"), "warn", "target", dashed=True),
        Curve(dashes, np.repeat(values_of("value"), 3), "measured", "─ value", joined=False),
    ]
    return Figure(
        title="along the line",
        unit=unit,
        curves=tuple(curve for curve in curves if np.isfinite(curve.values).any()),
        start=start,
        end=end,
        time_unit=unit_along,
        note=f"points {first + 1} to {first + len(part)} of {len(rows)}",
        cursor=float(places[chosen - first]) if first <= chosen < first + len(part) else None,
    )


def profile_lines(
    rows: Sequence[PointRow],
    window: tuple[int, int],
    chosen: int,
    size: tuple[int, int],
    glyphs: Glyphs,
    *,
    by_chainage: bool = False,
) -> list[Line]:
    """Return the plot of values along the line, with the value of the chosen point below it."""
    width, height = size
    if not any(row.value is not None for row in rows):
        text = " no point has a value yet; pfwd invert computes it" if rows else " no point"
        return [line(cell(text, "dim"))]
    figure = profile_figure(rows, *window, chosen, by_chainage=by_chainage)
    lines = plot_lines(figure, width, max(3, height - 2), glyphs)
    row = rows[min(chosen, len(rows) - 1)]
    text = "no value" if row.value is None else SI.show(row.judged_fact)
    text = f" {row.title}: {text}  {row.state}"
    return [*lines, line(cell(text, "strong")), line(cell(" left/right moves, +/- zooms", "dim"))]


def map_lines(rows: Sequence[PointRow], chosen: str, width: int, height: int) -> list[Line]:
    """Return a map: o pass, x fail, ? undecided, · without a verdict, and names where they fit."""
    placed = [row for row in rows if row.latitude is not None and row.longitude is not None]
    if not placed or height < 4 or width < 10:
        return [line(cell(" no point has a position", "dim"))]
    north = [row.latitude or 0.0 for row in placed]
    east = [row.longitude or 0.0 for row in placed]
    top, west = max(north), min(east)
    shrink = math.cos(math.radians((min(north) + top) / 2))
    # A cell is about twice as high as wide.
    metres = 111_195.0
    high = max((top - min(north)) * metres, 1.0)
    wide = max((max(east) - west) * metres * shrink, 1.0)
    per_cell = max(wide / (width - 2), high / (2 * (height - 3)))
    grid: dict[tuple[int, int], PointRow] = {}
    for row, latitude, longitude in zip(placed, north, east, strict=True):
        x = (longitude - west) * metres * shrink / per_cell
        y = (top - latitude) * metres / (2 * per_cell)
        place = (min(height - 3, round(y)), min(width - 2, round(x)))
        before = grid.get(place)
        # Of several points in a cell the chosen one has priority, then one that failed.
        if before is None or row.name == chosen or (row.state == "FAIL" != before.state):
            grid[place] = row
    names = _map_names(grid, chosen, width - 1)
    lines: list[Line] = []
    for y in range(height - 2):
        letters: list[tuple[str, TextRole]] = [(" ", "text")]
        for x in range(width - 1):
            point = grid.get((y, x))
            if point is None:
                letters.append(names.get((y, x), (" ", "text")))
            elif point.name == chosen:
                letters.append(("@", "cursor"))
            else:
                mark = STATE_MARKS.get(point.state, "·")
                letters.append((mark, STATE_ROLES.get(point.state, "text")))
        lines.append(joined(letters))
    bar = max(1, round((width - 2) / 5))
    name = next((row.title for row in placed if row.name == chosen), "chosen point")
    scale = f" {'─' * bar} {_length(bar * per_cell)}, north up"
    marks = [piece(1, cell(text, "dim")) for text in ("o pass", "x fail", "? undecided")]
    return [
        *lines,
        fit([piece(0, cell(scale, "dim")), piece(0, cell(f"@ {name}", "strong")), *marks], width),
    ]


def _map_names(
    grid: Mapping[tuple[int, int], PointRow], chosen: str, width: int
) -> dict[tuple[int, int], tuple[str, TextRole]]:
    """Return the letters of the names of points that fit beside their marks without overlap."""
    letters: dict[tuple[int, int], tuple[str, TextRole]] = {}
    by_priority = sorted(
        grid.items(), key=lambda item: (item[1].name != chosen, item[1].state != "FAIL", item[0])
    )
    for (y, x), row in by_priority:
        name = cell(row.title).text
        if not name or cell_len(name) != len(name):
            continue
        role: TextRole = "strong" if row.name == chosen else "dim"
        for start in (x + 2, x - 1 - len(name)):
            # A free cell on either side separates the name from its neighbours.
            span = range(start - 1, start + len(name) + 1)
            is_free = all(
                (y, at) not in letters and ((y, at) not in grid or at == x) for at in span
            )
            if start >= 0 and start + len(name) <= width and is_free:
                letters |= {(y, start + at): (letter, role) for at, letter in enumerate(name)}
                break
    return letters


def _length(metres: float) -> str:
    return f"{metres / 1e3:.3g} km" if metres >= 1000 else f"{metres:.3g} m"


def _end_of_pulse(load: Curve) -> float:
    """Return the end of an overlay, ms: the end of the load pulse and a third of it more.

    Later the integrated signal of a geophone drifts, and the drift would set the scale.
    """
    loaded = load.time[load.values > END_OF_PULSE * np.nanmax(load.values)]
    after_pulse = float(loaded[-1]) * PULSE_MARGIN if loaded.size else math.inf
    return min(MAX_OVERLAY_MS, after_pulse, float(load.time[-1]))


def overlay_figures(drops: Sequence[tuple[str, Any]]) -> tuple[list[Figure], list[str]]:
    """Return load and deflection of drops over each other as recorded, and what was not readable.

    Parameters
    ----------
    drops : sequence of name and SurveyDrop
    """
    loads, depths, faults = [], [], []
    for place, (name, stored) in enumerate(drops[:MAX_OVERLAID_DROPS]):
        role = OVERLAY_ROLES[place % len(OVERLAY_ROLES)]
        dashed = place >= len(OVERLAY_ROLES)
        try:
            drop = stored.read_traces().drop
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
    end = max(_end_of_pulse(curve) for curve in loads)
    return [
        Figure("load", "kN", tuple(loads), -2.0, end),
        Figure("deflection as recorded", "µm", tuple(depths), -2.0, end),
    ], faults
