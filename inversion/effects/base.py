"""What an effect is: something real in a record that the base model does not contain.

The model of a record goes through five stages, and an effect changes one of them::

    ground               parameters of the ground and the mass on it
    compliance           displacement over load in the Laplace domain
    nonlinear_stiffness  static resistance that is no straight line
    motion               what plate and ground do in time
    record               what sensor and processing make of it

A new effect is one module with one class and one entry in the catalogue. The class says what the
inference has to know of it: its unknowns with their priors, and what it is not tried with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

import numpy as np
from scipy.linalg.lapack import dtbtrs

from inversion.arrays import ComplexArray, FloatArray
from inversion.errors import ModelError
from inversion.fitting.coordinates import Coordinate, coordinate_of, parameter_value
from inversion.fitting.layered.first_look import FirstLook
from inversion.fitting.parameters import Parameter
from inversion.forward.layered import Medium
from inversion.forward.nonlinear_stiffness import NonlinearStiffness

Scope = Literal["drop", "point", "device"]
Values = Mapping[str, float]
ManyValues = Mapping[str, FloatArray]
"""Values (m,) of each parameter, for m predictions."""
ImpulseResponse = Callable[[], FloatArray]
"""Motion (n_sensors, n), m, after an impulse of 1 N s on the plate at time 0; or of m grounds,
(m, n_sensors, n)."""


@dataclass(frozen=True, eq=False)
class DropContext:
    """What an effect may know of a drop.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform, of the model's samples
    offsets : (n_sensors,) ndarray of float, m, >= 0: distances from the plate centre
    load : (n,) ndarray of float, N
    peak_load : float, N
    largest_load : float, N, peak of the point's largest drop
    plate_radius : float, m
    poisson_ratio : float
    quantities : tuple of "velocity" or "displacement", of each sensor
    contact_end : float, s, on ``time``
    index : int, of the drop within the point
    count : int, of drops of the point
    flat : tuple of float or None, of each sensor: the level of a flat top in its velocity, m/s
    flat_load : float or None, N, the level of a flat top in the load
    rest : tuple of float, of each sensor: its middle before the pulse, m/s or m
    hum : tuple of amplitude, m/s, frequency, Hz, and phase at time 0, turns, of the velocity of hum
        as the time before the pulse may show it, the likeliest first
    harmonics : tuple of the harmonics of hum before the pulse: order, share of the first one, and
        phase against as many turns of it, rad
    most_hum : float, m/s, how large hum may be by the time before the pulse
    plate_mass : float, kg, declared
    has_bedrock : bool, whether a rigid base is declared
    swings_back : bool, whether the plate comes up above where it stood before
    elastic : bool, whether the base model's ground is
    density_given : bool, whether the ground's density is declared
    load_left : (n,) ndarray of float, N: what the load in use leaves of the measured one
    layers : FirstLook or None, the point's drops as layered ground
    """

    time: FloatArray
    offsets: FloatArray
    load: FloatArray
    peak_load: float
    largest_load: float
    plate_radius: float
    poisson_ratio: float
    quantities: tuple[str, ...]
    contact_end: float
    index: int
    count: int
    flat: tuple[float | None, ...] = ()
    flat_load: float | None = None
    rest: tuple[float, ...] = ()
    hum: tuple[tuple[float, float, float], ...] = ()
    harmonics: tuple[tuple[int, float, float], ...] = ()
    most_hum: float = np.inf
    plate_mass: float = 0.0
    has_bedrock: bool = False
    swings_back: bool = False
    elastic: bool = False
    density_given: bool = False
    load_left: FloatArray | None = None
    layers: FirstLook | None = None

    @property
    def step(self) -> float:
        """Sampling interval of the model, s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class Ground:
    """What the ground stage may change.

    Parameters
    ----------
    modulus : Pa, viscosity : Pa s, density : kg/m3, inverse_depth : 1/m, plate_mass : kg
    above : tuple of Medium, from the surface down, on top of that ground
    contact_share : float, of the plate's radius, out to which it touches homogeneous ground
    loss_exponent : float, of constant-Q damping beside the dashpot, in ground without `above`; see
        :class:`inversion.forward.model.Grounds`
    growth_exponent : float, by which the modulus grows with depth, in ground without rock and
        `above`; the modulus then is the effective one of
        :class:`inversion.forward.growth.GrowthSurrogate`. 0: no growth
    inverse_growth_depth : float, 1/m, one over the depth z0 of that growth
    """

    modulus: float
    viscosity: float
    density: float
    inverse_depth: float
    plate_mass: float
    above: tuple[Medium, ...] = ()
    contact_share: float = 1.0
    loss_exponent: float = 0.0
    growth_exponent: float = 0.0
    inverse_growth_depth: float = 0.0

    def __post_init__(self) -> None:
        growing = self.growth_exponent > 0.0
        if (self.above and (growing or self.loss_exponent > 0.0)) or (
            growing and self.inverse_depth > 0.0
        ):
            raise ModelError(
                "ground: expected growth without layers and rock, constant-Q damping without "
                f"layers, got {self}"
            )


class Effect:
    """Base of all effects: changes nothing.

    ``scope`` tells for what one value holds: a drop, a point, or all drops of a device.
    """

    name: ClassVar[str]
    scope: ClassVar[Scope]
    parameters: ClassVar[tuple[Parameter, ...]]
    advice: ClassVar[str] = ""
    """What to do in the field."""
    replaces_ground: ClassVar[bool] = False
    """Whether there is no ground where it is: then none is fitted."""
    rows_alike: ClassVar[bool] = True
    """Whether `record` treats every sensor alike: then it is given the rows of many at once."""
    ground_is_below: ClassVar[bool] = False
    """Whether the ground's modulus is that of what lies below, far from what the plate says."""
    excludes: ClassVar[frozenset[str]] = frozenset()
    """Names of effects that are not tried together with it, because both would explain anything.
    It is enough that one of two names the other."""
    drop_deviations: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})
    """Prior deviations by which single drops differ from the point, by coordinate: of the first of
    several drops, and of later ones."""

    told_as: ClassVar[str] = ""
    """Name in results; empty: its own. Two forms of one effect have one name there."""
    least_gain: ClassVar[float] = 0.0
    """Log evidence by which a model with it must exceed those without, for what it imitates."""

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Whether records like these could show it."""
        return True

    def conflicts_with(self, other: Effect) -> bool:
        """Whether the two are never tried together."""
        return other.name in self.excludes or self.name in other.excludes

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """The parameters with bounds that fit the plate and the drop; none: it has no effect."""
        return self.parameters

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the unknowns of the inference, with priors about the absence of the effect."""
        return tuple(map(coordinate_of, self.parameters_for(drop)))

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the parameters at coordinates by name."""
        return {
            p.name: parameter_value(p, coordinates[p.name])
            for p in self.parameters
            if p.name in coordinates
        }

    def told(self, values: Values, drop: DropContext) -> dict[str, tuple[str, float]]:
        """Return what a result says of the effect: units and values by name, the first its value.

        Parameters
        ----------
        values : of the parameters
        drop : DropContext
        """
        return {
            p.name: (p.unit, values[p.name]) for p in self.parameters_for(drop) if p.name in values
        }

    def coordinate_at(self, name: str, value: float) -> float:
        """Return the unknown of a parameter at its value, the inverse of `values_at`."""
        parameter = next(p for p in self.parameters if p.name == name)
        return math.log(value) if parameter.logarithmic else value

    def known(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Name, unit and value of what the record itself tells of the effect; goes first."""
        return ()

    def held(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Name, unit and value of what is not fitted but belongs to the values; goes last."""
        return ()

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether values describe what the effect is meant to be.

        Parameters
        ----------
        ground : Ground, with all effects
        values : of the parameters
        drop : DropContext
        """
        return True

    def model_error(self, values: Values) -> float:
        """Relative error (95 %) of the modulus that the effect's own simplification may leave."""
        return 0.0

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """Secant modulus at a mean contact pressure, Pa, over that of the ground of the drop."""
        return 1.0

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """The ground with the effect."""
        return ground

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Displacement over load, (n_sensors, n), m/N, with the effect."""
        return compliance

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """The law of the ground's static resistance, with the effect."""
        return law

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """What plate and ground do, (n_sensors, n), m, with the effect."""
        return motion

    def motions(
        self,
        motions: FloatArray,
        values: ManyValues,
        drop: DropContext,
        impulse_responses: ImpulseResponse,
    ) -> FloatArray:
        """`motion` of many at once, (m, n_sensors, n), each with values of its own.

        What a fit spends its time with: to be given where `motion` is slow.
        """
        return np.stack(
            [
                self.motion(
                    motion,
                    {name: float(value[row]) for name, value in values.items()},
                    drop,
                    lambda row=row: impulse_responses()[row],  # type: ignore[misc]
                )
                for row, motion in enumerate(motions)
            ]
        )

    def record(self, record: FloatArray, values: Values, drop: DropContext) -> FloatArray:
        """What is recorded, (n_sensors, n), m, with the effect."""
        return record


def geophone(
    record: FloatArray, natural_frequency: float, damping: float, step: float
) -> FloatArray:
    r"""What a geophone makes of displacements (k, n) that begin at rest.

    .. math:: \frac{s^2}{s^2 + 2 h \omega s + \omega^2}
              = 1 - \frac{2 h \omega s + \omega^2}{s^2 + 2 h \omega s + \omega^2}

    The second part is a convolution with a damped oscillation, by the trapezoidal rule.
    """
    omega = 2 * np.pi * natural_frequency
    root = omega * np.sqrt(complex(damping**2 - 1.0) + 1e-12)
    first, second = -damping * omega + root, -damping * omega - root
    # Residues of (2 h omega s + omega^2) / ((s - first)(s - second)).
    top = 2 * damping * omega * np.array([first, second]) + omega**2
    residues = top / np.array([first - second, second - first])
    # The oscillation is a sum of two exponentials: the convolution goes from sample to sample.
    turns = np.exp(step * np.array([first, second]))
    top = np.array([residues.sum(), -(residues @ turns[::-1])]).real
    bottom = np.array([1.0, -turns.sum().real, turns.prod().real])
    # The rule counts both ends half.
    halved = record.copy()
    halved[:, 0] *= 0.5
    driven = top[0] * halved
    driven[:, 1:] += top[1] * halved[:, :-1]
    # A recursion is a banded system. As a filter of scipy.signal it takes 0.3 s to import.
    bands = np.broadcast_to(bottom[:, None], (3, record.shape[1]))
    moved, _ = dtbtrs(bands, driven.T, uplo="L", overwrite_b=True)
    oscillation = moved.T - 0.5 * top[0] * record
    result: FloatArray = record - step * oscillation
    return result


def forced_motion(impulse_motion: FloatArray, force: FloatArray, step: float) -> FloatArray:
    """Motion (k, n) under a force on the plate (n,), N, given that after an impulse of 1 N s."""
    if not force.any():
        return np.zeros_like(impulse_motion)
    return np.stack([step * np.convolve(row, force)[: force.size] for row in impulse_motion])


def held(record: FloatArray, size: int) -> FloatArray:
    """Records (k, n) that go on at their last value and fade, (k, size): their end is no step."""
    count = size - record.shape[1]
    fading = record[:, -1:] * np.linspace(1.0, 0.0, count)
    return np.concatenate([record, fading], axis=1)


def shift(record: FloatArray, delay: float, time: FloatArray) -> FloatArray:
    """Records (k, n) later by ``delay`` s (earlier when negative); held at the ends."""
    return np.stack([np.interp(time - delay, time, row) for row in record])
