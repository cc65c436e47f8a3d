"""Faults of plate, cell, sensor and converter that the vocabulary of effects does not name.

Each fault has an operator, which alters the channels, and a builder, which draws the random
parameters of a device or point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from simulators.effects.scene import Scene, SimulatedPoint, undisturbed
from simulators.effects.signals import Signals
from simulators.effects.unmodelled import mode
from simulators.mesh import Array


def rocking_mode(
    modulus: float, density: float, poisson_ratio: float, radius: float, inertia: float
) -> tuple[float, float]:
    r"""Return frequency (Hz) and damping (fraction of critical) of a rocking disc on a half-space.

    .. math:: K = \frac{8 G a^3}{3 (1 - \nu)}, \quad B = \frac{3 (1 - \nu) I}{8 \rho a^5}, \quad
        D = \frac{0.15}{(1 + B) \sqrt B}

    Richart, Hall and Woods (1970), Vibrations of Soils and Foundations, tables 10-12 and 10-13.

    Parameters
    ----------
    inertia : of the plate about its diameter at the ground, kg m2
    """
    shear = modulus / (2 * (1 + poisson_ratio))
    stiffness = 8 * shear * radius**3 / (3 * (1 - poisson_ratio))
    ratio = 3 * (1 - poisson_ratio) * inertia / (8 * density * radius**5)
    return math.sqrt(stiffness / inertia) / (2 * math.pi), 0.15 / ((1 + ratio) * math.sqrt(ratio))


def tilt(signals: Signals, share: float, frequency: float, damping: float) -> Signals:
    """Add what an eccentric sensor reads of a plate that tilts under an eccentric load.

    `share`: the sensor's reading of the tilt at rest under the peak load over the peak deflection.
    """
    moved, speed = mode(signals.load / signals.peak_load, frequency, damping, signals.time_step)
    size = share * float(np.max(signals.displacement[0]))
    velocity, displacement = signals.velocity.copy(), signals.displacement.copy()
    velocity[0] += size * speed
    displacement[0] += size * moved
    return replace(signals, velocity=velocity, displacement=displacement)


def tilted_plate(scene: Scene, product: float) -> SimulatedPoint:
    """Build a point with load and sensor off the plate's axis.

    `product`: of both eccentricities, over the square of the radius. At rest the tilt over the
    deflection is :math:`(e_F / K_{tilt}) e_s K = 1.5 e_F e_s / a^2`, with :math:`K = 4 G a/(1-nu)`.
    """
    soil = scene.ground.layers[0]
    # a plate whose centre of mass lies half a radius above the ground
    inertia = scene.plate_mass * scene.radius**2 / 2
    frequency, damping = rocking_mode(
        scene.modulus, soil.density, soil.poisson_ratio, scene.radius, inertia
    )
    share = 1.5 * product * (-1.0 if scene.generator.random() < 0.5 else 1.0)
    return undisturbed(scene).through(
        lambda s: tilt(s, share, frequency, damping),
        share=share,
        frequency_hz=frequency,
        damping=damping,
    )


def creep(signals: Signals, gains: Sequence[float], times: Sequence[float]) -> Signals:
    r"""Add :math:`g x` to the displacement w of every sensor, with :math:`\tau \dot x = w - x`.

    Parameters
    ----------
    gains : g of each sensor, -
    times : tau of each sensor, s; stepped by the trapezoidal rule
    """
    velocity = signals.velocity.copy()
    for row, (gain, time) in enumerate(zip(gains, times, strict=True)):
        ratio = signals.time_step / (2 * time)
        numerator, denominator = [ratio, ratio], [1 + ratio, ratio - 1]
        velocity[row] += gain * lfilter(numerator, denominator, signals.velocity[row])
    return signals.with_velocity(velocity)


def sensor_creep(scene: Scene, gain: float) -> SimulatedPoint:
    """Build a point whose sensors drift one by one: gains up to `gain`, times of 20 to 100 ms."""
    gains: list[float] = (gain * scene.device.uniform(-1.0, 1.0, scene.sensors)).tolist()
    slowest = scene.device.uniform(math.log(0.02), math.log(0.1), scene.sensors)
    times: list[float] = np.exp(slowest).tolist()
    return undisturbed(scene).through(lambda s: creep(s, gains, times), gains=gains, times_s=times)


def load_cell_ringing(signals: Signals, frequency: float, damping: float) -> Signals:
    """Return the force in the spring of a load cell that carries a mass (Hz, of critical)."""
    return replace(signals, load=mode(signals.load, frequency, damping, signals.time_step)[0])


def ringing_load_cell(scene: Scene, frequency: float) -> SimulatedPoint:
    """Build a point whose load cell rings at `frequency` (Hz) with 1 to 5 % of critical damping."""
    damping = float(scene.device.uniform(0.01, 0.05))
    return undisturbed(scene).through(
        lambda s: load_cell_ringing(s, frequency, damping), frequency_hz=frequency, damping=damping
    )


def rod_ringing(
    signals: Signals, share: float, frequency: float, damping: float, on_load: bool
) -> Signals:
    """Add the speed of a rod that the load sets ringing, to the load cell or to all sensors.

    `share`: largest disturbance over the peak of the load, or of the centre's velocity.
    """
    speed = mode(signals.load, frequency, damping, signals.time_step)[1]
    shape = speed / np.max(np.abs(speed))
    if on_load:
        return replace(signals, load=signals.load + share * signals.peak_load * shape)
    return signals.with_velocity(signals.velocity + share * signals.peak_velocity * shape)


def ringing_guide_rod(scene: Scene, share: float) -> SimulatedPoint:
    """Build a point whose guide rod rings at 25 to 120 Hz and drags at load cell or carrier."""
    frequency = float(np.exp(scene.device.uniform(math.log(25.0), math.log(120.0))))
    damping = float(scene.device.uniform(0.02, 0.08))
    on_load = bool(scene.device.random() < 0.5)
    return undisturbed(scene).through(
        lambda s: rod_ringing(s, share, frequency, damping, on_load),
        share=share,
        frequency_hz=frequency,
        damping=damping,
        on_load=float(on_load),
    )


def coil_travel(
    velocity: Array, frequency: float, damping: float, time_step: float, stop: float = math.inf
) -> tuple[Array, Array]:
    """Return travel (m) of a geophone's coil against its case, and the equalised reading (m/s).

    The coil stays at the stop (m) until it is driven back. The instrument integrates the coil's
    relative speed by the same steps, so that without a stop it reads the velocity of the case.
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
    """Build a point with a stop at `share` of the centre coil's travel in the largest drop."""
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
    """Move values out of gaps of `share` times `level` around multiples of a quarter of `level`.

    The converter's range is twice `level` to either side; zero has no gap.
    """
    code = np.round(4 * values / level)
    beyond = values - code * level / 4
    edge = np.where(beyond < 0, -1.0, 1.0) * share * level / 2
    inside = (np.abs(beyond) < share * level / 2) & (code != 0)
    return np.where(inside, code * level / 4 + edge, values)


def missing_codes(scene: Scene, share: float) -> SimulatedPoint:
    """Build a point whose converter lacks codes; `share`: width of a gap over the peak."""
    clean = undisturbed(scene)
    load = max(s.peak_load for s in clean.signals)
    speed = max(s.peak_velocity for s in clean.signals)

    def converted(signals: Signals) -> Signals:
        changed = replace(signals, load=without_codes(signals.load, load, share))
        return changed.with_velocity(without_codes(signals.velocity, speed, share))

    return clean.through(converted, share=share)


def crosstalk(signals: Signals, share: float, load: float, speed: float) -> Signals:
    """Mix the channels over a common ground wire: each gets `share` of the other, by full scale."""
    changed = replace(signals, load=signals.load + share * load / speed * signals.velocity[0])
    return changed.with_velocity(signals.velocity + share * speed / load * signals.load)


def channel_crosstalk(scene: Scene, share: float) -> SimulatedPoint:
    """Build a point whose load and sensor channels leak into one another, in either sign."""
    clean = undisturbed(scene)
    signed = share * (-1.0 if scene.device.random() < 0.5 else 1.0)
    load = max(s.peak_load for s in clean.signals)
    speed = max(s.peak_velocity for s in clean.signals)
    return clean.through(lambda s: crosstalk(s, signed, load, speed), share=signed)
