"""Compliance of a plate on one medium by the converged rule, the reference of the surrogates."""

import math

import numpy as np

from inversion.arrays import ComplexArray
from inversion.forward.contact import PlateProblem
from inversion.forward.layered import (
    LayeredGround,
    LayeredGrounds,
    Medium,
    PlateSetup,
    displacement_per_force,
)


def half_sine_transform(s: ComplexArray, duration: float, start: float = 0.0) -> ComplexArray:
    """Transform of a half-sine of unit peak."""
    pulse = math.pi * duration * (1 + np.exp(-s * duration)) / (s**2 * duration**2 + math.pi**2)
    return np.asarray(pulse * np.exp(-s * start))


def converged_compliance(
    problem: PlateProblem, z: ComplexArray, depth: float = math.inf
) -> ComplexArray:
    """Phi, (n_offsets, k), at points z (k,) off the negative real axis; depth in plate radii."""
    nu = problem.poisson_ratio
    medium = Medium(2.0 * (1.0 + nu), 0.0, 1.0, nu, depth)  # of unit shear modulus
    ground = LayeredGrounds.of([LayeredGround((medium,), math.isfinite(depth))])
    setup, s = PlateSetup(problem.plate, 1.0, problem.offsets), np.sqrt(z)
    result = np.empty((len(problem.offsets), s.size), dtype=complex)
    # Points of one size share their wavenumbers.
    sizes = np.ceil(np.log2(np.abs(s)))
    for size in np.unique(sizes):
        rows = sizes == size
        result[:, rows] = displacement_per_force(setup, ground, s[rows])[0]
    return result
