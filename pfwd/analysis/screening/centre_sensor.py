r"""Check of the centre sensor of a drop.

The ground and the plate are passive, and the surface deflects most under the plate. A record of the
centre sensor that contradicts this is not the motion of the plate; its drop has no modulus.

- **Polarity**: during the contact the sensor moves up more than twice as far as down.
- **Stop**: the sensor comes to rest abruptly at its largest displacement and stands still there. A
  sound top is round; a flat one is the end of the sensor's stroke or of the recorder's range.
- **Neighbours**: both of the two nearest sensors go down farther than the centre sensor during the
  contact.
- **Early return**: the sensor is back below 30 % of its peak while half of the load acts. A spring
  without mass would hold half of its deflection; damping and inertia delay the return.
- **Negative work**: :math:`W(t) = \int_0^t F\, \mathrm{d}w < 0` during the contact. Ground that
  was at rest has no energy that it could return to the falling weight.

Work and return are tested on a motion that is delayed by the largest error of timing that a sound
chain may have. A filter in the load channel delays the load, which shows in the rise: the delay is
the time by which the motion reaches half of its peak before the load does, plus `RESPONSE_LEAD`,
the phase lead of a geophone whose response is not declared. A declared response is taken out first.
Each rule allows for the motion before the pulse, which is due to hum or drift.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd_device.signals import correct_response

Vector = NDArray[np.float64]

RESPONSE_LEAD = 1.5e-3
"""Time, s, by which a sensor whose response is not declared may lead the motion. On spring test
rigs, where the load does the least work, raw geophones need 0.7 ms. Drops of finite elements need 1
ms with a geophone of 10 Hz and damping 0.6, and 1.5 ms with a load filter of 200 Hz as well."""

RETURNED = 0.3
"""Fraction of its peak below which the centre sensor has returned too early. With the delay, sound
records of five devices stay above 0.57; those of sensors that reached their stops fall to 0.09 or
less."""

HALF_LOAD = 0.5
"""Fraction of the peak load that acts when the early return is tested."""

NO_WORK = 0.02
"""Negative work, over peak load times peak displacement, that errors of the zero lines may cause;
sound records have at most 0.01."""

NEIGHBOURS_BEYOND = 1.05
"""Displacement of both neighbours over that of the centre sensor, from which the centre sensor is
faulty; two gains may differ by 5 %. On sound ground a neighbour has at most 0.9."""

MIN_REVERSED_MOTION = 2.0
"""Ratio of upward to downward motion from which a sensor has the wrong polarity."""

FLAT_BAND = 0.015
"""A top is flat where the displacement is within this fraction of its maximum."""

MIN_FLAT_SAMPLES = 4
"""Smallest number of samples of a flat top."""

STEEPER = 2.5
"""A flat top is a stop if the slopes beside it exceed this multiple of the slope of a round one.
The round one is a parabola that falls by the same band within half of the same width. Sound tops
have at most 1.7."""

HELD_PART = 0.2
"""Fraction of the contact for which a sensor stands still that never leaves its stop."""

ABRUPT = 0.5
"""A sensor stops abruptly if it arrives with more than this fraction of its greatest velocity.
Plates that stay in soft ground come to rest with at most 0.2."""

LOAD_ONSET = 0.01
CONTACT_END = 0.03
"""Fractions of the peak load at which the contact begins and ends."""

ONSET_MARGIN = 1e-3
"""Time before the load's onset, s, at which the motion is taken as 0."""


@dataclass(frozen=True, slots=True)
class Response:
    """Response of a geophone that has not been removed from the record."""

    natural_frequency: float
    """Hz"""
    damping: float


def centre_sensor_fault(
    time: Vector,
    load: Vector,
    centre: Vector,
    neighbours: Sequence[Vector] = (),
    response: Response | None = None,
) -> Notice | None:
    """Return the fault of the centre sensor; None: no fault was detected.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform
    load : (n,) ndarray of float, N
        Load without offset, with a pulse.
    centre : (n,) ndarray of float, m
        Displacement of the centre sensor, downward positive.
    neighbours : sequence of (n,) ndarray of float, m
        Displacements of the two sensors next to the plate; with fewer the rule on neighbours is
        skipped.
    response : Response, optional
        Declared response of the sensors, which is removed before work and return are tested.
    """
    top = int(np.argmax(load))
    step = float(time[-1] - time[0]) / (time.size - 1)
    quiet = np.flatnonzero(load[:top] < LOAD_ONSET * load[top])
    first = max(0, (int(quiet[-1]) if quiet.size else 0) - round(ONSET_MARGIN / step))
    ended = np.flatnonzero(load[top:] <= CONTACT_END * load[top])
    end = top + (int(ended[0]) if ended.size else load.size - top - 1) + 1
    contact = slice(first, end)
    moved = centre[contact] - centre[first]
    # Motion before the pulse is hum or drift; the same amount may be part of the later motion.
    unsure = float(np.ptp(centre[: first + 1]))
    force = load[contact]
    if -moved.min() > MIN_REVERSED_MOTION * moved.max():
        return Notice("moves-upward")
    if _stands_still(moved):
        return Notice("stops-under-load", {"deflection_m": float(moved.max())})
    if len(neighbours) >= 2:
        neighbour_peaks = [
            float((values[contact] - values[first]).max()) for values in neighbours[:2]
        ]
        if min(neighbour_peaks) > NEIGHBOURS_BEYOND * moved.max() + unsure:
            share = min(neighbour_peaks) / float(moved.max())
            return Notice("neighbours-deflect-more", {"share": share})
    if response is not None:
        moved = correct_response(moved, 1.0 / step, response.natural_frequency, response.damping)
    return _timing_fault(force, moved, step, unsure)


def _timing_fault(force: Vector, moved: Vector, step: float, unsure: float) -> Notice | None:
    """Return the fault of a sensor that returns too early or moves against the load.

    The result is None if there is no such fault.

    First the motion is delayed by the largest timing error of an intact measuring chain. So such an
    error is not reported.
    """
    lead = _half_way(force) - _half_way(moved)
    delay = round(max(lead, 0.0) + RESPONSE_LEAD / step)
    delayed = np.concatenate([np.zeros(delay), moved[: max(0, moved.size - delay)]])[: moved.size]
    peak = float(delayed.max())
    if not peak > 0.0:
        return None
    unsure /= peak
    turned = int(np.argmax(delayed))
    after = np.arange(force.size) > turned
    under_load = after & (force >= HALF_LOAD * force.max())
    remaining = float(delayed[under_load].min()) / peak if under_load.any() else 1.0
    if remaining < RETURNED - unsure:
        return Notice("returns-too-early", {"share": remaining})
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(delayed))
    smallest = float(work.min()) / (float(force.max()) * peak)
    if smallest < -NO_WORK - unsure:
        return Notice("negative-work", {"share": smallest})
    return None


def _half_way(values: Vector) -> float:
    """Return the fractional index at which values last rise to half of their maximum."""
    top = int(np.argmax(values))
    below = np.flatnonzero(values[: top + 1] < 0.5 * values[top])
    if not below.size:
        return 0.0
    last = int(below[-1])
    return last + float((0.5 * values[top] - values[last]) / (values[last + 1] - values[last]))


def _stands_still(moved: Vector) -> bool:
    """Return whether the motion ends abruptly at its largest displacement."""
    top = int(np.argmax(moved))
    largest = float(moved[top])
    below = np.flatnonzero(moved < (1.0 - FLAT_BAND) * largest)
    before, after = below[below < top], below[below > top]
    first = int(before[-1]) + 1 if before.size else 0
    last = int(after[0]) - 1 if after.size else moved.size - 1
    width = last - first + 1
    if first < 2 or width < MIN_FLAT_SAMPLES:
        return False
    arrival = 0.5 * float(moved[first] - moved[first - 2])
    greatest = 0.5 * float((moved[2 : first + 1] - moved[: first - 1]).max())
    if width >= HELD_PART * moved.size and arrival >= ABRUPT * greatest:
        return True
    if last + 2 >= moved.size:
        return False
    departure = 0.5 * float(moved[last] - moved[last + 2])
    rounded = 4.0 * FLAT_BAND * largest / width
    return min(arrival, departure) > STEEPER * rounded
