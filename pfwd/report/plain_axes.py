"""Ticks, numbers and grid of axes as few artists, which are faster than those of matplotlib.

matplotlib makes five artists for each tick and asks each for its size. In the pictures of a report
that took as long as everything else.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

_ABOVE_LINES, _BELOW_ALL = 2.01, 0.5
"""Levels at which ticks and grid are drawn; curves have 2, bars 1."""

_LINE_HEIGHT = 1.17
"""Height of a line of text over the size of its letters."""


def draw_axes_plainly(figure: Any) -> None:
    """Replace ticks, numbers, grid and titles of all axes of a figure by artists of their own.

    Axes whose numbers have a common factor or minor ticks keep what matplotlib draws.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Complete: ticks that are changed later are not drawn.
    """
    for axes in figure.axes:
        if axes.axison:
            axes.apply_aspect()
            for axis in (axes.xaxis, axes.yaxis):
                _replace(axes, axis)


def _replace(axes: Any, axis: Any) -> None:
    """Replace one axis, if it is visible and plain."""
    from matplotlib.ticker import NullLocator

    if not axis.get_visible() or not isinstance(axis.get_minor_locator(), NullLocator):
        return
    first, last = sorted(axis.get_view_interval())
    margin = 1e-9 * (last - first)
    positions = [float(value) for value in axis.get_majorticklocs()]
    formatter = axis.get_major_formatter()
    names = formatter.format_ticks(positions)
    if formatter.get_offset():
        return
    ticks = [
        (value, name)
        for value, name in zip(positions, names, strict=True)
        if first - margin <= value <= last + margin
    ]
    axis.set_visible(False)
    params = axis.get_tick_params()
    horizontal = axis is axes.xaxis
    if params.get("gridOn"):
        _draw_grid(axes, [value for value, _ in ticks], params, horizontal=horizontal)
    depth = _draw_ticks(axes, ticks, params, horizontal=horizontal)
    _draw_title(axes, axis, depth, horizontal=horizontal)


def _draw_grid(
    axes: Any, values: Sequence[float], params: dict[str, Any], *, horizontal: bool
) -> None:
    from matplotlib import rcParams
    from matplotlib.collections import LineCollection

    defaults: Any = rcParams
    ends = [[(v, 0.0), (v, 1.0)] if horizontal else [(0.0, v), (1.0, v)] for v in values]
    grid = LineCollection(
        ends,
        colors=params.get("grid_color", defaults["grid.color"]),
        linewidths=params.get("grid_linewidth", defaults["grid.linewidth"]),
        alpha=params.get("grid_alpha", defaults["grid.alpha"]),
        transform=axes.get_xaxis_transform() if horizontal else axes.get_yaxis_transform(),
        zorder=_BELOW_ALL,
    )
    axes.add_collection(grid, autolim=False)


def _draw_ticks(
    axes: Any,
    ticks: Sequence[tuple[float, str]],
    params: dict[str, Any],
    *,
    horizontal: bool,
) -> float:
    """Draw ticks with their numbers, and return how far they reach from the axes, points."""
    from matplotlib import rcParams
    from matplotlib.font_manager import FontProperties
    from matplotlib.lines import Line2D
    from matplotlib.markers import TICKDOWN, TICKLEFT
    from matplotlib.transforms import ScaledTranslation

    defaults: Any = rcParams
    side, kind = ("bottom", "xtick") if horizontal else ("left", "ytick")
    transform = axes.get_xaxis_transform() if horizontal else axes.get_yaxis_transform()
    length = params.get("length", defaults[f"{kind}.major.size"])
    pad = params.get("pad", defaults[f"{kind}.major.pad"])
    values, ends = [value for value, _ in ticks], np.zeros(len(ticks))
    marker: Any = TICKDOWN if horizontal else TICKLEFT
    if params.get(side, True):
        line = Line2D(
            values if horizontal else ends,
            ends if horizontal else values,
            linestyle="none",
            marker=marker,
            markersize=length,
            markeredgewidth=defaults[f"{kind}.major.width"],
            color=defaults[f"{kind}.color"],
            transform=transform,
            clip_on=False,
            zorder=_ABOVE_LINES,
        )
        axes.add_artist(line)
    if not params.get(f"label{side}", True):
        return float(length)
    gap = (length + pad) / 72.0
    shift = (0.0, -gap) if horizontal else (-gap, 0.0)
    font = FontProperties(size=params.get("labelsize", defaults[f"{kind}.labelsize"]))
    size = font.get_size_in_points()
    # Its key depends on the version of matplotlib.
    turned = bool(params.get("rotation", params.get("labelrotation", 0.0)))
    style: dict[str, Any] = {
        "transform": transform + ScaledTranslation(shift[0], shift[1], axes.figure.dpi_scale_trans),
        "fontsize": size,
        "horizontalalignment": "center" if horizontal else "right",
        "verticalalignment": "top" if horizontal else "center" if turned else "center_baseline",
        "rotation": 90 if turned else 0,
        "parse_math": False,
    }
    for value, name in ticks:
        axes.text(*((value, 0.0) if horizontal else (0.0, value)), name, **style)
    along_text = horizontal == turned
    reach = _widest([name for _, name in ticks], font) if along_text else size * _LINE_HEIGHT
    return float(length + pad + reach)


def _widest(names: Sequence[str], font: Any) -> float:
    """Return the largest width of texts, points."""
    from matplotlib.textpath import text_to_path

    sizes = (text_to_path.get_text_width_height_descent(name, font, False) for name in set(names))
    return max((float(width) for width, _, _ in sizes), default=0.0)


def _draw_title(axes: Any, axis: Any, depth: float, *, horizontal: bool) -> None:
    """Draw the title of an axis beyond its numbers, which reach so many points from the axes."""
    from matplotlib.transforms import ScaledTranslation

    label = axis.label
    if not label.get_text():
        return
    distance = (depth + axis.labelpad) / 72.0
    shift = (0.0, -distance) if horizontal else (-distance, 0.0)
    axes.text(
        *((0.5, 0.0) if horizontal else (0.0, 0.5)),
        label.get_text(),
        transform=axes.transAxes
        + ScaledTranslation(shift[0], shift[1], axes.figure.dpi_scale_trans),
        fontsize=label.get_fontsize(),
        color=label.get_color(),
        horizontalalignment="center",
        verticalalignment="top" if horizontal else "bottom",
        rotation=0 if horizontal else 90,
        rotation_mode="anchor",
        parse_math=False,
    )
