"""Equivalent modulus of a fit: tables against layers, alternatives, and where there is none.

`tests/inversion/inference/test_structures.py` has its definition, against finite elements.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from inversion import SurrogateLibrary
from inversion.fitting.equivalent_modulus import equivalent_modulus
from inversion.fitting.ground_fit import GroundFit, Minimum
from inversion.fitting.ground_parameters import MODULUS, layered_space
from inversion.fitting.misfit import Misfit
from inversion.fitting.uncertainty import estimate_uncertainty
from inversion.forward.laplace import FULL_BAND_HZ
from tests.inversion.synthetic import (
    POISSON_RATIO,
    RADIUS,
    TRUTH,
    Scene,
    fit_at_truth,
    record,
    space,
    weighted,
)

DEPTH = 0.35


@pytest.fixture(scope="module")
def fit(library: SurrogateLibrary) -> GroundFit:
    drop = weighted(library, record(library, Scene(sensor_noise=1e-6), DEPTH))
    return fit_at_truth(library, (drop,), space(depth=DEPTH))


def estimate(fit: GroundFit) -> tuple[float, tuple[float, float]]:
    result = equivalent_modulus(fit, estimate_uncertainty(fit))
    assert result is not None
    return result


def test_tables_and_layers_have_the_same_equivalent_modulus(fit: GroundFit) -> None:
    one = layered_space(1, 4e7, RADIUS, POISSON_RATIO, density=fit.space.density, rock_depth=DEPTH)
    misfit = Misfit(fit.drops, one, "rigid-smooth", FULL_BAND_HZ, 400)
    ground = fit.space.grounds(fit.best.point[None])
    relaxation = float(ground.viscosity[0, 0] / ground.modulus[0, 0])
    best = Minimum(one.point([TRUTH[MODULUS], relaxation]), fit.best.cost)
    layered = replace(fit, best=best, misfit=misfit)
    value, _ = estimate(fit)
    assert value > 1.05 * TRUTH[MODULUS]
    assert estimate(layered)[0] == pytest.approx(value, rel=2e-3)


def test_a_half_space_is_its_own_equivalent(fit: GroundFit) -> None:
    misfit = Misfit(fit.drops, space(depth=math.inf), fit.misfit.plate, FULL_BAND_HZ, 400)
    half_space = replace(fit, misfit=misfit)
    uncertainty = estimate_uncertainty(half_space)
    value, interval = estimate(half_space)
    assert value == pytest.approx(TRUTH[MODULUS], rel=1e-6)
    assert interval == pytest.approx(uncertainty.intervals[0], rel=1e-4)


def test_the_interval_covers_alternatives(fit: GroundFit) -> None:
    value, (low, high) = estimate(fit)
    softer = Minimum(fit.space.point([0.8 * TRUTH[MODULUS], 4e4]), fit.best.cost)
    softer_value, _ = estimate(replace(fit, best=softer))
    assert softer_value < 0.85 * value
    widened = estimate(replace(fit, others=(softer,)))[1]
    assert widened == pytest.approx((min(softer_value, low), high), rel=1e-6)


def test_no_sensor_on_the_plate_gives_no_equivalent_modulus(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene(offsets=(0.3, 0.6)), DEPTH))
    fit = fit_at_truth(library, (drop,), space(depth=DEPTH))
    assert equivalent_modulus(fit, estimate_uncertainty(fit)) is None
