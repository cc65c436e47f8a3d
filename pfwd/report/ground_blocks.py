"""The part of a point's page on the ground: profile, bowl, residual by sensor, layers."""

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from pfwd.analysis.results import DropResult, LayerResult
from pfwd.analysis.sensor_fits import SensorFit, over_drops, sensor_fits
from pfwd.digits import significant
from pfwd.facts import facts_of_drop
from pfwd.judging import DropView
from pfwd.report import formatting
from pfwd.report.blocks import Block, Heading, Paragraph, Picture
from pfwd.report.drawing import COLOURS, finish, margins, number_log_axis
from pfwd.report.formatting import Column, declared, number
from pfwd.report.point_facts import drops_text
from pfwd.report.texts import Texts
from pfwd.units import DECLARED, Fact

_LAYERS_HEIGHT, _BOWL_HEIGHT = 66.0, 42.0
"""Heights of the picture in mm: layers with deflection bowl, and the bowl alone."""


def ground_blocks(drops: Sequence[DropView], name: str, texts: Texts) -> list[Block]:
    """Return the blocks on layers and deflection bowl; empty for one sensor without layers.

    Parameters
    ----------
    drops : sequence of DropView
    name : str
        Of the point.
    texts : Texts
    """
    layered = [drop for drop in drops if drop.has_layers]
    several = [drop for drop in drops if drop.curves is not None and drop.curves.offsets.size > 1]
    captions = [texts["layers_note"]] if layered else []
    captions += [texts["bowl_note"]] if several else []
    if not captions:
        return []
    title = texts["ground" if layered else "bowl"]
    picture = Picture(
        partial(draw_ground, drops=drops, texts=texts),
        _LAYERS_HEIGHT if layered else _BOWL_HEIGHT,
        f"{title}. {' '.join(captions)}",
        f"{title}: {texts['point']} {name}",
    )
    blocks: list[Block] = [picture]
    if layered:
        blocks += _layers(layered, texts)
    if several:
        blocks += _sensors(several, texts)
    return blocks


def effective_of(result: DropResult, texts: Texts) -> str:
    """Return the effective modulus with its interval and the depth that it stands for."""
    depth = result.effective_depth_m
    if result.effective_modulus_pa is None or depth is None:
        return formatting.NO_VALUE
    value = formatting.show(facts_of_drop(result)["effective"], texts)
    return texts.say("effective_text", value=value, depth=texts.decimals(significant(depth, 2)))


def _layers(drops: Sequence[DropView], texts: Texts) -> list[Block]:
    media = [
        (drop, place, layer)
        for drop in drops
        for place, layer in enumerate((drop.result or DropResult()).layers or (), 1)
    ]
    layers = [layer for _, _, layer in media]
    names = [
        texts.say("subgrade_of", place=place)
        if drop.result is not None and place == len(drop.result.layers or ())
        else str(place)
        for drop, place, _ in media
    ]
    blocks: list[Block] = [
        Heading(texts["layers"], 3),
        formatting.table(
            Column(texts["drop"], [str(drop.number) for drop, _, _ in media]),
            Column(texts["layer"], names, right=False),
            Column(f"{texts['modulus']}, MPa", [_modulus(layer, texts) for layer in layers]),
            Column(f"{texts['thickness']}, m", [_thickness(layer, texts) for layer in layers]),
            Column(
                f"{texts['viscosity']}, kPa s",
                [number("viscosity", layer.viscosity_pa_s, texts) for layer in layers],
            ),
            Column(
                f"{texts['density']}, kg/m³",
                [number("density", layer.density_kg_m3, texts) for layer in layers],
            ),
            Column(texts["poisson"], [declared(layer.poisson_ratio, texts) for layer in layers]),
        ),
    ]
    for drop in drops:
        effective = effective_of(drop.result or DropResult(), texts)
        if effective != formatting.NO_VALUE:
            text = f"{texts['drop']} {drop.number}: {texts['effective']} {effective}"
            blocks.append(Paragraph(text, "note"))
    return blocks


def _modulus(layer: LayerResult, texts: Texts) -> str:
    interval = layer.modulus_interval_pa
    value = layer.modulus_pa if layer.modulus_known else None
    return formatting.show(Fact("modulus", value, interval), texts, with_unit=False)


def _thickness(layer: LayerResult, texts: Texts) -> str:
    if layer.thickness_m is None:
        return texts["endless"]
    note = DECLARED if layer.thickness_sd_m is None else ""
    fact = Fact("depth", layer.thickness_m, layer.thickness_interval_m, note=note)
    return formatting.show(fact, texts, with_unit=False)


def _sensors(drops: Sequence[DropView], texts: Texts) -> list[Block]:
    """Return a line for each sensor: rms over the drops of its residual over its own peak."""
    fits = over_drops([sensor_fits(drop.curves) for drop in drops if drop.curves is not None])
    excluded = dict.fromkeys(offset for drop in drops for offset in drop.left_out)
    excluded_names = [texts.say("left_out", offset=declared(offset, texts)) for offset in excluded]
    dashes = [formatting.NO_VALUE] * len(excluded_names)

    def column(title: str, cells: Iterable[str]) -> Column:
        return Column(title, [*cells, *dashes])

    table = formatting.table(
        Column(
            texts["sensor"],
            [*(formatting.place_of_sensor(fit.offset, texts) for fit in fits), *excluded_names],
            right=False,
        ),
        column(
            f"{texts['bowl_measured']}, mm",
            (number("settlement", fit.measured_peak, texts) for fit in fits),
        ),
        column(
            f"{texts['bowl_modelled']}, mm",
            (number("settlement", fit.modelled_peak, texts) for fit in fits),
        ),
        column(texts["contact_phase"], (formatting.percent(fit.contact, texts) for fit in fits)),
        column(texts["whole_record"], (formatting.percent(fit.whole, texts) for fit in fits)),
    )
    numbers = [str(drop.number) for drop in drops]
    names = drops_text(numbers, numbers, texts)
    return [
        Heading(texts["sensor_residuals"], 3),
        table,
        Paragraph(f"{names}. {texts['sensor_residuals_note']}", "note"),
    ]


DRAWN_DEPTH_OVER_DEEPEST = 1.35
"""Drawn depth over that of the deepest boundary or of the effective depth: the lowest medium is
seen to go on."""

ROCK_PART = 0.08
"""Part of the drawn depth that rock takes."""

_SOLID_LINE, _DOTTED_LINE = "-", ":"
_BAND_OPACITY = 0.14
"""Opacity of bands; those of several drops lie on each other."""


def draw_ground(figure: Any, drops: Sequence[DropView], texts: Texts) -> None:
    """Draw the profile of moduli if there are layers, the deflection bowl if there are sensors."""
    layered, bowls = [drop.has_layers for drop in drops], [_bowl(drop) for drop in drops]
    has_profile, has_bowl = any(layered), any(bowls)
    if has_profile and has_bowl:
        profile, bowl = figure.subplots(
            1,
            2,
            gridspec_kw={
                **margins(0.09, 0.985, 0.24, 0.97),
                "wspace": 0.22,
                "width_ratios": (1.0, 1.25),
            },
        )
    elif has_profile or has_bowl:
        profile = bowl = figure.subplots(gridspec_kw=margins(0.09, 0.985, 0.24, 0.97))
    else:
        return
    if has_profile:
        _draw_layers(profile, drops, texts)
    if has_bowl:
        _draw_bowl(bowl, drops, bowls, texts)


def _draw_layers(axes: Any, drops: Sequence[DropView], texts: Texts) -> None:
    results = [(i, drop.result) for i, drop in enumerate(drops) if drop.result is not None]
    layered = [(i, result) for i, result in results if len(result.layers or ()) > 1]
    bottom = DRAWN_DEPTH_OVER_DEEPEST * max(_reach(result) for _, result in layered)
    rock = [r.bedrock_depth_m for _, r in layered if r.bedrock_depth_m is not None]
    if rock:
        bottom = max(rock) / (1.0 - ROCK_PART)
    for index, result in layered:
        _draw_profile(axes, result, COLOURS[index % len(COLOURS)], bottom)
    if rock:
        # The deepest rock of several drops, below which all agree.
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
    number_log_axis(axes, texts, min_ratio=10.0)
    axes.set_ylim(bottom, 0.0)
    axes.set_xlabel(texts["modulus_axis"], fontsize=8)
    axes.set_ylabel(texts["depth_axis"], fontsize=8)
    axes.plot([], [], color="0.3", linewidth=1.4, label=texts["layers"])
    if any(result.effective_modulus_pa is not None for _, result in layered):
        axes.plot([], [], "--", color="0.3", linewidth=1.0, label=texts["effective"])
    axes.legend(fontsize=7, loc="best")
    finish(axes, texts)


def _reach(result: DropResult) -> float:
    """Return the depth down to which a result describes the ground, m."""
    ends = [result.effective_depth_m or 0.0, result.bedrock_depth_m or 0.0]
    thickness = [layer.thickness_m or 0.0 for layer in result.layers or ()]
    return max(*ends, sum(thickness), 1e-3)


def _draw_profile(axes: Any, result: DropResult, colour: str, bottom: float) -> None:
    """Draw moduli as steps with bands, intervals of the boundaries, and the effective modulus."""
    top, before = 0.0, None
    above: LayerResult | None = None
    for layer in result.layers or ():
        end = bottom if layer.thickness_m is None else top + layer.thickness_m
        value = layer.modulus_pa / 1e6
        if layer.modulus_interval_pa is not None:
            low, high = (edge / 1e6 for edge in layer.modulus_interval_pa)
            axes.fill_betweenx(
                [top, end], low, high, color=colour, alpha=_BAND_OPACITY, linewidth=0.0
            )
        # A value that the record leaves open is one of many.
        style = _SOLID_LINE if layer.modulus_known else _DOTTED_LINE
        axes.plot([value, value], [top, end], style, color=colour, linewidth=1.6)
        if before is not None and above is not None:
            axes.plot([before, value], [top, top], color=colour, linewidth=1.6)
            _draw_boundary(axes, above, math.sqrt(before * value), top, colour)
        top, before, above = end, value, layer
    if before is not None and above is not None:
        _draw_boundary(axes, above, before, top, colour)
    modulus, depth = result.effective_modulus_pa, result.effective_depth_m
    if modulus is not None and depth is not None:
        axes.plot([modulus / 1e6] * 2, [0.0, depth], "--", color=colour, linewidth=1.0)
        axes.plot([modulus / 1e6], [depth], "v", color=colour, markersize=3.5)


def _draw_boundary(axes: Any, layer: LayerResult, value: float, end: float, colour: str) -> None:
    """Draw the interval of a layer's lower end as a bar."""
    if layer.thickness_interval_m is None or layer.thickness_m is None:
        return
    low, high = (end - layer.thickness_m + edge for edge in layer.thickness_interval_m)
    axes.plot([value, value], [low, high], "_-", color=colour, linewidth=2.6, alpha=0.6)


def _bowl(drop: DropView) -> tuple[SensorFit, ...]:
    """Return the sensors of a drop from one side to the other; none if it has a single one."""
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
        measured = np.array([fit.measured_peak for fit in bowl]) * 1e3
        modelled = np.array([fit.modelled_peak for fit in bowl]) * 1e3
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
