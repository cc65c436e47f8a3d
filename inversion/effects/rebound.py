r"""Plate or hammer leaves contact and flies under gravity.

From the time of lift-off on the plate moves as a thrown body,
:math:`w = w_0 + v_0 t + g t^2 / 2`, until the ground is met again.
"""

import numpy as np

from inversion.effects.base import DropContext, Effect, EffectParameter, Values
from inversion.kernel import FloatArray

GRAVITY = 9.80665


class Rebound(Effect):
    """Deflection far below zero, a second bump; the time counts from the end of the contact."""

    name = "rebound"
    scope = "drop"
    parameters = (EffectParameter("lift_off", "s", -0.012, 0.02, (-0.006, -0.002, 0.002, 0.008)),)
    advice = "the plate jumps: level it, seat it, or drop from lower down"

    def motion(self, motion: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """The plate in flight; the ground beside it goes its own way."""
        time = drop.time
        moment = drop.contact_end + values["lift_off"]
        if not time[2] < moment < time[-2]:
            return motion
        result = motion.copy()
        for row, offset in zip(result, drop.offsets, strict=True):
            if offset >= drop.plate_radius:
                continue
            start = np.interp(moment, time, row)
            around = np.array([moment - drop.step, moment + drop.step])
            below, above = np.interp(around, time, row)
            speed = (above - below) / (2 * drop.step)
            flight = time - moment
            free = start + speed * flight + 0.5 * GRAVITY * flight**2
            # Nearer to the eye than the ground: it cannot fly into it.
            row[:] = np.where(flight > 0, np.minimum(free, row), row)
        return result
