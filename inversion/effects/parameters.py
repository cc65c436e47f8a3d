"""Parameters of effects with bounds and priors, and coordinates, in which they are fitted.

A coordinate is a parameter itself, or its logarithm. For most effects 0 means absent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from inversion.arrays import FloatArray, exponential

# Prior standard deviation of a parameter without a prior, as a fraction of its range.
_VAGUE_DEVIATION_SHARE = 0.25


@dataclass(frozen=True)
class Parameter:
    """Number that is fitted between bounds: a property of the ground or of an effect.

    Parameters
    ----------
    name : str, as in the result's keys (modulus, mass, natural_frequency, ...)
    unit : str, SI; "-": none
    lower, upper : float, bounds
    starts : tuple of float, starting points of a fit; for an effect large enough to have a visible
        influence
    logarithmic : bool, True: the unit interval is linear in the logarithm
    natural : bool, True: the bounds are physical limits, so that a value on one causes no warning
    prior : (float, float) or None, mean and standard deviation of a normal prior, of the natural
        logarithm for a logarithmic parameter
    absent : float or None, value at which the parameter's effect changes nothing, or almost nothing
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

    def value(self, unit_value: FloatArray | float) -> FloatArray:
        """Return the physical values of points (...,) of the unit interval."""
        if self.logarithmic:
            return np.asarray(self.lower * (self.upper / self.lower) ** unit_value)
        return np.asarray(self.lower + (self.upper - self.lower) * unit_value)


@dataclass(frozen=True)
class Coordinate:
    """One unknown number of the inference, with its prior.

    Parameters
    ----------
    name : str
    mean, deviation : float, of the normal prior
    lower, upper : float, bounds
    starts : tuple of float, starting points of fits
    """

    name: str
    mean: float
    deviation: float
    lower: float = -math.inf
    upper: float = math.inf
    starts: tuple[float, ...] = ()

    def start(self, variant: int) -> float:
        """Return the starting point with index ``variant``, or the last one if there are fewer.

        Without starting points it is the mean of the prior, within the bounds.
        """
        if not self.starts:
            return min(max(self.mean, self.lower), self.upper)
        return self.starts[min(variant, len(self.starts) - 1)]


def coordinate_of(parameter: Parameter) -> Coordinate:
    """Return the coordinate of a parameter, with the parameter's prior.

    If the parameter has a prior and a value at which its effect is absent, fits start at that
    value.
    """

    def scaled(value: float) -> float:
        return math.log(value) if parameter.logarithmic else value

    lower, upper = scaled(parameter.lower), scaled(parameter.upper)
    mean, deviation = parameter.prior or (
        0.5 * (lower + upper),
        _VAGUE_DEVIATION_SHARE * (upper - lower),
    )
    starts = parameter.starts
    if parameter.prior is not None and parameter.absent is not None:
        starts = (parameter.absent,)
    return Coordinate(
        parameter.name, mean, deviation, lower, upper, tuple(scaled(start) for start in starts)
    )


def parameter_value(parameter: Parameter, coordinate: float) -> float:
    """Return the value of a parameter at its coordinate, in the parameter's unit."""
    return exponential(coordinate) if parameter.logarithmic else coordinate
