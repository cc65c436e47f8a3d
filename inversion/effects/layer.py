"""A crust or a soft top, and a layer between it and the ground below where the sensors tell.

Dynamic: the ground is that of :mod:`inversion.forward.layered`.  The reported modulus is that of
the ground below.
"""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.layered import Medium

# Soils, granular fills and asphalt differ by so much in modulus, damping and density (logarithms).
_RATIO = Parameter(
    "modulus_ratio", "-", 0.02, 100.0, (2.0, 0.6), logarithmic=True, prior=(0.0, 1.5)
)
_RELAXATION = Parameter(
    "relaxation_ratio", "-", 0.05, 20.0, (1.0,), logarithmic=True, prior=(0.0, 0.7)
)
_DENSITY = Parameter(
    "density_ratio", "-", 0.75, 1.4, (1.0,), logarithmic=True, natural=True, prior=(0.0, 0.08)
)
_THICKNESS = Parameter("thickness", "m", 0.03, 3.0, (0.2,), logarithmic=True)
# Thicknesses that the plate can feel and the sensors can tell, in plate radii.
_THICKNESS_RADII = (0.2, 20.0)
# The layers end above the rock by at least this part of its depth.
_ABOVE_ROCK = 0.98
# Of the layers, what has to be left below them; and by how much a single layer has to change the
# plate's deflection where there are so many distances or fewer.
_LEFT, _LEAST_FELT, _FEW_DISTANCES = 0.25, 0.03, 3
# Modulus of a layer over that of the ground: less is soil on rock.
_ROCK = 0.05
_MIDDLE = "middle_"
# Relative error (95 %) of the modulus below: ground of three media that was fitted with fewer left
# 0.6 to 1.5 % in a campaign of finite elements.
_MORE_MEDIA = 0.015


class Layer(Effect):
    """Centre and offset sensors do not fit one modulus; the reported one is that below."""

    name = "layer"
    scope = "point"
    parameters = (_RATIO, _THICKNESS, _RELAXATION, _DENSITY)
    advice = (
        "the top differs from what is below: look into a trial pit, or measure on what is below"
    )

    # Both change the plate's deflection over that of the ground beside it.
    excludes = frozenset({"rough_contact"})
    # The modulus below may be far from what the plate's deflection says.
    ground_is_below = True

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether ground is left below, and whether the plate feels it by few sensors.

        Layers that fill the ground down to its rock do what rock does that lies elsewhere, and
        ground far stiffer than the layers on it is rock. Slow motions of other causes look like a
        boundary far below the plate.
        """
        ratios = (values.get(prefix + "modulus_ratio", 1.0) for prefix in ("", _MIDDLE))
        if min(ratios) < _ROCK:
            return False
        layers = sum(medium.thickness for medium in ground.above)
        if ground.inverse_depth > 0.0 and 1.0 / ground.inverse_depth - layers < _LEFT * layers:
            return False
        if _MIDDLE + "thickness" in values or np.unique(np.abs(drop.offsets)).size > _FEW_DISTANCES:
            return True
        felt = abs(values["modulus_ratio"] - 1.0) * drop.plate_radius / values["thickness"]
        return bool(felt >= _LEAST_FELT)

    def model_error(self, values: Values) -> float:
        """What more media than are fitted may move the modulus of the lowest one."""
        return _MORE_MEDIA

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Thicknesses that the plate can feel, and a second layer where the sensors tell one."""
        a = drop.plate_radius
        low, high = (radii * a for radii in _THICKNESS_RADII)
        thickness = replace(_THICKNESS, lower=low, upper=high, starts=(a, 2.0 * a))
        top: tuple[Parameter, ...] = (_RATIO, thickness)
        top += () if drop.elastic else (_RELAXATION,)
        top += () if drop.density_given else (_DENSITY,)
        if drop.layers is None or not drop.layers.has_middle:
            return top
        return (*top, *(replace(p, name=_MIDDLE + p.name) for p in top))

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """The centre alone cannot tell it from another modulus."""
        return drops[0].layers is not None and drops[0].layers.distances > 1

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Media above the ground, of its Poisson's ratio, on the same rock."""
        prefixes = ("", _MIDDLE) if _MIDDLE + "thickness" in values else ("",)
        thicknesses = [values[prefix + "thickness"] for prefix in prefixes]
        if ground.inverse_depth > 0.0:
            most = _ABOVE_ROCK / ground.inverse_depth
            share = min(1.0, most / sum(thicknesses))
            thicknesses = [share * h for h in thicknesses]
        relaxation = ground.viscosity / ground.modulus
        above = tuple(
            Medium(
                modulus := ground.modulus * values[prefix + "modulus_ratio"],
                modulus * relaxation * values.get(prefix + "relaxation_ratio", 1.0),
                ground.density * values.get(prefix + "density_ratio", 1.0),
                drop.poisson_ratio,
                thickness,
            )
            for prefix, thickness in zip(prefixes, thicknesses, strict=True)
        )
        return replace(ground, above=above)
