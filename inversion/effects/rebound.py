r"""Plate or hammer leaves contact, flies under gravity and comes down again.

From the time of lift-off on the plate is a thrown body on which the load may still act,
:math:`\ddot w = g + F/m`, until it meets the ground again. Its momentum then goes into ground and
plate as an impulse.  It leaves with the speed that it has on the ground and with a kick upward of
buffers that unload and of a frame that the hammer takes along: without one, ground that is relieved
of load and weight may come up as fast as the plate, and nothing flies.
"""

import math
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, ImpulseResponse, ManyValues, Values
from inversion.fitting.parameters import Parameter
from inversion.forward.nonlinear_stiffness import convolve_rows

GRAVITY = 9.80665
# Logarithm; of the mass in flight about that of the plate.
_MASS_SPREAD = 0.7
# m/s: what a plate has that flies for some ten milliseconds.
_KICK_SPREAD = 0.05
# A plate that comes no higher above the ground than this part of the largest displacement changes
# as much less: between one that stays and one that leaves there is no jump.
_LEAST_LIFT = 0.005


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
        Parameter(
            "kick", "m/s", 0.0, 0.25, (0.03,), natural=True, prior=(0.0, _KICK_SPREAD), absent=0.0
        ),
    )
    is_no_small_step = True
    present = ({"lift_off": 0.0, "kick": 0.03},)
    advice = "the plate jumps: level it, seat it, or drop from lower down"

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """The mass in flight is about that of the plate, where that is known."""
        time, mass, kick = self.parameters
        known = drop.plate_mass or mass.starts[0]
        return time, replace(mass, starts=(known,), prior=(math.log(known), _MASS_SPREAD)), kick

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """The plate in flight and after; the ground beside it goes its own way."""
        alone = {name: np.array([value]) for name, value in values.items()}
        found = self.motions(motion[None], alone, drop, lambda: impulse_response()[None])
        return np.asarray(found[0])

    def motions(
        self,
        motions: FloatArray,
        values: ManyValues,
        drop: DropContext,
        impulse_responses: ImpulseResponse,
    ) -> FloatArray:
        """Each plate in flight and after."""
        time = drop.time
        moments = drop.contact_end + values["lift_off"]
        inside = np.flatnonzero((time[2] < moments) & (moments < time[-2]))
        if inside.size == 0:
            return motions
        result = motions.copy()
        result[inside] = _flown(
            motions[inside], moments[inside], values["mass"][inside], values["kick"][inside], drop,
            impulse_responses()[inside],
        )  # fmt: skip
        return result


def _flown(
    motions: FloatArray,
    moments: FloatArray,
    masses: FloatArray,
    kicks: FloatArray,
    drop: DropContext,
    impulses: FloatArray,
) -> FloatArray:
    """Motions (m, n_sensors, n) with plates that lift off at moments within the record."""
    time, step, size = drop.time, drop.step, drop.time.size
    flight = time - moments[:, None]
    # What the ground does once the plate has left it: neither load nor weight press on it.
    pressing = drop.load + (masses * GRAVITY)[:, None]
    # Parts of samples count, so that the times have a smooth influence.
    flown = np.minimum(np.maximum(flight / step + 0.5, 0.0), 1.0)
    result = motions + step * convolve_rows(impulses, (-flown * pressing)[:, None])
    # A load below zero there is a weight that the cell has lost, and pulls nothing up.
    way = _way(flown * np.maximum(drop.load, 0.0) / masses[:, None], step)
    fall = 0.5 * GRAVITY * flight**2
    rows, index = np.arange(moments.size), np.arange(size)
    left = ((moments - time[0]) / step).astype(int)
    between = (moments - time[left]) / step
    lifts = np.full(moments.size, np.inf)
    last = np.full(moments.size, size)
    speed, part = np.zeros(moments.size), np.zeros(moments.size)
    for sensor in np.flatnonzero(drop.offsets < drop.plate_radius):
        row = motions[:, sensor]
        around = row[rows[:, None], left[:, None] + np.arange(-1, 3)]
        # One sample before the moment, at it, and one after.
        before, start, after = (
            (1.0 - between) * around[:, k] + between * around[:, k + 1] for k in range(3)
        )
        speed_down = ((after - before) / (2 * step) - kicks)[:, None]
        free = start[:, None] + speed_down * flight + fall + way
        gap = free - result[:, sensor]
        flying = (flight > 0) & (gap < 0)
        highest = np.where(flying, -gap, 0.0).max(axis=1)
        lifts = np.minimum(lifts, highest / np.abs(row).max(axis=1))
        first = np.argmax(flying, axis=1)
        down = ~flying & (index > first[:, None])
        lands = down.any(axis=1)
        last = np.where(lands, np.argmax(down, axis=1), size)
        here = np.minimum(last, size - 1)
        now, then = gap[rows, here], gap[rows, here - 1]
        closing = np.where(lands, now - then, 1.0)
        speed = np.where(lands, np.maximum(closing / step, 0.0), speed)
        part = np.where(lands, -then / closing, part)
        aloft = (index >= first[:, None]) & (index < last[:, None])
        result[:, sensor] = np.where(aloft, free, result[:, sensor])
    back = last < size
    if back.any():
        # The plate is back with its momentum, load and weight press again.
        given = np.minimum(np.maximum(index - (last - 1.5 + part)[:, None], 0.0), 1.0) * pressing
        there, push = np.flatnonzero(back), masses * speed / step
        given[there, last[there] - 1] += (push * (1 - part))[there]
        given[there, last[there]] += (push * part)[there]
        given[~back] = 0.0
        result += step * convolve_rows(impulses, given[:, None])
    # A plate that never leaves the ground changes nothing.
    return motions + np.minimum(lifts / _LEAST_LIFT, 1.0)[:, None, None] * (result - motions)


def _way(acceleration: FloatArray, step: float) -> FloatArray:
    """Twice integrated by trapezoids, (m, n)."""
    way = acceleration
    for _ in range(2):
        steps = np.zeros_like(way)
        np.cumsum(0.5 * step * (way[:, 1:] + way[:, :-1]), axis=1, out=steps[:, 1:])
        way = steps
    return way
