"""Rigid base at a finite depth where none was declared."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.ground_parameters import INVERSE_DEPTH_SD_PER_M, depth_parameter
from inversion.fitting.parameters import Parameter

# Starting depths of the inference, in plate radii. From a single starting depth, fits of other
# depths end at a half-space or at rock right below the plate.
_STARTS_RADII = (6.0, 14.0)


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
        return (replace(depth, name="depth", starts=starts, absent=depth.upper),)

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the inverse depth, 1/m, as the unknown; it is zero for a half-space."""
        depth = depth_parameter(drop.plate_radius)
        nearest, farthest = 1.0 / depth.lower, 1.0 / depth.upper
        starts = tuple(1.0 / (start * drop.plate_radius) for start in _STARTS_RADII)
        return (Coordinate("depth", 0.0, INVERSE_DEPTH_SD_PER_M, farthest, nearest, starts),)

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the depth, m, from the inverse depth."""
        return {"depth": 1.0 / coordinates["depth"]}

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with the rigid base."""
        return replace(ground, inverse_depth=1.0 / values["depth"])
