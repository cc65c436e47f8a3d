"""Displacement that is left after the drop."""

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Struck, Values
from inversion.kernel import FloatArray


class PermanentSet(Effect):
    """Grows with the displacement up to its peak and stays; a part of the peak, m."""

    name = "permanent_set"
    scope = "drop"
    parameters = (EffectParameter("displacement", "m", -3e-3, 1e-2, (5e-5,)),)
    advice = "seat the plate with more drops before measuring"

    def motion(
        self, motion: FloatArray, values: Values, drop: DropContext, struck: Struck
    ) -> FloatArray:
        """With what stays, at each sensor in proportion to its peak."""
        highest = np.maximum.accumulate(np.maximum(motion, 0.0), axis=1)
        first = max(float(highest[0, -1]), 1e-12)
        return motion + highest * (values["displacement"] / first)
