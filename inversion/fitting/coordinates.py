"""Coordinates: the unknowns of the inference, with normal priors. For most effects 0 means absent.

A coordinate is a parameter itself, or its logarithm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from inversion.fitting.parameters import Parameter

# Prior standard deviation of a parameter without a prior, as a fraction of its range.
_VAGUE_DEVIATION_SHARE = 0.25


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
    return math.exp(coordinate) if parameter.logarithmic else coordinate
