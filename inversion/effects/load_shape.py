"""Difference between the measured load and the half-sine that drives the model in its place."""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import (
    DropContext,
    Effect,
    ImpulseResponse,
    Values,
    forced_motion,
)
from inversion.effects.parameters import Parameter


class LoadShape(Effect):
    """Difference between measured load and half-sine, a fraction of which is added.

    1 gives the measured load.
    """

    name = "load_shape"
    scope = "drop"
    parameters = (Parameter("share", "-", 0.0, 1.5, (1.0,), natural=True, absent=0.0),)
    advice = "use the measured load; look after buffers and guide of the hammer"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return True if a half-sine drives the model."""
        return drops[0].unmodelled_load is not None

    def recorded_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return the root mean square misfit of the half-sine, over the peak load."""
        assert drop.unmodelled_load is not None
        part = drop.time <= drop.contact_end
        rms = float(np.sqrt(np.mean(drop.unmodelled_load[part] ** 2)))
        return (("misfit", "-", rms / drop.peak_load),)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """Return the motion with that due to the difference of the loads, (n_sensors, n), m."""
        assert drop.unmodelled_load is not None
        return motion + values["share"] * forced_motion(
            impulse_response(), drop.unmodelled_load, drop.step
        )
