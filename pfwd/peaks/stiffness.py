r"""Stiffness of a rig of springs: force over displacement, at the peaks and over frequency.

- Secant: peak of the force over peak of the displacement.
- Dynamic: mean of :math:`|F(f) / U(f)|` from 15 to 30 Hz, where the pulse has most of its energy
  and a geophone answers; below, what is left of offset and drift counts, above, the inertia of
  what moves between load cell and springs.

Response and delays that are declared are taken out of the velocity.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd.files.header import PointSetup
from pfwd_device import Channel, Drop
from pfwd_device.response import correct_response
from pfwd_device.signals import remove_offset

BAND = (15.0, 30.0)
"""Hz."""

FREQUENCIES = 16
"""At which the band is looked at."""


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Of one drop on a rig."""

    peak_load_n: float
    peak_displacement_m: float
    secant_n_per_m: float
    dynamic_n_per_m: float | None
    """Over the band; None: there is no time history."""


def stiffness_of(drop: Drop, setup: PointSetup) -> Stiffness | None:
    """Stiffness that a drop on a rig shows; None without a sensor in the centre.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Its declared geophone response is taken out.
    """
    if drop.only_peaks is not None:
        moved, pressed = drop.only_peaks.centre, drop.only_peaks.load
        if moved is None or moved <= 0 or pressed <= 0:
            return None
        return Stiffness(pressed, moved, pressed / moved, None)
    channel = next((one for one in drop.channels if abs(one.offset) < 1e-3), None)
    if channel is None:
        return None
    # Some devices store a last sample of 0, which is no measurement.
    time, load = drop.time[:-1], remove_offset(drop.time, drop.load)[:-1]
    velocity = _velocity(channel, drop, setup)[:-1]
    steps = np.diff(time) * (velocity[1:] + velocity[:-1]) / 2
    path = np.concatenate([[0.0], np.cumsum(steps)])
    top = int(np.argmax(load))
    # The peak that belongs to the load's; a trace that drifts is larger later.
    end = min(load.size, 2 * top - int(np.argmin(np.abs(time))) + 1)
    peak_load, peak = float(load[top]), float(path[:end].max())
    if peak_load <= 0 or peak <= 0:
        return None
    frequencies = np.linspace(*BAND, FREQUENCIES)
    turn = np.exp(-2j * np.pi * frequencies[:, None] * time[None, :])
    force, rate = np.abs(turn @ load), np.abs(turn @ velocity)
    dynamic = float(np.mean(2 * np.pi * frequencies * force / rate))
    return Stiffness(peak_load, peak, peak_load / peak, dynamic)


def _velocity(channel: Channel, drop: Drop, setup: PointSetup) -> NDArray[np.float64]:
    values = remove_offset(drop.time, channel.values)
    if channel.quantity == "displacement":
        return np.asarray(np.gradient(values, drop.time), np.float64)
    frequency, damping = setup.geophone_natural_frequency, setup.geophone_damping
    if frequency is None or damping is None:
        return values
    return correct_response(values, drop.sampling_rate, frequency, damping)
