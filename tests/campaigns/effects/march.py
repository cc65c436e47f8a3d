r"""Motion of hammer, plate and finite-element ground, step by step, with nonlinear contact.

The ground is represented by its response to a short triangular pulse of force, the hat
(`GroundResponse`). At each step the displacement w of the ground under the plate is the root of one
scalar equation, which is solved by Newton's method:

.. math::
    m (u - \hat u)/(\beta h^2) = F_{cell}(u) - F, \qquad
    F = (w - w_{past})/k_1 + D(w), \qquad u = w + p(F)

with u the displacement of the plate, :math:`\hat u` Newmark's predictor (beta = 1/4, gamma = 1/2),

:math:`w_{past}` the displacement by earlier forces, :math:`p` a plastic indentation and :math:`D`
the deviation of the soil's resistance from the linear one. The contact carries no tension beyond
the weight W that presses plate and ground together at rest: where the root has :math:`F < -W` the
plate is in flight, :math:`F = -W`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulators.drop import Hammer, SimulatedDrop
from simulators.mesh import Array, require
from tests.campaigns.effects.response import GroundResponse

# Parameters (beta, gamma) of Newmark's rule. The first pair damps the unresolved vibration after
# the plate has hit the ground again; it is of first order.
DISSIPATIVE = (0.3025, 0.6)
TRAPEZOIDAL = (0.25, 0.5)


class SoilLaw(Protocol):
    """Interface of nonlinear soils: deviation of their static resistance from the linear one."""

    def deviation(self, displacement: float) -> tuple[float, float]:
        """Return the force beyond the linear static resistance, N, and its slope, N/m.

        The displacement (m) is that of the ground under the plate.
        """

    def commit(self, displacement: float) -> None:
        """Store the displacement of the ground (m) at the end of a step, for soils with memory."""


class Linear:
    """Linear soil, which has no deviation from the linear resistance."""

    def deviation(self, displacement: float) -> tuple[float, float]:
        """Return no force (0 N) and no slope (0 N/m), because linear soil does not deviate."""
        return 0.0, 0.0

    def commit(self, displacement: float) -> None:
        """Do nothing, because linear soil has no memory."""


@dataclass(frozen=True)
class Indentation:
    """Permanent plastic indentation of the plate, :math:`p = s (F_{max}/F_{ref})^m`."""

    depth: float
    """Indentation s under the reference force, m."""
    force: float
    """Reference force F_ref, N, > 0."""
    exponent: float = 2.0
    """Exponent m, >= 1."""

    def at(self, largest_force: float) -> float:
        """Return the indentation for the largest contact force (N) so far, m."""
        return float(self.depth * (max(largest_force, 0.0) / self.force) ** self.exponent)

    def slope(self, largest_force: float) -> float:
        """Return the derivative of the indentation by the largest contact force (N), m/N."""
        share = max(largest_force, 0.0) / self.force
        return float(self.depth * self.exponent / self.force * share ** (self.exponent - 1))


Pull = Callable[[float], float]
Applied = Callable[[float], tuple[float, float]]


def strike(
    response: GroundResponse,
    plate_mass: float,
    source: Hammer | Array,
    samples: int,
    *,
    law: SoilLaw | None = None,
    indentation: Indentation | None = None,
    weight: float = math.inf,
    pull: Pull | None = None,
) -> SimulatedDrop:
    """Return the motion under one drop on finite-element ground with nonlinear contact.

    Parameters
    ----------
    response : GroundResponse
        Response of the ground to a short triangular pulse of force.
    plate_mass : float, kg
        Mass between the load cell and the ground, > 0.
    source : Hammer or (samples,) ndarray of float, N
        Falling weight, or the force above the plate.
    samples : int
        Length of the record.
    law : SoilLaw, optional
        Nonlinear soil; by default linear.
    indentation : Indentation, optional
        Plastic part of the plate's displacement.
    weight : float, N
        Static force between plate and ground; infinite: they never separate.
    pull : callable, optional
        Function that returns the upward force of the hammer's frame on the load cell (N) at a
        time (s).

    Raises
    ------
    GroundError
        If a quantity is outside its range; the message names it and the value.
    """
    require(0 < plate_mass < math.inf, "plate_mass", "kg, > 0", plate_mass)
    require(2 <= samples <= response.displacement.shape[1], "samples", "2 to response", samples)
    if not isinstance(source, Hammer):
        require(source.shape == (samples,), "source", "one force per sample", source.shape)
    plastic = indentation or Indentation(0.0, 1.0)
    run = _March(response, plate_mass, source, law or Linear(), plastic, weight)
    load, force, linear, plate, speed = np.zeros((5, samples))
    for n in range(1, samples):
        upward = pull(n * response.time_step) if pull else 0.0
        load[n], force[n], linear[n] = run.advance(n, linear, upward)
        plate[n], speed[n] = run.u, run.v
    moved, velocity = response.motion(force)
    moved[0], velocity[0] = plate, speed
    return SimulatedDrop(
        time=np.arange(samples, dtype=float) * response.time_step,
        load=load,
        contact_force=force,
        plate_displacement=plate,
        plate_velocity=speed,
        offsets=np.array(response.offsets),
        ground_displacement=moved,
        ground_velocity=velocity,
    )


class _March:
    """State of hammer and plate, and the solution of one step."""

    def __init__(
        self,
        response: GroundResponse,
        mass: float,
        source: Hammer | Array,
        law: SoilLaw,
        plastic: Indentation,
        weight: float,
    ) -> None:
        self.response, self.mass, self.law = response, mass, law
        self.plastic, self.weight, self.source = plastic, weight, source
        self.h = response.time_step
        self.compliance = float(response.displacement[0, 1])
        self.rule = TRAPEZOIDAL
        self.u = self.v = self.a = self.w = self.largest = 0.0
        hammer = source if isinstance(source, Hammer) else None
        self.x, self.y = 0.0, hammer.velocity if hammer else 0.0
        self.z = hammer.gravity if hammer else 0.0

    def advance(self, n: int, past: Array, upward: float) -> tuple[float, float, float]:
        """Advance to sample n; return load, contact force and its part on the linear ground, N."""
        h, (beta, gamma) = self.h, self.rule
        guess = self.u + h * self.v + (0.5 - beta) * h**2 * self.a
        back = self.response.reversed_centre
        # sum over j = 1 .. n-1 of past[j] k[n-j+1]
        history = float(past[1:n] @ back[back.size - n - 1 : back.size - 2]) if n > 1 else 0.0
        applied, after = self._cell(n, upward)
        inertia = self.mass / (beta * h**2)
        u, load, force, share = self._in_contact(guess, inertia, history, applied)
        if force < -self.weight:  # in flight
            self.rule = DISSIPATIVE
            force = share = -self.weight
            u, load = _in_flight(guess, inertia, force, applied)
            self.w = history + self.compliance * share
        new = (u - guess) / (beta * h**2)
        self.v += h * ((1 - gamma) * self.a + gamma * new)
        self.u, self.a = u, new
        self.largest = max(self.largest, force)
        self.law.commit(self.w)
        after(load)
        return load, force, share

    def _in_contact(
        self, guess: float, inertia: float, history: float, applied: Applied
    ) -> tuple[float, float, float, float]:
        """Return plate displacement (m), load, contact force and its linear part (N).

        The displacement of the ground is updated.
        """
        w = self.w
        for _ in range(50):
            extra, extra_slope = self.law.deviation(w)
            share = (w - history) / self.compliance
            force, slope = share + extra, 1 / self.compliance + extra_slope
            plastic = self.plastic.at(max(self.largest, force))
            yielding = self.plastic.slope(force) * slope if force > self.largest else 0.0
            u = w + plastic
            load, load_slope = applied(u)
            residual = inertia * (u - guess) - load + force
            step = residual / ((inertia - load_slope) * (1 + yielding) + slope)
            if abs(step) <= 1e-14 + 1e-11 * abs(w):
                break
            w -= step
        self.w = w
        return u, load, force, share

    def _cell(self, n: int, upward: float) -> tuple[Applied, Callable[[float], None]]:
        """Return two functions for the step to sample n.

        The first returns the load and its slope for a displacement of the plate. The second
        advances the hammer under a load.
        """
        if not isinstance(self.source, Hammer):
            load_value = float(self.source[n]) - upward
            return (lambda u: (load_value, 0.0)), (lambda load: None)
        hammer, rate = self.source, 2 / self.h
        hammer_response = 1 / (hammer.mass * rate**2)
        free = self.x + 2 * self.y / rate + (self.z + hammer.gravity) / rate**2
        spring = hammer.stiffness / (1 + hammer.stiffness * hammer_response)

        def applied(u: float) -> tuple[float, float]:
            if free <= u:
                return -upward, 0.0
            return spring * (free - u) - upward, -spring

        def after(load: float) -> None:
            force = load + upward
            new = free - force * hammer_response
            self.z = hammer.gravity - force / hammer.mass
            self.x, self.y = new, rate * (new - self.x) - self.y

        return applied, after


def _in_flight(guess: float, inertia: float, force: float, applied: Applied) -> tuple[float, float]:
    """Return the displacement (m) of a plate that has left the ground, and the load on it (N)."""
    u = guess
    for _ in range(3):  # enough, because the load is linear with and without touch of the hammer
        load, slope = applied(u)
        u -= (inertia * (u - guess) - load + force) / (inertia - slope)
    return u, applied(u)[0]
