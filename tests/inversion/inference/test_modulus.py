"""The modulus of a point over structures, against closed forms."""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from inversion.effects import BY_NAME, Ground
from inversion.inference.modulus import (
    Component,
    log_deviation,
    mean_stress,
    model_error,
    quantiles,
    secant_estimate,
    secant_modulus,
)
from inversion.inference.point_model import PointModel
from tests.inversion.effects.drop_contexts import context

AREA = math.pi * 0.15**2


def test_a_single_structure_has_a_normal_interval() -> None:
    low, _, high = quantiles([Component(0.3, math.log(4e7), 0.05)])
    reach = norm.ppf(0.975) * 0.05
    assert np.log([low / 4e7, high / 4e7]) == pytest.approx([-reach, reach], rel=1e-6)


def test_two_distinct_structures_each_set_an_end() -> None:
    low, _, high = quantiles(
        [Component(3.0, math.log(2e7), 0.02), Component(1.0, math.log(8e7), 0.03)]
    )
    # A fortieth of all is a thirtieth of the first part, and a tenth of the second.
    assert low == pytest.approx(2e7 * math.exp(0.02 * norm.ppf(0.025 / 0.75)))
    assert high == pytest.approx(8e7 * math.exp(0.03 * norm.ppf(1.0 - 0.025 / 0.25)))


def test_a_structure_of_little_weight_leaves_the_interval_as_it_is() -> None:
    alone = Component(1.0, math.log(4e7), 0.05)
    low, _, high = quantiles([alone, Component(1e-4, math.log(9e7), 0.05)])
    assert (low, high) == pytest.approx(quantiles([alone])[::2], rel=1e-3)


def posterior(*effects: tuple[str, dict[str, float]], **changes: Any) -> Any:
    """Unknowns: logarithm of the modulus over 40 MPa and another, with a stated covariance."""

    def ground_and_effects(values: np.ndarray, drop: int) -> Any:
        ground = Ground(4e7 * math.exp(values[0]), 4e4, 1900.0, 0.0, 10.0)
        return ground, [(BY_NAME[name], numbers) for name, numbers in effects]

    model = SimpleNamespace(
        ground_and_effects=ground_and_effects,
        point=SimpleNamespace(modulus_error=0.03),
        context=context(**changes),
        last=0,
        lower=np.array([-1.0, -1.0]),
        upper=np.array([1.0, 1.0]),
    )
    model.changed_ground = partial(PointModel.changed_ground, model)  # type: ignore[arg-type]
    return SimpleNamespace(
        model=model, values=np.array([0.1, 0.0]), covariance=np.array([[4e-4, 1e-4], [1e-4, 1e-2]])
    )


def test_linear_ground_has_a_modulus_independent_of_stress() -> None:
    fit = posterior()
    assert mean_stress(fit.model) == pytest.approx(8000.0 / AREA)
    for stress in (5e4, 1e5):
        assert secant_modulus(fit, stress) == pytest.approx(4e7 * math.exp(0.1))
        assert log_deviation(fit, stress) == pytest.approx(0.02)


def test_the_secant_modulus_follows_the_power_law_and_seating() -> None:
    exponent = {"exponent": 0.4, "rest_stress": 500.0, "within": 0.0}
    fit = posterior(("stress_dependence", exponent), peak_load=6000.0)
    # The ground of the last drop; its power law between drops goes to the stress.
    largest = 8000.0 / AREA
    assert secant_modulus(fit, 6000.0 / AREA) == pytest.approx(
        4e7 * math.exp(0.1) * 0.75**0.4, rel=1e-6
    )
    assert secant_modulus(fit, largest) == pytest.approx(4e7 * math.exp(0.1), rel=1e-6)
    seated = posterior(("seating", {"modulus_ratio": 0.5}))
    assert secant_modulus(seated, largest) == pytest.approx(2e7 * math.exp(0.1))


def test_errors_of_the_instrument_and_of_simplified_effects_are_in_the_deviation() -> None:
    plain, layered = posterior(), posterior(("layer", {"modulus_ratio": 2.0, "thickness": 0.2}))
    assert model_error(plain) == pytest.approx(0.03)
    assert model_error(layered) == pytest.approx(math.hypot(0.03, 0.015))
    modulus, deviation = secant_estimate(plain, 1e5)
    assert math.exp(modulus) == pytest.approx(secant_modulus(plain, 1e5))
    assert deviation == pytest.approx(math.hypot(0.02, 0.03 / norm.ppf(0.975)), rel=1e-4)
