r"""Plate or hammer leaves contact, flies under gravity and comes down again.

From the time of lift-off on the plate is a thrown body on which the load may still act,
:math:`\ddot w = g + F/m`, until it meets the ground again. Its momentum then goes into ground and
plate as an impulse.
"""

import math
from dataclasses import replace

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

GRAVITY = 9.80665
# Logarithm; of the mass in flight about that of the plate.
_MASS_SPREAD = 0.7


class Rebound(Effect):
    """Deflection far below zero, a second bump; the time counts from the end of the contact."""

    name = "rebound"
    scope = "drop"
    parameters = (
        Parameter(
            "lift_off", "s", -0.012, 0.02, (-0.006, -0.002, 0.002, 0.004, 0.008), absent=0.02
        ),
        Parameter(
            "mass",
            "kg",
            1.0,
            300.0,
            (20.0,),
            logarithmic=True,
            natural=True,
            prior=(math.log(20.0), _MASS_SPREAD),
        ),
    )
    advice = "the plate jumps: level it, seat it, or drop from lower down"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """The mass in flight is about that of the plate, where that is known."""
        time, mass = self.parameters
        known = drop.plate_mass or mass.starts[0]
        return time, replace(mass, starts=(known,), prior=(math.log(known), _MASS_SPREAD))

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """The plate in flight and after; the ground beside it goes its own way."""
        time, step = drop.time, drop.step
        moment = drop.contact_end + values["lift_off"]
        if not time[2] < moment < time[-2]:
            return motion
        flight, near = time - moment, drop.offsets < drop.plate_radius
        impulse_motion = impulse_response()
        # What the ground does once the plate has left it: neither load nor weight press on it.
        weight = values["mass"] * GRAVITY
        # Parts of samples count, so that the times have a smooth influence.
        flown = np.clip(flight / step + 0.5, 0.0, 1.0)
        taken = -flown * (drop.load + weight)
        result = motion + forced_motion(impulse_motion, taken, step)
        way = _way(flown * drop.load / values["mass"], step)
        last, speed, part = time.size, 0.0, 0.0
        for row, ground, below in zip(motion, result, near, strict=True):
            if not below:
                continue
            start = np.interp(moment, time, row)
            before, after = np.interp([moment - step, moment + step], time, row)
            free = start + (after - before) / (2 * step) * flight + 0.5 * GRAVITY * flight**2 + way
            flying = (flight > 0) & (free < ground)
            if not flying.any():
                return motion
            first = int(np.argmax(flying))
            landed = np.flatnonzero(~flying[first:])
            last = first + int(landed[0]) if landed.size else time.size
            if last < time.size:
                gap = free - ground
                speed = max(0.0, float(gap[last] - gap[last - 1]) / step)
                part = float(-gap[last - 1] / (gap[last] - gap[last - 1]))
            ground[first:last] = free[first:last]
        if last < time.size:
            # The plate is back with its momentum, load and weight press again.
            index = np.arange(time.size)
            given = np.clip(index - last + 1.5 - part, 0.0, 1.0) * (drop.load + weight)
            given[last - 1 : last + 1] += values["mass"] * speed / step * np.array([1 - part, part])
            result += forced_motion(impulse_motion, given, step)
        return result


def _way(acceleration: FloatArray, step: float) -> FloatArray:
    """Twice integrated by trapezoids, (n,)."""
    speed = np.concatenate([[0.0], np.cumsum(0.5 * step * (acceleration[1:] + acceleration[:-1]))])
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (speed[1:] + speed[:-1]))])
