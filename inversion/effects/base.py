"""Base class of effects: physical or instrumental causes that the base model does not contain.

The base model is a homogeneous ground under a plate. The model of a record has five stages, and an
effect changes one of them::

    ground               parameters of the ground and the mass on it
    compliance           displacement over load in the Laplace domain
    nonlinear_stiffness  law of the static resistance
    motion               motion of plate and ground in time
    record               output of sensor and processing

A new effect is one class in a module of its own, and one entry in the catalogue. The class declares
its unknowns with their priors, and the effects that it excludes. A coordinate is the form in which
an unknown is fitted, such as the logarithm of a parameter.
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
from inversion.effects.parameters import Coordinate, Parameter, coordinate_of, parameter_value
from inversion.errors import ModelError
from inversion.forward.layered import LayeredGround, Medium
from inversion.forward.nonlinear_stiffness import NonlinearStiffness
from pfwd_plugins.quantities import Measurand

Scope = Literal["drop", "point", "device"]
Values = Mapping[str, float]
ValueArrays = Mapping[str, FloatArray]
"""Values (m,) of each parameter, for m predictions that are computed together."""
ImpulseResponse = Callable[[], FloatArray]
"""Function without arguments that returns the motion after an impulse of 1 N s on the plate at time
0: (n_sensors, n), m; for m grounds (m, n_sensors, n)."""


@dataclass(frozen=True, eq=False)
class DropContext:
    """Properties of a drop on which an effect may depend.

    Parameters
    ----------
    time : (n,) ndarray of float, s, uniform, of the model's samples
    offsets : (n_sensors,) ndarray of float, m, >= 0: distances from the plate centre
    load : (n,) ndarray of float, N
    peak_load : float, N
    largest_load : float, N, peak of the point's largest drop
    plate_radius : float, m
    poisson_ratio : float
    quantities : tuple of Measurand, of each sensor
    contact_end : float, s, end of the load pulse on the axis ``time``
    index : int, of the drop within the point, from 0
    count : int, number of drops of the point
    flat : tuple of float or None, for each sensor the level of a flat top in its velocity, m/s
    flat_load : float or None, N, the level of a flat top in the load
    rest : tuple of float, for each sensor its median before the pulse, m/s or m
    hum : tuple of candidates for mains hum, the most probable first: amplitude of its velocity,
        m/s, frequency, Hz, and phase at time 0, in turns
    harmonics : tuple of the harmonics of hum before the pulse: order, amplitude over that of the
        fundamental, and phase relative to that multiple of the fundamental's phase, rad
    max_hum : float, m/s, largest amplitude of hum that the record before the pulse allows
    plate_mass : float, kg, declared mass of plate and frame
    has_bedrock : bool, True if a rigid base is declared
    swings_back : bool, True if the plate rises above its initial position
    elastic : bool, True if the ground of the base model is elastic
    is_density_declared : bool, True if the ground's density is declared
    unmodelled_load : (n,) ndarray of float or None, N: measured load minus the half-sine that
        drives the model
    """

    time: FloatArray
    offsets: FloatArray
    load: FloatArray
    peak_load: float
    largest_load: float
    plate_radius: float
    poisson_ratio: float
    quantities: tuple[Measurand, ...]
    contact_end: float
    index: int
    count: int
    flat: tuple[float | None, ...] = ()
    flat_load: float | None = None
    rest: tuple[float, ...] = ()
    hum: tuple[tuple[float, float, float], ...] = ()
    harmonics: tuple[tuple[int, float, float], ...] = ()
    max_hum: float = np.inf
    plate_mass: float = 0.0
    has_bedrock: bool = False
    swings_back: bool = False
    elastic: bool = False
    is_density_declared: bool = False
    unmodelled_load: FloatArray | None = None

    @property
    def step(self) -> float:
        """Sampling interval of the model, s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class Ground:
    """Parameters of the ground and of the mass on it, which effects may change.

    Parameters
    ----------
    modulus : Pa, viscosity : Pa s, density : kg/m3, plate_mass : kg
    inverse_depth : 1/m, one over the bedrock depth; 0: no bedrock
    above : tuple of Medium, layers above that ground, from the surface down
    contact_share : float, radius of the contact area over the plate's radius, for homogeneous
        ground
    loss_exponent : float, exponent of constant-Q damping in addition to the viscosity, for ground
        without `above`; see :class:`inversion.forward.model.Grounds`
    growth_exponent : float, exponent of the growth of the modulus with depth, for ground without
        rock and `above`; the modulus is then the effective one of
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
        if growing and (self.above or self.inverse_depth > 0.0):
            raise ModelError(
                f"ground: expected no layers or rock where the modulus grows with depth, got {self}"
            )
        if self.above and self.loss_exponent > 0.0:
            raise ModelError(f"ground: expected no layers with constant-Q damping, got {self}")

    def layered(self, poisson_ratio: float) -> LayeredGround:
        """Return the media from the surface down."""
        rock = self.inverse_depth > 0.0
        above = sum(medium.thickness for medium in self.above)
        thickness = 1.0 / self.inverse_depth - above if rock else math.inf
        lowest = Medium(self.modulus, self.viscosity, self.density, poisson_ratio, thickness)
        return LayeredGround((*self.above, lowest), rock)


class Effect:
    """Base class of all effects; by itself it changes nothing.

    ``scope`` is the range in which the values are constant: a drop, a point, or all drops of a
    device.
    """

    name: ClassVar[str]
    scope: ClassVar[Scope]
    parameters: ClassVar[tuple[Parameter, ...]]
    advice: ClassVar[str] = ""
    """Advice to the operator."""
    replaces_ground: ClassVar[bool] = False
    """True if the effect replaces the ground, so that no ground is fitted."""
    is_identical_for_all_sensors: ClassVar[bool] = True
    """True if `record` treats all sensors alike; it is then called with the rows of many
    predictions."""
    excludes: ClassVar[frozenset[str]] = frozenset()
    """Names of effects that are not combined with this one, because together they fit any record.
    It is enough that one of the two effects names the other."""
    drop_deviations: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})
    """Prior standard deviations of single drops from the point, by coordinate: of the first of
    several drops, and of later ones."""

    result_name: ClassVar[str] = ""
    """Name in results; empty: `name`. Two forms of one effect may share a name."""

    def offered(self, drops: tuple[DropContext, ...]) -> bool:
        """Return whether the effect is a candidate for these drops."""
        return True

    def conflicts_with(self, second: Effect) -> bool:
        """Return whether the two effects exclude each other."""
        return second.name in self.excludes or self.name in second.excludes

    def parameters_for(self, drop: DropContext) -> tuple[Parameter, ...]:
        """Return the parameters with bounds for this plate and drop.

        The tuple is empty if the effect cannot occur.
        """
        return self.parameters

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return the unknowns of the inference.

        Their priors are centred on the absence of the effect.
        """
        return tuple(map(coordinate_of, self.parameters_for(drop)))

    def values_at(self, coordinates: Mapping[str, float]) -> dict[str, float]:
        """Return the values of the parameters by name, in SI units, from coordinates by name."""
        return {
            p.name: parameter_value(p, coordinates[p.name])
            for p in self.parameters
            if p.name in coordinates
        }

    def reported_values(self, values: Values, drop: DropContext) -> dict[str, tuple[str, float]]:
        """Return unit and value of each number to report, by name; the first one is the main value.

        Parameters
        ----------
        values : mapping
            Values of the parameters, in SI units.
        drop : DropContext
        """
        return {
            p.name: (p.unit, values[p.name]) for p in self.parameters_for(drop) if p.name in values
        }

    def coordinate_at(self, name: str, value: float) -> float:
        """Return the coordinate of a parameter's value, the inverse of `values_at`."""
        parameter = next(p for p in self.parameters if p.name == name)
        return math.log(value) if parameter.logarithmic else value

    def recorded_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return name, unit and value of numbers read from the record, which are reported first."""
        return ()

    def fixed_values(self, drop: DropContext) -> tuple[tuple[str, str, float], ...]:
        """Return name, unit and value of numbers that are not fitted, which are reported last."""
        return ()

    def is_sound(self, ground: Ground, values: Values, drop: DropContext) -> bool:
        """Return whether fitted values are plausible for this effect.

        Parameters
        ----------
        ground : Ground
            Ground with all effects.
        values : mapping
            Values of the parameters, in SI units.
        drop : DropContext
        """
        return True

    def model_error(self, values: Values) -> float:
        """Return the relative error (95 %) of the modulus due to the effect's simplifications."""
        return 0.0

    def modulus_at(self, stress: float, values: Values, drop: DropContext) -> float:
        """Return the secant modulus at a contact pressure, Pa, over that of the drop's ground."""
        return 1.0

    def ground(self, ground: Ground, values: Values, drop: DropContext) -> Ground:
        """Return the ground with the effect."""
        return ground

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Return displacement over load, (n_sensors, n), m/N, with the effect."""
        return compliance

    def nonlinear_stiffness(
        self, law: NonlinearStiffness, values: Values, drop: DropContext
    ) -> NonlinearStiffness:
        """Return the law of the ground's static resistance with the effect."""
        return law

    def motion(
        self,
        motion: FloatArray,
        values: Values,
        drop: DropContext,
        impulse_response: ImpulseResponse,
    ) -> FloatArray:
        """Return the motion of plate and ground, (n_sensors, n), m, with the effect."""
        return motion

    def motions(
        self,
        motions: FloatArray,
        values: ValueArrays,
        drop: DropContext,
        impulse_responses: ImpulseResponse,
    ) -> FloatArray:
        """Return several motions (m, n_sensors, n), m, with the effect, each with its own values.

        Fits spend most of their time here: override it where `motion` is slow.
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
        """Return the recorded displacement, (n_sensors, n), m, with the effect."""
        return record


def geophone(
    record: FloatArray, natural_frequency: float, damping: float, step: float
) -> FloatArray:
    r"""Return the output of a geophone for displacements (k, n) that start at rest.

    .. math:: \frac{s^2}{s^2 + 2 h \omega s + \omega^2}
              = 1 - \frac{2 h \omega s + \omega^2}{s^2 + 2 h \omega s + \omega^2}

    The second part is a convolution with a damped oscillation, computed by the trapezoidal rule.

    Parameters
    ----------
    record : (k, n) ndarray of float, m
    natural_frequency : float, Hz
    damping : float
        Damping ratio h.
    step : float, s
        Sampling interval.
    """
    omega = 2 * np.pi * natural_frequency
    root = omega * np.sqrt(complex(damping**2 - 1.0) + 1e-12)
    first, second = -damping * omega + root, -damping * omega - root
    # Residues of (2 h omega s + omega^2) / ((s - first)(s - second)).
    top = 2 * damping * omega * np.array([first, second]) + omega**2
    residues = top / np.array([first - second, second - first])
    # The oscillation is a sum of two exponentials, so the convolution is a recursion.
    turns = np.exp(step * np.array([first, second]))
    top = np.array([residues.sum(), -(residues @ turns[::-1])]).real
    bottom = np.array([1.0, -turns.sum().real, turns.prod().real])
    # In the trapezoidal rule both ends have half the weight.
    halved = record.copy()
    halved[:, 0] *= 0.5
    driven = top[0] * halved
    driven[:, 1:] += top[1] * halved[:, :-1]
    # A recursion is a banded system. A filter of scipy.signal would take 0.3 s to import.
    bands = np.broadcast_to(bottom[:, None], (3, record.shape[1]))
    moved, _ = dtbtrs(bands, driven.T, uplo="L", overwrite_b=True)
    oscillation = moved.T - 0.5 * top[0] * record
    result: FloatArray = record - step * oscillation
    return result


def forced_motion(impulse_motion: FloatArray, force: FloatArray, step: float) -> FloatArray:
    """Return the motion (k, n), m, under a force (n,), N.

    Parameters
    ----------
    impulse_motion : (k, n) ndarray of float, m
        Motion after an impulse of 1 N s.
    force : (n,) ndarray of float, N
    step : float, s
        Sampling interval.
    """
    if not force.any():
        return np.zeros_like(impulse_motion)
    return np.stack([step * np.convolve(row, force)[: force.size] for row in impulse_motion])


def pad_with_decay(record: FloatArray, size: int) -> FloatArray:
    """Return records (k, n) extended to (k, size) with a linear decay, to avoid a step."""
    count = size - record.shape[1]
    fading = record[:, -1:] * np.linspace(1.0, 0.0, count)
    return np.concatenate([record, fading], axis=1)


def shift(record: FloatArray, delay: float, time: FloatArray) -> FloatArray:
    """Return records (k, n) delayed by ``delay``, s.

    A negative delay advances them. The ends stay constant.
    """
    return np.stack([np.interp(time - delay, time, row) for row in record])
