r"""Rebound of the plate: lift-off when the load has gone, flight under gravity, and landing.

A contact cannot pull. Therefore lift-off is when the load has fallen to a level that is zero
except for the offset of the cell. The plate leaves with its speed on the ground plus a kick. The
kick comes from unloading buffers and from a frame that the hammer carries along; it is the same
for the drops of a device. In flight :math:`\ddot w = g`; a landing returns the momentum to plate
and ground. The reading of the load cell falls by the weight of the mass in flight.

In this model a plate that is slower than the ground below it falls without end. No record shows
this, so fits avoid such values. If the plate stayed on the ground instead, its motion would not
depend on the parameters, and fits would stop there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, ImpulseResponse, ValueArrays, Values
from inversion.effects.parameters import Coordinate, Parameter
from inversion.forward.nonlinear_stiffness import convolve_rows

GRAVITY = 9.80665
# Time over which the load is smoothed before its level is determined, s.
_SMOOTHED_S = 6e-4
# Time over which load and weight are removed from the ground, and earliest time of a landing, both
# in s after the lift-off.
_RELIEF_S, _EARLIEST_LANDING_S = 1e-3, 2e-3
# Time after the contact, s, from which the load shows the weight in flight, and the number of
# samples that are needed.
_TAIL_BEGINS_S, _TAIL_SAMPLES = 4e-3, 10
# Plates below this radius, m, have the first smallest mass in flight, kg; larger ones the second.
_SMALL_PLATE_M, _MIN_MASS_KG = 0.25, (8.0, 20.0)


class Rebound(Effect):
    """Rebound of the plate: it rises above its place after the contact and lands again."""

    name = "rebound"
    scope = "point"
    parameters = (
        Parameter("level", "-", -0.06, 0.1, (0.008, -0.03), prior=(0.008, 0.02)),
        Parameter("mass", "kg", 1.0, 500.0, (20.0,), logarithmic=True, natural=True),
        Parameter("kick", "m/s", -0.25, 0.25, (-0.05, 0.0), prior=(0.0, 0.05)),
    )
    advice = "the plate jumps: level it, seat it, or use a lower drop height"

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the unknowns: load level at lift-off, logarithm of the mass, kg, and kick, m/s.

        The prior of the mass is the weight by which the reading of the load cell falls.
        """
        level, mass, kick = super().coordinates(drop)
        log_mass = math.log(_mass_from_load(drop))
        kick = replace(kick, starts=self.parameters[2].starts)
        return level, replace(mass, mean=log_mass, deviation=0.3, starts=(log_mass,)), kick

    def reported_values(self, values: Values, drop: DropContext) -> dict[str, tuple[str, float]]:
        """Return the time of lift-off on the model's time axis, s, and the parameters."""
        moment = float(lift_off_times(drop, np.array([values["level"]]))[0])
        first = {"liftoff": ("s", moment)} if math.isfinite(moment) else {}
        return first | super().reported_values(values, drop)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """Return the motion with flight and landing of the plate, (n_sensors, n), m."""
        single = {name: np.array([value]) for name, value in values.items()}
        flown = self.motions(motion[None], single, drop, lambda: impulse_response()[None])
        return np.asarray(flown[0])

    def motions(
        self,
        motions: FloatArray,
        values: ValueArrays,
        drop: DropContext,
        impulse_responses: ImpulseResponse,
    ) -> FloatArray:
        """Return several motions with flight and landing of the plate, (m, n_sensors, n), m."""
        time = drop.time
        moments = lift_off_times(drop, values["level"])
        inside = np.flatnonzero((time[3] < moments) & (moments < time[-4]))
        if inside.size == 0:
            return motions
        result = motions.copy()
        result[inside] = _flown(
            motions[inside],
            moments[inside],
            values["mass"][inside],
            values["kick"][inside],
            drop,
            impulse_responses()[inside],
        )
        return result

    def take_off_speed(self, motion: FloatArray, values: Values, drop: DropContext) -> float | None:
        """Return the upward speed of the plate when it leaves the ground, m/s; None: it does not.

        Parameters
        ----------
        motion : (n_sensors, n) ndarray of float, m
            Motion of the ground under the load.
        values : mapping
            Values of the parameters, in SI units.
        drop : DropContext
        """
        slope = self._slope(motion, values, drop)
        return None if slope is None else values["kick"] - slope

    def kick_for(
        self, speed: float, motion: FloatArray, values: Values, drop: DropContext
    ) -> float:
        """Return the kick, m/s, with which a plate leaves the ground at this upward speed, m/s."""
        slope = self._slope(motion, values, drop)
        return values["kick"] if slope is None else speed + slope

    def _slope(self, motion: FloatArray, values: Values, drop: DropContext) -> float | None:
        """Return the downward speed of the innermost sensor at lift-off, m/s.

        The result is None if there is no lift-off.
        """
        moment = lift_off_times(drop, np.array([values["level"]]))[0]
        if not drop.time[3] < moment < drop.time[-4]:
            return None
        row = motion[int(np.argmin(drop.offsets))]
        earlier, later = np.interp([moment - drop.step, moment + drop.step], drop.time, row)
        return float((later - earlier) / (2.0 * drop.step))


def lift_off_times(drop: DropContext, levels: FloatArray) -> FloatArray:
    """Return the times at which the load has fallen to levels (m,) of its peak, (m,), s.

    The time is inf for a level that the load does not reach.
    """
    half = max(1, round(0.5 * _SMOOTHED_S / drop.step))
    window = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    smooth = np.convolve(np.pad(drop.load, half, mode="edge"), window, "valid")
    top = int(np.argmax(smooth))
    moments = np.full(len(levels), np.inf)
    for row, level in enumerate((levels * drop.peak_load).tolist()):
        below = np.flatnonzero(smooth[top:] < level)
        if below.size and below[0] > 0:
            end = top + int(below[0])
            share = (smooth[end - 1] - level) / (smooth[end - 1] - smooth[end])
            moments[row] = drop.time[end - 1] + share * drop.step
    return moments


def _mass_from_load(drop: DropContext) -> float:
    """Return the mass, kg, whose weight is missing in the load after the contact."""
    min_mass = _MIN_MASS_KG[0] if drop.plate_radius < _SMALL_PLATE_M else _MIN_MASS_KG[1]
    tail = drop.load[drop.time > drop.contact_end + _TAIL_BEGINS_S]
    if tail.size <= _TAIL_SAMPLES:
        return min_mass
    return max(-float(np.median(tail)) / GRAVITY, min_mass)


def _flown(
    motions: FloatArray,
    moments: FloatArray,
    masses: FloatArray,
    kicks: FloatArray,
    drop: DropContext,
    impulses: FloatArray,
) -> FloatArray:
    """Return motions (m, n_sensors, n) of plates that lift off at times ``moments`` (m,), s."""
    time, step = drop.time, drop.step
    flight = time[None] - moments[:, None]
    pressing = drop.load[None] + (masses * GRAVITY)[:, None]
    relieved = np.clip(flight / _RELIEF_S, 0.0, 1.0)
    ground = motions + step * convolve_rows(impulses, (-relieved * pressing)[:, None])
    # Fractions of samples count, so that the motion depends smoothly on the moment.
    aloft = np.clip(flight / step + 0.5, 0.0, 1.0)
    rows = np.arange(moments.size)
    before = ((moments - time[0]) / step).astype(int)
    share = (moments - time[before]) / step
    result = motions.copy()
    for sensor, offset in enumerate(drop.offsets.tolist()):
        motion = motions[:, sensor]
        if offset >= drop.plate_radius:
            result[:, sensor] = (1.0 - aloft) * motion + aloft * ground[:, sensor]
            continue
        earlier, start, later = (
            (1.0 - share) * motion[rows, before + k] + share * motion[rows, before + k + 1]
            for k in (-1, 0, 1)
        )
        speed = (later - earlier) / (2.0 * step) - kicks
        free = start[:, None] + speed[:, None] * flight + 0.5 * GRAVITY * flight**2
        result[:, sensor] = (1.0 - aloft) * motion + aloft * free
        for row in range(moments.size):
            _land(
                result[row, sensor],
                ground[row, sensor],
                impulses[row, sensor],
                flight[row],
                (relieved[row] * pressing[row], float(masses[row])),
                step,
            )
    return result


def _land(
    plate: FloatArray,
    ground: FloatArray,
    impulse: FloatArray,
    flight: FloatArray,
    load: tuple[FloatArray, float],
    step: float,
) -> None:
    """Continue the motion of a plate after its landing; the array ``plate`` is changed in place.

    The plate keeps its momentum when it reaches the ground.

    Parameters
    ----------
    plate, ground : (n,) ndarray of float, m
    impulse : (n,) ndarray of float, m, motion after 1 N s
    flight : (n,) ndarray of float, s, since the lift-off
    load : force on the ground after landing, (n,), N, and the mass in flight, kg
    step : float, s
    """
    pressing, mass = load
    gap = plate - ground
    risen = np.flatnonzero((flight > _EARLIEST_LANDING_S) & (gap < 0.0))
    if risen.size == 0:
        return
    down = np.flatnonzero(gap[risen[0] :] >= 0.0)
    if down.size == 0:
        return
    landing = int(risen[0] + down[0])
    now, previous = gap[landing], gap[landing - 1]
    closing = max(now - previous, 1e-15)
    share = -previous / closing
    force = np.clip(np.arange(plate.size) - (landing - 1.5 + share), 0.0, 1.0) * pressing
    push = mass * max(now - previous, 0.0) / step / step
    force[landing - 1] += push * (1.0 - share)
    force[landing] += push * share
    back = ground + step * np.convolve(impulse, force)[: plate.size]
    plate[landing:] = back[landing:]
