"""Rigid base at a finite depth where none was declared."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.effects.parameters import Coordinate, Parameter
from inversion.forward.surrogate import MIN_DEPTH_RADII

# Starting depths of the inference, in plate radii. From a single starting depth, fits of other
# depths end at a half-space or at rock right below the plate.
_STARTS_RADII = (6.0, 14.0)
# Prior standard deviation of one over the depth: a subgrade rarely has rock within a few
# decimetres, and often none near enough for an echo. Rock below 60 plate radii causes none.
_INVERSE_DEPTH_SD_PER_M, _MAX_DEPTH_RADII = 1.25, 60.0


class Bedrock(Effect):
    """Rigid base below the ground; the half-space of the base model becomes a layer on it."""

    name = "bedrock"
    scope = "point"
    parameters = (Parameter("depth", "m", 0.1, 20.0, (1.0,), logarithmic=True),)
    advice = (
        "a rigid base lies below: the modulus belongs to the layer above it; confirm the depth "
        "by a sounding or a second sensor"
    )

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return True if no rigid base is declared."""
        return not any(drop.has_bedrock for drop in drops)

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the depth with starting values, within the range of the response tables."""
        depth = depth_parameter(drop.plate_radius)
        starts = tuple(float(d) for d in np.geomspace(depth.lower, depth.upper, 8)[1:-1])
        return (replace(depth, starts=starts, absent=depth.upper),)

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the inverse depth, 1/m, as the unknown; it is zero for a half-space."""
        depth = depth_parameter(drop.plate_radius)
        nearest, farthest = 1.0 / depth.lower, 1.0 / depth.upper
        starts = tuple(1.0 / (start * drop.plate_radius) for start in _STARTS_RADII)
        return (Coordinate("depth", 0.0, _INVERSE_DEPTH_SD_PER_M, farthest, nearest, starts),)

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the depth, m, from the inverse depth."""
        return {"depth": 1.0 / coordinates["depth"]}

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with the rigid base."""
        return replace(ground, inverse_depth=1.0 / values["depth"])


def depth_parameter(plate_radius: float) -> Parameter:
    """Return the parameter of the depth, m, within the range of the tables and echoes."""
    low, high = MIN_DEPTH_RADII * 1.001 * plate_radius, _MAX_DEPTH_RADII * plate_radius
    return Parameter("depth", "m", low, high, logarithmic=True)
