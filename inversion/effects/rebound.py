r"""The plate leaves the ground when its load has gone, flies under gravity and lands.

A contact cannot pull. So the time of lift-off follows from the load alone: it has fallen to a level
that is zero but for the cell's offset. The plate leaves with the speed that it has on the ground
and with a kick, of buffers that unload and of a frame that the hammer takes along, which is common
to the drops of a device. In flight :math:`\ddot w = g`; a landing gives the momentum back to plate
and ground. The load cell shows the mass in flight: its reading falls by the weight.

A plate that is slower than the ground below it falls on here without end. No record does so: it
leads fits away from there, which a plate that stays, whose motion no number changes, would not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from inversion.arrays import FloatArray
from inversion.effects.base import DropContext, Effect, ImpulseResponse, ManyValues, Values
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter
from inversion.forward.nonlinear_stiffness import convolve_rows

GRAVITY = 9.80665
# s: the load is smoothed over this time before its level is read.
_SMOOTHED_S = 6e-4
# s: the ground is relieved of load and weight over this time, and no landing comes before that.
_RELIEF_S, _EARLIEST_LANDING_S = 1e-3, 2e-3
# s after the contact from which on the load shows the weight in flight, and the samples it takes.
_TAIL_BEGINS_S, _TAIL_SAMPLES = 4e-3, 10
# kg: the least mass in flight, of plates below and above this radius, m.
_SMALL_PLATE_M, _LEAST_MASS_KG = 0.25, (8.0, 20.0)


class Rebound(Effect):
    """The plate rises above its place after the contact and comes down again."""

    name = "rebound"
    scope = "point"
    parameters = (
        Parameter("level", "-", -0.06, 0.1, (0.008, -0.03), prior=(0.008, 0.02)),
        Parameter("mass", "kg", 1.0, 500.0, (20.0,), logarithmic=True, natural=True),
        Parameter("kick", "m/s", -0.25, 0.25, (-0.05, 0.0), prior=(0.0, 0.05)),
    )
    advice = "the plate jumps: level it, seat it, or drop from lower down"

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return level and kick; the mass about the weight that the load cell lost."""
        level, mass, kick = super().coordinates(drop)
        known = math.log(_mass_from_load(drop))
        kick = replace(kick, starts=self.parameters[2].starts)
        return level, replace(mass, mean=known, deviation=0.3, starts=(known,)), kick

    def told(self, values: Values, drop: DropContext) -> dict[str, tuple[str, float]]:
        """Return the time of lift-off on the model's time, s, and the parameters."""
        moment = float(lift_off_times(drop, np.array([values["level"]]))[0])
        first = {"liftoff": ("s", moment)} if math.isfinite(moment) else {}
        return first | super().told(values, drop)

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """The plate in flight and after; the ground beside it is relieved."""
        single = {name: np.array([value]) for name, value in values.items()}
        flown = self.motions(motion[None], single, drop, lambda: impulse_response()[None])
        return np.asarray(flown[0])

    def motions(
        self,
        motions: FloatArray,
        values: ManyValues,
        drop: DropContext,
        impulse_responses: ImpulseResponse,
    ) -> FloatArray:
        """Each plate in flight and after."""
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
        """Return the upward speed of the plate as it leaves the ground, m/s; None: it stays.

        Parameters
        ----------
        motion : (n_sensors, n) ndarray of float, m, of the ground under the load
        """
        slope = self._slope(motion, values, drop)
        return None if slope is None else values["kick"] - slope

    def kick_for(
        self, speed: float, motion: FloatArray, values: Values, drop: DropContext
    ) -> float:
        """Return the kick with which a plate takes off at an upward speed, m/s."""
        slope = self._slope(motion, values, drop)
        return values["kick"] if slope is None else speed + slope

    def _slope(self, motion: FloatArray, values: Values, drop: DropContext) -> float | None:
        """Return the downward speed of the innermost sensor at lift-off, m/s."""
        moment = lift_off_times(drop, np.array([values["level"]]))[0]
        if not drop.time[3] < moment < drop.time[-4]:
            return None
        row = motion[int(np.argmin(drop.offsets))]
        earlier, later = np.interp([moment - drop.step, moment + drop.step], drop.time, row)
        return float((later - earlier) / (2.0 * drop.step))


def lift_off_times(drop: DropContext, levels: FloatArray) -> FloatArray:
    """Return when the load has fallen to levels (m,) of its peak, (m,), s; inf: never."""
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
    """Return the mass whose weight the load cell lost after the contact, kg."""
    least = _LEAST_MASS_KG[0] if drop.plate_radius < _SMALL_PLATE_M else _LEAST_MASS_KG[1]
    tail = drop.load[drop.time > drop.contact_end + _TAIL_BEGINS_S]
    if tail.size <= _TAIL_SAMPLES:
        return least
    return max(-float(np.median(tail)) / GRAVITY, least)


def _flown(
    motions: FloatArray,
    moments: FloatArray,
    masses: FloatArray,
    kicks: FloatArray,
    drop: DropContext,
    impulses: FloatArray,
) -> FloatArray:
    """Return motions (m, n_sensors, n) with plates that lift off at moments (m,)."""
    time, step = drop.time, drop.step
    flight = time[None] - moments[:, None]
    pressing = drop.load[None] + (masses * GRAVITY)[:, None]
    relieved = np.clip(flight / _RELIEF_S, 0.0, 1.0)
    ground = motions + step * convolve_rows(impulses, (-relieved * pressing)[:, None])
    # Parts of samples count, so that the moment has a smooth influence.
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
    """Put a plate (n,) back on the ground that it meets, with its momentum; changes ``plate``.

    Parameters
    ----------
    plate, ground : (n,) ndarray of float, m
    impulse : (n,) ndarray of float, m, motion after 1 N s
    flight : (n,) ndarray of float, s, since the lift-off
    load : what presses on the ground again, (n,), N, and the mass in flight, kg
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
    given = np.clip(np.arange(plate.size) - (landing - 1.5 + share), 0.0, 1.0) * pressing
    push = mass * max(now - previous, 0.0) / step / step
    given[landing - 1] += push * (1.0 - share)
    given[landing] += push * share
    back = ground + step * np.convolve(impulse, given)[: plate.size]
    plate[landing:] = back[landing:]
