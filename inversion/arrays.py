"""Type aliases of numpy arrays, functions of numbers and of arrays, and a bounded memory."""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
IntArray = NDArray[np.intp]
_K = TypeVar("_K")
_V = TypeVar("_V")


def exponential(value: Any) -> Any:
    """Return the exponential of a number, or of each number of an array."""
    return math.exp(value) if isinstance(value, float) else np.exp(value)


def capped(limit: float, value: Any) -> Any:
    """Return a number, or each number of an array, but at most a limit."""
    return min(limit, value) if isinstance(value, float) else np.minimum(limit, value)


def remember(memory: dict[_K, _V], key: _K, value: _V, most: int = 24) -> None:
    """Store a value, and remove the oldest one if there are too many.

    The default number is enough for the responses to the drops of a point, and a few earlier ones.
    """
    if len(memory) >= most:
        memory.pop(next(iter(memory)))
    memory[key] = value
