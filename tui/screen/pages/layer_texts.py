"""Layers and sensors of a drop as text and bars, for the drop page and the measure page."""

import math
from collections.abc import Collection

from pfwd.analysis.results import DropResult, LayerResult, TimeHistories
from pfwd.analysis.sensor_fits import sensor_fits
from pfwd.facts import facts_of_drop
from pfwd.units import Fact, Units, percent
from tui.screen.drawing.lines import Line, cell, line, wrap

MIN_BAR_COLUMNS = 8
"""Smallest width of a bar; with less room it takes a line of its own."""

_BAR_SCALE_MARGIN = 1.25
"""Factor by which the scale of the bars extends beyond the intervals."""


def has_layers(result: DropResult | None) -> bool:
    """Return True if the ground of a result has more than one layer."""
    return result is not None and len(result.layers or ()) > 1


def layer_lines(result: DropResult, units: Units, width: int) -> list[Line]:
    """Return a row for each layer with its modulus as a bar, then the effective modulus.

    Ground without layers has no lines.

    Parameters
    ----------
    result : DropResult
    units : Units
    width : int
        Columns.
    """
    layers = result.layers or ()
    if len(layers) < 2:
        return []
    unit = units.unit("modulus")
    scale = _scale(layers)
    head = f"layers, E {unit} (95 %)"
    if scale is not None:
        low, high = (units.text("modulus", end, 2) for end in scale)
        head += f"; bars {low} to {high} {unit}, log"
    lines: list[Line] = [line(cell(row, "strong")) for row in wrap(head, width)]
    texts = _layer_texts(layers, units, with_depth_interval=True)
    if max(map(len, texts)) > width:
        texts = _layer_texts(layers, units, with_depth_interval=False)
    widest = max(map(len, texts))
    for text, layer in zip(texts, layers, strict=True):
        room = width - widest - 2
        if room >= MIN_BAR_COLUMNS:
            lines.append(line(f"{text:{widest}}  ", cell(_bar(layer, scale, room), "measured")))
        else:
            lines.append(line(text))
            lines.append(line("   ", cell(_bar(layer, scale, width - 3), "measured")))
    if result.bedrock_depth_m is not None:
        lines.append(line(f"rock at {units.show(facts_of_drop(result)['bedrock'])}"))
    text = effective_text(result, units)
    lines += [line(row) for row in wrap(text, width)] if text else []
    return lines


def effective_text(result: DropResult, units: Units) -> str:
    """Return effective modulus and effective depth as text; empty if there is none."""
    modulus, depth = result.effective_modulus_pa, result.effective_depth_m
    if modulus is None or depth is None:
        return ""
    value = units.show(facts_of_drop(result)["effective"])
    return f"effective {value}, down to {units.with_unit('depth', depth, 2)}"


def top_and_subgrade(result: DropResult, units: Units) -> list[str]:
    """Return lines for the top layer and the subgrade; none without layers."""
    if not has_layers(result):
        return []
    layers = result.layers or ()
    unit = units.unit("modulus")
    top, below = layers[0], layers[-1]
    thickness = units.with_unit("depth", top.thickness_m, 2)
    return [
        f"subgrade  {_modulus(below, units)} {unit}",
        f"top       {_modulus(top, units)} {unit}, {thickness}",
    ]


def sensor_lines(
    curves: TimeHistories | None, recorded: Collection[float], units: Units
) -> list[Line]:
    """Return the residual of each sensor over its own peak; nothing for a single sensor.

    Parameters
    ----------
    curves : TimeHistories or None
    recorded : collection of float
        Offsets of all sensors of the record, m; those without a curve were excluded from the fit.
    units : Units
    """
    if curves is None or len(recorded) < 2:
        return []
    lines: list[Line] = [line(cell("residual by sensor, of its own peak", "strong"))]
    for fit in sensor_fits(curves):
        place = _place(fit.offset, units)
        total, contact = percent(fit.whole), percent(fit.contact)
        lines.append(line(f"{place:>9}  {total:>6}, {contact:>6} in contact"))
    fitted = [float(offset) for offset in curves.offsets]
    for offset in recorded:
        if offset not in fitted:
            lines.append(line(cell(f"{_place(offset, units):>9}  excluded from the fit", "warn")))
    return lines


def _place(offset: float, units: Units) -> str:
    return "centre" if offset == 0 else units.with_unit("length", offset)


def _layer_texts(
    layers: tuple[LayerResult, ...], units: Units, *, with_depth_interval: bool
) -> list[str]:
    """Return number, thickness and modulus of each layer; the lowest layer has no end."""
    depths = []
    for layer in layers:
        interval = layer.thickness_interval_m if with_depth_interval else None
        has_end = layer.thickness_m is not None
        depths.append(
            units.show(Fact("depth", layer.thickness_m, interval)) if has_end else "no end"
        )
    widest = max(map(len, depths))
    return [
        f"{number} {depth:{widest}} {_modulus(layer, units)}"
        for number, (depth, layer) in enumerate(zip(depths, layers, strict=True), 1)
    ]


def _modulus(layer: LayerResult, units: Units) -> str:
    """Return the modulus with its interval; without a value if the record does not determine it."""
    value, ends = units.value_and_ends(Fact("modulus", layer.modulus_pa, layer.modulus_interval_pa))
    return (value if layer.modulus_known else "not known") + (f" ({ends})" if ends else "")


def _scale(layers: tuple[LayerResult, ...]) -> tuple[float, float] | None:
    """Return the ends of the scale of the bars, Pa."""
    values = [layer.modulus_pa for layer in layers]
    for layer in layers:
        values += layer.modulus_interval_pa
    sound = [value for value in values if value > 0 and math.isfinite(value)]
    return (min(sound) / _BAR_SCALE_MARGIN, max(sound) * _BAR_SCALE_MARGIN) if sound else None


def _bar(layer: LayerResult, scale: tuple[float, float] | None, width: int) -> str:
    """Return the interval as a line and the value as a block on it, if it is determined."""
    letters = ["·"] * width
    if scale is None:
        return "".join(letters)

    def column(value: float) -> int:
        low, high = scale
        if not value > 0 or not math.isfinite(value):
            return 0
        part = math.log(value / low) / math.log(high / low)
        return min(width - 1, max(0, round(part * (width - 1))))

    if layer.modulus_interval_pa is not None:
        start, end = map(column, layer.modulus_interval_pa)
        letters[start : end + 1] = "─" * (end + 1 - start)
    if layer.modulus_known:
        letters[column(layer.modulus_pa)] = "■"
    return "".join(letters)
