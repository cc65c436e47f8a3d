"""A rigid base at a finite depth where none was declared."""

from dataclasses import replace

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Ground, Values
from inversion.fitting.parameters import DEEPEST
from inversion.forward.surrogate import SHALLOWEST


class Bedrock(Effect):
    """The base model's half-space becomes a layer."""

    name = "bedrock"
    scope = "point"
    parameters = (EffectParameter("depth", "m", 0.1, 20.0, (1.0,), logarithmic=True),)
    advice = (
        "a rigid base lies below: the modulus belongs to the layer above it; a sounding or a "
        "second sensor tells the depth"
    )

    def parameters_for(self, drop: DropContext) -> tuple[EffectParameter, ...]:
        """Depths that the tables cover, with starts over all of them."""
        radius = drop.plate_radius
        low, high = SHALLOWEST * 1.001 * radius, DEEPEST * radius
        starts = tuple(float(d) for d in np.geomspace(low, high, 8)[1:-1])
        return (replace(self.parameters[0], lower=low, upper=high, starts=starts),)

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with its base."""
        return replace(ground, inverse_depth=1.0 / values["depth"])
