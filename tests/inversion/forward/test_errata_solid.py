"""Misprints of docs/errata.md in the solid: Lame's parameters and Eq. 5 to 13.

How they are proven stands in tests/inversion/forward/errata.py.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpc, mpf

from tests.inversion.forward import published_method as published
from tests.inversion.forward.errata import (
    DENSITY,
    PEAK_PRESSURE,
    POISSON_RATIO,
    PULSE_DURATION,
    RADIUS,
)


@pytest.fixture(autouse=True)
def digits() -> Iterator[None]:
    """Work with 50 digits, enough for every cancellation in Eq. 13 at the points drawn here."""
    with mpmath.workdps(50):
        yield


# --- the solid -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Solid:
    """One point (xi, s) and the constants of the transformed solid, in many digits."""

    xi: mpf
    s: mpc
    lame: mpc
    shear: mpc
    density: mpf
    depth: mpf

    @property
    def inertia(self) -> mpc:
        return self.density * self.s**2

    @property
    def stiffness(self) -> mpc:
        return self.lame + 2 * self.shear

    @property
    def m(self) -> tuple[mpc, mpc, mpc, mpc]:
        """m1 to m4 after Eq. 8, corrected."""
        xi, shear, stiffness = self.xi, self.shear, self.stiffness
        return (
            (stiffness * xi**2 + self.inertia) / shear,
            xi * (self.lame + shear) / shear,
            (shear * xi**2 + self.inertia) / stiffness,
            xi * (self.lame + shear) / stiffness,
        )

    @property
    def roots(self) -> tuple[mpc, mpc]:
        """Alpha and delta of Eq. 11, the nested root as printed."""
        m1, m2, m3, m4 = self.m
        total = m3 + m1 - m2 * m4
        inner = mp.sqrt(total**2 - 4 * m1 * m3)
        return mp.sqrt((total + inner) / 2), mp.sqrt((total - inner) / 2)

    @property
    def k(self) -> tuple[mpc, mpc, mpc, mpc, mpc, mpc]:
        """k1 and k2 after Eq. 10; k3 to k6 of Eq. 12."""
        alpha, delta = self.roots
        m1, m2, _, _ = self.m
        k1 = (alpha**2 - m1) / (m2 * alpha)
        k2 = (delta**2 - m1) / (m2 * delta)
        return (
            k1,
            k2,
            self.stiffness * k1 * alpha + self.lame * self.xi,
            self.stiffness * k2 * delta + self.lame * self.xi,
            self.shear * (alpha - self.xi * k1),
            self.shear * (delta - self.xi * k2),
        )


def draw_solids(count: int, seed: int = 20220) -> list[Solid]:
    """Random soils, depths, wavenumbers and Laplace points of the range the method is used in."""
    rng = random.Random(seed)

    def log_uniform(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    solids = []
    for _ in range(count):
        modulus = mpf(log_uniform(10e6, 300e6))
        viscosity = mpf(rng.uniform(0, 150e3))
        nu = mpf(rng.uniform(0.05, 0.48))
        s = mpc(rng.uniform(60, 130), rng.uniform(0, 2500))
        e = modulus + viscosity * s
        solids.append(
            Solid(
                xi=mpf(log_uniform(0.05, 50)),
                s=s,
                lame=nu * e / ((1 + nu) * (1 - 2 * nu)),
                shear=e / (2 * (1 + nu)),
                density=mpf(rng.uniform(1500, 2200)),
                depth=mpf(log_uniform(0.3, 5)),
            )
        )
    return solids


SOLIDS = draw_solids(200)


def relative(value: mpc, reference: mpc) -> float:
    """Relative difference."""
    return float(abs(value - reference) / abs(reference))


# --- after Eq. 7 and 8: Lame's parameters --------------------------------------------------------


def youngs_modulus_and_poisson_ratio(lame: float, shear: float) -> tuple[float, float]:
    """Tension of a bar, sigma_r = sigma_theta = 0 in Eq. 7: solve for the lateral strain."""
    lateral = -lame / (2 * (lame + shear))
    return lame * (1 + 2 * lateral) + 2 * shear, -lateral


def test_lame_parameters_give_back_modulus_and_poisson_ratio() -> None:
    e, nu = 40e6, 0.35
    lame, shear = published.lame_parameters(np.array(e + 0j), nu)
    assert youngs_modulus_and_poisson_ratio(lame.real, shear.real) == pytest.approx((e, nu))
    printed = nu * e / ((1 + nu) * (1 + 2 * nu)), 2 * e / (1 + nu)
    printed_e, printed_nu = youngs_modulus_and_poisson_ratio(*printed)
    assert printed_e == pytest.approx(3.1 * e, rel=0.01)
    assert printed_nu < 0.05


# --- Eq. 5 to 8: the equations of motion ---------------------------------------------------------


def motion_residuals(solid: Solid, u_of_z: Callable, w_of_z: Callable) -> tuple[mpc, mpc]:
    """Eq. 5 with the stresses of Eq. 6 and 7, for u_r = u(z) J1(xi r) and w = w(z) J0(xi r).

    Differentiated numerically in r and z; d2/dt2 is s^2. Each is divided by its Bessel function
    and by the modulus in front of the second derivative, as in Eq. 8.
    """
    r0, z0 = mpf("0.23"), mpf("0.31")
    lame, stiffness, shear, xi = solid.lame, solid.stiffness, solid.shear, solid.xi

    def u(r: mpf, z: mpf) -> mpc:
        return u_of_z(z) * mp.besselj(1, xi * r)

    def w(r: mpf, z: mpf) -> mpc:
        return w_of_z(z) * mp.besselj(0, xi * r)

    def normal(which: int) -> Callable:
        def stress(r: mpf, z: mpf) -> mpc:
            strains = (
                mp.diff(lambda x: u(x, z), r),
                u(r, z) / r,
                mp.diff(lambda x: w(r, x), z),
            )
            return lame * sum(strains) + 2 * shear * strains[which]

        return stress

    def shear_stress(r: mpf, z: mpf) -> mpc:
        return shear * (mp.diff(lambda x: u(r, x), z) + mp.diff(lambda x: w(x, z), r))

    sigma_r, sigma_theta, sigma_z = normal(0), normal(1), normal(2)
    radial = (
        mp.diff(lambda x: sigma_r(x, z0), r0)
        + mp.diff(lambda x: shear_stress(r0, x), z0)
        + (sigma_r(r0, z0) - sigma_theta(r0, z0)) / r0
        - solid.inertia * u(r0, z0)
    )
    vertical = (
        mp.diff(lambda x: sigma_z(r0, x), z0)
        + mp.diff(lambda x: shear_stress(x, z0), r0)
        + shear_stress(r0, z0) / r0
        - solid.inertia * w(r0, z0)
    )
    return (
        radial / (shear * mp.besselj(1, xi * r0)),
        vertical / (stiffness * mp.besselj(0, xi * r0)),
    )


def test_m1_to_m4_follow_from_the_equations_of_motion() -> None:
    solid = SOLIDS[0]
    z0 = mpf("0.31")

    # Any two functions of depth do: they need not be solutions.
    def u(z: mpf) -> mpc:
        return mp.exp(-2 * z) * (1 + z)

    def w(z: mpf) -> mpc:
        return mp.cos(3 * z)

    radial, vertical = motion_residuals(solid, u, w)

    def equation_8(m: tuple[mpc, mpc, mpc, mpc]) -> tuple[mpc, mpc]:
        return (
            mp.diff(u, z0, 2) - m[0] * u(z0) - m[1] * mp.diff(w, z0),
            mp.diff(w, z0, 2) - m[2] * w(z0) + m[3] * mp.diff(u, z0),
        )

    right = equation_8(solid.m)
    assert relative(right[0], radial) < 1e-10
    assert relative(right[1], vertical) < 1e-10

    _, m2, _, m4 = solid.m
    xi, lame, shear, inertia = solid.xi, solid.lame, solid.shear, solid.inertia
    printed = equation_8(
        (
            (lame + 2 * shear * xi**2 + inertia) / shear,
            m2,
            (inertia + shear) * xi**2 / solid.stiffness,
            m4,
        )
    )
    assert relative(printed[0], radial) > 0.05
    assert relative(printed[1], vertical) > 0.05


# --- Eq. 11: the roots ---------------------------------------------------------------------------


def test_equation_11_simplifies_to_the_shear_and_pressure_waves() -> None:
    for solid in SOLIDS:
        shear_wave = solid.xi**2 + solid.inertia / solid.shear
        pressure_wave = solid.xi**2 + solid.inertia / solid.stiffness
        squares = sorted((root**2 for root in solid.roots), key=lambda x: abs(x - shear_wave))
        assert relative(squares[0], shear_wave) < 1e-30
        assert relative(squares[1], pressure_wave) < 1e-30


def test_equation_11_root_with_plus_is_shear_for_real_s_and_swaps_for_complex_s() -> None:
    def plus_root_is_shear(s: mpc) -> bool:
        lame, shear = mpf("43e6"), mpf("15e6")
        solid = Solid(mpf(5), s, lame, shear, mpf(2000), mpf(1))
        alpha, delta = solid.roots
        shear_wave = solid.xi**2 + solid.inertia / shear
        return abs(alpha**2 - shear_wave) < abs(delta**2 - shear_wave)

    assert plus_root_is_shear(mpc(75, 0))
    assert not plus_root_is_shear(mpc(75, 1000))


def test_equation_11_as_printed_loses_twice_the_digits() -> None:
    # The same nested root in double precision; Eq. 13 is symmetric in the roots, k1 - k2 is what
    # the rounding reaches.
    xi, s, lame, shear = 200.0, 75.0, 43e6, 15e6
    stiffness, inertia = lame + 2 * shear, DENSITY * s**2
    m1, m3 = (stiffness * xi**2 + inertia) / shear, (shear * xi**2 + inertia) / stiffness
    total = m3 + m1 - xi**2 * (lame + shear) ** 2 / (shear * stiffness)
    inner = math.sqrt(abs(total**2 - 4 * m1 * m3))  # rounding may even turn its sign
    exact = inertia / shear - inertia / stiffness
    simplified = (xi**2 + inertia / shear) - (xi**2 + inertia / stiffness)
    assert abs(simplified / exact - 1) < 1e-10
    assert abs(inner / exact - 1) > 1e-6


# --- Eq. 10, 12 and 13: the coefficients ---------------------------------------------------------


def test_k3_to_k6_follow_from_equation_10_and_7() -> None:
    for solid in SOLIDS[:20]:
        alpha, delta = solid.roots
        k1, k2, k3, k4, k5, k6 = solid.k
        z = solid.depth / 3
        for root, k_w, k_sigma, k_tau in ((alpha, k1, k3, k5), (delta, k2, k4, k6)):
            for sign in (1, -1):
                u = mp.exp(sign * root * z)
                w = sign * k_w * u
                du, dw = sign * root * u, sign * root * w
                sigma = solid.stiffness * dw + solid.lame * solid.xi * u
                tau = solid.shear * (du - solid.xi * w)
                assert relative(k_sigma * u, sigma) < 1e-30
                assert relative(sign * k_tau * u, tau) < 1e-30


def solve_boundary_conditions(solid: Solid) -> mpmath.matrix:
    """A to D from Eq. 4 for unit pressure: four equations, solved as they stand."""
    alpha, delta = solid.roots
    k1, k2, k3, k4, k5, k6 = solid.k
    up_a, up_d = mp.exp(alpha * solid.depth), mp.exp(delta * solid.depth)
    matrix = mp.matrix(
        [
            [up_a, 1 / up_a, up_d, 1 / up_d],
            [k1 * up_a, -k1 / up_a, k2 * up_d, -k2 / up_d],
            [k3, k3, k4, k4],
            [k5, -k5, k6, -k6],
        ]
    )
    return mp.lu_solve(matrix, mp.matrix([0, 0, -1, 0]))


def equation_13(solid: Solid, *, as_printed: bool) -> list[mpc]:
    """A to D of Eq. 13 for unit pressure; as printed, Delta lacks a bracket and k2."""
    alpha, delta = solid.roots
    k1, k2, k3, k4, k5, k6 = solid.k
    total = mp.exp((alpha + delta) * solid.depth)
    ratio = mp.exp((alpha - delta) * solid.depth)
    second = ratio * (k1 + k2) + (k1 if as_printed else k1 + k2) / ratio
    determinant = (
        (total + 1 / total) * (k1 - k2) * (k3 * k6 - k4 * k5)
        + second * (k3 * k6 + k4 * k5)
        - 4 * (k1 * k4 * k6 + k2 * k3 * k5)
    )
    plus, minus = k1 + k2, k1 - k2
    return [
        -(k6 * plus / ratio + k6 * minus / total - 2 * k2 * k5) / determinant,
        -(k6 * minus * total + k6 * plus * ratio - 2 * k2 * k5) / determinant,
        -(k5 * plus * ratio - k5 * minus / total - 2 * k1 * k6) / determinant,
        -(-k5 * minus * total + k5 * plus / ratio - 2 * k1 * k6) / determinant,
    ]


def test_equation_13_corrected_solves_the_boundary_conditions() -> None:
    # The direct solution needs the digits that e^(2 alpha h0) takes, up to 10^217 here.
    with mpmath.workdps(300):
        for solid in SOLIDS:
            direct = solve_boundary_conditions(solid)
            for value, reference in zip(equation_13(solid, as_printed=False), direct, strict=True):
                assert relative(value, reference) < 1e-30


def test_equation_13_as_printed_is_wrong() -> None:
    errors, depths = [], []
    for solid in SOLIDS:
        printed, right = (equation_13(solid, as_printed=flag)[0] for flag in (True, False))
        errors.append(relative(printed, right))
        depths.append(float(solid.xi * solid.depth))
    wrong = np.array(errors) > 0.01
    assert np.mean(wrong) > 0.1
    assert max(errors) > 1.0
    assert np.max(np.array(depths)[wrong]) < 8  # deeper, the term is drowned by e^(alpha h0)


def centre_displacement(depth: float, *, as_printed: bool) -> np.ndarray:
    """Eq. 1 to 15 in double precision with Eq. 11 and 13 unscaled; 40 MPa, 54 kPa s."""
    s = ((6 + 2j * math.pi * np.arange(128)) / 0.08)[:, None]
    xi, weights = published.gauss_segments(40, 9.5 * math.pi / RADIUS)
    lame, shear = published.lame_parameters(40e6 + 54e3 * s, POISSON_RATIO)
    inertia, stiffness = DENSITY * s**2, lame + 2 * shear
    m1, m3 = (stiffness * xi**2 + inertia) / shear, (shear * xi**2 + inertia) / stiffness
    m2 = xi * (lame + shear) / shear
    total = m3 + m1 - m2 * xi * (lame + shear) / stiffness
    inner = np.sqrt(total**2 - 4 * m1 * m3)
    alpha, delta = np.sqrt((total + inner) / 2), np.sqrt((total - inner) / 2)
    k1, k2 = (alpha**2 - m1) / (m2 * alpha), (delta**2 - m1) / (m2 * delta)
    k3, k4 = stiffness * k1 * alpha + lame * xi, stiffness * k2 * delta + lame * xi
    k5, k6 = shear * (alpha - xi * k1), shear * (delta - xi * k2)
    up, ratio = np.exp((alpha + delta) * depth), np.exp((alpha - delta) * depth)
    determinant = (
        (up + 1 / up) * (k1 - k2) * (k3 * k6 - k4 * k5)
        + (ratio * (k1 + k2) + (k1 if as_printed else k1 + k2) / ratio) * (k3 * k6 + k4 * k5)
        - 4 * (k1 * k4 * k6 + k2 * k3 * k5)
    )
    a_minus_b = k6 * ((k1 - k2) * (up - 1 / up) + (k1 + k2) * (ratio - 1 / ratio))
    c_minus_d = -k5 * ((k1 - k2) * (up - 1 / up) - (k1 + k2) * (1 / ratio - ratio))
    compliance = (k1 * a_minus_b + k2 * c_minus_d) / determinant
    transfer = compliance @ (weights * xi * published.plate_transform(xi, RADIUS))
    pulse = published.half_sine_transform(s[:, 0], PEAK_PRESSURE, PULSE_DURATION)
    return published.invert_laplace((transfer * pulse)[None], 0.08, 6.0)


@pytest.mark.parametrize(("depth", "error_of_peak"), [(0.5, -0.397), (1.0, -0.051)])
def test_equation_13_as_printed_spoils_the_deflection(depth: float, error_of_peak: float) -> None:
    right = centre_displacement(depth, as_printed=False)[:96]
    printed = centre_displacement(depth, as_printed=True)[:96]
    _, module = published.published_displacement(
        40e6, 54e3, DENSITY, POISSON_RATIO, RADIUS, PEAK_PRESSURE, PULSE_DURATION, depth
    )
    assert np.max(np.abs(right - module[:96])) < 1e-5 * right.max()
    assert printed.max() / right.max() - 1 == pytest.approx(error_of_peak, abs=0.002)


def test_rescaled_equation_13_is_equation_13() -> None:
    for solid in SOLIDS:
        k1, k2, *_ = solid.k
        a, b, c, d = equation_13(solid, as_printed=False)
        reference = k1 * (a - b) + k2 * (c - d)
        value = published.surface_compliance(
            np.array(float(solid.xi)),
            np.array(complex(solid.s)),
            np.array(complex(solid.lame)),
            np.array(complex(solid.shear)),
            float(solid.density),
            float(solid.depth),
        )
        assert relative(mpc(complex(value)), reference) < 1e-6
