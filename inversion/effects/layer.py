"""Layers above the ground, stiffer or softer than it.

The model is the dynamic layered ground of :mod:`inversion.forward.layered`. The reported modulus is
that of the ground below the layers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import capped, exponential
from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Parameter
from inversion.forward.layered import Medium
from inversion.measured.weighted_drop import count_distances

# Priors of the logarithms cover soils, granular fills and asphalt.
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
# Range of thicknesses that plate and sensors can resolve, in plate radii.
_THICKNESS_RADII = (0.2, 20.0)
ABOVE_ROCK = 0.98
"""Largest depth of the layers over the depth of the rock."""
# Smallest thickness of the ground above rock, over that of the layers. Smallest relative change of
# the plate's deflection by a layer; it is required up to this number of sensor distances.
_MIN_GROUND_SHARE, _MIN_CHANGE, _MAX_DISTANCES = 0.25, 0.03, 3
# Smallest modulus of a layer over that of the ground; below it, the model is soil on rock.
_ROCK = 0.05
# Relative error (95 %) of the modulus below. In a campaign of finite elements, fits of three media
# with fewer layers had errors of 0.6 to 1.5 %.
_MORE_MEDIA = 0.015


class Layer(Effect):
    """Layers above the ground: one modulus does not fit the centre sensor and the others.

    Parameters
    ----------
    count : int, number of layers; the effect that is searched for has one
    thickness : sequence of float, m, of the layers from the top; None: fitted
    """

    name = "layer"
    scope = "point"
    parameters = (_RATIO, _THICKNESS, _RELAXATION, _DENSITY)
    advice = (
        "the top differs from what is below: look into a trial pit, or measure on what is below"
    )

    # Both change the ratio of the plate's deflection to that of the ground outside.
    excludes = frozenset({"rough_contact"})

    def __init__(self, count: int = 1, thickness: Sequence[float] | None = None) -> None:
        self.count = count
        self.thickness = thickness

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether a layer changes the deflection, with enough ground below.

        A layer down to the rock is equivalent to rock at another depth, and ground much stiffer
        than its layer is rock. A change of the plate's deflection is required if there are few
        sensor distances: slow motions of other causes then resemble a boundary far below the plate.
        """
        if values["modulus_ratio"] < _ROCK:
            return False
        layers = sum(medium.thickness for medium in ground.above)
        if (
            ground.inverse_depth > 0.0
            and 1.0 / ground.inverse_depth - layers < _MIN_GROUND_SHARE * layers
        ):
            return False
        if count_distances(drop.offsets) > _MAX_DISTANCES:
            return True
        change = abs(values["modulus_ratio"] - 1.0) * drop.plate_radius / values["thickness"]
        return bool(change >= _MIN_CHANGE)

    def model_error(self, values: Values) -> float:
        """Return the relative error of the lowest modulus if the true ground has more layers."""
        return _MORE_MEDIA

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters of the layers, from the top."""
        a = drop.plate_radius
        low, high = (radii * a for radii in _THICKNESS_RADII)
        of_layer: tuple[Parameter, ...] = (_RATIO,)
        if self.thickness is None:
            of_layer += (replace(_THICKNESS, lower=low, upper=high, starts=(a, 2.0 * a)),)
        of_layer += () if drop.elastic else (_RELAXATION,)
        of_layer += () if drop.is_density_declared else (_DENSITY,)
        return tuple(
            replace(p, name=layer_prefix(number) + p.name)
            for number in range(self.count)
            for p in of_layer
        )

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the parameters, all of which are fitted by their logarithms."""
        return {name: exponential(value) for name, value in coordinates.items()}

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether sensors are at several distances.

        The centre alone cannot resolve layers.
        """
        return count_distances(drops[0].offsets) > 1

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with layers above it; Poisson's ratio and rock depth do not change."""
        prefixes = [layer_prefix(number) for number in range(self.count)]
        thicknesses = self.thickness or [values[prefix + "thickness"] for prefix in prefixes]
        if np.all(ground.inverse_depth > 0.0):
            available = ABOVE_ROCK / ground.inverse_depth
            share = capped(1.0, available / sum(thicknesses))
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


def layer_prefix(number: int) -> str:
    """Return the prefix of the parameters of a layer, counted from 0; that of the top is empty."""
    return f"layer_{number + 1}_" if number else ""
