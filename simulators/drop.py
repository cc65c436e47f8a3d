r"""Simulation of one drop on a plate: hammer and ground are stepped through time together.

Trapezoidal rule: Newmark (1959), J. Eng. Mech. Div. ASCE 85(EM3), 67-94, with beta = 1/4 and
gamma = 1/2; unconditionally stable, second order, no numerical damping. The matrix
:math:`K + (2/h) C + (4/h^2) M` is factorised once. Because the ground is linear, the force F
between hammer and plate enters the new state as :math:`u = u_{free} + F q`, with q the response of
one step to a unit force; the contact condition
:math:`F = \max(0, k (x_{hammer} - u_{plate}))` is then one scalar equation, solved exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from simulators.finite_elements import PLATE_INDEX, FiniteElementModel, factorise
from simulators.mesh import Array, ConstantQ, Plate, Resolution, SoilProfile, design_grid, require

STANDARD_GRAVITY = 9.80665  # m/s2


@dataclass(frozen=True)
class Hammer:
    r"""Falling weight: a mass that hits a spring above the plate. The spring takes no tension.

    The force at a compression s is :math:`k s (1 + d \, \dot s / v_1)`, with the damping d and the
    velocity :math:`v_1` at the first touch; it does not jump at the touch.
    """

    mass: float
    """Mass, kg, > 0."""
    stiffness: float
    """Stiffness of the spring, N/m, > 0."""
    velocity: float
    """Velocity at the first touch, m/s, downward positive."""
    gravity: float = 0.0
    """Acceleration of the hammer after the first touch, m/s2; 0 or `STANDARD_GRAVITY`."""
    damping: float = 0.0
    """Damping of the spring, >= 0, without a unit."""

    def __post_init__(self) -> None:
        require(0 < self.mass < math.inf, "mass", "kg, > 0", self.mass)
        require(0 < self.stiffness < math.inf, "stiffness", "N/m, > 0", self.stiffness)
        require(0 < self.velocity < math.inf, "velocity", "m/s, > 0", self.velocity)

    @property
    def pulse_duration(self) -> float:
        r"""Duration of the half-sine pulse on rigid ground, :math:`\pi \sqrt{m/k}`, s."""
        return math.pi * math.sqrt(self.mass / self.stiffness)


@dataclass(frozen=True)
class PrescribedLoad:
    """Known force above the plate as a function of time, linear between samples, zero outside."""

    time: Array
    """Increasing times (n,), s; 0 is the start of the drop."""
    force: Array
    """Forces (n,), N, downward positive."""

    def __post_init__(self) -> None:
        require(self.time.shape == self.force.shape, "force", "as many as times", self.force.shape)
        require(bool(np.all(np.diff(self.time) > 0)), "time", "increasing values", self.time)
        require(bool(np.max(self.force) > 0), "force", "a positive peak", np.max(self.force))

    @property
    def pulse_duration(self) -> float:
        r"""Duration of the half-sine of equal peak and impulse I, :math:`\pi I/(2 F_{max})`, s."""
        impulse = np.trapezoid(np.maximum(self.force, 0.0), self.time)
        return float(math.pi / 2 * impulse / np.max(self.force))

    def at(self, time: float) -> float:
        """Return the force at a time (s), N."""
        return float(np.interp(time, self.time, self.force, left=0.0, right=0.0))


@dataclass(frozen=True)
class SimulatedDrop:
    """Computed load and motion of one drop, without any error of an instrument."""

    time: Array
    """Times (n,) from the first touch, s."""
    load: Array
    """Force in the load cell above the plate, (n,), N."""
    contact_force: Array
    """Force on the ground, load - plate mass * acceleration, (n,), N."""
    plate_displacement: Array
    """Displacement of the plate, (n,), m, downward positive."""
    plate_velocity: Array
    """Velocity of the plate, (n,), m/s."""
    offsets: Array
    """Distances from the plate centre, (n_offsets,), m."""
    ground_displacement: Array
    """Displacement at the offsets, (n_offsets, n), m; up to the plate radius that of the plate."""
    ground_velocity: Array
    """Velocity at the offsets, (n_offsets, n), m/s."""

    def scaled(self, factor: float) -> SimulatedDrop:
        """Return the drop with all signals multiplied by a factor, as from another height.

        It is exact for a `Hammer` without gravity and damping, because the ground is linear.
        """
        return SimulatedDrop(
            time=self.time,
            load=factor * self.load,
            contact_force=factor * self.contact_force,
            plate_displacement=factor * self.plate_displacement,
            plate_velocity=factor * self.plate_velocity,
            offsets=self.offsets,
            ground_displacement=factor * self.ground_displacement,
            ground_velocity=factor * self.ground_velocity,
        )


class Instant(NamedTuple):
    """State of the finite elements at one time."""

    displacement: Array
    """Displacement of each degree of freedom, (n,), m; the first is the plate."""
    velocity: Array
    """Velocity of each degree of freedom, (n,), m/s."""
    acceleration: Array
    """Acceleration of each degree of freedom, (n,), m/s2."""
    load: float
    """Force above the plate, N."""


class DropSimulator:
    """Finite-element simulator of a plate on the ground, which serves any number of drops.

    Parameters
    ----------
    ground : Ground
    plate : Plate
    offsets : sequence of float, m
        Distances of the observed points from the plate centre.
    duration, time_step : float, s
        Length and sampling step of the record. The internal steps are an integer fraction of it.
    pulse_duration : float, s
        Duration of the load, which determines grid and internal step. A shorter value costs time; a
        longer one makes the result inaccurate.
    resolution : Resolution
    """

    def __init__(
        self,
        ground: SoilProfile,
        plate: Plate,
        offsets: Sequence[float],
        duration: float,
        time_step: float,
        pulse_duration: float,
        resolution: Resolution = Resolution(),  # noqa: B008  (frozen)
    ) -> None:
        require(0 < time_step < duration, "time_step", "s, below the duration", time_step)
        require(pulse_duration > 0, "pulse_duration", "s, > 0", pulse_duration)
        grid = design_grid(ground, plate, offsets, pulse_duration, duration, resolution)
        absorption = resolution.absorption * pulse_duration / math.pi
        self.model = FiniteElementModel(ground, plate, grid, offsets, absorption)
        self.offsets = np.array(offsets, dtype=float)
        self.samples = round(duration / time_step) + 1
        self.substeps = math.ceil(time_step * resolution.steps_per_pulse / pulse_duration - 1e-9)
        self.step = time_step / self.substeps
        model, rate = self.model, 2 / self.step
        self._memory = _Memory(ground.damping_law, self.step) if ground.damping_law else None
        spring = self._memory.stiffness if self._memory else 1.0
        elastic = spring * model.stiffness
        self._solve = factorise(elastic + rate * model.damping + rate**2 * model.inertia)
        self._unit_response = self._solve(model.plate_force())

    def run(self, source: Hammer | PrescribedLoad) -> SimulatedDrop:
        """Return the motion under one drop.

        Parameters
        ----------
        source : Hammer or PrescribedLoad
            Falling weight, or known force above the plate.
        """
        load, contact, displacement, velocity = np.zeros((4, self.samples))
        ground = np.zeros((2, self.offsets.size, self.samples))
        for count, state in enumerate(self.march(source)):
            sample, between = divmod(count, self.substeps)
            if between:
                continue
            load[sample] = state.load
            contact[sample] = state.load - self.model.plate.mass * state.acceleration[PLATE_INDEX]
            displacement[sample] = state.displacement[PLATE_INDEX]
            velocity[sample] = state.velocity[PLATE_INDEX]
            ground[0, :, sample] = self.model.observation @ state.displacement
            ground[1, :, sample] = self.model.observation @ state.velocity
        return SimulatedDrop(
            time=np.arange(self.samples, dtype=float) * self.step * self.substeps,
            load=load,
            contact_force=contact,
            plate_displacement=displacement,
            plate_velocity=velocity,
            offsets=self.offsets,
            ground_displacement=ground[0],
            ground_velocity=ground[1],
        )

    def march(self, source: Hammer | PrescribedLoad) -> Iterator[Instant]:
        """Yield the state of the finite elements at every internal step, from rest on."""
        model, rate = self.model, 2 / self.step
        force = _HammerForce(source, rate) if isinstance(source, Hammer) else source
        u, v, a = np.zeros((3, model.size))
        memory = self._memory
        extensions = np.zeros((memory.shares.size if memory else 0, model.size))
        yield Instant(u, v, a, 0.0)
        for count in range(1, (self.samples - 1) * self.substeps + 1):
            damped, inert = rate * u + v, rate**2 * u + 2 * rate * v + a
            right_side = model.damping @ damped + model.inertia @ inert
            if memory is not None:
                right_side += model.stiffness @ memory.history_displacement(u, v, extensions)
            free = self._solve(right_side)
            if isinstance(force, _HammerForce):
                load = force.advance(free[PLATE_INDEX], self._unit_response[PLATE_INDEX])
            else:
                load = force.at(count * self.step)
            new = free + load * self._unit_response
            if memory is not None:
                extensions = memory.advanced(extensions, new - u)
            a = rate**2 * (new - u) - 2 * rate * v - a
            v = rate * (new - u) - v
            u = new
            yield Instant(u, v, a, load)


class _Memory:
    r"""Maxwell elements of constant-Q soil in one step of the trapezoidal rule.

    The spring of element j is extended by :math:`\dot e_j = \dot u - \omega_j e_j`,
    and the ground resists by :math:`K (c_0 u + \sum c_j e_j + c_\infty \dot u)`. With
    :math:`x_j = h \omega_j / 2` the rule is
    :math:`e_j^{new} = (e_j (1 - x_j) + u^{new} - u)/(1 + x_j)`.
    """

    def __init__(self, law: ConstantQ, step: float) -> None:
        self.spring, rates, self.shares, self.dashpot = law.elements
        self.rate = 2 / step
        half = step * rates / 2
        self.decay, self.gain = (1 - half) / (1 + half), 1 / (1 + half)
        self.stiffness = float(self.spring + self.shares @ self.gain + self.rate * self.dashpot)

    def history_displacement(self, u: Array, v: Array, extensions: Array) -> Array:
        """Return a displacement (m) that represents the past motion in the equation of a step.

        The elastic force of this displacement is the force of the Maxwell elements by their present
        extensions and by the present motion of the ground.
        """
        past = (self.shares * self.decay) @ extensions
        return float(self.shares @ self.gain) * u - past + self.dashpot * (self.rate * u + v)

    def advanced(self, extensions: Array, change: Array) -> Array:
        """Return the extensions of the springs after a change of the displacements, m."""
        return self.decay[:, None] * extensions + np.multiply.outer(self.gain, change)


class _HammerForce:
    """Motion of the hammer, and the force that satisfies the contact condition at each step."""

    def __init__(self, hammer: Hammer, rate: float) -> None:
        self.hammer, self.rate = hammer, rate
        self.x, self.v, self.a = 0.0, hammer.velocity, hammer.gravity
        self.compression, self.closing = 0.0, hammer.velocity

    def advance(self, free_plate: float, plate_response: float) -> float:
        """Advance the hammer by one step and return the force on the plate at its end, N.

        Parameters
        ----------
        free_plate : float, m
            Displacement of the plate at the end of the step without a force.
        plate_response : float, m/N
            Displacement of the plate for a unit force at the end of the step.
        """
        hammer, rate = self.hammer, self.rate
        hammer_response = 1 / (hammer.mass * rate**2)
        free = self.x + 2 * self.v / rate + (self.a + hammer.gravity) / rate**2
        # The speed of the step before keeps the equation linear.
        damped = 1 + hammer.damping * self.closing / hammer.velocity
        stiffness = hammer.stiffness * max(0.0, damped)
        squeeze = stiffness * (free - free_plate)
        force = max(0.0, squeeze / (1 + stiffness * (hammer_response + plate_response)))
        new = free - force * hammer_response
        compression = new - free_plate - force * plate_response
        self.closing = rate / 2 * (compression - self.compression)
        self.compression = compression
        self.a = hammer.gravity - force / hammer.mass
        self.x, self.v = new, rate * (new - self.x) - self.v
        return force


def simulate_drop(
    ground: SoilProfile,
    plate: Plate,
    source: Hammer | PrescribedLoad,
    offsets: Sequence[float] = (),
    duration: float = 0.05,
    time_step: float = 2.5e-4,
    resolution: Resolution = Resolution(),  # noqa: B008  (frozen)
) -> SimulatedDrop:
    """Return the motion of plate and ground under one drop, by axisymmetric finite elements.

    Parameters
    ----------
    ground : Ground
    plate : Plate
    source : Hammer or PrescribedLoad
        Falling weight, or known force above the plate.
    offsets : sequence of float, m
        Distances from the plate centre at which the ground is observed.
    duration, time_step : float, s
        Length and sampling step of the record.
    resolution : Resolution

    Raises
    ------
    GroundError
        If a quantity is outside its range; the message names it and the value.
    """
    simulator = DropSimulator(
        ground, plate, offsets, duration, time_step, source.pulse_duration, resolution
    )
    return simulator.run(source)
