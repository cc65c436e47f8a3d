"""Effects that the diagnosis does not know, and should report as unexplained.

Each function changes the signals of a drop.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulators.mesh import Array
from tests.campaigns.effects.signals import Signals


def oscillator(
    force: Array, mass: float, damping: float, stiffness: float, time_step: float
) -> tuple[Array, Array]:
    r"""Return displacement (m) and velocity (m/s) of a damped mass on a spring, from rest.

    The equation :math:`m \ddot x + c \dot x + k x = F` is integrated by Newmark's rule with
    beta = 1/4 and gamma = 1/2; F is linear between samples.

    Parameters
    ----------
    force : (n,) ndarray of float, N
    mass : float, kg
    damping : float, N s/m
    stiffness : float, N/m
    time_step : float, s
    """
    h = time_step
    x, v = np.zeros((2, force.size))
    a = force[0] / mass
    effective_mass = mass + h / 2 * damping + h**2 / 4 * stiffness
    for n in range(1, force.size):
        x_free = x[n - 1] + h * v[n - 1] + h**2 / 4 * a
        v_free = v[n - 1] + h / 2 * a
        a = (force[n] - damping * v_free - stiffness * x_free) / effective_mass
        x[n], v[n] = x_free + h**2 / 4 * a, v_free + h / 2 * a
    return x, v


def mode(force: Array, frequency: float, damping: float, time_step: float) -> tuple[Array, Array]:
    """Return displacement and velocity of an oscillator with a static displacement of 1 per force.

    Parameters
    ----------
    force : (n,) ndarray of float
        Force in any unit, in which the displacement is returned as well.
    frequency : float, Hz
        Natural frequency.
    damping : float
        Damping as a fraction of critical damping.
    time_step : float, s
    """
    omega = 2 * math.pi * frequency
    return oscillator(force, 1 / omega**2, 2 * damping / omega, 1.0, time_step)


def plate_mode(signals: Signals, frequency: float, damping: float, share: float) -> Signals:
    """Return the signals with a mode of the plate at the centre sensor: bending or rocking.

    Parameters
    ----------
    signals : Signals
    frequency : float, Hz
        Natural frequency of the mode, usually 150 to 300 Hz for bending, 20 to 50 Hz for rocking.
    damping : float
        Damping as a fraction of critical damping.
    share : float
        Static deflection of the mode under the peak load, over the peak deflection.
    """
    moved, speed = mode(signals.load / signals.peak_load, frequency, damping, signals.time_step)
    size = share * float(np.max(signals.displacement[0]))
    velocity, displacement = signals.velocity.copy(), signals.displacement.copy()
    velocity[0] += size * speed
    displacement[0] += size * moved
    return replace(signals, velocity=velocity, displacement=displacement)


def cable_crosstalk(signals: Signals, share: float, corner: float) -> Signals:
    """Return the signals with crosstalk of the load to the sensors through the cable capacitance.

    The crosstalk is the load after a first-order high-pass, integrated by the trapezoidal rule.

    Parameters
    ----------
    signals : Signals
    share : float
        Crosstalk of the unfiltered peak load, over the peak velocity of the centre sensor.
    corner : float, Hz
        Corner frequency of the high-pass.
    """
    ratio = math.pi * corner * signals.time_step
    coupled = np.zeros_like(signals.load)
    for n in range(1, coupled.size):
        change = signals.load[n] - signals.load[n - 1]
        coupled[n] = ((1 - ratio) * coupled[n - 1] + change) / (1 + ratio)
    size = share * signals.peak_velocity / signals.peak_load
    return signals.with_velocity(signals.velocity + size * coupled)


def time_base_error(signals: Signals, error: float) -> Signals:
    """Return the signals with wrong times, as from a converter with a slow clock.

    The recorded times are too short by the fraction `error`, and so are displacements, which the
    instrument integrates from velocities with these times.
    """
    slower = replace(signals, time=signals.time / (1 + error))
    return replace(slower, displacement=signals.displacement / (1 + error))


def gain_glitch(signals: Signals, time: float, share: float) -> Signals:
    """Return the signals with the gain of the sensors increased by `share` from `time` (s) on.

    A converter that changes its range has this error.
    """
    gain = 1 + share * (signals.time >= time)
    return signals.with_velocity(signals.velocity * gain)


def passing_traffic(
    signals: Signals, amplitude: float, frequency: float, centre: float, width: float
) -> Signals:
    """Return the signals with the ground vibration of a passing lorry in all sensors.

    Parameters
    ----------
    signals : Signals
    amplitude : float, m/s
    frequency : float, Hz
    centre : float, s
        Time at which the vibration is largest.
    width : float, s
        Time over which it rises and falls.
    """
    burst = np.exp(-(((signals.time - centre) / width) ** 2))
    wave = burst * np.sin(2 * math.pi * frequency * (signals.time - centre))
    return signals.with_velocity(signals.velocity + amplitude * wave)


def load_cell_curvature(signals: Signals, share: float) -> Signals:
    """Return the signals with a quadratic error of the load, as from an overloaded load cell.

    The error is the fraction `share` of the load at its peak.
    """
    return replace(signals, load=signals.load * (1 + share * signals.load / signals.peak_load))


def loose_sensor(signals: Signals, frequency: float, damping: float) -> Signals:
    """Return the signals of sensors whose cases vibrate on a soft support.

    The case moves by x on a plate that moves by u, and the sensor measures the velocity of the
    case: :math:`\\ddot x + 2 \\zeta \\omega (\\dot x - \\dot u) + \\omega^2 (x - u) = 0`.

    Parameters
    ----------
    signals : Signals
    frequency : float, Hz
        Natural frequency of a case on its support.
    damping : float
        Damping as a fraction of critical damping.
    """
    omega = 2 * math.pi * frequency
    velocity = np.empty_like(signals.velocity)
    for row, (moved, speed) in enumerate(zip(signals.displacement, signals.velocity, strict=True)):
        push = 2 * damping * omega * speed + omega**2 * moved
        velocity[row] = oscillator(push, 1.0, 2 * damping * omega, omega**2, signals.time_step)[1]
    return signals.with_velocity(velocity)


def lost_samples(signals: Signals, time: float, count: int) -> Signals:
    """Return the signals with lost samples of the sensors; the following samples move forward.

    Parameters
    ----------
    signals : Signals
    time : float, s
        Time of the first lost sample.
    count : int
        Number of lost samples.
    """
    first = int(np.searchsorted(signals.time, time))
    remaining = np.delete(signals.velocity, slice(first, first + count), axis=1)
    padding = np.repeat(remaining[:, -1:], count, axis=1)
    return signals.with_velocity(np.concatenate([remaining, padding], axis=1))
