"""Which parameters of the ground are fitted, and where they may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.forward.model import Grounds
from inversion.forward.surrogate import MIN_DEPTH_RADII

MODULUS, VISCOSITY, DENSITY, DEPTH = "modulus", "viscosity", "density", "bedrock_depth"

# Bounds.  The modulus lies within a factor of the peak-method value (which inertia, viscosity and
# rock bend by less), the density within that of soils and granular fills, the viscosity below
# what would leave no deflection within a pulse, and rock below 60 plate radii sends no echo.
_MODULUS_FACTORS = (0.12, 6.0)
_DENSITY_BOUNDS = (1000.0, 2800.0)
_LEAST_VISCOSITY_BOUND = 4.0e5
_RELAXATION_BOUND_S = 0.012
_DEEPEST = 60.0

# What nature gives, centre and standard deviation: density of soils and granular fills from loose
# and dry to dense and wet (the logarithm, kg/m3), and viscosity over modulus, s.
DENSITY_PRIOR = (math.log(1900.0), 0.12)
RELAXATION_PRIOR = (1.0e-3, 1.5e-3)
# Standard deviation of one over the depth of rock, 1/m: what is called a subgrade has rarely rock
# within a few decimetres, and often none within reach.
INVERSE_DEPTH_PRIOR = 1.25

# A fitted value this close to a bound, as a fraction of the range, is on it.
_ON_BOUND = 1e-3


@dataclass(frozen=True)
class Parameter:
    """One number that is fitted between bounds: of the ground or of an effect.

    Parameters
    ----------
    name : str, as in the result's keys (modulus, mass, natural_frequency, ...)
    unit : str, SI; "-": none
    lower, upper : float, bounds
    starts : tuple of float, where a fit begins; of an effect: so large that it shows
    logarithmic : bool, whether the unit interval is linear in its logarithm
    natural : bool, whether its bounds are those of nature, where a value may well sit
    prior : (float, float) or None, what nature gives: centre and standard deviation, of the natural
        logarithm where it is logarithmic
    inverse_prior : float or None, standard deviation of what nature gives for one over the value,
        around 0; in place of ``prior``
    absent : float or None, value at which the effect that it belongs to changes nothing, or nearly
    """

    name: str
    unit: str
    lower: float
    upper: float
    starts: tuple[float, ...] = ()
    logarithmic: bool = False
    natural: bool = False
    prior: tuple[float, float] | None = None
    absent: float | None = None
    inverse_prior: float | None = None

    def value(self, unit_value: FloatArray | float) -> FloatArray:
        """Physical value of points (...,) of the unit interval."""
        if self.logarithmic:
            return np.asarray(self.lower * (self.upper / self.lower) ** unit_value)
        return np.asarray(self.lower + (self.upper - self.lower) * unit_value)

    def unit_value(self, value: float) -> float:
        """The inverse of `value`, clipped to the unit interval."""
        if self.logarithmic:
            unit_value = np.log(value / self.lower) / np.log(self.upper / self.lower)
        else:
            unit_value = (value - self.lower) / (self.upper - self.lower)
        return float(np.clip(unit_value, 0.0, 1.0))

    def slopes(self, unit_value: FloatArray | float) -> FloatArray:
        """Derivatives (...,) of the physical value with respect to the unit value."""
        if self.logarithmic:
            return np.asarray(self.value(unit_value) * math.log(self.upper / self.lower))
        return np.full(np.shape(unit_value), self.upper - self.lower)

    def from_prior(self, unit_value: float) -> tuple[float, float]:
        """Distance from the prior's centre in its standard deviations, and its slope."""
        if self.inverse_prior is not None:
            value, slope = float(self.value(unit_value)), float(self.slopes(unit_value))
            away = 1.0 / (value * self.inverse_prior)
            return away, -away * slope / value
        if self.prior is None:
            return 0.0, 0.0
        centre, deviation = self.prior
        low, high = self.lower, self.upper
        if self.logarithmic:
            low, high = math.log(low), math.log(high)
        return (low + (high - low) * unit_value - centre) / deviation, (high - low) / deviation


def on_bound(
    unit_values: FloatArray, low: FloatArray | float = 0.0, high: FloatArray | float = 1.0
) -> NDArray[np.bool_]:
    """Which unit values (...,) sit on a bound; of the unit interval, if no others are given."""
    return np.asarray((unit_values < low + _ON_BOUND) | (unit_values > high - _ON_BOUND))


def soil_parameters(peak_modulus: float) -> tuple[Parameter, Parameter, Parameter]:
    """Modulus, viscosity and density as they are searched around a peak-method modulus, Pa."""
    low, high = (factor * peak_modulus for factor in _MODULUS_FACTORS)
    most_viscous = max(_LEAST_VISCOSITY_BOUND, _RELAXATION_BOUND_S * peak_modulus)
    return (
        Parameter(MODULUS, "Pa", low, high, logarithmic=True),
        Parameter(
            VISCOSITY,
            "Pa s",
            0.0,
            most_viscous,
            prior=(peak_modulus * RELAXATION_PRIOR[0], peak_modulus * RELAXATION_PRIOR[1]),
        ),
        Parameter(
            DENSITY,
            "kg/m3",
            *_DENSITY_BOUNDS,
            starts=(1800.0,),
            logarithmic=True,
            prior=DENSITY_PRIOR,
        ),
    )


def depth_parameter(plate_radius: float) -> Parameter:
    """The depth of rock, within what the tables cover and an echo reaches."""
    shallow, deep = MIN_DEPTH_RADII * 1.001 * plate_radius, _DEEPEST * plate_radius
    return Parameter(DEPTH, "m", shallow, deep, logarithmic=True, inverse_prior=INVERSE_DEPTH_PRIOR)


@dataclass(frozen=True)
class ParameterSpace:
    """Fitted parameters and the fixed values of the others.

    Parameters
    ----------
    fitted : tuple of Parameter
    fixed : dict of the remaining names to SI values; bedrock_depth inf: half-space
    """

    fitted: tuple[Parameter, ...]
    fixed: dict[str, float]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted parameters, in the order of the unit box."""
        return tuple(p.name for p in self.fitted)

    def index(self, name: str) -> int | None:
        """Column of a fitted parameter, or None."""
        return self.names.index(name) if name in self.names else None

    def values(self, name: str, points: FloatArray) -> FloatArray:
        """Physical values (m,) of one parameter at points (m, d) of the unit box."""
        column = self.index(name)
        if column is None:
            return np.full(points.shape[0], self.fixed[name])
        return self.fitted[column].value(points[:, column])

    def grounds(self, points: FloatArray) -> Grounds:
        """Grounds of points (m, d) of the unit box."""
        depth = self.values(DEPTH, points)
        return Grounds(
            self.values(MODULUS, points),
            self.values(VISCOSITY, points),
            self.values(DENSITY, points),
            1.0 / depth,
        )

    def from_priors(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (m, d) of points from their priors, in deviations, and slopes (m, d)."""
        pairs = [
            [p.from_prior(float(unit_value)) for unit_value in column]
            for p, column in zip(self.fitted, points.T, strict=True)
        ]
        found = np.array(pairs, dtype=np.float64).reshape(len(self.fitted), points.shape[0], 2)
        return found[:, :, 0].T, found[:, :, 1].T

    def ground_slopes(
        self, points: FloatArray, columns: NDArray[np.intp]
    ) -> tuple[tuple[str, ...], FloatArray]:
        """Fields of the grounds that columns of points (m, d) move, and how far, (m, columns)."""
        names = [self.fitted[column].name for column in columns]
        slopes = np.stack([self.fitted[c].slopes(points[:, c]) for c in columns], axis=1)
        if DEPTH in names:
            depth = self.values(DEPTH, points)
            slopes[:, names.index(DEPTH)] /= -(depth**2)
        return tuple("inverse_depth" if name == DEPTH else name for name in names), slopes

    def at_bound(self, point: FloatArray) -> tuple[str, ...]:
        """Names of the parameters that sit on a bound at one point (d,).

        A viscosity of zero is physical (elastic ground), but it is named all the same.
        """
        return tuple(p.name for p, hit in zip(self.fitted, on_bound(point), strict=True) if hit)


def parameter_space(
    peak_modulus: float,
    plate_radius: float,
    density: float | None,
    bedrock_depth: float | None,
    elastic: bool,
) -> ParameterSpace:
    """The space for a drop: E always, eta unless elastic, rho and h0 where they are not given.

    Parameters
    ----------
    peak_modulus : float, Pa, modulus by the peak method, the centre of the search
    bedrock_depth : float, m; inf: half-space; None: fitted
    """
    modulus, viscosity, soil_density = soil_parameters(peak_modulus)
    fitted = [modulus]
    fixed: dict[str, float] = {}
    if elastic:
        fixed[VISCOSITY] = 0.0
    else:
        fitted.append(viscosity)
    if density is None:
        fitted.append(soil_density)
    else:
        fixed[DENSITY] = density
    if bedrock_depth is None:
        fitted.append(depth_parameter(plate_radius))
    elif bedrock_depth > 0.0:
        fixed[DEPTH] = bedrock_depth
    else:
        raise ModelError(f"bedrock depth: expected a value > 0 m or inf, got {bedrock_depth:g}")
    return ParameterSpace(tuple(fitted), fixed)
