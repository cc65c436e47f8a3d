"""Objectives for tests of the search and its operators."""

from collections.abc import Callable

import numpy as np
from hypothesis import strategies as st

from inversion.arrays import FloatArray

Objective = Callable[[FloatArray], FloatArray]

seeds = st.integers(0, 2**32 - 1)


def sphere(points: FloatArray) -> FloatArray:
    return (points**2).sum(axis=1)


def rastrigin_at(place: FloatArray) -> Objective:
    def objective(points: FloatArray) -> FloatArray:
        z = points - place
        return 10.0 * place.size + (z**2 - 10.0 * np.cos(2.0 * np.pi * z)).sum(axis=1)

    return objective


def ackley_at(place: FloatArray) -> Objective:
    def objective(points: FloatArray) -> FloatArray:
        z = points - place
        cone = -20.0 * np.exp(-0.2 * np.sqrt((z**2).mean(axis=1)))
        return cone - np.exp(np.cos(2.0 * np.pi * z).mean(axis=1)) + 20.0 + np.e

    return objective
