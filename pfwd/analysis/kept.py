"""Whether a result that was kept can be used: it is whole, and rests on what is declared now."""

import math

from pfwd.analysis.results import DropResult
from pfwd.files.header import PointSetup

PLATES = frozenset({"rigid-rough", "rigid-smooth", "averaged", "published", "uniform"})
"""Contacts of plate and ground that the inversion knows, which is not loaded for it."""

SAME = 1e-9
"""Relative; a result rests on the declared values when it agrees with them to rounding."""


_NEEDED = (
    "modulus_pa",
    "viscosity_pa_s",
    "density_kg_m3",
    "poisson_ratio",
    "plate_radius_m",
    "model",
)
_SHOWN = (
    "modulus_interval_pa",
    "warnings",
    "modulus_sd_pa",
    "viscosity_sd_pa_s",
    "density_sd_kg_m3",
    "bedrock_depth_m",
    "bedrock_depth_sd_m",
    "residual_rms_over_peak",
    "peak_modulus_pa",
    "peak_factor",
    "contact_end_s",
    "window_end_s",
    "layers",
)


def is_sound(result: DropResult) -> bool:
    """Whether a result that was kept, by whatever program, says what a report needs of it."""
    depth = result.bedrock_depth_m
    return (
        all(
            getattr(result, key) is not None
            for key in _NEEDED
            # Layers may leave the lowest one's modulus open; then they say what is known.
            if key != "modulus_pa" or not result.layers
        )
        and layers_are_whole(result)
        and not result.unreadable.intersection(_SHOWN)
        and (depth is None or depth > 0)
        and result.plate in PLATES
    )


def layers_are_whole(result: DropResult) -> bool:
    """Whether all layers that a result names can be computed with."""
    layers = result.layers or ()
    return all(
        not layer.unreadable
        and layer.modulus_pa is not None
        and layer.viscosity_pa_s is not None
        and layer.density_kg_m3 is not None
        and layer.poisson_ratio is not None
        and (layer.thickness_m is not None or layer is layers[-1])
        for layer in layers
    )


def rests_on(result: DropResult, setup: PointSetup) -> bool:
    """Whether a stored result was found with what is declared of the point now.

    Parameters
    ----------
    result : DropResult
    setup : PointSetup
    """
    pairs = [(result.plate_radius_m, setup.plate_radius)]
    if setup.poisson_ratio is not None:
        pairs.append((result.poisson_ratio, setup.poisson_ratio))
    if setup.density is not None:
        pairs.append((result.density_kg_m3, setup.density))
    return all(said is not None and math.isclose(said, now, rel_tol=SAME) for said, now in pairs)
