"""Ground whose modulus grows with depth: published plates at rest, limits, finer sublayers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inversion.errors import ModelError
from inversion.forward.contact import PlateProblem
from inversion.forward.growth import (
    MAX_GROWTH,
    GrowthSurrogate,
    build_growth_surrogate,
    growth_compliance,
    stiffening,
)
from inversion.forward.laplace import DampedTransform
from inversion.forward.library import SurrogateLibrary
from inversion.forward.model import Grounds, Instrument, transfer_function
from inversion.forward.rational import barycentric_shares
from tests.inversion.forward.converged import (
    converged_compliance,
    half_sine_transform,
    motion_before_load,
    slope_error,
)

RADIUS, NU = 0.15, 0.35
CENTRE = PlateProblem("rigid-rough", NU)
TRANSFORM = DampedTransform(0.06, 1600.0)
TIME = np.linspace(2.5e-4, 0.06, 240)


@pytest.fixture(scope="module", params=["shipped", "built"])
def surrogate(request: pytest.FixtureRequest, library: SurrogateLibrary) -> GrowthSurrogate:
    """Centre of the usual plate."""
    if request.param == "shipped":
        return library.growth(CENTRE, 0.5)
    return build_growth_surrogate(CENTRE, 1.0)


# --- at rest -------------------------------------------------------------------------------------


def test_incompressible_gibson_soil_is_a_bed_of_springs() -> None:
    """Gibson (1967), Geotechnique 17, 58-67: pressure over settlement is 2 m for G = m z."""
    nu, growth = 0.4995, 1000.0  # of the surface's shear modulus a thousandth is left at a radius
    plate = PlateProblem("rigid-smooth", nu)
    # Over the surface's shear modulus and the radius: F/w, and 2 m pi a^2.
    result = 4.0 / (1.0 - nu) * stiffening(plate, 1.0, growth, 100, 5e-4)
    assert result == pytest.approx(2.0 * math.pi * growth, rel=0.015)


def test_a_root_of_depth_has_the_published_stiffness() -> None:
    r"""Smooth disc on :math:`E = m \sqrt z` at nu = 0.4.

    :math:`F/w = 4 m a^{1+n} \cos(\pi n/2) (n+2)/(n+3)`: Booker, Balaam and Davis (1985), Int. J.
    Numer. Anal. Meth. Geomech. 9, 353-381.
    """
    n, growth = 0.5, 3000.0
    result = (
        2.0 / (1.0 - 0.4**2) * stiffening(PlateProblem("rigid-smooth", 0.4), n, growth, 100, 5e-4)
    )
    right = 4.0 * growth**n * math.cos(0.5 * math.pi * n) * (n + 2.0) / (n + 3.0)
    assert result == pytest.approx(right, rel=0.015)


def test_without_growth_the_effective_modulus_is_the_surface_s() -> None:
    assert stiffening(CENTRE, 0.5, 0.0) == pytest.approx(1.0, rel=1e-12)
    assert stiffening(CENTRE, 1.0, 1e-6) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("growth", [0.1, 0.7, 3.0])
def test_effective_modulus_of_finer_sublayers(growth: float, surrogate: GrowthSurrogate) -> None:
    fine = stiffening(CENTRE, surrogate.exponent, growth, 90, 0.02)
    shares = barycentric_shares(surrogate.coordinates, np.array([growth / (1.0 + growth)]))[0]
    assert np.exp(shares @ np.log(surrogate.stiffening)) == pytest.approx(fine, rel=3e-3)


# --- in time -------------------------------------------------------------------------------------


def ground(inverse_depth: float, viscosity: float, modulus: float = 60e6) -> Grounds:
    """One ground by its effective modulus, Pa, and 1/z0, 1/m."""
    return Grounds(*(np.array([v]) for v in (modulus, viscosity, 1900.0, inverse_depth)))


PULSE = half_sine_transform(TRANSFORM.s, 0.0133)


def shear_modulus(some_ground: Grounds) -> np.ndarray:
    """Complex shear modulus of the effective ground."""
    modulus = some_ground.modulus + some_ground.viscosity * TRANSFORM.s
    return np.asarray(modulus / (2.0 * (1.0 + NU)))


@pytest.mark.parametrize("viscosity", [0.0, 40e3])
@pytest.mark.parametrize("growth", [0.05, 0.4, 1.7])
def test_histories_agree_with_60_sublayers(
    growth: float, viscosity: float, surrogate: GrowthSurrogate
) -> None:
    some_ground = ground(growth / RADIUS, viscosity)
    shear = shear_modulus(some_ground)
    p = TRANSFORM.s * RADIUS * np.sqrt(1900.0 / shear)
    # Beyond 600 Hz there is 0.1 % of the pulse.
    part = slice(0, 48)
    right = growth_compliance(CENTRE, surrogate.exponent, growth, p[part], 60)[0]
    right = right / (shear[part] * RADIUS)
    result = transfer_function(surrogate, Instrument(RADIUS), TRANSFORM.s, some_ground)[0, 0, part]
    histories = [
        ((values * PULSE[part]) @ TRANSFORM.synthesis(TIME)[part]).real
        for values in (result, right)
    ]
    assert np.max(np.abs(histories[0] - histories[1])) < 2e-3 * np.max(np.abs(histories[1]))


@pytest.mark.parametrize("viscosity", [0.0, 40e3])
def test_without_growth_it_is_the_half_space(viscosity: float, surrogate: GrowthSurrogate) -> None:
    some_ground = ground(0.0, viscosity)
    shear = shear_modulus(some_ground)
    z = 1900.0 * (RADIUS * TRANSFORM.s) ** 2 / shear
    right = converged_compliance(CENTRE, z)[0] / (shear * RADIUS)
    result = transfer_function(surrogate, Instrument(RADIUS), TRANSFORM.s, some_ground)[0, 0]
    histories = [((values * PULSE) @ TRANSFORM.synthesis(TIME)).real for values in (result, right)]
    assert np.max(np.abs(histories[0] - histories[1])) < 1e-3 * np.max(np.abs(histories[1]))


def test_motion_begins_with_the_load(surrogate: GrowthSurrogate) -> None:
    assert np.all(surrogate.poles.real < 0)
    result = transfer_function(surrogate, Instrument(RADIUS, 12.0), TRANSFORM.s, ground(3.0, 20e3))
    assert motion_before_load(result[0, 0], TRANSFORM, TIME, 0.02) < 1e-4


@pytest.mark.parametrize("field", ["modulus", "viscosity", "density", "inverse_depth"])
def test_slopes_are_the_differences(surrogate: GrowthSurrogate, field: str) -> None:
    s, instrument = TRANSFORM.s[::8], Instrument(RADIUS, 12.0)
    assert slope_error(surrogate, instrument, s, ground(2.2, 30e3), (field,), field) < 1e-6


def test_growth_beyond_the_table_is_refused(surrogate: GrowthSurrogate) -> None:
    p = np.array([[0.1 + 0.5j]])
    with pytest.raises(ModelError, match=r"growth of the modulus: expected 0 to 6 .*got 6\.1"):
        surrogate.compliance(p, np.array([MAX_GROWTH + 0.1]))
