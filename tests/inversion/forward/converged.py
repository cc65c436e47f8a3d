"""Compliance of a plate on one medium by the converged rule, the reference of the surrogates."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from inversion.arrays import ComplexArray, FloatArray
from inversion.forward.contact import PlateProblem
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import (
    LayeredGround,
    LayeredGrounds,
    Medium,
    PlateSetup,
    displacement_per_force,
)
from inversion.forward.model import Grounds, Instrument, transfer_function, transfer_slopes
from inversion.forward.surrogate import PlateResponse


def half_sine_transform(s: ComplexArray, duration: float, start: float = 0.0) -> ComplexArray:
    """Transform of a half-sine of unit peak."""
    pulse = math.pi * duration * (1 + np.exp(-s * duration)) / (s**2 * duration**2 + math.pi**2)
    return np.asarray(pulse * np.exp(-s * start))


def slope_error(
    surrogate: PlateResponse,
    instrument: Instrument,
    s: ComplexArray,
    grounds: Grounds,
    fields: Sequence[str],
    field: str,
) -> float:
    """Largest difference of a slope from central differences, over the largest slope."""
    value, slopes = transfer_slopes(surrogate, instrument, s, grounds, fields)
    assert np.allclose(value, transfer_function(surrogate, instrument, s, grounds), rtol=1e-12)
    base = getattr(grounds, field)
    step = 1e-5 * np.maximum(base, 1e3 if field == "viscosity" else 0.0)
    ahead, back = (
        transfer_function(surrogate, instrument, s, replace(grounds, **{field: base + change}))
        for change in (step, -step)
    )
    expected = (ahead - back) / (2.0 * step[:, None, None])
    difference = slopes[:, fields.index(field)] - expected
    return float(np.abs(difference).max() / np.abs(expected).max())


def motion_before_load(
    transfer: ComplexArray, transform: DampedTransform, time: FloatArray, start: float
) -> float:
    """Largest motion before a half-sine at a start, s, over the largest of all.

    A band of 1600 Hz blurs the start itself over about a millisecond.
    """
    spectrum = transfer * half_sine_transform(transform.s, 0.0133, start)
    moved = (spectrum @ transform.synthesis(time)).real
    return float(np.abs(moved[start - 1.5e-3 > time]).max() / moved.max())


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
