"""Surface compliances of a single medium against stiffness matrices, and their limits."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpc

from inversion.forward.kernel import (
    Compliance,
    half_space_from_waves,
    layer_from_waves,
    vertical_wavenumbers,
)
from tests.inversion.forward.layered.references import Elastic, surface_compliance


@dataclass(frozen=True)
class Point:
    """One wavenumber and Laplace point; lengths over the plate radius, stresses over G*."""

    xi: float
    z: complex
    poisson_ratio: float
    depth: float = math.inf


def exact(point: Point) -> tuple[complex, complex, complex]:
    """Return ww, wu and uu of the surface by stiffness matrices with enough digits."""
    growth = point.depth * (point.xi + math.sqrt(abs(point.z)))
    is_layer = math.isfinite(point.depth)
    digits = 60 + (math.ceil(2 * growth / math.log(10)) if is_layer else 0)
    medium = Elastic(1.0, 1.0, point.poisson_ratio, point.depth if is_layer else None)
    with mpmath.workdps(digits):
        s = mp.sqrt(mpc(point.z))
        (uu, _), (wu, ww) = surface_compliance([medium], is_layer, point.xi, s, digits)
        return complex(ww), -complex(wu), complex(uu)


def half_space_compliance(
    xi: np.ndarray, z: np.ndarray, poisson_ratio: float, shear: bool = True
) -> Compliance:
    alpha, beta, c = vertical_wavenumbers(xi, z[:, None], poisson_ratio)
    return half_space_from_waves(xi, z[:, None], c, alpha, beta, shear)


def layer_compliance(
    xi: np.ndarray, z: np.ndarray, poisson_ratio: float, depth: float, shear: bool = True
) -> Compliance:
    alpha, beta, _ = vertical_wavenumbers(xi, z[:, None], poisson_ratio)
    return layer_from_waves(xi, z[:, None], alpha, beta, depth, shear)


def computed(point: Point) -> Compliance:
    """Return the compliance that the package computes at a point."""
    xi, z = np.array([point.xi]), np.array([point.z])
    if math.isinf(point.depth):
        return half_space_compliance(xi, z, point.poisson_ratio)
    return layer_compliance(xi, z, point.poisson_ratio, point.depth)


def draw_points(count: int, bounded: bool, seed: int) -> list[Point]:
    """Random points: every direction of z but the negative axis, shallow to deep, slow to fast."""
    rng = random.Random(seed)
    points = []
    for _ in range(count):
        angle = rng.uniform(-0.995, 0.995) * math.pi
        size = 10 ** rng.uniform(-2.5, 3.0)
        points.append(
            Point(
                xi=10 ** rng.uniform(-2.0, 1.7),
                z=complex(size * math.cos(angle), size * math.sin(angle)),
                poisson_ratio=rng.uniform(0.0, 0.49),
                depth=10 ** rng.uniform(0.2, 1.5) if bounded else math.inf,
            )
        )
    return points


def worst_difference(points: list[Point]) -> float:
    """Largest relative difference of any compliance over the points."""
    worst = 0.0
    for point in points:
        right, result = exact(point), computed(point)
        for value, true in zip((result.ww, result.wu, result.uu), right, strict=True):
            # wu passes through zero at some wavenumbers: measure it against ww there.
            size = max(abs(true), 1e-3 * abs(right[0]))
            worst = max(worst, abs(complex(value[0, 0]) - true) / size)
    return worst


@pytest.mark.parametrize(("is_layer", "tolerance"), [(False, 1e-11), (True, 1e-9)])
def test_compliances_agree_with_stiffness_matrices(is_layer: bool, tolerance: float) -> None:
    assert worst_difference(draw_points(60, is_layer, seed=1 + is_layer)) < tolerance


# --- limits --------------------------------------------------------------------------------------

XI = np.geomspace(1e-2, 1e2, 41)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.2, 0.35, 0.49])
def test_half_space_at_rest_is_boussinesq_and_cerruti(poisson_ratio: float) -> None:
    result = half_space_compliance(XI, np.zeros(1, dtype=complex), poisson_ratio)
    assert result.ww[0] == pytest.approx((1 - poisson_ratio) / XI, rel=1e-13)
    assert result.wu[0] == pytest.approx(-(1 - 2 * poisson_ratio) / (2 * XI), rel=1e-12)
    assert result.uu[0] == pytest.approx((1 - poisson_ratio) / XI, rel=1e-13)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.45])
@pytest.mark.parametrize("depth", [1.6, 6.0])
def test_layer_at_rest(poisson_ratio: float, depth: float) -> None:
    # Elastic layer bonded to a rigid base, kappa = 3 - 4 nu, y = xi h:
    # w = (1 - nu)/xi (2 kappa sinh 2y - 4y) / (2 kappa cosh 2y + 1 + kappa^2 + 4 y^2)
    xi = np.array([0.05, 0.2, 0.5, 1.0, 2.0])
    kappa, y = 3 - 4 * poisson_ratio, xi * depth
    closed = (2 * kappa * np.sinh(2 * y) - 4 * y) / (
        2 * kappa * np.cosh(2 * y) + 1 + kappa**2 + 4 * y**2
    )
    z = np.array([1e-4 / depth**2 + 0j])
    result = layer_compliance(xi, z, poisson_ratio, depth, shear=False).ww[0]
    assert result.real == pytest.approx((1 - poisson_ratio) / xi * closed, rel=1e-4)


@pytest.mark.parametrize("depth", [300.0, 1e4, 1e6])
def test_deep_layer_is_the_half_space(depth: float) -> None:
    z = np.array([0.5 + 0.2j, -1 + 0.6j, 3.0 + 0j])
    layer = layer_compliance(XI, z, 0.35, depth)
    half_space = half_space_compliance(XI, z, 0.35)
    for result, right in zip(layer, half_space, strict=True):
        assert result == pytest.approx(right, rel=1e-12)


@given(
    depth=st.floats(0.2, 6).map(lambda x: 10.0**x),
    size=st.floats(-4, 6).map(lambda x: 10.0**x),
    angle=st.floats(-0.99, 0.99),
    poisson_ratio=st.floats(0, 0.49),
)
@settings(max_examples=100, deadline=None)
def test_compliances_are_finite(
    depth: float, size: float, angle: float, poisson_ratio: float
) -> None:
    xi = np.geomspace(1e-3, 1e5, 60)
    z = np.array([size * np.exp(1j * np.pi * angle)])
    for values in layer_compliance(xi, z, poisson_ratio, depth):
        assert np.all(np.isfinite(values))
