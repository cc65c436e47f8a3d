"""Residuals of layered ground against finite elements, and their derivatives by differences."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import Instrument
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.misfit import Misfit, WeightedDrop, model_floor
from inversion.fitting.parameters import ParameterSpace
from inversion.forward.layered import CONVERGED
from tests.inversion.differences import by_differences
from tests.inversion.layered_drops import (
    DEPTH,
    POISSON_RATIO,
    RADIUS,
    TWO,
    Array,
    prepared,
    recorded,
)
from tests.inversion.synthetic import names, point_at

BAND = 800.0
INDEPENDENT = 7.0


@pytest.fixture(scope="module")
def drop() -> WeightedDrop:
    return prepared(recorded())


@pytest.mark.parametrize("granted", [None, 3e-6])
def test_errors_of_noise_steps_and_model_add_as_squares(
    drop: WeightedDrop, granted: float | None
) -> None:
    measured = replace(
        drop.drop,
        noise=np.full_like(drop.scale, 3e-6),
        quantisation=np.full_like(drop.scale, 4e-6),
    )
    made = WeightedDrop.of(measured, drop.instrument, drop.model_load, granted)
    assert made.model_floor == pytest.approx(model_floor(measured, granted))
    assert made.scale == pytest.approx(np.hypot(5e-6, made.model_floor), rel=1e-12)


def space(**options: Any) -> ParameterSpace:
    return layered_space(2, 6e7, RADIUS, POISSON_RATIO, **({"rock_depth": DEPTH} | options))


def truth(of: ParameterSpace) -> Array:
    """The point at the ground of the finite elements."""
    upper, lower = TWO.layers
    values = {
        "modulus_1": upper.modulus,
        "modulus_2": lower.modulus,
        "thickness_1": upper.thickness,
        "thickness_2": lower.thickness,
        "relaxation": lower.viscosity / lower.modulus,
        "density_1": upper.density,
        "density_2": lower.density,
    }
    return point_at(of, values)


KINDS: dict[str, dict[str, Any]] = {
    "rock declared": {},
    "rock anywhere": {"rock_depth": None},
    "no rock": {"rock_depth": math.inf},
    "thickness given": {"thickness": (0.2,)},
    "elastic": {"elastic": True, "density": 2000.0},
}


@pytest.mark.parametrize("name", KINDS)
def test_derivatives_are_central_differences(name: str, drop: WeightedDrop) -> None:
    """By the converged rule: the fast one's derivatives are good to 0.6 % (docs/layers.md)."""
    of = space(**KINDS[name])
    misfit = Misfit([drop], of, "rigid-rough", 400.0, 40, prior_level=2.0, rule=CONVERGED)
    place, free = truth(of)[None], np.arange(of.size)
    values, slopes = misfit.linearise(place, free)
    expected_values, expected = by_differences(misfit.residual)(place, free)
    assert values == pytest.approx(expected_values)
    for column, unknown in enumerate(names(of)):
        size = np.abs(expected[0, :, column]).max()
        assert size > 0.0, unknown
        assert slopes[0, :, column] == pytest.approx(expected[0, :, column], abs=2e-4 * size), (
            unknown
        )


@pytest.mark.parametrize("name", KINDS)
def test_derivatives_of_the_fast_rule(name: str, drop: WeightedDrop) -> None:
    of = space(**KINDS[name])
    misfit = Misfit([drop], of, "rigid-rough", BAND, 40)
    place, free = truth(of)[None], np.arange(of.size)
    slopes = misfit.linearise(place, free)[1]
    expected = by_differences(misfit.residual)(place, free)[1]
    size = np.abs(expected).max(axis=1)
    assert np.all(np.abs(slopes - expected).max(axis=1) <= 0.01 * size + 1e-12)


def test_derivatives_by_some_unknowns_are_those_of_all(drop: WeightedDrop) -> None:
    of = space()
    misfit = Misfit([drop], of, "rigid-rough", BAND, 40, prior_level=1.0)
    place = truth(of)[None]
    every = misfit.linearise(place, np.arange(of.size))[1]
    for free in ([0], [1, 3, of.size - 1], [4, 2]):
        some = misfit.linearise(place, np.array(free))[1]
        assert some == pytest.approx(every[:, :, free])


def test_a_batch_is_its_members(drop: WeightedDrop) -> None:
    of = space()
    misfit = Misfit([drop], of, "rigid-rough", 400.0, 40, prior_level=1.0, rule=CONVERGED)
    places = np.clip(truth(of) + 0.05 * np.array([[-1.0], [0.0], [1.0]]), 0.0, 1.0)
    values, slopes = misfit.linearise(places, np.arange(of.size))
    costs = misfit.objective(places)
    for place, value, slope, cost in zip(places, values, slopes, costs, strict=True):
        alone = misfit.linearise(place[None], np.arange(of.size))
        # Members may share their wavenumbers; what the converged rule finds is the same.
        assert value == pytest.approx(alone[0][0], abs=1e-4 * np.abs(alone[0]).max())
        assert slope == pytest.approx(alone[1][0], abs=1e-4 * np.abs(alone[1]).max())
        assert cost == pytest.approx(float(np.mean(value**2)), rel=1e-9)


@pytest.mark.parametrize("weight", [0.0, 0.5, 3.0])
def test_priors_stand_behind_the_data_with_their_weight(weight: float, drop: WeightedDrop) -> None:
    of = space()
    misfit = Misfit(
        [drop], of, "rigid-rough", BAND, 40, prior_level=weight**2, n_independent=INDEPENDENT
    )
    weight = weight * math.sqrt(misfit.count / INDEPENDENT)
    place = np.full((1, of.size), 0.45)
    left, slope = of.prior_distances(place)
    residual = misfit.residual(place)
    assert residual.shape[1] == misfit.count + (of.size if weight else 0)
    assert residual[0, misfit.count :] == pytest.approx(weight * left[0] if weight else [])
    values, slopes = misfit.linearise(place, np.arange(of.size))
    assert values == pytest.approx(residual)
    assert slopes[0, misfit.count :] == pytest.approx(
        np.diag(weight * slope[0]) if weight else np.zeros((0, of.size))
    )
    assert misfit.data_cost(place)[0] == pytest.approx(np.mean(residual[0, : misfit.count] ** 2))
    assert misfit.objective(place)[0] == pytest.approx(np.mean(residual[0] ** 2))


def test_drops_share_the_ground(drop: WeightedDrop) -> None:
    of = space()
    twice = replace(
        drop,
        drop=replace(drop.drop, displacement=2 * drop.drop.displacement),
        model_load=2 * drop.model_load,
    )
    alone = Misfit([drop], of, "rigid-rough", BAND, 40)
    both = Misfit([drop, twice], of, "rigid-rough", BAND, 40)
    point = truth(of)
    first = alone.residual(point[None])[0, : alone.count]
    found = both.residual(point[None])[0, : both.count]
    # One transform for both: the ground is linear, so that twice the load moves it twice as far.
    assert found == pytest.approx(np.concatenate([first, 2 * first]))
    assert both.solves == 1


def test_no_more_of_the_band_than_samples_and_filter_hold(drop: WeightedDrop) -> None:
    step = drop.drop.step
    wide = Misfit([drop], space(), "rigid-rough", 1e5, 40)
    assert wide.transform.band == pytest.approx(0.5 / step)
    narrow = replace(drop, instrument=Instrument(RADIUS, 10.0, load_filter=150.0))
    assert Misfit([narrow], space(), "rigid-rough", BAND, 40).transform.band == 300.0
    assert Misfit([drop], space(), "rigid-rough", BAND, 40).transform.band == BAND
