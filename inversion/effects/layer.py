"""A crust or a soft top, and a layer between it and the ground below where the sensors tell.

Dynamic: the ground is that of :mod:`inversion.forward.layered`.  The reported modulus is that of
the ground below.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.layered import Medium
from inversion.notices import Notice

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
_MIDDLE = "middle_"
# What the first look calls what effects and ground have: (effect, parameter); "" is the ground.
_OTHERS = {
    "relaxation": ("", "relaxation"),
    "density": ("", "density"),
    "depth": ("bedrock", "depth"),
    "natural_frequency": ("geophone_response", "natural_frequency"),
    "damping": ("geophone_response", "damping"),
    "lag": ("sensor_lag", "delay"),
}

# A boundary at depth h under a plate of radius a changes its deflection by about the difference of
# moduli times a / h.  What changes it by less than load cell and sensor may be off is not felt, and
# what lies below is an extrapolation: so few distances take slow motions of other causes for it.
_LEAST_FELT, _FEW_DISTANCES = 0.03, 3

# Relative error (95 %) of the modulus below: ground of three media that was fitted with fewer left
# 0.6 to 1.5 % in a campaign of finite elements.
_MORE_MEDIA = 0.015


class Layer(Effect):
    """Centre and offset sensors do not fit one modulus; the reported one is that below."""

    name = "layer"
    scope = "point"
    parameters = (_RATIO, _THICKNESS, _RELAXATION, _DENSITY)
    in_full_set = False
    advice = (
        "the top differs from what is below: look into a trial pit, or measure on what is below"
    )

    # Both change the plate's deflection over that of the ground beside it.
    excludes = frozenset({"rough_contact"})
    # The modulus below may be far from what the plate's deflection says.
    ground_is_below = True
    # Layers imitate a lag and a geophone in one sensor, and hide them in several.
    imitates = frozenset(
        {"sensor_lag", "geophone_response", "stress_dependence", "hysteretic_unloading"}
    )
    told_sets = (
        frozenset({"layer", "geophone_response"}),
        frozenset({"layer", "bedrock"}),
        frozenset({"layer", "geophone_response", "sensor_lag"}),
        frozenset({"layer", "bedrock", "geophone_response", "sensor_lag"}),
    )

    def model_error(self, values: Values) -> float:
        """What more media than are fitted may move the modulus of the lowest one."""
        return _MORE_MEDIA

    def objection(self, values: Values, drop: DropContext) -> Notice | None:
        """Of a single layer that few sensors show: whether the plate feels what is below it."""
        if _MIDDLE + "thickness" in values or np.unique(np.abs(drop.offsets)).size > _FEW_DISTANCES:
            return None
        ratio, thickness = values["modulus_ratio"], values["thickness"]
        if abs(ratio - 1.0) * drop.plate_radius >= _LEAST_FELT * thickness:
            return None
        numbers = {"thickness_m": thickness, "modulus_ratio": ratio, "least": _LEAST_FELT}
        return Notice("layer-not-felt", numbers)

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

    def set_starts(
        self, drop: DropContext, names: frozenset[str]
    ) -> Mapping[tuple[str, str], float]:
        """What a quick fit of layers with the rock and the instrument of the set found."""
        if drop.layers is None:
            return {}
        found = drop.layers.values(
            rock="bedrock" in names,
            geophone="geophone_response" in names,
            lag="sensor_lag" in names,
        )
        modulus = found.pop("modulus") / drop.layers.peak_modulus
        starts = {("", "modulus_ratio"): modulus}
        for name, value in found.items():
            starts[_OTHERS.get(name, (self.name, name))] = value
        return starts

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
