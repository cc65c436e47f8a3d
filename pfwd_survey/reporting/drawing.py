"""The drawings of a report, into a figure of matplotlib or a part of one."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pfwd_survey.inverting.worker.tasks import Curves
from pfwd_survey.procedures import Quantity, Verdict
from pfwd_survey.reporting.blocks import SIGNS
from pfwd_survey.reporting.content import Report, ReportDrop, ReportPoint
from pfwd_survey.reporting.fonts import Letters
from pfwd_survey.reporting.shown import name_of
from pfwd_survey.reporting.texts import Texts

EARTH_RADIUS = 6_371_000.0
"""m, mean; a sketch of some kilometres needs no ellipsoid."""

COLOURS = ("#0b3c5d", "#b8500f", "#3d7a2a", "#7b3f8c", "#8a6d00", "#444444")
"""Distinguishable without colour vision."""

VERDICT_COLOURS = {"pass": "#1b7837", "fail": "#b2182b", "undecided": "#b8860b", "none": "#555555"}
VERDICT_SHAPES = {"pass": "o", "fail": "X", "undecided": "D", "none": "s"}

SHOWN_AFTER = 2.2
"""Window of the fit that a picture shows; what comes later is the same line."""

MOST_NAMES = 40
"""Points in a sketch that are named; more names hide each other."""

MOST_DOTS = 260
"""Of a trace; more cannot be told apart and make a file large."""


def place(report: Report) -> dict[int, tuple[float, float]]:
    """East and north of the points that have a position, m from their middle, by index."""
    known = {
        index: (float(point.position["latitude"]), float(point.position["longitude"]))
        for index, point in enumerate(report.points)
        if point.position is not None
    }
    if not known:
        return {}
    middle = [math.fsum(values) / len(known) for values in zip(*known.values(), strict=True)]
    scale = math.radians(1) * EARTH_RADIUS
    return {
        index: (
            (longitude - middle[1]) * scale * math.cos(math.radians(middle[0])),
            (latitude - middle[0]) * scale,
        )
        for index, (latitude, longitude) in known.items()
    }


def draw_map(figure: Any, report: Report, texts: Texts, letters: Letters) -> None:
    """Points from above, by their verdict."""
    axes = figure.subplots(gridspec_kw=margins(0.11, 0.97, 0.17, 0.96))
    places = place(report)
    for index, (east, north) in places.items():
        point = report.points[index]
        kind = _verdict(point)
        axes.plot(
            east,
            north,
            VERDICT_SHAPES[kind],
            color=VERDICT_COLOURS[kind],
            markersize=8,
            markeredgecolor="white",
        )
        if len(places) > MOST_NAMES:
            continue
        axes.annotate(
            f"{_short(letters.drawable(point.name))} {SIGNS[kind]}",
            (east, north),
            xytext=(6, 5),
            textcoords="offset points",
            fontsize=8,
            parse_math=False,
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
    finish(axes)


def draw_profile(figure: Any, report: Report, texts: Texts, letters: Letters) -> None:
    """What is judged, point by point, with intervals and targets."""
    axes = figure.subplots(gridspec_kw=margins(0.09, 0.98, 0.22, 0.96))
    distances = _distances(report)
    deflection = report.procedure.quantity is Quantity.DEFLECTION
    scale = 1e3 if deflection else 1e-6
    told: set[str] = set()
    highest = 0.0
    for index, point in enumerate(report.points):
        value = point.progress.value
        if value is None:
            continue
        x, y = distances[index], value.value * scale
        kind = _verdict(point)
        spread = None
        if value.interval is not None:
            low, high = (end * scale for end in value.interval)
            spread = [[y - low], [high - y]]
        highest = max(highest, y + (spread[1][0] if spread else 0.0))
        axes.errorbar(
            x,
            y,
            yerr=spread,
            fmt=VERDICT_SHAPES[kind],
            color=VERDICT_COLOURS[kind],
            capsize=4,
            markersize=7,
            label=texts[kind] if kind not in told else None,
        )
        told.add(kind)
        if point.progress.target is not None:
            target = point.progress.target * scale
            highest = max(highest, target)
            axes.hlines(
                target, x - 0.35 * _step(distances), x + 0.35 * _step(distances), "0.2", "dashed"
            )
    unit = "mm" if deflection else "MPa"
    axes.set_ylabel(f"{name_of(report.procedure.quantity, texts)}, {unit}", fontsize=8)
    by_distance = bool(place(report)) and len(place(report)) == len(report.points) > 1
    axes.set_xlabel(texts["profile_distance" if by_distance else "profile_order"], fontsize=8)
    if not by_distance and len(report.points) <= 24:
        names = [letters.drawable(point.name) for point in report.points]
        axes.set_xticks(distances, [_short(name) for name in names])
        for label in axes.get_xticklabels():
            label.set_parse_math(False)
            label.set_rotation(30 if max(map(len, names)) > 4 else 0)
    axes.set_ylim(0, 1.12 * highest if highest > 0 else 1.0)
    axes.margins(x=0.06 if len(report.points) > 1 else 0.5)
    if told:
        axes.legend(fontsize=7, loc="lower right", ncols=4)
    finish(axes)


def _distances(report: Report) -> list[float]:
    """Way from the first point to each, m, when all have a position; else their order."""
    places = place(report)
    if len(places) < len(report.points) or len(places) < 2:
        return [float(index) for index in range(1, len(report.points) + 1)]
    found = [0.0]
    for index in range(1, len(report.points)):
        found.append(found[-1] + math.dist(places[index - 1], places[index]))
    return found


def _step(distances: Sequence[float]) -> float:
    if len(distances) < 2:
        return 1.0
    return max((distances[-1] - distances[0]) / (len(distances) - 1), 1e-9)


def _short(name: str) -> str:
    return name if len(name) <= 12 else f"{name[:11]}…"


def _verdict(point: ReportPoint) -> str:
    return "none" if point.discarded else Verdict(point.progress.verdict).value


def draw_traces(figure: Any, drops: Sequence[ReportDrop], texts: Texts) -> None:
    """Load, displacement and residual of drops, one above the other."""
    load, moved, residual = figure.subplots(
        3,
        1,
        sharex=True,
        height_ratios=(1.0, 1.6, 1.0),
        gridspec_kw={**margins(0.09, 0.985, 0.115, 0.985), "hspace": 0.1},
    )
    ends = []
    for index, drop in enumerate(drops):
        curves = drop.curves
        if curves is None:
            continue
        colour = COLOURS[index % len(COLOURS)]
        end = _end(curves)
        ends.append(end)
        part = curves.time <= end
        few = np.flatnonzero(part)[:: max(1, int(part.sum()) // MOST_DOTS)]
        time = curves.time * 1e3
        name = f"{texts['drop']} {drop.number}"
        load.plot(time[part], curves.load[part] / 1e3, color=colour, linewidth=1.1, label=name)
        for row, offset in enumerate(curves.offsets):
            label = texts["centre"] if offset == 0 else f"{offset:g} m"
            if len(drops) == 1:
                colour = COLOURS[row % len(COLOURS)]
            moved.plot(
                time[few], curves.observed[row][few] * 1e6, ".", markersize=2.6, color=colour
            )
            moved.plot(
                time[part],
                curves.predicted[row][part] * 1e6,
                color=colour,
                linewidth=1.0,
                linestyle=("-", "--", "-.", ":")[row % 4],
                label=label if index == 0 else None,
            )
            left = curves.predicted[row] - curves.observed[row]
            residual.plot(time[few], left[few] * 1e6, color=colour, linewidth=0.9)
        moved.axvline(curves.window_end * 1e3, color="0.5", linewidth=0.8, linestyle=":")
        residual.axvline(curves.window_end * 1e3, color="0.5", linewidth=0.8, linestyle=":")
    load.set_ylabel(texts["load_axis"], fontsize=8)
    moved.set_ylabel(texts["deflection_axis"], fontsize=8)
    residual.set_ylabel(texts["residual_axis"], fontsize=7)
    residual.set_xlabel(texts["time_axis"], fontsize=8)
    for axes in (load, moved, residual):
        axes.axhline(0.0, color="0.7", linewidth=0.6)
        finish(axes)
    left_out = dict.fromkeys(offset for drop in drops for offset in drop.left_out)
    for offset in left_out:
        # Its name alone: what a loose sensor recorded would squeeze the others into a line.
        moved.plot([], [], color="0.6", label=texts.say("left_out", offset=f"{offset:g}"))
    if ends:
        load.legend(fontsize=7, loc="upper right")
        several = any(d.curves is not None and d.curves.offsets.size > 1 for d in drops)
        if several or left_out:
            moved.legend(fontsize=7, loc="upper right")
        load.set_xlim(right=max(ends) * 1e3)
    figure.align_ylabels([load, moved, residual])


def _end(curves: Curves) -> float:
    """Until when a drop is shown, s."""
    start = float(curves.time[0])
    return min(float(curves.time[-1]), start + SHOWN_AFTER * (curves.window_end - start))


def draw_compaction(figure: Any, point: ReportPoint, texts: Texts) -> None:
    """Deflection by drop, and the modulus beside it."""
    left, right = figure.subplots(
        1, 2, gridspec_kw={**margins(0.09, 0.985, 0.24, 0.95), "wspace": 0.24}
    )
    kinds = dict(point.progress.kinds)
    shapes = {"seating": ("s", "white"), "measured": ("o", COLOURS[0]), "discarded": ("x", "0.4")}
    told: set[str] = set()
    numbers, depths = [], []
    highest = {id(left): 0.0, id(right): 0.0}
    for number, kind, deflection in point.progress.compaction:
        shape, fill = shapes.get(kind, ("x", "0.4"))
        label = texts[kind] if kind not in told else None
        told.add(kind)
        style: Mapping[str, Any] = {
            "color": COLOURS[0] if kind != "discarded" else "0.4",
            "markerfacecolor": fill,
            "markersize": 6,
        }
        left.plot(number, deflection * 1e6, shape, label=label, **style)
        numbers.append(number)
        depths.append(deflection * 1e6)
        highest[id(left)] = max(highest[id(left)], deflection * 1e6)
    left.plot(numbers, depths, color="0.75", linewidth=1.0, zorder=0)
    left.set_ylabel(texts["deflection_axis"], fontsize=8)
    for drop in point.drops:
        facts = drop.facts
        if facts.modulus is None:
            continue
        value, spread = facts.modulus / 1e6, None
        if facts.modulus_interval is not None:
            low, high = (end / 1e6 for end in facts.modulus_interval)
            spread = [[value - low], [high - value]]
        highest[id(right)] = max(highest[id(right)], value + (spread[1][0] if spread else 0.0))
        shape, fill = shapes.get(str(kinds.get(drop.number)), ("x", "0.4"))
        right.errorbar(
            drop.number,
            value,
            yerr=spread,
            fmt=shape,
            color=COLOURS[0],
            markerfacecolor=fill,
            markersize=6,
            capsize=4,
        )
    right.set_ylabel(texts["modulus_axis"], fontsize=8)
    for axes in (left, right):
        axes.set_xlabel(texts["drop_axis"], fontsize=8)
        axes.margins(x=0.08)
        axes.set_ylim(0, 1.15 * (highest[id(axes)] or 1.0))
        axes.xaxis.get_major_locator().set_params(integer=True)
        finish(axes)
    if told:
        left.legend(fontsize=7, loc="lower right")


def margins(left: float, right: float, bottom: float, top: float) -> dict[str, float]:
    """Given, not found: parts of a page are not laid out by matplotlib."""
    return {"left": left, "right": right, "bottom": bottom, "top": top}


def finish(axes: Any) -> None:
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
