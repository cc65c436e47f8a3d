"""Effects outside the vocabulary of the diagnosis, which should report them as unexplained."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulators.effects.signals import Signals
from simulators.mesh import Array


def oscillator(
    force: Array, mass: float, damping: float, stiffness: float, time_step: float
) -> tuple[Array, Array]:
    r"""Return displacement and velocity of :math:`m \ddot x + c \dot x + k x = F`, from rest.

    Newmark's rule with beta = 1/4 and gamma = 1/2; F is linear between samples.
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
    """Return the motion of an oscillator of unit static compliance (Hz, fraction of critical)."""
    omega = 2 * math.pi * frequency
    return oscillator(force, 1 / omega**2, 2 * damping / omega, 1.0, time_step)


def plate_flexure(signals: Signals, frequency: float, damping: float, share: float) -> Signals:
    """Add the first bending mode of the plate (150 to 300 Hz) to the centre sensor.

    `share`: static deflection of the mode under the peak load over the peak deflection.
    """
    moved, speed = mode(signals.load / signals.peak_load, frequency, damping, signals.time_step)
    return _centre_moves(signals, moved, speed, share)


def plate_rocking(signals: Signals, frequency: float, damping: float, share: float) -> Signals:
    """Add the rocking of a tilted plate on its edge (20 to 50 Hz) to the centre sensor."""
    return plate_flexure(signals, frequency, damping, share)


def _centre_moves(signals: Signals, moved: Array, speed: Array, share: float) -> Signals:
    size = share * float(np.max(signals.displacement[0]))
    velocity, displacement = signals.velocity.copy(), signals.displacement.copy()
    velocity[0] += size * speed
    displacement[0] += size * moved
    return replace(signals, velocity=velocity, displacement=displacement)


def cable_crosstalk(signals: Signals, share: float, corner: float) -> Signals:
    """Add the load to the sensors, coupled through the capacitance of the cable.

    First-order high-pass of the load (corner in Hz, stepped by the trapezoidal rule), with `share`
    of the velocity's peak at the load's peak.
    """
    ratio = math.pi * corner * signals.time_step
    coupled = np.zeros_like(signals.load)
    for n in range(1, coupled.size):
        change = signals.load[n] - signals.load[n - 1]
        coupled[n] = ((1 - ratio) * coupled[n - 1] + change) / (1 + ratio)
    size = share * signals.peak_velocity / signals.peak_load
    return signals.with_velocity(signals.velocity + size * coupled)


def time_base_error(signals: Signals, error: float) -> Signals:
    """Shorten the stated times by `error`, as a slow clock of the converter does.

    Displacements are integrated with the stated times.
    """
    slower = replace(signals, time=signals.time / (1 + error))
    return replace(slower, displacement=signals.displacement / (1 + error))


def gain_glitch(signals: Signals, time: float, share: float) -> Signals:
    """Increase the gain of the sensors by `share` at `time` (s), as a change of range does."""
    gain = 1 + share * (signals.time >= time)
    return signals.with_velocity(signals.velocity * gain)


def passing_traffic(
    signals: Signals, amplitude: float, frequency: float, centre: float, width: float
) -> Signals:
    """Add the ground vibration of a passing lorry: a burst (m/s, Hz) around a time, s."""
    burst = np.exp(-(((signals.time - centre) / width) ** 2))
    wave = burst * np.sin(2 * math.pi * frequency * (signals.time - centre))
    return signals.with_velocity(signals.velocity + amplitude * wave)


def load_cell_curvature(signals: Signals, share: float) -> Signals:
    """Add a quadratic error of an overloaded load cell, `share` of the load at the peak."""
    return replace(signals, load=signals.load * (1 + share * signals.load / signals.peak_load))


def loose_sensor(signals: Signals, frequency: float, damping: float) -> Signals:
    """Add the ringing of sensor cases on a soft seat (Hz, fraction of critical).

    :math:`\\ddot x + 2 \\zeta \\omega (\\dot x - \\dot u) + \\omega^2 (x - u) = 0` for the case on
    a plate that moves by u; the sensor shows the case's velocity.
    """
    omega = 2 * math.pi * frequency
    velocity = np.empty_like(signals.velocity)
    for row, (moved, speed) in enumerate(zip(signals.displacement, signals.velocity, strict=True)):
        push = 2 * damping * omega * speed + omega**2 * moved
        velocity[row] = oscillator(push, 1.0, 2 * damping * omega, omega**2, signals.time_step)[1]
    return signals.with_velocity(velocity)


def lost_samples(signals: Signals, time: float, count: int) -> Signals:
    """Remove samples of the sensors at a time (s); the following samples move forward."""
    first = int(np.searchsorted(signals.time, time))
    remaining = np.delete(signals.velocity, slice(first, first + count), axis=1)
    padding = np.repeat(remaining[:, -1:], count, axis=1)
    return signals.with_velocity(np.concatenate([remaining, padding], axis=1))
