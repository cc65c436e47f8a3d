"""A rigid base at a finite depth where none was declared."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, Ground, Values
from inversion.fitting.parameters import Parameter, depth_parameter


class Bedrock(Effect):
    """The base model's half-space becomes a layer."""

    name = "bedrock"
    scope = "point"
    parameters = (Parameter("depth", "m", 0.1, 20.0, (1.0,), logarithmic=True),)
    advice = (
        "a rigid base lies below: the modulus belongs to the layer above it; a sounding or a "
        "second sensor tells the depth"
    )
    # Rock may lie under ground that stiffens, recorded with roll-off of the sensor.
    may_be_masked = True
    joint_sets = (
        frozenset({"bedrock", "stress_dependence", "hysteretic_unloading", "geophone_response"}),
        frozenset(
            {"bedrock", "stress_dependence", "hysteretic_unloading", "rebound", "geophone_response"}
        ),
    )

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Only where none is declared."""
        return not any(drop.has_bedrock for drop in drops)

    def joint_starts_for(self, drop: DropContext) -> tuple[Mapping[str, float], ...]:
        """Depths in plate radii."""
        return tuple({"depth": radii * drop.plate_radius} for radii in (6.0, 4.0))

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Depths that the tables cover, with starts over all of them."""
        depth = depth_parameter(drop.plate_radius)
        starts = tuple(float(d) for d in np.geomspace(depth.lower, depth.upper, 8)[1:-1])
        return (replace(depth, name="depth", starts=starts),)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with its base."""
        return replace(ground, inverse_depth=1.0 / values["depth"])
