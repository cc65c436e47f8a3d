"""Description of a simulated test point (ground, plate, hammer, drops, sensors), and its drops."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from simulators.drop import Hammer, PrescribedLoad, SimulatedDrop
from simulators.mesh import SoilProfile
from tests.campaigns.effects.march import Indentation, Pull, SoilLaw, strike
from tests.campaigns.effects.response import RESPONSE_DURATION_S, GroundResponse, ground_response
from tests.campaigns.effects.signals import Signals, signals_of


class Laboratory:
    """Store of finite-element responses, which are computed once for all test points.

    Parameters
    ----------
    cache : Path, optional
        Folder in which responses are stored for later runs; None: they are only in this object.
    """

    def __init__(self, cache: Path | None = None) -> None:
        self.cache = cache
        self._responses: dict[tuple[object, ...], GroundResponse] = {}

    def response(
        self, ground: SoilProfile, radius: float, offsets: tuple[float, ...], contact: str = "rough"
    ) -> GroundResponse:
        """Return the response of a ground to a triangular pulse; see `ground_response`."""
        key = (ground, radius, offsets, contact)
        if key not in self._responses:
            self._responses[key] = ground_response(
                ground, radius, offsets, contact=contact, cache=self.cache
            )
        return self._responses[key]


@dataclass(frozen=True)
class Scene:
    """Simulated test point: ground, plate, hammer, sensors and heights of the drops."""

    laboratory: Laboratory
    site: SoilProfile
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
    """Duration of the pulse of hammer and spring on rigid ground, s."""
    pressure: float
    """Peak of the mean pressure under the plate in the largest drop, Pa."""
    heights: tuple[float, ...]
    """Speed of the hammer in each drop, relative to the largest drop."""
    sensors: int
    """Number of recorded offsets."""
    generator: np.random.Generator = field(repr=False)
    """Random numbers of the point."""
    device: np.random.Generator = field(repr=False)
    """Random numbers of the device, the same on every point of a survey."""
    pre_trigger: float = 0.015
    """Time before the pulse, s."""
    time_scale: float = 1.0
    """Factor on all times of the finite-element run; see `GroundResponse.rescaled`."""
    density_scale: float = 1.0
    """Factor on the density of the finite-element run; see `GroundResponse.rescaled`."""

    def response(
        self, site: SoilProfile | None = None, contact: str = "rough", radius: float | None = None
    ) -> GroundResponse:
        """Return the response of the ground to a triangular pulse of force, in SI units.

        Parameters
        ----------
        site : Ground, optional
            Another ground, in the units of the finite-element run.
        contact : "rough" or "smooth"
            Contact of plate and ground.
        radius : float, optional, m
            Another radius of the plate.
        """
        raw = self.laboratory.response(
            site or self.site, radius or self.radius, self.offsets, contact
        )
        return raw.rescaled(self.time_scale, self.density_scale)

    @property
    def ground(self) -> SoilProfile:
        """Simulated ground, after it was rescaled from the units of the finite-element run."""
        return self.response().ground

    @property
    def modulus(self) -> float:
        """True modulus of the ground, Pa, as in `GroundResponse.modulus`.

        For constant-Q soil it is the absolute modulus at the frequency 1/(2 T0), with T0 the
        duration of the half-sine of equal peak and impulse.
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
        """Number of samples of a record."""
        step = self.response().time_step
        available = round(RESPONSE_DURATION_S * self.time_scale / step)
        required = math.ceil((2.5 * self.hammer_pulse + 0.025) / step)
        return min(required, available)

    def hammer(self, velocity: float) -> Hammer:
        """Return the hammer with its spring, at a speed (m/s)."""
        stiffness = self.hammer_mass * (math.pi / self.hammer_pulse) ** 2
        return Hammer(self.hammer_mass, stiffness, velocity)

    def velocity(self, response: GroundResponse, plate_mass: float) -> float:
        """Return the speed of the hammer that gives the intended peak load on linear ground, m/s.

        Parameters
        ----------
        response : GroundResponse
            Response of the ground.
        plate_mass : float, kg
        """
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
    ) -> list[SimulatedDrop]:
        """Return the motion under each drop of the point.

        Parameters
        ----------
        responses : sequence of GroundResponse, optional
            Response of the ground in each drop; by default that of the scene.
        plate_mass : float, optional, kg
            True mass, if it differs from the declared one.
        law : callable, optional
            Function that returns a new nonlinear soil for each drop.
        indentation : callable, optional
            Function that returns the plastic indentation of drop 0, 1 and so on.
        weight : float, N
            Static force between plate and ground; see `strike`.
        pull : callable, optional
            Upward force of the hammer's frame; see `strike`.
        """
        responses = responses or [self.response()] * len(self.heights)
        mass = self.plate_mass if plate_mass is None else plate_mass
        velocity = self.velocity(responses[0], mass)
        return [
            strike(
                responses[n],
                mass,
                self.hammer(velocity * height),
                self.samples,
                law=law() if law else None,
                indentation=indentation(n) if indentation else None,
                weight=weight,
                pull=pull,
            )
            for n, height in enumerate(self.heights)
        ]

    def signals(self, drops: Sequence[SimulatedDrop]) -> list[Signals]:
        """Return the signals of the sensors for each drop, without errors of the instrument."""
        return [signals_of(drop, self.sensors, self.pre_trigger) for drop in drops]


@dataclass(frozen=True)
class SimulatedPoint:
    """Signals of a simulated test point with an effect, and its true values."""

    signals: list[Signals]
    """Signals of each drop."""
    modulus: float | None
    """Modulus that a perfect diagnosis reports, Pa; None if it cannot report a modulus."""
    parameters: Mapping[str, float | list[float]]
    """True values of the effect, SI units in the names; the first is its `value`."""
    declared_depth: float | None = None
    """Wrong depth in the header, m; None: the true depth."""

    def through(
        self, operator: Callable[[Signals], Signals], **parameters: float | list[float]
    ) -> SimulatedPoint:
        """Return the point with changed signals.

        Parameters
        ----------
        operator : callable
            Function that changes the signals of a drop.
        **parameters : float or list of float
            True values of the effect, with SI units in their names.
        """
        changed = [operator(signals) for signals in self.signals]
        return replace(self, signals=changed, parameters={**self.parameters, **parameters})


def undisturbed(scene: Scene) -> SimulatedPoint:
    """Return the test point of a scene without any effect."""
    return SimulatedPoint(scene.signals(scene.strike_all()), scene.modulus, {})


def altered(
    scene: Scene, operator: Callable[..., Signals], **values: float | list[float]
) -> SimulatedPoint:
    """Return the test point with signals changed by an operator.

    Parameters
    ----------
    scene : Scene
    operator : callable
        Function of the signals and the values, in this order.
    **values : float or list of float
        True values of the effect, with SI units in their names.
    """
    return undisturbed(scene).through(lambda s: operator(s, *values.values()), **values)
