"""The drawings of the ground under a point: moduli over depth, and the deflection bowl."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pfwd.analysis.results import DropResult, LayerResult
from pfwd.analysis.sensor_fits import SensorFit, sensor_fits
from pfwd.judging import DropView
from pfwd.report.drawing import COLOURS, finish, margins
from pfwd.report.texts import Texts

BELOW = 1.35
"""Shown depth over that of the deepest boundary or of the effective depth: the lowest medium shows
as one that goes on."""

ROCK_SHOWN = 0.08
"""Part of the shown depth that rock takes."""

_STEADY, _OPEN = "-", ":"
_BAND = 0.14
"""Opacity: the bands of several drops lie on each other."""


def has_layers(drop: DropView) -> bool:
    """Whether the drop's result has a profile of moduli."""
    return drop.result is not None and len(drop.result.layers or ()) > 1


def draw_ground(figure: Any, drops: Sequence[DropView], texts: Texts) -> None:
    """Profile of moduli where there are layers, deflection bowl where there are sensors."""
    layered, bowls = [has_layers(drop) for drop in drops], [_bowl(drop) for drop in drops]
    wanted = [any(layered), any(bowls)]
    if all(wanted):
        left, right = figure.subplots(
            1,
            2,
            gridspec_kw={
                **margins(0.09, 0.985, 0.24, 0.97),
                "wspace": 0.22,
                "width_ratios": (1.0, 1.25),
            },
        )
    elif any(wanted):
        left = right = figure.subplots(gridspec_kw=margins(0.09, 0.985, 0.24, 0.97))
    else:
        return
    if wanted[0]:
        _draw_layers(left, drops, texts)
    if wanted[1]:
        _draw_bowl(right, drops, bowls, texts)


def _draw_layers(axes: Any, drops: Sequence[DropView], texts: Texts) -> None:
    shown = [(i, drop.result) for i, drop in enumerate(drops) if drop.result is not None]
    layered = [(i, result) for i, result in shown if len(result.layers or ()) > 1]
    bottom = BELOW * max(_reach(result) for _, result in layered)
    rock = [r.bedrock_depth_m for _, r in layered if r.bedrock_depth_m is not None]
    if rock:
        bottom = max(rock) / (1.0 - ROCK_SHOWN)
    for index, result in layered:
        _draw_profile(axes, result, COLOURS[index % len(COLOURS)], bottom)
    if rock:
        # Of several drops the deepest, below which all agree.
        axes.axhspan(
            max(rock), bottom, facecolor="0.92", edgecolor="0.55", hatch="////", linewidth=0.0
        )
        axes.axhline(max(rock), color="0.35", linewidth=1.0)
        axes.annotate(
            texts["rock"],
            (0.03, (max(rock) + bottom) / 2.0),
            xycoords=("axes fraction", "data"),
            fontsize=7,
            va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )
    axes.set_xscale("log")
    _decades(axes)
    axes.set_ylim(bottom, 0.0)
    axes.set_xlabel(texts["modulus_axis"], fontsize=8)
    axes.set_ylabel(texts["depth_axis"], fontsize=8)
    axes.plot([], [], color="0.3", linewidth=1.4, label=texts["layers"])
    if any(result.effective_modulus_pa is not None for _, result in layered):
        axes.plot([], [], "--", color="0.3", linewidth=1.0, label=texts["effective"])
    axes.legend(fontsize=7, loc="best")
    finish(axes, texts)


def _reach(result: DropResult) -> float:
    """How deep something is said of the ground, m."""
    ends = [result.effective_depth_m or 0.0, result.bedrock_depth_m or 0.0]
    thickness = [layer.thickness_m or 0.0 for layer in result.layers or ()]
    return max(*ends, sum(thickness), 1e-3)


def _draw_profile(axes: Any, result: DropResult, colour: str, bottom: float) -> None:
    """Steps, their bands, the intervals of the boundaries and what stands for all."""
    top, before, above = 0.0, None, LayerResult()
    for layer in result.layers or ():
        end = bottom if layer.thickness_m is None else top + layer.thickness_m
        value = None if layer.modulus_pa is None else layer.modulus_pa / 1e6
        if layer.modulus_interval_pa is not None:
            low, high = (edge / 1e6 for edge in layer.modulus_interval_pa)
            axes.fill_betweenx([top, end], low, high, color=colour, alpha=_BAND, linewidth=0.0)
        if value is not None:
            # A value that the record leaves open is one of many.
            style = _STEADY if layer.modulus_known else _OPEN
            axes.plot([value, value], [top, end], style, color=colour, linewidth=1.6)
            if before is not None:
                axes.plot([before, value], [top, top], color=colour, linewidth=1.6)
                _draw_boundary(axes, above, math.sqrt(before * value), top, colour)
        top, before, above = end, value, layer
    if before is not None:
        _draw_boundary(axes, above, before, top, colour)
    modulus, depth = result.effective_modulus_pa, result.effective_depth_m
    if modulus is not None and depth is not None:
        axes.plot([modulus / 1e6] * 2, [0.0, depth], "--", color=colour, linewidth=1.0)
        axes.plot([modulus / 1e6], [depth], "v", color=colour, markersize=3.5)


def _draw_boundary(axes: Any, layer: LayerResult, value: float, end: float, colour: str) -> None:
    """The interval of a layer's lower end, as a bar."""
    if layer.thickness_interval_m is None or layer.thickness_m is None:
        return
    low, high = (end - layer.thickness_m + edge for edge in layer.thickness_interval_m)
    axes.plot([value, value], [low, high], "_-", color=colour, linewidth=2.6, alpha=0.6)


def _decades(axes: Any) -> None:
    """Ticks as plain numbers, and a decade at least: else a log axis has no number at all."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    if high < 10.0 * low:
        middle = math.sqrt(low * high)
        low, high = middle / math.sqrt(10.0), middle * math.sqrt(10.0)
    axes.set_xlim(low, high)
    many = math.log10(high / low) > 2.5
    axes.xaxis.set_major_locator(LogLocator(10.0, (1.0,) if many else (1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _bowl(drop: DropView) -> tuple[SensorFit, ...]:
    """The sensors of a drop from one side to the other; none where there is a single one."""
    if drop.curves is None or drop.curves.offsets.size < 2:
        return ()
    return tuple(sorted(sensor_fits(drop.curves), key=lambda fit: fit.offset))


def _draw_bowl(
    axes: Any, drops: Sequence[DropView], bowls: Sequence[Sequence[SensorFit]], texts: Texts
) -> None:
    deepest = 0.0
    for index, (drop, bowl) in enumerate(zip(drops, bowls, strict=True)):
        if not bowl:
            continue
        colour = COLOURS[index % len(COLOURS)]
        offsets = np.array([fit.offset for fit in bowl])
        measured = np.array([fit.measured_peak for fit in bowl]) * 1e6
        modelled = np.array([fit.modelled_peak for fit in bowl]) * 1e6
        name = f"{texts['drop']} {drop.number}"
        axes.plot(offsets, modelled, "-", color=colour, linewidth=1.1, label=name)
        axes.plot(offsets, measured, "o", color=colour, markersize=4.0)
        deepest = max(deepest, float(measured.max()), float(modelled.max()))
    axes.plot([], [], "o", color="0.3", markersize=4.0, label=texts["bowl_measured"])
    axes.plot([], [], "-", color="0.3", linewidth=1.1, label=texts["bowl_modelled"])
    axes.axhline(0.0, color="0.7", linewidth=0.6)
    axes.set_ylim(1.08 * deepest, min(0.0, -0.04 * deepest))
    axes.set_xlabel(texts["offset_axis"], fontsize=8)
    axes.set_ylabel(texts["peak_axis"], fontsize=8)
    axes.legend(fontsize=7, loc="lower right")
    finish(axes, texts)
