r"""Stiffness of a spring test rig: force over displacement, at the peaks and by frequency.

- Secant stiffness: peak of the force over peak of the displacement.
- Dynamic stiffness: mean of :math:`|F(f) / U(f)|` from 15 to 30 Hz, where the pulse has most of its
energy and a geophone responds. Below 15 Hz offset and drift distort it. Above 30 Hz the inertia of
the parts between load cell and springs does.

A declared response of the geophone is removed from the velocity.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfwd.files.header import PointSetup
from pfwd.peaks.basin import CENTRE_TOLERANCE_M
from pfwd_device import Channel, Drop
from pfwd_device.signals import correct_response, integrated, remove_offset, velocity_of
from pfwd_plugins.quantities import Measurand

STIFFNESS_BAND_HZ = (15.0, 30.0)
"""Lower and upper frequency, Hz, between which the dynamic stiffness is averaged."""

N_STIFFNESS_FREQUENCIES = 16
"""Number of frequencies, evenly spaced in the band, at which the dynamic stiffness is computed."""


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Secant and dynamic stiffness of a spring test rig, from one drop."""

    peak_load_n: float
    peak_displacement_m: float
    secant_n_per_m: float
    dynamic_n_per_m: float | None
    """Mean of force over displacement from 15 to 30 Hz; None if the file has peaks but no traces.
    """


def stiffness_of(drop: Drop, setup: PointSetup) -> Stiffness | None:
    """Return the stiffness of the spring test rig on which a drop was made.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Supplies the declared geophone response, which is removed from the velocity.

    Returns
    -------
    Stiffness or None
        None if there is no sensor in the centre or its peak is not positive.
    """
    if drop.only_peaks is not None:
        deflection, peak_load = drop.only_peaks.centre, drop.only_peaks.load
        if deflection is None or deflection <= 0 or peak_load <= 0:
            return None
        return Stiffness(peak_load, deflection, peak_load / deflection, None)
    centre = (each for each in drop.channels if abs(each.offset) < CENTRE_TOLERANCE_M)
    channel = next(centre, None)
    if channel is None:
        return None
    # Some devices store a last sample of 0, which is no measurement.
    time, load = drop.time[:-1], remove_offset(drop.time, drop.load)[:-1]
    velocity = ground_velocity(channel, drop, setup)[:-1]
    displacement = integrated(velocity, time)
    load_peak = int(np.argmax(load))
    # Search the peak near that of the load: a drifting trace is larger later.
    end = min(load.size, 2 * load_peak - int(np.argmin(np.abs(time))) + 1)
    peak_load, peak = float(load[load_peak]), float(displacement[:end].max())
    if peak_load <= 0 or peak <= 0:
        return None
    frequencies = np.linspace(*STIFFNESS_BAND_HZ, N_STIFFNESS_FREQUENCIES)
    kernel = np.exp(-2j * np.pi * frequencies[:, None] * time[None, :])
    force, rate = np.abs(kernel @ load), np.abs(kernel @ velocity)
    dynamic = float(np.mean(2 * np.pi * frequencies * force / rate))
    return Stiffness(peak_load, peak, peak_load / peak, dynamic)


def ground_velocity(channel: Channel, drop: Drop, setup: PointSetup) -> NDArray[np.float64]:
    """Return the velocity of a channel, m/s, without the declared response of the geophone."""
    velocity = velocity_of(channel, drop.time)
    frequency, damping = setup.geophone_natural_frequency, setup.geophone_damping
    if channel.quantity is not Measurand.VELOCITY or frequency is None or damping is None:
        return velocity
    return correct_response(velocity, drop.sampling_rate, frequency, damping)
