"""Moduli from peak values against the closed forms they come from."""

from __future__ import annotations

import math

import pytest

from inversion.measured.peak_method import PLATE_FACTORS, peak_modulus
from tests import reference

RADIUS = 0.15
FORCE = 7070.0


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.5])
def test_uniform_pressure(poisson_ratio: float) -> None:
    pressure = FORCE / (math.pi * RADIUS**2)
    peak = reference.uniform_pressure_centre_displacement(pressure, RADIUS, 45e6, poisson_ratio)
    found = peak_modulus(FORCE, peak, RADIUS, poisson_ratio, PLATE_FACTORS["uniform"])
    assert found.modulus == pytest.approx(45e6, rel=1e-12)
    assert found.factor == 2.0


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.35, 0.49])
def test_rigid_plate_is_the_default(poisson_ratio: float) -> None:
    peak = FORCE / reference.smooth_disc_stiffness(45e6, poisson_ratio, RADIUS)
    found = peak_modulus(FORCE, peak, RADIUS, poisson_ratio)
    assert found.modulus == pytest.approx(45e6, rel=1e-12)
    assert found.poisson_ratio == poisson_ratio
    assert found.plate_radius == RADIUS


def test_parabolic_pressure() -> None:
    # p = 2 p_mean (1 - r^2/a^2); w(0) = (1 - nu^2)/E times the integral of 2 p dr.
    pressure, nu = FORCE / (math.pi * RADIUS**2), 0.35
    peak = (1 - nu**2) / 45e6 * 2 * (2 * pressure) * (RADIUS - RADIUS / 3)
    found = peak_modulus(FORCE, peak, RADIUS, nu, PLATE_FACTORS["parabolic"])
    assert found.modulus == pytest.approx(45e6, rel=1e-12)


def test_rigid_instead_of_uniform_takes_off_21_per_cent() -> None:
    rigid, uniform = (
        peak_modulus(FORCE, 5e-4, RADIUS, 0.35, PLATE_FACTORS[name]).modulus
        for name in ("rigid", "uniform")
    )
    assert rigid / uniform - 1 == pytest.approx(-0.21, abs=0.005)
