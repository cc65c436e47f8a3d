"""Type aliases of numpy arrays, and functions of numbers and of arrays."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
IntArray = NDArray[np.intp]


def exponential(value: Any) -> Any:
    """Return the exponential of a number, or of each number of an array."""
    return math.exp(value) if isinstance(value, float) else np.exp(value)


def capped(limit: float, value: Any) -> Any:
    """Return a number, or each number of an array, but at most a limit."""
    return min(limit, value) if isinstance(value, float) else np.minimum(limit, value)
