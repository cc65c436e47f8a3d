"""Unknowns of the inference: numbers with normal priors, on scales where absence is zero."""

from __future__ import annotations

import math
from dataclasses import dataclass

from inversion.fitting.parameters import Parameter

# Prior deviation of a parameter without a prior, as a part of its range.
_VAGUE_DEVIATION_SHARE = 0.25


@dataclass(frozen=True)
class Coordinate:
    """One unknown number with its prior.

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
        """Return the starting point of a number; numbers beyond the last return the last."""
        if not self.starts:
            return min(max(self.mean, self.lower), self.upper)
        return self.starts[min(variant, len(self.starts) - 1)]


def coordinate_of(parameter: Parameter) -> Coordinate:
    """Return the coordinate of a parameter: its logarithm or itself, with the parameter's prior.

    A parameter with a prior near the value at which its effect is absent starts there.
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
    """Return the value of a parameter at its coordinate."""
    return math.exp(coordinate) if parameter.logarithmic else coordinate
