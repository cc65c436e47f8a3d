"""Constant-Q ground: closed forms of the law, its limits, causality, and derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.forward.contact import PlateProblem
from inversion.forward.laplace import DampedTransform
from inversion.forward.model import (
    REFERENCE_RAD_S,
    Grounds,
    Instrument,
    loss_exponent,
    transfer_function,
)
from inversion.forward.surrogate import Surrogate
from tests.inversion.forward.converged import (
    converged_compliance,
    motion_before_load,
    slope_error,
)

RADIUS, NU = 0.15, 0.35
TRANSFORM = DampedTransform(0.1, 1600.0)
TIME = np.linspace(2.5e-4, 0.1, 400)
FIELDS = ("modulus", "viscosity", "density", "inverse_depth", "loss_exponent")


@pytest.fixture(scope="module")
def surrogate(library: SurrogateLibrary) -> Surrogate:
    """Rough plate, centre, all depths."""
    return library.get(PlateProblem("rigid-rough", NU), None)


def ground(
    quality: float, depth: float = math.inf, modulus: float = 40e6, viscosity: float = 0.0
) -> Grounds:
    """One ground of a quality factor."""
    values = (modulus, viscosity, 1900.0, 1.0 / depth, loss_exponent(quality))
    return Grounds(*(np.array([value]) for value in values))


@pytest.mark.parametrize("quality", [3.0, 10.0, 40.0])
def test_the_loss_factor_is_the_same_at_every_frequency(quality: float) -> None:
    # tan(pi alpha / 2) = 1/Q: the phase of (i omega)^alpha.
    alpha = loss_exponent(quality)
    assert math.tan(0.5 * math.pi * alpha) == pytest.approx(1.0 / quality, rel=1e-12)
    assert loss_exponent(math.inf) == 0.0


@pytest.mark.parametrize("depth", [0.4, 1.3, math.inf])
@pytest.mark.parametrize("quality", [4.0, 15.0])
def test_the_transfer_function_is_that_of_the_complex_modulus(
    quality: float, depth: float, surrogate: Surrogate
) -> None:
    """Quadrature at Kjartansson's modulus, to what the surrogate promises."""
    s = TRANSFORM.s[:120:6]
    gamma = math.atan(1.0 / quality) / math.pi
    shear = 40e6 * (s / REFERENCE_RAD_S) ** (2.0 * gamma) / (2.0 * (1.0 + NU))
    z = 1900.0 * (RADIUS * s) ** 2 / shear
    right = converged_compliance(PlateProblem("rigid-rough", NU), z, depth / RADIUS)[0] / (
        shear * RADIUS
    )
    result = transfer_function(surrogate, Instrument(RADIUS), s, ground(quality, depth))[0, 0]
    assert np.max(np.abs(result - right)) < 1e-3 * np.max(np.abs(right))


def test_no_exponent_is_the_kelvin_voigt_solid(surrogate: Surrogate) -> None:
    s, instrument = TRANSFORM.s, Instrument(RADIUS, 12.0)
    with_zero = ground(math.inf, 1.2, viscosity=30e3)
    without = replace(with_zero, loss_exponent=None)
    result = transfer_function(surrogate, instrument, s, with_zero)
    assert np.allclose(result, transfer_function(surrogate, instrument, s, without), rtol=1e-13)


def test_an_exponent_of_1_is_a_dashpot(surrogate: Surrogate) -> None:
    s, instrument = TRANSFORM.s, Instrument(RADIUS)
    power = replace(ground(1.0, 1.2), loss_exponent=np.array([1.0]))
    dashpot = Grounds(
        np.zeros(1), np.array([40e6 / REFERENCE_RAD_S]), np.array([1900.0]), np.array([1.0 / 1.2])
    )
    result = transfer_function(surrogate, instrument, s, power)
    assert np.allclose(result, transfer_function(surrogate, instrument, s, dashpot), rtol=1e-12)


@pytest.mark.parametrize("quality", [3.0, 10.0])
@pytest.mark.parametrize("depth", [0.5, 2.0, math.inf])
def test_motion_begins_with_the_load(quality: float, depth: float, surrogate: Surrogate) -> None:
    instrument = Instrument(RADIUS, 12.0)
    result = transfer_function(surrogate, instrument, TRANSFORM.s, ground(quality, depth))[0, 0]
    assert motion_before_load(result, TRANSFORM, TIME, 0.03) < 1e-4


@pytest.mark.parametrize("mass", [0.0, 15.0])
@pytest.mark.parametrize("field", FIELDS)
def test_slopes_are_the_differences(surrogate: Surrogate, field: str, mass: float) -> None:
    instrument, s = Instrument(RADIUS, mass), TRANSFORM.s[::20]
    some_grounds = Grounds(
        np.array([40e6, 25e6]),
        np.array([20e3, 0.0]),
        np.array([2000.0, 1500.0]),
        np.array([1.1, 0.2]),
        np.array([0.08, 0.02]),
    )
    assert slope_error(surrogate, instrument, s, some_grounds, FIELDS, field) < 1e-6
