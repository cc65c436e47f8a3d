"""The part of a point's page on the ground: profile, bowl, residual per sensor, layers."""

from collections.abc import Sequence
from functools import partial

from pfwd.analysis.results import DropResult, LayerResult
from pfwd.analysis.sensor_fits import over_drops, sensor_fits
from pfwd.judging import DropView
from pfwd.report import shown
from pfwd.report.blocks import Block, Heading, Paragraph, Picture, Table
from pfwd.report.ground_drawing import draw_ground, has_layers
from pfwd.report.texts import Texts

_LAYERS_HEIGHT, _BOWL_HEIGHT = 66.0, 42.0
"""mm, of the picture; with a bowl alone a point of three drops and eleven sensors fits a page."""

_COLUMNS = (
    ("drop", ""),
    ("layer", ""),
    ("modulus", "MPa"),
    ("thickness", "m"),
    ("viscosity", "kPa s"),
    ("density", "kg/m³"),
    ("poisson", ""),
)


def ground_blocks(drops: Sequence[DropView], name: str, texts: Texts) -> list[Block]:
    """Blocks on the drops whose traces are shown; none for one sensor on ground without layers.

    Parameters
    ----------
    drops : sequence of DropView
    name : str
        Of the point.
    texts : Texts
    """
    layered = [drop for drop in drops if has_layers(drop)]
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
    """The one modulus that deflects alike, with its interval and the depth it stands for."""
    modulus, depth = result.effective_modulus_pa, result.effective_depth_m
    if modulus is None or depth is None:
        return shown.NOTHING
    ends = result.effective_modulus_interval_pa
    interval = None if ends is None else [end / 1e6 for end in ends]
    value = shown.with_interval(modulus / 1e6, interval, "MPa", texts)
    return texts.say("effective_text", value=value, depth=shown.digits(depth, 2))


def _layers(drops: Sequence[DropView], texts: Texts) -> list[Block]:
    rows = []
    for drop in drops:
        result = drop.result or DropResult()
        layers = result.layers or ()
        for place, layer in enumerate(layers, 1):
            last = place == len(layers)
            rows.append(
                (
                    str(drop.number),
                    texts.say("subgrade_of", place=place) if last else str(place),
                    _modulus(layer, texts),
                    _thickness(layer, texts),
                    shown.scaled(layer.viscosity_pa_s, 1e-3, ""),
                    shown.scaled(layer.density_kg_m3, 1.0, "", 4),
                    shown.scaled(layer.poisson_ratio, 1.0, "", 2),
                )
            )
    columns = tuple(f"{texts[name]}{', ' if unit else ''}{unit}" for name, unit in _COLUMNS)
    blocks: list[Block] = [
        Heading(texts["layers"], 3),
        Table(columns, tuple(rows), (0, *range(2, len(columns)))),
    ]
    for drop in drops:
        said = effective_of(drop.result or DropResult(), texts)
        if said != shown.NOTHING:
            text = f"{texts['drop']} {drop.number}: {texts['effective']} {said}"
            blocks.append(Paragraph(text, "note"))
    return blocks


def _modulus(layer: LayerResult, texts: Texts) -> str:
    interval = layer.modulus_interval_pa
    if layer.modulus_pa is None:
        return shown.NOTHING
    ends = None if interval is None else [end / 1e6 for end in interval]
    if ends is not None and not layer.modulus_known:
        low, high = (shown.digits(end, 2) for end in ends)
        return texts.say("layer_open", low=low, high=high)
    return shown.with_interval(layer.modulus_pa / 1e6, ends, "", texts)


def _thickness(layer: LayerResult, texts: Texts) -> str:
    if layer.thickness_m is None:
        return texts["endless"]
    if layer.thickness_sd_m is None:
        return f"{layer.thickness_m:.3g} ({texts['given']})"
    return shown.with_interval(layer.thickness_m, layer.thickness_interval_m, "", texts)


def _sensors(drops: Sequence[DropView], texts: Texts) -> list[Block]:
    """A line a sensor: rms over the drops of its residual over its own peak."""
    fits = over_drops([sensor_fits(drop.curves) for drop in drops if drop.curves is not None])
    rows = [
        (
            texts["centre"] if fit.offset == 0 else f"{fit.offset:g} m",
            shown.scaled(fit.measured_peak, 1e6, ""),
            shown.scaled(fit.modelled_peak, 1e6, ""),
            shown.scaled(fit.contact, 1e2, "", 2),
            shown.scaled(fit.whole, 1e2, "", 2),
        )
        for fit in fits
    ]
    left_out = dict.fromkeys(offset for drop in drops for offset in drop.left_out)
    nothing = (shown.NOTHING,) * 4
    rows += [(texts.say("left_out", offset=f"{offset:g}"), *nothing) for offset in left_out]
    columns = (
        texts["sensor"],
        f"{texts['bowl_measured']}, µm",
        f"{texts['bowl_modelled']}, µm",
        f"{texts['contact_phase']}, %",
        f"{texts['whole_record']}, %",
    )
    numbers = ", ".join(str(drop.number) for drop in drops)
    return [
        Heading(texts["sensor_residuals"], 3),
        Table(columns, tuple(rows), (1, 2, 3, 4)),
        Paragraph(f"{texts['drops']} {numbers}. {texts['sensor_residuals_note']}", "note"),
    ]
