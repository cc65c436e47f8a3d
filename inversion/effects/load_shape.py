"""The pulse is no half-sine, where a half-sine stands in for the measured load."""

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import (
    DropContext,
    Effect,
    ImpulseResponse,
    Values,
    forced_motion,
)
from inversion.fitting.parameters import Parameter


class LoadShape(Effect):
    """What the half-sine leaves of the measured load; 1 puts all of it back."""

    name = "load_shape"
    scope = "drop"
    parameters = (Parameter("share", "-", 0.0, 1.5, (1.0,), natural=True, absent=0.0),)
    advice = "use the measured load; look after buffers and guide of the hammer"

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Only where a half-sine is in use."""
        return drops[0].load_left is not None

    def known(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """How badly the half-sine fits, over its peak."""
        assert drop.load_left is not None
        part = drop.time <= drop.contact_end
        rms = float(np.sqrt(np.mean(drop.load_left[part] ** 2)))
        return (("misfit", "-", rms / drop.peak_load),)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """With what the rest of the load moves."""
        assert drop.load_left is not None
        return motion + values["share"] * forced_motion(
            impulse_response(), drop.load_left, drop.step
        )
