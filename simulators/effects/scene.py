"""One test point before anything happens to it: ground, plate, hammer, drops, sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from simulators.drop import Hammer, PrescribedLoad, SimulatedDrop
from simulators.effects.march import Indentation, Pull, SoilLaw, strike
from simulators.effects.response import DURATION, GroundResponse, ground_response
from simulators.effects.signals import Signals, signals_of
from simulators.mesh import Ground


class Laboratory:
    """Finite-element answers computed once and shared by all scenes.

    Parameters
    ----------
    cache : folder where answers stay between runs; none: only as long as this object lives
    """

    def __init__(self, cache: Path | None = None) -> None:
        self.cache = cache
        self._kept: dict[tuple[object, ...], GroundResponse] = {}

    def response(
        self, ground: Ground, radius: float, offsets: tuple[float, ...], contact: str = "rough"
    ) -> GroundResponse:
        """See `ground_response`."""
        key = (ground, radius, offsets, contact)
        if key not in self._kept:
            self._kept[key] = ground_response(
                ground, radius, offsets, contact=contact, cache=self.cache
            )
        return self._kept[key]


@dataclass(frozen=True)
class Scene:
    """One test point: what is there and what will be done."""

    laboratory: Laboratory
    site: Ground
    """Ground in the units of the finite-element run; see `time_scale`."""
    radius: float
    """Of the plate, m."""
    offsets: tuple[float, ...]
    """Of the sensors, m; the first is 0."""
    plate_mass: float
    """Declared, kg."""
    hammer_mass: float
    """kg."""
    hammer_pulse: float
    """Pulse of hammer and spring on unyielding ground, s."""
    pressure: float
    """Peak of the mean pressure under the plate in the largest drop, Pa."""
    heights: tuple[float, ...]
    """Speed of the hammer in each drop over that in the largest."""
    sensors: int
    """How many of the offsets are recorded."""
    generator: np.random.Generator = field(repr=False)
    """For what belongs to the point."""
    device: np.random.Generator = field(repr=False)
    """For what belongs to the device: starts alike on every point of a survey."""
    pre_trigger: float = 0.015
    """s."""
    time_scale: float = 1.0
    """See `GroundResponse.rescaled`."""
    density_scale: float = 1.0
    """See `GroundResponse.rescaled`."""

    def response(
        self, site: Ground | None = None, contact: str = "rough", radius: float | None = None
    ) -> GroundResponse:
        """Answer of this ground, or of another in the units of the finite-element run."""
        raw = self.laboratory.response(
            site or self.site, radius or self.radius, self.offsets, contact
        )
        return raw.rescaled(self.time_scale, self.density_scale)

    @property
    def ground(self) -> Ground:
        """The ground as it is."""
        return self.response().ground

    @property
    def modulus(self) -> float:
        """See `GroundResponse.modulus`; of constant-Q soil |E*| at the pulse's frequency, Pa.

        That frequency is 1/(2 T0), with T0 of the half-sine of equal peak and impulse.
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
        """Load cell peak that the largest drop aims at, N."""
        return self.pressure * math.pi * self.radius**2

    @property
    def samples(self) -> int:
        """Length of a record in steps of the finite elements."""
        step = self.response().time_step
        whole = round(DURATION * self.time_scale / step)
        wanted = math.ceil((2.5 * self.hammer_pulse + 0.025) / step)
        return min(wanted, whole)

    def hammer(self, velocity: float, gravity: float = 0.0) -> Hammer:
        """The falling mass on its spring."""
        stiffness = self.hammer_mass * (math.pi / self.hammer_pulse) ** 2
        return Hammer(self.hammer_mass, stiffness, velocity, gravity)

    def velocity(self, response: GroundResponse, plate_mass: float) -> float:
        """Speed of the hammer that gives the wanted peak on linear ground, m/s."""
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
        """Every drop of the point.

        Parameters
        ----------
        responses : of the ground, one per drop
        plate_mass : true mass where it is not the declared one, kg
        law : makes the soil of a drop
        indentation : of drop 0, 1, ...
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
        """Channels of the drops as ideal instruments would have them."""
        return [signals_of(drop, self.sensors, self.pre_trigger) for drop in drops]


@dataclass(frozen=True)
class SimulatedPoint:
    """What a point became under an effect."""

    signals: list[Signals]
    """One per drop."""
    modulus: float | None
    """What a perfect reader would report, Pa; none: nothing to report."""
    parameters: Mapping[str, float | list[float]]
    """True values of the effect, SI units in the names; the first is its `value`."""
    declared_depth: float | None = None
    """Depth that the header states although it is wrong; none: the true one."""
    declared_radius: float | None = None
    """The same for the plate."""

    def through(
        self, operator: Callable[[Signals], Signals], **parameters: float | list[float]
    ) -> SimulatedPoint:
        """The same point seen through an operator on the channels."""
        changed = [operator(signals) for signals in self.signals]
        return replace(self, signals=changed, parameters={**self.parameters, **parameters})


def undisturbed(scene: Scene) -> SimulatedPoint:
    """The point without any effect."""
    return SimulatedPoint(scene.signals(scene.strike_all()), scene.modulus, {})
