"""Surface compliances against the equations of motion solved in many digits, and their limits."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpc, mpf

from inversion.forward.kernel import (
    Compliance,
    half_space_from_waves,
    layer_from_waves,
    vertical_wavenumbers,
)

# --- an independent derivation -------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """One wavenumber and Laplace point; lengths over the plate radius, stresses over G*."""

    xi: float
    z: complex
    poisson_ratio: float
    depth: float = math.inf


def equations_of_motion(point: Point) -> mp.matrix:
    """Matrix M of d/dz (u, w, tau, sigma) = M (u, w, tau, sigma) in the Hankel-Laplace domain.

    From sigma = (lambda + 2) w' + lambda xi u, tau = u' - xi w (Hooke, order 1 for u and tau,
    order 0 for w and sigma) and tau' = z u + (lambda + 2) xi^2 u + lambda xi w',
    sigma' = z w - xi tau (momentum). No potentials, no roots.
    """
    xi, z, nu = mpf(point.xi), mpc(point.z), mpf(point.poisson_ratio)
    lame = 2 * nu / (1 - 2 * nu)
    stiff = lame + 2
    return mp.matrix(
        [
            [0, xi, 1, 0],
            [-lame * xi / stiff, 0, 0, 1 / stiff],
            [z + (stiff - lame**2 / stiff) * xi**2, 0, 0, lame * xi / stiff],
            [0, z, -xi, 0],
        ]
    )


def exact(point: Point) -> mp.matrix:
    """(u, w) at the surface per (shear q, pressure p): [[uu, uw], [wu, ww]].

    A pressure p down is sigma = -p, a shear q outward is tau = -q. Layer: the state at the base
    is exp(M h) times that at the surface, and its u and w vanish. Half-space: the state at the
    surface holds the two decaying eigenvectors alone.
    """
    with mpmath.workdps(60):
        matrix = equations_of_motion(point)
        if math.isinf(point.depth):
            rates, vectors = mp.eig(matrix)
            decaying = [i for i in range(4) if rates[i].real < 0]
            assert len(decaying) == 2
            motion = mp.matrix([[vectors[row, i] for i in decaying] for row in (0, 1)])
            stress = mp.matrix([[vectors[row, i] for i in decaying] for row in (2, 3)])
            return -motion * stress**-1
        growth = point.depth * (point.xi + math.sqrt(abs(point.z)))
        with mpmath.workdps(60 + math.ceil(2 * growth / math.log(10))):
            state = mp.expm(matrix * mpf(point.depth))
            return state[0:2, 0:2] ** -1 * state[0:2, 2:4]


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
    """What the package says at one point."""
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
        right, found = exact(point), computed(point)
        assert found.wu is not None
        assert found.uu is not None
        for value, row, column in ((found.ww, 1, 1), (found.wu, 1, 0), (found.uu, 0, 0)):
            true = complex(right[row, column])
            # wu passes through zero at some wavenumbers: measure it against ww there.
            size = max(abs(true), 1e-3 * abs(complex(right[1, 1])))
            worst = max(worst, abs(complex(value[0, 0]) - true) / size)
    return worst


def test_half_space_solves_the_equations_of_motion() -> None:
    assert worst_difference(draw_points(60, bounded=False, seed=1)) < 1e-11


def test_layer_solves_the_equations_of_motion() -> None:
    assert worst_difference(draw_points(60, bounded=True, seed=2)) < 1e-9


# --- limits --------------------------------------------------------------------------------------

XI = np.geomspace(1e-2, 1e2, 41)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.2, 0.35, 0.49])
def test_half_space_at_rest_is_boussinesq_and_cerruti(poisson_ratio: float) -> None:
    found = half_space_compliance(XI, np.zeros(1, dtype=complex), poisson_ratio)
    assert found.wu is not None
    assert found.uu is not None
    assert found.ww[0] == pytest.approx((1 - poisson_ratio) / XI, rel=1e-13)
    assert found.wu[0] == pytest.approx(-(1 - 2 * poisson_ratio) / (2 * XI), rel=1e-12)
    assert found.uu[0] == pytest.approx((1 - poisson_ratio) / XI, rel=1e-13)


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
    for place, value in zip(xi, (1 - poisson_ratio) / xi * closed, strict=True):
        right = exact(Point(float(place), 0j, poisson_ratio, depth))[1, 1]
        assert complex(right) == pytest.approx(value, rel=1e-12)
    z = np.array([1e-4 / depth**2 + 0j])
    found = layer_compliance(xi, z, poisson_ratio, depth, shear=False).ww[0]
    assert found.real == pytest.approx((1 - poisson_ratio) / xi * closed, rel=1e-4)


@pytest.mark.parametrize("depth", [300.0, 1e4, 1e6])
def test_deep_layer_is_the_half_space(depth: float) -> None:
    z = np.array([0.5 + 0.2j, -1 + 0.6j, 3.0 + 0j])
    layer = layer_compliance(XI, z, 0.35, depth)
    half_space = half_space_compliance(XI, z, 0.35)
    for found, right in zip(layer, half_space, strict=True):
        assert found == pytest.approx(right, rel=1e-12)


@given(
    depth=st.floats(0.2, 6).map(lambda x: 10.0**x),
    size=st.floats(-4, 6).map(lambda x: 10.0**x),
    angle=st.floats(-0.99, 0.99),
    poisson_ratio=st.floats(0, 0.49),
)
@settings(max_examples=100, deadline=None)
def test_nothing_overflows(depth: float, size: float, angle: float, poisson_ratio: float) -> None:
    xi = np.geomspace(1e-3, 1e5, 60)
    z = np.array([size * np.exp(1j * np.pi * angle)])
    for values in layer_compliance(xi, z, poisson_ratio, depth):
        assert values is not None
        assert np.all(np.isfinite(values))


def test_without_shear_the_pressure_part_is_the_same() -> None:
    z, depth = np.array([0.5 + 0.2j, -1 + 0.6j]), 3.0
    smooth = layer_compliance(XI, z, 0.35, depth, shear=False)
    assert smooth.wu is None
    assert smooth.uu is None
    assert np.array_equal(smooth.ww, layer_compliance(XI, z, 0.35, depth).ww)
    assert half_space_compliance(XI, z, 0.35, shear=False).uu is None
