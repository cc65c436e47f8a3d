"""The pictures of a report, drawn into a figure of matplotlib."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inversion.result import TimeHistories
from pfwd.analysis.drop_facts import JudgedDeflection
from pfwd.files.photos import opened_photo
from pfwd.judging import DropView, PointView
from pfwd.procedures import Verdict
from pfwd.report.content import Report
from pfwd.report.fonts import Letters
from pfwd.report.formatting import declared, name_of, place_of_sensor
from pfwd.report.labels import common_beginning, on_page, place_labels, room_of
from pfwd.report.lot import Line, Lot
from pfwd.report.point_facts import shown_drops
from pfwd.report.texts import Texts

EARTH_RADIUS_M = 6_371_000.0
"""Mean radius of the earth; a sketch of some kilometres needs no ellipsoid."""

COLOURS = ("#0b3c5d", "#b8500f", "#3d7a2a", "#7b3f8c", "#8a6d00", "#444444")
"""Colours that can be distinguished without colour vision."""

VERDICT_COLOURS = {"pass": "#1b7837", "fail": "#b2182b", "undecided": "#b8860b", "none": "#555555"}
VERDICT_SHAPES = {"pass": "o", "fail": "X", "undecided": "D", "none": "s"}

DRAWN_PART_OF_WINDOW = 2.2
"""Length of the drawn time over that of the fitted window; later the curves are flat."""

_NAME_SIZE_PT = 7.5
"""Font size of the point names in the sketch."""

_MAX_NAMES_WITH_LINES = 30
"""Number of points up to which names without room beside their point get a line to it."""

_MAX_LARGE_MARKERS = 15
"""Number of points up to which the markers of a sketch are large; more would overlap."""

_MAX_AXIS_STEPS = 4
"""Number of tick intervals of an axis two centimetres long; with more, numbers would touch."""

MAX_LEGEND_SENSORS = 5
"""Number of sensors in the legend of a picture; more would hide the curves."""

MAX_PHOTOS = 4
"""Number of photos that a report shows for a point."""

PRINTED_PHOTO_PIXELS = 500
"""Longest side of a photo in a report, which is 45 mm wide there."""

MAX_DOTS = 260
"""Number of dots that a trace is thinned out to; more would only make the file larger."""


def place(report: Report) -> dict[int, tuple[float, float]]:
    """Return the places of the points on a plane: (east, north) from their centroid, m, by index.

    Points without a position are left out.
    """
    positions = {
        index: point.position
        for index, point in enumerate(report.points)
        if point.position is not None
    }
    if not positions:
        return {}
    centroid = [
        math.fsum(values) / len(positions) for values in zip(*positions.values(), strict=True)
    ]
    scale = math.radians(1) * EARTH_RADIUS_M
    return {
        index: (
            (longitude - centroid[1]) * scale * math.cos(math.radians(centroid[0])),
            (latitude - centroid[0]) * scale,
        )
        for index, (latitude, longitude) in positions.items()
    }


def draw_map(figure: Any, report: Report, texts: Texts, letters: Letters) -> None:
    """Draw a sketch of the points from above, marked by their verdicts."""
    axes = figure.subplots(gridspec_kw=margins(0.11, 0.97, 0.17, 0.96))
    places = place(report)
    radius = 4.0 if len(places) <= _MAX_LARGE_MARKERS else 2.5
    for index, (east, north) in places.items():
        kind = _verdict(report.points[index])
        axes.plot(
            east,
            north,
            VERDICT_SHAPES[kind],
            color=VERDICT_COLOURS[kind],
            markersize=2 * radius,
            markeredgecolor="white",
        )
    if len(places) > 1:
        path = np.array(list(places.values()))
        axes.plot(path[:, 0], path[:, 1], color="0.75", linewidth=1.0, zorder=0)
    axes.set_xlabel(texts["east_axis"], fontsize=8)
    axes.set_ylabel(texts["north_axis"], fontsize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.18)
    axes.annotate(
        "N",
        xy=(0.97, 0.98),
        xytext=(0.97, 0.74),
        xycoords="axes fraction",
        ha="center",
        fontsize=9,
        arrowprops={"arrowstyle": "->", "color": "0.2"},
    )
    finish(axes, texts)
    _name_points(axes, report, places, letters, radius)


def _name_points(
    axes: Any,
    report: Report,
    places: Mapping[int, tuple[float, float]],
    letters: Letters,
    radius: float,
) -> None:
    """Write names beside the markers, except those that would hide a name or a marker."""
    axes.apply_aspect()  # places on the page are known from here on
    titles = [letters.drawable(report.points[index].name) for index in places]
    skipped = len(common_beginning(titles))
    names = [_short(title[skipped:]) for title in titles]
    sizes = [(letters.width(name, _NAME_SIZE_PT) + 2, _NAME_SIZE_PT * 1.3) for name in names]
    spots = list(places.values())
    for label in place_labels(on_page(axes, spots), sizes, room_of(axes), radius + 0.5):
        if label.has_line and len(spots) > _MAX_NAMES_WITH_LINES:
            continue  # lines to many names would cover the sketch
        line = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.6}
        axes.annotate(
            names[label.number],
            spots[label.number],
            xytext=(label.dx, label.dy),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=_NAME_SIZE_PT,
            parse_math=False,
            arrowprops=line if label.has_line else None,
        )


def draw_profile(figure: Any, report: Report, texts: Texts, letters: Letters) -> None:
    """Draw the judged quantity point by point, with intervals and targets."""
    axes = figure.subplots(gridspec_kw=margins(0.09, 0.98, 0.24, 0.90))
    distances = _distances(report)
    unit, scale = report.procedure.quantity.display_unit
    labelled: set[str] = set()
    highest = 0.0
    for index, point in enumerate(report.points):
        value = point.progress.value
        if value is None:
            continue
        x, kind = distances[index], _verdict(point)
        style = {"fmt": VERDICT_SHAPES[kind], "color": VERDICT_COLOURS[kind], "markersize": 7}
        label = texts[kind] if kind not in labelled else None
        top = _draw_value(axes, x, value.value, value.interval, scale, label=label, **style)
        highest = max(highest, top)
        labelled.add(kind)
        if point.progress.target is not None:
            target = point.progress.target / scale
            highest = max(highest, target)
            axes.hlines(
                target, x - 0.35 * _step(distances), x + 0.35 * _step(distances), "0.2", "dashed"
            )
    axes.set_ylabel(f"{name_of(report.procedure.quantity, texts)}, {unit}", fontsize=8)
    by_distance = has_distances(report)
    axes.set_xlabel(texts["profile_distance" if by_distance else "profile_order"], fontsize=8)
    axes.set_ylim(0, 1.12 * highest if highest > 0 else 1.0)
    axes.margins(x=0.06 if len(report.points) > 1 else 0.5)
    if labelled:
        # Above the axes, where no point is.
        above = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.985)}
        axes.legend(fontsize=7, ncols=4, frameon=False, **above)
    finish(axes, texts)
    if not by_distance:
        name_ticks(axes, distances, [point.shown_name for point in report.points], letters)


def _draw_value(
    axes: Any,
    place: float,
    value: float,
    interval: tuple[float, float] | None,
    scale: float,
    **style: Any,
) -> float:
    """Draw a value with its interval in a unit of this scale; return its upper end there."""
    low, high = interval or (value, value)
    ends = None if interval is None else [[(value - low) / scale], [(high - value) / scale]]
    axes.errorbar(place, value / scale, yerr=ends, capsize=4, **style)
    return max(value, high) / scale


def draw_peaks_profile(
    figure: Any,
    report: Report,
    points: Sequence[PointView],
    moduli: Sequence[Sequence[float]],
    texts: Texts,
    letters: Letters,
) -> None:
    """Draw the deflections of all sensors along the points, and the peak modulus below them.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    report : Report
    points : sequence of PointView
    moduli : sequence of sequence of float, Pa
        Peak moduli of the averaged drops of each point.
    texts : Texts
    letters : Letters
    """
    from matplotlib import colormaps

    by_distance = has_distances(report)
    all_places = dict(zip(map(id, report.points), _distances(report), strict=True))
    places = [all_places[id(point)] for point in points]
    depth = figure.add_axes((0.09, 0.44, 0.78, 0.52))
    below = figure.add_axes((0.09, 0.15, 0.78, 0.24), sharex=depth)
    peaks = [_mean_peaks(point) for point in points]
    offsets = sorted({offset for of_point in peaks for offset in of_point})
    for number, offset in enumerate(offsets):
        colour = colormaps["viridis"](0.9 * number / max(1, len(offsets) - 1))
        values = [1e6 * of_point.get(offset, math.nan) for of_point in peaks]
        label = place_of_sensor(offset, texts)
        depth.plot(places, values, ".-", color=colour, linewidth=0.9, markersize=4, label=label)
    depth.set_ylim(bottom=0.0)
    depth.invert_yaxis()
    depth.set_ylabel(f"{texts['deflection']}, µm", fontsize=7)
    depth.legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.005, 1.03), frameon=False)
    depth.tick_params(labelbottom=False)
    means = [1e-6 * float(np.mean(values)) if values else math.nan for values in moduli]
    below.plot(places, means, ".-", color=COLOURS[0], linewidth=0.9, markersize=4)
    below.set_ylim(bottom=0.0)
    below.set_ylabel(f"{texts['peak_method']}, MPa", fontsize=7)
    below.set_xlabel(texts["profile_distance" if by_distance else "profile_order"], fontsize=8)
    below.locator_params(axis="y", nbins=_MAX_AXIS_STEPS)
    for axes in (depth, below):
        finish(axes, texts)
    if not by_distance:
        name_ticks(below, places, [point.shown_name for point in points], letters)


def _mean_peaks(point: PointView) -> dict[float, float]:
    """Return the mean peak of the averaged drops by distance from the centre, m."""
    values: dict[float, list[float]] = {}
    for drop in point.drops:
        if drop.number in point.progress.used and drop.peaks is not None:
            for offset, peak in drop.peaks.displacements:
                values.setdefault(offset, []).append(peak)
    return {offset: math.fsum(of_offset) / len(of_offset) for offset, of_offset in values.items()}


def has_distances(report: Report) -> bool:
    """Return whether all points have positions, so that a profile can have distances."""
    return len(place(report)) == len(report.points) > 1


def name_ticks(axes: Any, places: Sequence[float], titles: Sequence[str], letters: Letters) -> None:
    """Write names below an axis: upright if they are long, only every nth if they are many.

    No two of them overlap.
    """
    names = [letters.drawable(title) for title in titles]
    skipped = len(common_beginning(names))
    names = [_short(name[skipped:]) for name in names]
    room = room_of(axes)
    step = (room.x1 - room.x0) / max(1, len(names))
    widest = max(letters.width(name, 7.0) for name in names) + 4
    turned = widest > step
    every = max(1, math.ceil((9.0 if turned else widest) / step))
    axes.set_xticks(list(places)[::every], names[::every])
    for label in axes.get_xticklabels():
        label.set_parse_math(False)
    axes.tick_params(axis="x", labelrotation=90 if turned else 0)


def _distances(report: Report) -> list[float]:
    """Return the distance of each point along the path of the points, m.

    If a point has no position: the numbers 1, 2, 3 of all points.
    """
    places = place(report)
    if len(places) < len(report.points) or len(places) < 2:
        return [float(index) for index in range(1, len(report.points) + 1)]
    distances = [0.0]
    for index in range(1, len(report.points)):
        distances.append(distances[-1] + math.dist(places[index - 1], places[index]))
    return distances


def _step(distances: Sequence[float]) -> float:
    if len(distances) < 2:
        return 1.0
    return max((distances[-1] - distances[0]) / (len(distances) - 1), 1e-9)


def _short(name: str, max_length: int = 12) -> str:
    return name if len(name) <= max_length else f"{name[: max_length - 1]}…"


def _verdict(point: PointView) -> str:
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def draw_point(figure: Any, point: PointView, drops: Sequence[DropView], texts: Texts) -> None:
    """Draw traces of drops on the left, deflection and modulus drop by drop on the right."""
    several = len(point.progress.compaction) > 1
    if drops:
        _draw_traces(figure, drops, texts, 0.62 if several else 0.985)
    if several:
        start = 0.71 if drops else 0.09
        if not any(drop.facts.modulus for drop in point.drops):
            axes = figure.add_axes((start, 0.24, 0.985 - start, 0.64))
            _draw_deflections(axes, point, texts)
            return
        bottom = figure.add_axes((start, 0.16, 0.985 - start, 0.33))
        top = figure.add_axes((start, 0.585, 0.985 - start, 0.33), sharex=bottom)
        _draw_deflections(top, point, texts)
        _draw_moduli(bottom, point, texts)
        top.set_xlabel("")
        top.tick_params(labelbottom=False)


def _draw_traces(figure: Any, drops: Sequence[DropView], texts: Texts, right: float) -> None:
    wide = right - 0.1
    residual = figure.add_axes((0.1, 0.16, wide, 0.235))
    moved = figure.add_axes((0.1, 0.42, wide, 0.33), sharex=residual)
    load = figure.add_axes((0.1, 0.775, wide, 0.21), sharex=residual)
    for axes in (load, moved):
        axes.tick_params(labelbottom=False)
    ends = []
    for index, drop in enumerate(drops):
        curves = drop.curves
        if curves is None:
            continue
        colour = COLOURS[index % len(COLOURS)]
        end = _end(curves)
        ends.append(end)
        part = curves.time <= end
        dots = np.flatnonzero(part)[:: max(1, int(part.sum()) // MAX_DOTS)]
        time = curves.time * 1e3
        name = f"{texts['drop']} {drop.number}"
        load.plot(time[part], curves.load[part] / 1e3, color=colour, linewidth=1.1, label=name)
        for values in () if curves.before is None else curves.before:
            grey: Mapping[str, Any] = {"color": "0.65", "linewidth": 0.9, "zorder": 1.5}
            moved.plot(time[part], values[part] * 1e3, **grey)
        # A single sensor needs no name, and many names would hide the curves.
        sensors = curves.offsets.size
        is_named = sensors <= MAX_LEGEND_SENSORS and sensors + len(drop.left_out) > 1
        for row, offset in enumerate(curves.offsets):
            label = place_of_sensor(offset, texts)
            if len(drops) == 1:
                colour = COLOURS[row % len(COLOURS)]
            moved.plot(
                time[dots], curves.observed[row][dots] * 1e3, ".", markersize=2.6, color=colour
            )
            moved.plot(
                time[part],
                curves.predicted[row][part] * 1e3,
                color=colour,
                linewidth=1.0,
                linestyle=("-", "--", "-.", ":")[row % 4],
                label=label if index == 0 and is_named else None,
            )
            difference = curves.predicted[row] - curves.observed[row]
            residual.plot(time[dots], difference[dots] * 1e6, color=colour, linewidth=0.9)
        moved.axvline(curves.window_end * 1e3, color="0.5", linewidth=0.8, linestyle=":")
        residual.axvline(curves.window_end * 1e3, color="0.5", linewidth=0.8, linestyle=":")
    titles = ("load_axis", "deflection_axis", "residual_axis")
    for axes, title in zip((load, moved, residual), titles, strict=True):
        # The unit stands in a line of its own, lest the words run into each other.
        axes.set_ylabel(re.sub(", |，", "\n", texts[title]), fontsize=5.5, linespacing=1.1)
        axes.yaxis.set_label_coords(-0.068 / wide, 0.5)
    residual.set_xlabel(texts["time_axis"], fontsize=7, labelpad=1)
    for axes in (load, moved, residual):
        axes.axhline(0.0, color="0.7", linewidth=0.6)
        axes.locator_params(axis="y", nbins=_MAX_AXIS_STEPS)
        finish(axes, texts)
    excluded = dict.fromkeys(offset for drop in drops for offset in drop.left_out)
    for offset in excluded:
        # Its name alone: what a loose sensor recorded would squeeze the others into a line.
        moved.plot([], [], color="0.6", label=texts.say("left_out", offset=declared(offset, texts)))
    if ends:
        load.legend(fontsize=7, loc="upper right")
        drawn = [drop.curves for drop in drops if drop.curves is not None]
        if has_before := any(curves.before is not None for curves in drawn):
            moved.plot([], [], color="0.65", linewidth=0.9, label=texts["before"])
        if has_before or excluded or max(curves.offsets.size for curves in drawn) > 1:
            moved.legend(fontsize=6, loc="upper right")
        load.set_xlim(right=max(ends) * 1e3)


def _end(curves: TimeHistories) -> float:
    """Return the time at which the picture of a drop ends, s."""
    start = float(curves.time[0])
    return min(float(curves.time[-1]), start + DRAWN_PART_OF_WINDOW * (curves.window_end - start))


_DROP_SHAPES = {
    "seating": ("s", "white"),
    "measured": ("o", COLOURS[0]),
    "discarded": ("x", "0.4"),
}
_REJECTED_SHAPE = ("x", "0.4")


def _draw_deflections(axes: Any, point: PointView, texts: Texts) -> None:
    """Draw the deflection of each drop."""
    labelled: set[str] = set()
    numbers, depths = [], []
    for number, kind, deflection in point.progress.compaction:
        shape, fill = _DROP_SHAPES.get(kind, _REJECTED_SHAPE)
        label = texts[kind] if kind not in labelled else None
        labelled.add(kind)
        style: Mapping[str, Any] = {
            "color": COLOURS[0] if kind != "discarded" else "0.4",
            "markerfacecolor": fill,
            "markersize": 6,
        }
        axes.plot(number, deflection * 1e3, shape, label=label, **style)
        numbers.append(number)
        depths.append(deflection * 1e3)
    axes.plot(numbers, depths, color="0.75", linewidth=1.0, zorder=0)
    axes.set_ylabel(texts["deflection_axis"], fontsize=6)
    _finish_by_drop(axes, max([0.0, *depths]), texts)
    if labelled:
        # Above the axes, where no drop is.
        axes.legend(
            fontsize=6.5,
            loc="lower right",
            bbox_to_anchor=(1.02, 0.98),
            ncols=3,
            frameon=False,
            handletextpad=0.1,
            columnspacing=0.8,
        )


def _draw_moduli(axes: Any, point: PointView, texts: Texts) -> None:
    """Draw the modulus of each drop with its interval."""
    kinds = dict(point.progress.kinds)
    highest = 0.0
    for drop in point.drops:
        facts = drop.facts
        if facts.modulus is None:
            continue
        shape, fill = _DROP_SHAPES.get(str(kinds.get(drop.number)), _REJECTED_SHAPE)
        style = {"fmt": shape, "color": COLOURS[0], "markerfacecolor": fill, "markersize": 6}
        interval = facts.modulus_interval
        top = _draw_value(axes, drop.number, facts.modulus, interval, 1e6, **style)
        highest = max(highest, top)
    axes.set_ylabel(texts["modulus_axis"], fontsize=6)
    _finish_by_drop(axes, highest, texts)


def _finish_by_drop(axes: Any, highest: float, texts: Texts) -> None:
    axes.set_xlabel(texts["drop_axis"], fontsize=7, labelpad=1)
    axes.margins(x=0.08)
    axes.set_ylim(0, 1.15 * (highest or 1.0))
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.locator_params(axis="y", nbins=_MAX_AXIS_STEPS)
    finish(axes, texts)


_CURVES_IN_ROW, _MAX_CURVES_IN_ROW = 4, 6
"""Number of curves side by side: usually, and where that would give more than two rows."""

_SINGLE_HEIGHT, _ROW_HEIGHT, _SMALL_ROW_HEIGHT, _FOOT_HEIGHT = 62.0, 33.0, 30.0, 8.0
"""Heights in mm: picture of a single point, row of curves, row of small curves, axis below."""

_MAX_DEFLECTION_OVER_MEDIAN = 2.5
"""Deflection over the median of the points up to which a point is drawn to the common scale; with
a deeper one the curves of all others would be flat."""


def _curve_columns(points: Sequence[PointView]) -> int:
    in_row = _CURVES_IN_ROW if len(points) <= 2 * _CURVES_IN_ROW else _MAX_CURVES_IN_ROW
    return min(len(points), in_row)


def curves_height(points: Sequence[PointView]) -> float:
    """Return the height of the picture of :func:`draw_curves`, mm."""
    if len(points) == 1:
        return _SINGLE_HEIGHT
    columns = _curve_columns(points)
    row = _SMALL_ROW_HEIGHT if columns > _CURVES_IN_ROW else _ROW_HEIGHT
    return math.ceil(len(points) / columns) * row + _FOOT_HEIGHT


def draw_curves(figure: Any, points: Sequence[PointView], texts: Texts, letters: Letters) -> None:
    """Draw the deflection over time of the averaged drops, with axes for each point.

    All points have one scale, but for those that are much deeper than the others.
    """
    columns = _curve_columns(points)
    rows = math.ceil(len(points) / columns)
    base = _FOOT_HEIGHT / curves_height(points)
    wide, high = 0.93 / columns, (1.0 - base) / rows
    deep = points_out_of_scale(points)
    common = _deflection_range([point for place, point in enumerate(points) if place not in deep])
    times = [curve.time * 1e3 for curve in _curves(points)]
    first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    numbered_rows = set()  # rows that have the numbers of the common scale
    for number, point in enumerate(points):
        row, column = divmod(number, columns)
        has_numbers = number in deep or row not in numbered_rows
        if number not in deep:
            numbered_rows.add(row)
        x, y = 0.07 + column * wide, base + (rows - 1 - row) * high
        axes = figure.add_axes((x, y, wide * 0.86, high * 0.74))
        for index, drop in enumerate(with_deflection(point)):
            _draw_curve(axes, drop, COLOURS[index % len(COLOURS)])
        highest, deepest = _deflection_range([point]) if number in deep else common
        room = 0.08 * (deepest - highest)
        above = 3 * room if number in deep else room  # words stand there
        axes.set_ylim(deepest + room, highest - above)  # a plate goes down
        axes.set_xlim(first, last)
        axes.locator_params(nbins=_MAX_AXIS_STEPS)
        axes.axhline(0.0, color="0.7", linewidth=0.6)
        title = _short(letters.drawable(point.shown_name), 88 // columns)
        if number in deep:
            place = {"ha": "right", "va": "top", "transform": axes.transAxes}
            axes.text(0.99, 0.99, texts["own_scale"], fontsize=5.5, **place)
        axes.set_title(title, fontsize=7, pad=2, parse_math=False)
        finish(axes, texts)
        axes.tick_params(labelsize=6, labelleft=has_numbers)
        if axes.lines[1:]:
            axes.legend(fontsize=5.5, loc="lower right", frameon=False, handlelength=1.0)
        if not column:
            axes.set_ylabel("s, mm", fontsize=7)
        if number + columns >= len(points):
            # The words have room below an axis of up to four in a row.
            title = texts["time_axis"] if columns <= _CURVES_IN_ROW else "t, ms"
            axes.set_xlabel(title, fontsize=7, labelpad=1)


def _draw_curve(axes: Any, drop: DropView, colour: str) -> None:
    curve = drop.deflection
    if curve is None:
        return
    step = max(1, curve.time.size // MAX_DOTS)
    # The peak and the last sample are drawn, whatever lies between two dots.
    ends = (int(curve.deflection.argmax()), curve.time.size - 1)
    dots = np.union1d(np.arange(0, curve.time.size, step), ends)
    axes.plot(
        curve.time[dots] * 1e3,
        curve.deflection[dots] * 1e3,
        color=colour,
        linewidth=0.9,
        label=str(drop.number),
    )


def with_deflection(point: PointView) -> list[DropView]:
    """Return the shown drops that have a deflection over time."""
    return [drop for drop in shown_drops(point) if drop.deflection is not None]


def points_out_of_scale(points: Sequence[PointView]) -> set[int]:
    """Return the indices of the points whose deflections are too large for the common scale."""
    deepest = [_deflection_range([point])[1] for point in points]
    limit = _MAX_DEFLECTION_OVER_MEDIAN * float(np.median(deepest))
    return {place for place, depth in enumerate(deepest) if depth > limit}


def _deflection_range(points: Sequence[PointView]) -> tuple[float, float]:
    """Return the smallest (at most 0) and the largest deflection of the drawn curves, mm."""
    depths = [curve.deflection * 1e3 for curve in _curves(points)]
    return min(0.0, *(float(d.min()) for d in depths)), max(float(d.max()) for d in depths)


def _curves(points: Sequence[PointView]) -> list[JudgedDeflection]:
    """Return the drawn curves of points."""
    drops = [drop for point in points for drop in with_deflection(point)]
    return [drop.deflection for drop in drops if drop.deflection is not None]


def draw_signatures(figure: Any, labels: Sequence[str]) -> None:
    """Draw lines to sign on, each with its label below."""
    axes = blank_axes(figure, 0.0)
    wide = 1.0 / len(labels)
    for number, label in enumerate(labels):
        draw_signature(axes, number * wide, 0.34, 0.88 * wide, 0.26, label)


def blank_axes(figure: Any, start: float) -> Any:
    """Return axes from 0 to 1 without lines and numbers, from a place to the right edge."""
    axes = figure.add_axes((start, 0.0, 1.0 - start, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    return axes


def draw_signature(
    axes: Any, left: float, height: float, wide: float, gap: float, label: str
) -> None:
    """Draw a line to sign on, with its label below."""
    axes.plot([left, left + wide], [height, height], color="0.2", linewidth=0.8)
    axes.text(left, height - gap, label, fontsize=7.5, color="0.35", parse_math=False)


def draw_logo(figure: Any, image: Any) -> None:
    """Draw the logo at the left, over the full height."""
    axes = figure.add_axes((0.0, 0.02, 0.45, 0.96))
    axes.imshow(image)
    axes.set_anchor("W")
    axes.set_axis_off()


def draw_photos(figure: Any, files: Sequence[Path]) -> None:
    """Draw photos side by side, rotated upright and reduced to the printed resolution."""
    from PIL import ImageOps

    for place, file in enumerate(files):
        axes = figure.add_axes((place / MAX_PHOTOS, 0.0, 0.97 / MAX_PHOTOS, 1.0))
        axes.set_axis_off()
        axes.set_anchor("NW")
        with open(file, "rb") as stream, opened_photo(stream) as image:
            image.thumbnail((2 * PRINTED_PHOTO_PIXELS, 2 * PRINTED_PHOTO_PIXELS))
            upright = ImageOps.exif_transpose(image)
            upright.thumbnail((PRINTED_PHOTO_PIXELS, PRINTED_PHOTO_PIXELS))
            axes.imshow(np.asarray(upright.convert("RGB")))


def draw_lot(figure: Any, lot: Lot, unit: str, target: float | None, texts: Texts) -> None:
    """Draw the control chart of the values in their order, and their histogram."""
    shape = {**margins(0.09, 0.985, 0.19, 0.88), "wspace": 0.16, "width_ratios": (2.2, 1.0)}
    chart, bars = figure.subplots(1, 2, gridspec_kw=shape)
    numbers = np.arange(1, len(lot.values) + 1)
    values = np.asarray(lot.values)
    chart.plot(numbers, values, color="0.75", linewidth=1.0, zorder=0)
    chart.plot(numbers, values, "o", color=COLOURS[0], markersize=4)
    out = list(lot.noticeable)
    if out:
        ring: Mapping[str, Any] = {"markersize": 9, "markerfacecolor": "none"}
        chart.plot(
            numbers[out], values[out], "o", color=COLOURS[1], label=texts["outliers"], **ring
        )
    chart.axhline(lot.mean, color=COLOURS[0], linewidth=1.0, label=texts["mean"])
    for limit, name in zip(lot.limits, (texts["control_limits"], None), strict=True):
        chart.axhline(limit, color=COLOURS[1], linewidth=0.9, linestyle="--", label=name)
    line: Mapping[str, Any] = {"color": COLOURS[3], "linewidth": 0.9, "linestyle": ":"}
    if lot.characteristic > 0:
        chart.axhline(lot.characteristic, label=texts["characteristic_short"], **line)
    if target is not None:
        chart.axhline(target, color="0.2", linewidth=1.0, linestyle="-.", label=texts["target"])
    chart.set_ylim(0.0, 1.08 * max(*values, *lot.limits, target or 0.0))
    chart.set_ylabel(unit, fontsize=8)
    chart.set_xlabel(texts["profile_order"], fontsize=8)
    chart.xaxis.get_major_locator().set_params(integer=True)
    chart.legend(fontsize=6.5, loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=5, frameon=False)
    bars.hist(values, bins="auto" if len(values) > 5 else 3, color=COLOURS[0], rwidth=0.94)
    bars.set_xlabel(unit, fontsize=8)
    bars.set_ylabel(texts["points"], fontsize=8)
    bars.yaxis.get_major_locator().set_params(integer=True)
    for axes in (chart, bars):
        finish(axes, texts)


def draw_correlation(
    figure: Any,
    pairs: Sequence[tuple[float, float]],
    line: Line,
    names: tuple[str, str],
    texts: Texts,
) -> None:
    """Draw pairs of judged values and moduli of plate load tests, and the line through them."""
    axes = figure.subplots(gridspec_kw=margins(0.09, 0.6, 0.2, 0.96))
    xs, ys = zip(*pairs, strict=True)
    axes.plot(xs, ys, "o", color=COLOURS[0], markersize=5)
    ends = np.array([min(xs), max(xs)])
    axes.plot(ends, line.intercept + line.slope * ends, color=COLOURS[1], linewidth=1.2)
    axes.set_xlabel(names[0], fontsize=7)
    axes.set_ylabel(names[1], fontsize=6)
    axes.margins(0.12)
    finish(axes, texts)


def margins(x0: float, x1: float, y0: float, y1: float) -> dict[str, Any]:
    """Return arguments for a grid of axes: its edges as fractions of the width and height."""
    return {"left": x0, "right": x1, "bottom": y0, "top": y1}


def finish(axes: Any, texts: Texts) -> None:
    """Apply the style of all pictures to axes: grid, font size, decimal sign of the language."""
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if (decimal := texts.decimal) != ".":
        from matplotlib.ticker import ScalarFormatter

        class _Localised(ScalarFormatter):
            def __call__(self, value: float, place: Any = None) -> str:
                return str(super().__call__(value, place)).replace(".", decimal)

        for axis in (axes.xaxis, axes.yaxis):
            if type(axis.get_major_formatter()) is ScalarFormatter:
                axis.set_major_formatter(_Localised())


_MAX_RATIO_BY_1_2_5 = 300.0
"""Ends of a logarithmic axis, one over the other, up to which it is numbered at 2 and 5, too."""


def number_log_axis(axes: Any, texts: Texts, min_ratio: float = 1.0) -> None:
    """Number a logarithmic horizontal axis with plain numbers.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    texts : Texts
    min_ratio : float
        Smallest ratio of the ends of the axis; less than a decade may hold no number at all.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    low, high = axes.get_xlim()
    if high < min_ratio * low:
        centre, half = math.sqrt(low * high), math.sqrt(min_ratio)
        low, high = centre / half, centre * half
        axes.set_xlim(low, high)
    digits = (1.0,) if high > _MAX_RATIO_BY_1_2_5 * low else (1.0, 2.0, 5.0)
    axes.xaxis.set_major_locator(LogLocator(10.0, digits))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _place: declared(value, texts)))
