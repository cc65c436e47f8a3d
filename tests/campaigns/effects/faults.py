"""Faults of plate, load cell, sensor and converter that the diagnosis does not know.

Each fault has two functions: one that changes the signals of a drop, and one that draws random
parameters and builds a test point with the fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from simulators.mesh import Array
from tests.campaigns.effects.scene import Scene, SimulatedPoint, altered, undisturbed
from tests.campaigns.effects.signals import Signals
from tests.campaigns.effects.unmodelled import mode, plate_mode


def rocking_mode(
    modulus: float, density: float, poisson_ratio: float, radius: float, inertia: float
) -> tuple[float, float]:
    r"""Return frequency (Hz) and damping (fraction of critical) of a rocking disc on a half-space.

    .. math:: K = \frac{8 G a^3}{3 (1 - \nu)}, \quad B = \frac{3 (1 - \nu) I}{8 \rho a^5}, \quad
        D = \frac{0.15}{(1 + B) \sqrt B}

    Richart, Hall and Woods (1970), Vibrations of Soils and Foundations, tables 10-12 and 10-13.

    Parameters
    ----------
    modulus : float, Pa
        Young's modulus of the half-space.
    density : float, kg/m3
    poisson_ratio : float
    radius : float, m
        Radius of the disc.
    inertia : float, kg m2
        Moment of inertia of the disc about its diameter at the ground.
    """
    shear = modulus / (2 * (1 + poisson_ratio))
    stiffness = 8 * shear * radius**3 / (3 * (1 - poisson_ratio))
    ratio = 3 * (1 - poisson_ratio) * inertia / (8 * density * radius**5)
    return math.sqrt(stiffness / inertia) / (2 * math.pi), 0.15 / ((1 + ratio) * math.sqrt(ratio))


def tilted_plate(scene: Scene, product: float) -> SimulatedPoint:
    """Return a test point whose load and centre sensor are beside the axis of the plate.

    `product` is the product of the eccentricities of load and sensor, over the square of the plate
    radius. The static motion of the sensor by the tilt over the deflection is
    :math:`(e_F / K_{tilt}) e_s K = 1.5 e_F e_s / a^2`, with :math:`K = 4 G a/(1-nu)`.
    """
    soil = scene.ground.layers[0]
    # a plate whose centre of mass lies half a radius above the ground
    inertia = scene.plate_mass * scene.radius**2 / 2
    frequency, damping = rocking_mode(
        scene.modulus, soil.density, soil.poisson_ratio, scene.radius, inertia
    )
    share = 1.5 * product * (-1.0 if scene.generator.random() < 0.5 else 1.0)
    return altered(scene, plate_mode, frequency_hz=frequency, damping=damping, share=share)


def creep(signals: Signals, gains: Sequence[float], times: Sequence[float]) -> Signals:
    r"""Return the signals of sensors that creep under a deflection.

    :math:`g x` is added to the displacement w of every sensor, with :math:`\tau \dot x = w - x`,
    integrated by the trapezoidal rule.

    Parameters
    ----------
    signals : Signals
    gains : sequence of float
        Factor g of each sensor.
    times : sequence of float, s
        Time constant tau of each sensor.
    """
    velocity = signals.velocity.copy()
    for row, (gain, time) in enumerate(zip(gains, times, strict=True)):
        ratio = signals.time_step / (2 * time)
        numerator, denominator = [ratio, ratio], [1 + ratio, ratio - 1]
        velocity[row] += gain * lfilter(numerator, denominator, signals.velocity[row])
    return signals.with_velocity(velocity)


def sensor_creep(scene: Scene, gain: float) -> SimulatedPoint:
    """Return a test point whose sensors creep, each with other random constants.

    The factors are between -`gain` and `gain`, the time constants between 20 and 100 ms; see
    `creep`.
    """
    gains: list[float] = (gain * scene.device.uniform(-1.0, 1.0, scene.sensors)).tolist()
    slowest = scene.device.uniform(math.log(0.02), math.log(0.1), scene.sensors)
    times: list[float] = np.exp(slowest).tolist()
    return altered(scene, creep, gains=gains, times_s=times)


def load_cell_ringing(signals: Signals, frequency: float, damping: float) -> Signals:
    """Return the signals with the reading of a load cell that vibrates with a mass on it.

    Parameters
    ----------
    signals : Signals
    frequency : float, Hz
        Natural frequency of load cell and mass.
    damping : float
        Damping as a fraction of critical damping.
    """
    return replace(signals, load=mode(signals.load, frequency, damping, signals.time_step)[0])


def ringing_load_cell(scene: Scene, frequency: float) -> SimulatedPoint:
    """Return a test point whose load cell rings at `frequency` (Hz).

    The damping is random, 1 to 5 % of critical damping.
    """
    damping = float(scene.device.uniform(0.01, 0.05))
    return altered(scene, load_cell_ringing, frequency_hz=frequency, damping=damping)


def rod_ringing(
    signals: Signals, share: float, frequency: float, damping: float, on_load: bool
) -> Signals:
    """Return the signals disturbed by a guide rod that rings after the impact.

    Parameters
    ----------
    signals : Signals
    share : float
        Largest disturbance, over the peak load or over the peak velocity of the centre.
    frequency : float, Hz
        Natural frequency of the rod.
    damping : float
        Damping as a fraction of critical damping.
    on_load : bool
        True: the load is disturbed. False: all sensors are.
    """
    speed = mode(signals.load, frequency, damping, signals.time_step)[1]
    shape = speed / np.max(np.abs(speed))
    if on_load:
        return replace(signals, load=signals.load + share * signals.peak_load * shape)
    return signals.with_velocity(signals.velocity + share * signals.peak_velocity * shape)


def ringing_guide_rod(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose guide rod rings at 25 to 120 Hz and disturbs load or sensors.

    `share` is the largest disturbance, over the peak load or the peak velocity of the centre.
    """
    frequency = float(np.exp(scene.device.uniform(math.log(25.0), math.log(120.0))))
    damping = float(scene.device.uniform(0.02, 0.08))
    on_load = bool(scene.device.random() < 0.5)
    return altered(
        scene,
        rod_ringing,
        share=share,
        frequency_hz=frequency,
        damping=damping,
        on_load=float(on_load),
    )


def coil_travel(
    velocity: Array, frequency: float, damping: float, time_step: float, stop: float = math.inf
) -> tuple[Array, Array]:
    """Return the travel (m) of a geophone's coil in its case, and the corrected reading (m/s).

    The instrument corrects the reading for the response of the geophone. Without a stop it reads
    the velocity of the case.

    Parameters
    ----------
    velocity : (n,) ndarray of float, m/s
        Velocity of the case.
    frequency : float, Hz
        Natural frequency of the geophone.
    damping : float
        Damping as a fraction of critical damping.
    time_step : float, s
    stop : float, m
        Largest travel of the coil to either side. The coil stays there until it is driven back.
    """
    omega = 2 * math.pi * frequency
    travel, reading = np.zeros((2, velocity.size))
    position = speed = coil = read = 0.0  # travel, its rate, speed of the coil true and as read
    for n in range(1, velocity.size):
        force = time_step * (-2 * damping * omega * speed - omega**2 * position)
        coil, read = coil + force, read + force
        free = position + time_step * (coil - velocity[n])
        moved = min(max(free, -stop), stop)
        speed, position = (moved - position) / time_step, moved
        if moved != free:
            coil = velocity[n] + speed
        travel[n], reading[n] = position, read - speed
    return travel, reading


def coil_at_stop(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose geophone coils hit a stop.

    The stop is at `share` of the largest travel of the centre coil in the largest drop.
    """
    clean = undisturbed(scene)
    frequency, damping = (float(x) for x in scene.device.uniform([4.5, 0.3], [12.0, 0.7]))
    travels = [
        coil_travel(s.velocity[0], frequency, damping, s.time_step)[0] for s in clean.signals
    ]
    stop = share * max(float(np.max(np.abs(travel))) for travel in travels)

    def stopped(signals: Signals) -> Signals:
        rows = [
            coil_travel(row, frequency, damping, signals.time_step, stop)[1]
            for row in signals.velocity
        ]
        return signals.with_velocity(np.array(rows))

    return clean.through(stopped, stop_m=stop, frequency_hz=frequency, damping=damping)


def without_codes(values: Array, level: float, share: float) -> Array:
    """Return values as converted by a converter that lacks some codes.

    Values within a gap are moved to its edge. The gaps have a width of `share` times `level` and
    lie around the multiples of a quarter of `level`, except around zero.
    """
    code = np.round(4 * values / level)
    beyond = values - code * level / 4
    edge = np.where(beyond < 0, -1.0, 1.0) * share * level / 2
    inside = (np.abs(beyond) < share * level / 2) & (code != 0)
    return np.where(inside, code * level / 4 + edge, values)


def missing_codes(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose converter lacks some codes.

    `share` is the width of a gap between codes over the peak of the channel.
    """
    clean = undisturbed(scene)
    load = max(s.peak_load for s in clean.signals)
    speed = max(s.peak_velocity for s in clean.signals)

    def converted(signals: Signals) -> Signals:
        changed = replace(signals, load=without_codes(signals.load, load, share))
        return changed.with_velocity(without_codes(signals.velocity, speed, share))

    return clean.through(converted, share=share)


def crosstalk(signals: Signals, share: float, load: float, speed: float) -> Signals:
    """Return the signals of channels that leak into each other through a common ground wire.

    Parameters
    ----------
    signals : Signals
    share : float
        Leaked part of the other channel, when both are scaled by their full scale.
    load, speed : float, N and m/s
        Full scale of load and sensors.
    """
    changed = replace(signals, load=signals.load + share * load / speed * signals.velocity[0])
    return changed.with_velocity(signals.velocity + share * speed / load * signals.load)


def channel_crosstalk(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose load and sensor channels leak into each other.

    `share` is the leaked part of the other channel, when both are scaled by their peaks.
    """
    clean = undisturbed(scene)
    signed = share * (-1.0 if scene.device.random() < 0.5 else 1.0)
    load = max(s.peak_load for s in clean.signals)
    speed = max(s.peak_velocity for s in clean.signals)
    return clean.through(lambda s: crosstalk(s, signed, load, speed), share=signed)
