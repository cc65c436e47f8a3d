"""Parameter spaces of homogeneous and of layered ground: unknowns, their bounds and priors.

A medium is a layer or the half-space below. Homogeneous ground is searched around its modulus from
the peak method. The moduli of layers differ by orders of magnitude, so that their bounds are wider,
all of them have priors, and their viscosity is described by one relaxation time, viscosity over
modulus.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from inversion.errors import ModelError
from inversion.fitting.parameters import Parameter, ParameterSpace, Unknown
from inversion.forward.surrogate import MIN_DEPTH_RADII

MODULUS, VISCOSITY, DENSITY, DEPTH = "modulus", "viscosity", "density", "bedrock_depth"

# Bounds of homogeneous ground. Modulus: factors of that from the peak method, which inertia,
# viscosity and rock change by less. Density: that of soils and granular fills. Viscosity: with a
# larger one there is no deflection within a pulse. Rock below 60 plate radii causes no echo.
_MODULUS_FACTORS = (0.12, 6.0)
_DENSITY_BOUNDS_KG_M3 = (1000.0, 2800.0)
_MIN_VISCOSITY_BOUND_PA_S = 4.0e5
_MAX_RELAXATION_S = 0.012
_MAX_DEPTH_RADII = 60.0

# Priors of homogeneous ground: mean and standard deviation of the logarithm of the density, kg/m3,
# of soils and granular fills from loose and dry to dense and wet; and of viscosity over modulus, s.
LOG_DENSITY_PRIOR = (math.log(1900.0), 0.12)
TYPICAL_RELAXATION_S = 1.0e-3
# Prior standard deviation of one over the depth of rock: a subgrade rarely has rock within a few
# decimetres, and often none near enough for an echo.
INVERSE_DEPTH_SD_PER_M = 1.25

# Bounds of layers. Modulus: from slurry to sound asphalt. Thickness: layers thinner than a fifth of
# the plate radius, or deeper than twenty radii, do not change the deflection. Relaxation time: with
# more than 12 ms there is no deflection within a pulse.
_LAYER_MODULUS_BOUNDS_PA = (1.0e6, 3.0e10)
_LAYER_THICKNESS_BOUNDS_RADII = (0.2, 20.0)
_LAYER_RELAXATION_BOUNDS_S = (1e-4, _MAX_RELAXATION_S)
_LAYER_DENSITY_BOUNDS_KG_M3 = (1200.0, 2700.0)
# Rock is at least half a plate radius below the lowest boundary, and near enough for an echo.
_LOWEST_THICKNESS_BOUNDS_RADII = (0.5, _MAX_DEPTH_RADII)

# Priors of layers, mean and standard deviation (of the natural logarithm where logarithmic).
# Density: soils, granular fills and asphalt. Modulus: within two orders of magnitude of that from
# the deflection. Thickness: a third of the plate radius to ten radii.
_LAYER_LOG_DENSITY_PRIOR = (math.log(2000.0), 0.08)
_LAYER_LOG_MODULUS_SD = 2.0
_LAYER_THICKNESS_PRIOR_RADII, _LAYER_LOG_THICKNESS_SD = 1.7, 1.0
_LAYER_RELAXATION_PRIOR_S = (0.8e-3, 1.0e-3)


def depth_parameter(plate_radius: float) -> Parameter:
    """Return the parameter of the bedrock depth, m, within the range of the tables and echoes."""
    return Parameter(
        DEPTH,
        "m",
        MIN_DEPTH_RADII * 1.001 * plate_radius,
        _MAX_DEPTH_RADII * plate_radius,
        logarithmic=True,
    )


def homogeneous_space(
    peak_modulus: float,
    plate_radius: float,
    poisson_ratio: float,
    *,
    density: float | None = None,
    rock_depth: float | None = None,
    elastic: bool = False,
) -> ParameterSpace:
    """Return the parameter space of homogeneous ground: the modulus, and all that is not declared.

    Parameters
    ----------
    peak_modulus : float, Pa, from the peak method, the centre of the search
    plate_radius : float, m
    poisson_ratio : float
    density : float, kg/m3; None: fitted
    rock_depth : float, m; inf: half-space; None: fitted
    elastic : bool, True: no viscosity
    """
    low, high = (factor * peak_modulus for factor in _MODULUS_FACTORS)
    unknowns = [Unknown(Parameter(MODULUS, "Pa", low, high, logarithmic=True), "modulus", 0)]
    if not elastic:
        upper = max(_MIN_VISCOSITY_BOUND_PA_S, _MAX_RELAXATION_S * peak_modulus)
        viscosity = Parameter(VISCOSITY, "Pa s", 0.0, upper)
        unknowns.append(Unknown(viscosity, "viscosity", 0))
    if density is None:
        parameter = Parameter(DENSITY, "kg/m3", *_DENSITY_BOUNDS_KG_M3, logarithmic=True)
        unknowns.append(Unknown(parameter, "density", 0))
    if rock_depth is None:
        unknowns.append(Unknown(depth_parameter(plate_radius), "thickness", 0))
    elif not rock_depth > 0.0:
        raise ModelError(f"bedrock depth: expected a value > 0 m or inf, got {rock_depth:g}")
    return ParameterSpace(
        tuple(unknowns),
        1,
        poisson_ratio,
        math.nan if density is None else density,
        (math.nan if rock_depth is None else rock_depth,),
        rock=rock_depth is None or math.isfinite(rock_depth),
    )


def layered_space(
    media: int,
    surface_modulus: float,
    plate_radius: float,
    poisson_ratio: float,
    *,
    density: float | None = None,
    thickness: Sequence[float] | None = None,
    rock_depth: float | None = None,
    elastic: bool = False,
) -> ParameterSpace:
    """Return the parameter space of a ground of ``media`` media under one plate.

    Parameters
    ----------
    media : int
    surface_modulus : Pa, of homogeneous ground with the same deflection of the plate
    plate_radius : m
    poisson_ratio : float
    density : kg/m3, of all media; None: fitted
    thickness : media - 1 values from the top, m; None: fitted
    rock_depth : m; inf: no rock; None: fitted
    elastic : True: no viscosity
    """
    if media < 1:
        raise ModelError(f"layers: expected at least 1, got {media}")
    rock = rock_depth is None or math.isfinite(rock_depth)
    above = list(thickness) if thickness is not None else [math.nan] * (media - 1)
    if len(above) != media - 1:
        raise ModelError(
            f"thickness: expected {media - 1} values for {media} layers, got {len(above)}"
        )
    if thickness is not None and rock_depth is not None and not sum(above) < rock_depth:
        raise ModelError(
            f"thickness: expected layers above the rock at {rock_depth:g} m, got {sum(above):g} m"
        )
    modulus_prior = (math.log(surface_modulus), _LAYER_LOG_MODULUS_SD)
    unknowns = [
        Unknown(_logarithmic(f"modulus_{j + 1}", "Pa", _LAYER_MODULUS_BOUNDS_PA, modulus_prior),
                "modulus", j)
        for j in range(media)
    ]  # fmt: skip
    if thickness is None:
        low, high = (radii * plate_radius for radii in _LAYER_THICKNESS_BOUNDS_RADII)
        if rock_depth is not None and rock:
            high = min(high, 0.95 * rock_depth / max(1, media - 1))
            low = min(low, 0.2 * high)
        centre = math.log(min(_LAYER_THICKNESS_PRIOR_RADII * plate_radius, 0.7 * high))
        prior = (centre, _LAYER_LOG_THICKNESS_SD)
        unknowns += [
            Unknown(_logarithmic(f"thickness_{j + 1}", "m", (low, high), prior), "thickness", j)
            for j in range(media - 1)
        ]
    if rock_depth is None:
        low, high = (radii * plate_radius for radii in _LOWEST_THICKNESS_BOUNDS_RADII)
        lowest = _logarithmic(f"thickness_{media}", "m", (low, high), None)
        unknowns.append(Unknown(lowest, "thickness", media - 1))
    if not elastic:
        relaxation = Parameter(
            "relaxation",
            "s",
            *_LAYER_RELAXATION_BOUNDS_S,
            natural=True,
            prior=_LAYER_RELAXATION_PRIOR_S,
        )
        unknowns.append(Unknown(relaxation, "relaxation"))
    if density is None:
        prior = _LAYER_LOG_DENSITY_PRIOR
        unknowns += [
            Unknown(_logarithmic(f"density_{j + 1}", "kg/m3", _LAYER_DENSITY_BOUNDS_KG_M3, prior),
                    "density", j)
            for j in range(media)
        ]  # fmt: skip
    return ParameterSpace(
        tuple(unknowns),
        media,
        poisson_ratio,
        math.exp(_LAYER_LOG_DENSITY_PRIOR[0]) if density is None else density,
        (*above, math.nan if rock else math.inf),
        rock,
        rock_depth if rock else None,
    )


def _logarithmic(
    name: str, unit: str, bounds: tuple[float, float], prior: tuple[float, float] | None
) -> Parameter:
    return Parameter(name, unit, *bounds, logarithmic=True, prior=prior)
