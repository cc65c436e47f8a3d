"""Layers as columns of a table: so many of each, empty where a result has fewer."""

from collections.abc import Iterator
from typing import NamedTuple

from pfwd_survey.inverting.options import MOST_LAYERS
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.stored import Interval


class LayerColumn(NamedTuple):
    """One column; all but the first hold numbers."""

    name: str
    """With the SI unit at its end."""
    meaning: str


def _of_layer(place: int) -> Iterator[LayerColumn]:
    name = f"layer_{place}"
    which = f"Young's modulus of medium {place} from the top, Pa"
    yield LayerColumn(f"{name}_modulus_pa", f"{which}; empty: none, or not known within 10 times")
    yield LayerColumn(f"{name}_modulus_interval_low_pa", "its 95 % interval, Pa")
    yield LayerColumn(f"{name}_modulus_interval_high_pa", "its 95 % interval, Pa")
    yield LayerColumn(f"{name}_thickness_m", "its thickness, m; empty: it goes on without end")
    yield LayerColumn(f"{name}_thickness_interval_low_m", "95 %, m; empty: given, not fitted")
    yield LayerColumn(f"{name}_thickness_interval_high_m", "95 %, m; empty: given, not fitted")


NUMBER = LayerColumn("layers", "media with a modulus; modulus_pa is that of the lowest")

LAYER_COLUMNS = (
    *(column for place in range(1, MOST_LAYERS + 1) for column in _of_layer(place)),
    LayerColumn("effective_modulus_pa", "of one medium that the plate at rest deflects alike, Pa"),
    LayerColumn("effective_modulus_interval_low_pa", "its 95 % interval, Pa"),
    LayerColumn("effective_modulus_interval_high_pa", "its 95 % interval, Pa"),
    LayerColumn("effective_depth_m", "above which 90 % of that deflection arises, m"),
)


def layer_cells(result: DropResult) -> dict[str, float | int | None]:
    """The cells of these columns for a result, the number of media included."""
    layers = (result.layers or ())[:MOST_LAYERS]
    cells: dict[str, float | int | None] = dict.fromkeys(column.name for column in LAYER_COLUMNS)
    cells[NUMBER.name] = None if result.layers is None else len(result.layers)
    for place, layer in enumerate(layers, 1):
        name = f"layer_{place}"
        cells[f"{name}_modulus_pa"] = layer.modulus_pa if layer.modulus_known else None
        cells |= _ends(f"{name}_modulus_interval", "pa", layer.modulus_interval_pa)
        cells[f"{name}_thickness_m"] = layer.thickness_m
        cells |= _ends(f"{name}_thickness_interval", "m", layer.thickness_interval_m)
    cells["effective_modulus_pa"] = result.effective_modulus_pa
    cells |= _ends("effective_modulus_interval", "pa", result.effective_modulus_interval_pa)
    cells["effective_depth_m"] = result.effective_depth_m
    return cells


def _ends(name: str, unit: str, interval: Interval | None) -> dict[str, float | None]:
    low, high = interval or (None, None)
    return {f"{name}_low_{unit}": low, f"{name}_high_{unit}": high}
