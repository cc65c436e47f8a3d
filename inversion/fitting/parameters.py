"""Which parameters of the ground are fitted, and where they may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inversion.errors import ModelError
from inversion.forward.kernel import FloatArray
from inversion.forward.model import Grounds
from inversion.forward.surrogate import SHALLOWEST

MODULUS, VISCOSITY, DENSITY, DEPTH = "modulus", "viscosity", "density", "bedrock_depth"

# Bounds.  The modulus lies within a factor of the peak-method value (which inertia, viscosity and
# rock bend by less), the density within that of soils and granular fills, the viscosity below
# what would leave no deflection within a pulse, and rock below 60 plate radii sends no echo.
_MODULUS_FACTORS = (0.12, 6.0)
_DENSITY_BOUNDS = (1000.0, 2800.0)
_LEAST_VISCOSITY_BOUND = 4.0e5
_RELAXATION_BOUND_S = 0.012
DEEPEST = 60.0

# A fitted value this close to a bound, as a fraction of the range, is on it.
_ON_BOUND = 1e-4


@dataclass(frozen=True)
class Parameter:
    """One fitted parameter.

    Parameters
    ----------
    name : str
    lower, upper : float, SI
    logarithmic : bool, whether the unit box is linear in its logarithm
    """

    name: str
    lower: float
    upper: float
    logarithmic: bool

    def value(self, unit: FloatArray) -> FloatArray:
        """Physical value of a unit_value (...,) in the unit interval."""
        if self.logarithmic:
            return np.asarray(self.lower * (self.upper / self.lower) ** unit)
        return np.asarray(self.lower + (self.upper - self.lower) * unit)

    def unit_value(self, value: float) -> float:
        """Place in the unit interval, clipped, of a physical value."""
        if self.logarithmic:
            unit = np.log(value / self.lower) / np.log(self.upper / self.lower)
        else:
            unit = (value - self.lower) / (self.upper - self.lower)
        return float(np.clip(unit, 0.0, 1.0))

    def slopes(self, unit: FloatArray) -> FloatArray:
        """Derivatives (...,) of the physical value with respect to unit_values (...,)."""
        if self.logarithmic:
            return np.asarray(self.value(unit) * math.log(self.upper / self.lower))
        return np.full(np.shape(unit), self.upper - self.lower)


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
        near = (point < _ON_BOUND) | (point > 1.0 - _ON_BOUND)
        return tuple(p.name for p, hit in zip(self.fitted, near, strict=True) if hit)


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
    fitted = [
        Parameter(
            MODULUS,
            _MODULUS_FACTORS[0] * peak_modulus,
            _MODULUS_FACTORS[1] * peak_modulus,
            logarithmic=True,
        )
    ]
    fixed: dict[str, float] = {}
    if elastic:
        fixed[VISCOSITY] = 0.0
    else:
        upper = max(_LEAST_VISCOSITY_BOUND, _RELAXATION_BOUND_S * peak_modulus)
        fitted.append(Parameter(VISCOSITY, 0.0, upper, logarithmic=False))
    if density is None:
        fitted.append(Parameter(DENSITY, *_DENSITY_BOUNDS, logarithmic=True))
    else:
        fixed[DENSITY] = density
    if bedrock_depth is None:
        shallow, deep = SHALLOWEST * 1.001 * plate_radius, DEEPEST * plate_radius
        fitted.append(Parameter(DEPTH, shallow, deep, logarithmic=True))
    elif bedrock_depth > 0.0:
        fixed[DEPTH] = bedrock_depth
    else:
        raise ModelError(f"bedrock depth: expected a value > 0 m or inf, got {bedrock_depth:g}")
    return ParameterSpace(tuple(fitted), fixed)
