"""Test point without an effect: ground, plate, hammer, drops, sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from simulators.drop import Hammer, PrescribedLoad, SimulatedDrop
from simulators.effects.march import Indentation, Pull, SoilLaw, strike
from simulators.effects.response import RESPONSE_DURATION_S, GroundResponse, ground_response
from simulators.effects.signals import Signals, signals_of
from simulators.mesh import Ground


class Laboratory:
    """Finite-element responses, computed once and shared by all scenes.

    Parameters
    ----------
    cache : folder where responses are stored between runs; None: only in this object
    """

    def __init__(self, cache: Path | None = None) -> None:
        self.cache = cache
        self._responses: dict[tuple[object, ...], GroundResponse] = {}

    def response(
        self, ground: Ground, radius: float, offsets: tuple[float, ...], contact: str = "rough"
    ) -> GroundResponse:
        """See `ground_response`."""
        key = (ground, radius, offsets, contact)
        if key not in self._responses:
            self._responses[key] = ground_response(
                ground, radius, offsets, contact=contact, cache=self.cache
            )
        return self._responses[key]


@dataclass(frozen=True)
class Scene:
    """Test point with its ground, device and drops."""

    laboratory: Laboratory
    site: Ground
    """Ground in the units of the finite-element run; see `time_scale`."""
    radius: float
    """Radius of the plate, m."""
    offsets: tuple[float, ...]
    """Distances of the sensors from the plate centre, m; the first is 0."""
    plate_mass: float
    """Declared mass of the plate, kg."""
    hammer_mass: float
    """Mass of the hammer, kg."""
    hammer_pulse: float
    """Pulse of hammer and spring on unyielding ground, s."""
    pressure: float
    """Peak of the mean pressure under the plate in the largest drop, Pa."""
    heights: tuple[float, ...]
    """Speed of the hammer in each drop over that in the largest."""
    sensors: int
    """Number of recorded offsets."""
    generator: np.random.Generator = field(repr=False)
    """Random numbers of the point."""
    device: np.random.Generator = field(repr=False)
    """Random numbers of the device, the same on every point of a survey."""
    pre_trigger: float = 0.015
    """Time before the pulse, s."""
    time_scale: float = 1.0
    """See `GroundResponse.rescaled`."""
    density_scale: float = 1.0
    """See `GroundResponse.rescaled`."""

    def response(
        self, site: Ground | None = None, contact: str = "rough", radius: float | None = None
    ) -> GroundResponse:
        """Return the response of this ground, or of another in the units of the finite elements."""
        raw = self.laboratory.response(
            site or self.site, radius or self.radius, self.offsets, contact
        )
        return raw.rescaled(self.time_scale, self.density_scale)

    @property
    def ground(self) -> Ground:
        """Ground in SI units."""
        return self.response().ground

    @property
    def modulus(self) -> float:
        """Modulus as `GroundResponse.modulus`; for constant-Q soil |E*| at 1/(2 T0), Pa.

        T0 is the duration of the half-sine of equal peak and impulse.
        """
        response = self.response()
        law = response.ground.damping_law
        if law is None:
            return response.modulus
        drop = strike(response, self.plate_mass, self.hammer(1.0), self.samples)
        pulse = PrescribedLoad(drop.time, drop.load).pulse_duration
        return response.modulus * law.stiffening(math.pi / pulse)

    @property
    def peak_force(self) -> float:
        """Intended peak load of the largest drop, N."""
        return self.pressure * math.pi * self.radius**2

    @property
    def samples(self) -> int:
        """Length of a record in time steps of the finite elements."""
        step = self.response().time_step
        available = round(RESPONSE_DURATION_S * self.time_scale / step)
        required = math.ceil((2.5 * self.hammer_pulse + 0.025) / step)
        return min(required, available)

    def hammer(self, velocity: float, gravity: float = 0.0) -> Hammer:
        """Return the hammer with its spring."""
        stiffness = self.hammer_mass * (math.pi / self.hammer_pulse) ** 2
        return Hammer(self.hammer_mass, stiffness, velocity, gravity)

    def velocity(self, response: GroundResponse, plate_mass: float) -> float:
        """Return the speed of the hammer for the intended peak on linear ground, m/s."""
        drop = strike(response, plate_mass, self.hammer(1.0), self.samples)
        return self.peak_force / float(np.max(drop.load))

    def strike_all(
        self,
        responses: Sequence[GroundResponse] | None = None,
        *,
        plate_mass: float | None = None,
        law: Callable[[], SoilLaw] | None = None,
        indentation: Callable[[int], Indentation | None] | None = None,
        weight: float = math.inf,
        pull: Pull | None = None,
        gravity: float = 0.0,
    ) -> list[SimulatedDrop]:
        """Return all drops of the point.

        Parameters
        ----------
        responses : responses of the ground, one per drop
        plate_mass : true mass if it differs from the declared one, kg
        law : returns the soil of a drop
        indentation : returns the indentation of drop 0, 1, ...
        weight, pull, gravity : see `strike`
        """
        responses = responses or [self.response()] * len(self.heights)
        mass = self.plate_mass if plate_mass is None else plate_mass
        velocity = self.velocity(responses[0], mass)
        return [
            strike(
                responses[n],
                mass,
                self.hammer(velocity * height, gravity),
                self.samples,
                law=law() if law else None,
                indentation=indentation(n) if indentation else None,
                weight=weight,
                pull=pull,
            )
            for n, height in enumerate(self.heights)
        ]

    def signals(self, drops: Sequence[SimulatedDrop]) -> list[Signals]:
        """Return the channels of ideal instruments for the drops."""
        return [signals_of(drop, self.sensors, self.pre_trigger) for drop in drops]


@dataclass(frozen=True)
class SimulatedPoint:
    """Test point with an effect."""

    signals: list[Signals]
    """Signals of each drop."""
    modulus: float | None
    """Modulus that a perfect diagnosis reports, Pa; None: it reports none."""
    parameters: Mapping[str, float | list[float]]
    """True values of the effect, SI units in the names; the first is its `value`."""
    declared_depth: float | None = None
    """Wrong depth in the header, m; None: the true depth."""
    declared_radius: float | None = None
    """Wrong plate radius in the header, m; None: the true radius."""

    def through(
        self, operator: Callable[[Signals], Signals], **parameters: float | list[float]
    ) -> SimulatedPoint:
        """Return the point with an operator applied to its channels."""
        changed = [operator(signals) for signals in self.signals]
        return replace(self, signals=changed, parameters={**self.parameters, **parameters})


def undisturbed(scene: Scene) -> SimulatedPoint:
    """Return the point without an effect."""
    return SimulatedPoint(scene.signals(scene.strike_all()), scene.modulus, {})
