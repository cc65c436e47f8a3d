"""The box of the search and the ground that a point in it stands for."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion.errors import ModelError
from inversion.fitting.parameters import (
    DENSITY,
    DEPTH,
    MODULUS,
    VISCOSITY,
    Parameter,
    ParameterSpace,
    depth_parameter,
    on_bound,
    parameter_space,
    soil_parameters,
)
from inversion.forward.surrogate import MIN_DEPTH_RADII

RADIUS = 0.15
PLAIN = Parameter("viscosity", "Pa s", 0.0, 4e5, logarithmic=False)
LOGARITHMIC = Parameter("modulus", "Pa", 5e6, 3e8, logarithmic=True)
SHIFTED = Parameter("delay", "s", 2e-3, 5e-3)


def space(
    density: float | None = None, bedrock_depth: float | None = None, elastic: bool = False
) -> ParameterSpace:
    return parameter_space(40e6, RADIUS, density, bedrock_depth, elastic)


@pytest.mark.parametrize("parameter", [PLAIN, LOGARITHMIC, SHIFTED])
@given(unit=st.floats(0, 1))
def test_unit_values_and_values_are_inverse(parameter: Parameter, unit: float) -> None:
    value = float(parameter.value(np.array(unit)))
    assert parameter.lower * (1 - 1e-12) <= value <= parameter.upper * (1 + 1e-12)
    assert parameter.unit_value(value) == pytest.approx(unit, abs=1e-12)


@pytest.mark.parametrize("parameter", [PLAIN, LOGARITHMIC, SHIFTED])
@pytest.mark.parametrize("unit", [0.1, 0.5, 0.9])
def test_slope_is_the_derivative(parameter: Parameter, unit: float) -> None:
    high, low = (float(parameter.value(np.array(unit + d))) for d in (1e-6, -1e-6))
    assert parameter.slopes(np.array([unit, unit]))[1] == pytest.approx(
        (high - low) / 2e-6, rel=1e-8
    )


@pytest.mark.parametrize(
    "parameter",
    [
        replace(PLAIN, prior=(1e5, 5e4)),
        replace(LOGARITHMIC, prior=(math.log(4e7), 0.5)),
        replace(PLAIN, lower=0.2, upper=9.0, inverse_prior=1.25),
        PLAIN,
    ],
    ids=["linear", "logarithmic", "inverse", "none"],
)
def test_a_prior_is_a_distance_in_its_standard_deviations(parameter: Parameter) -> None:
    def expected(unit: float) -> float:
        value = float(parameter.value(unit))
        if parameter.inverse_prior is not None:
            return 1.0 / value / parameter.inverse_prior
        if parameter.prior is None:
            return 0.0
        centre, deviation = parameter.prior
        return ((math.log(value) if parameter.logarithmic else value) - centre) / deviation

    for unit in (0.2, 0.7):
        away, slope = parameter.from_prior(unit)
        assert away == pytest.approx(expected(unit), rel=1e-12)
        difference = (expected(unit + 1e-6) - expected(unit - 1e-6)) / 2e-6
        assert slope == pytest.approx(difference, rel=1e-6)


def test_middle_of_the_box() -> None:
    assert PLAIN.value(np.array(0.5)) == pytest.approx(2e5)
    assert LOGARITHMIC.value(np.array(0.5)) == pytest.approx(math.sqrt(5e6 * 3e8))


def test_values_outside_are_pulled_to_the_bounds() -> None:
    assert LOGARITHMIC.unit_value(1e6) == 0.0
    assert LOGARITHMIC.unit_value(1e9) == 1.0
    assert PLAIN.unit_value(-3.0) == 0.0


@pytest.mark.parametrize(
    ("density", "bedrock_depth", "elastic", "names"),
    [
        (None, None, False, (MODULUS, VISCOSITY, DENSITY, DEPTH)),
        (None, 1.0, False, (MODULUS, VISCOSITY, DENSITY)),
        (2000.0, math.inf, False, (MODULUS, VISCOSITY)),
        (2000.0, 1.0, True, (MODULUS,)),
        (None, None, True, (MODULUS, DENSITY, DEPTH)),
    ],
)
def test_what_is_not_given_is_fitted(
    density: float | None, bedrock_depth: float | None, elastic: bool, names: tuple[str, ...]
) -> None:
    found = space(density, bedrock_depth, elastic)
    assert found.names == names
    every = {MODULUS, VISCOSITY, DENSITY, DEPTH}
    assert set(found.names) | set(found.fixed) == every
    assert not set(found.names) & set(found.fixed)


def test_given_values_reach_the_grounds() -> None:
    points = np.array([[0.2], [0.9]])
    grounds = space(1950.0, 1.25, True).grounds(points)
    assert grounds.density == pytest.approx([1950.0, 1950.0])
    assert grounds.inverse_depth == pytest.approx([0.8, 0.8])
    assert grounds.viscosity == pytest.approx([0.0, 0.0])
    assert grounds.modulus[0] < 40e6 < grounds.modulus[1]
    assert space(1950.0, math.inf, True).grounds(points).inverse_depth == pytest.approx([0, 0])


def test_bounds_hold_the_grounds_of_the_field() -> None:
    found = space()
    low, high = found.grounds(np.zeros((1, 4))), found.grounds(np.ones((1, 4)))
    # Inertia, viscosity and rock bend the peak method by less than a factor of three.
    assert low.modulus < 40e6 / 3 < 40e6 * 3 < high.modulus
    assert low.viscosity == 0
    assert high.viscosity >= 3e5
    assert low.density <= 1200 < 2600 <= high.density
    assert MIN_DEPTH_RADII * RADIUS < 1 / low.inverse_depth[0] < 2 * RADIUS
    assert 1 / high.inverse_depth[0] == pytest.approx(60 * RADIUS)


def test_stiff_ground_may_be_as_viscous_for_its_modulus() -> None:
    stiff = parameter_space(400e6, RADIUS, None, None, False)
    high = stiff.grounds(np.ones((1, 4)))
    assert high.viscosity[0] > space().grounds(np.ones((1, 4))).viscosity[0]


def test_values_on_a_bound_are_named() -> None:
    found = space()
    assert found.at_bound(np.array([0.5, 0.0, 0.3, 0.99995])) == (VISCOSITY, DEPTH)
    assert found.at_bound(np.full(4, 0.5)) == ()


@pytest.mark.parametrize(
    ("unit_value", "hit"),
    [(0.0, True), (0.0005, True), (0.005, False), (0.995, False), (0.9995, True), (1.0, True)],
)
def test_a_thousandth_of_the_range_is_on_the_bound(unit_value: float, hit: bool) -> None:
    assert on_bound(np.array([unit_value, 0.5])).tolist() == [hit, False]


def test_soil_is_searched_around_the_peak_method() -> None:
    modulus, viscosity, density = soil_parameters(50e6)
    assert (modulus.lower, modulus.upper) == pytest.approx((6e6, 300e6))
    assert (viscosity.lower, viscosity.upper) == pytest.approx((0.0, 6e5))
    assert soil_parameters(10e6)[1].upper == pytest.approx(4e5)
    assert (density.lower, density.upper, density.starts) == (1000.0, 2800.0, (1800.0,))
    assert [p.logarithmic for p in (modulus, viscosity, density)] == [True, False, True]
    assert [p.unit for p in (modulus, viscosity, density)] == ["Pa", "Pa s", "kg/m3"]


def test_rock_is_searched_where_the_tables_reach() -> None:
    depth = depth_parameter(0.2)
    assert (depth.lower, depth.upper) == pytest.approx((1.001 * MIN_DEPTH_RADII * 0.2, 12.0))
    assert depth.logarithmic
    assert (depth.name, depth.unit) == (DEPTH, "m")


@pytest.mark.parametrize("columns", [[0, 1, 2, 3], [3], [1, 3], [2, 0]])
def test_slopes_of_the_ground_are_differences(columns: list[int]) -> None:
    found = space()
    points = np.array([[0.3, 0.2, 0.6, 0.4], [0.7, 0.5, 0.1, 0.9]])
    names, slopes = found.ground_slopes(points, np.array(columns))
    assert slopes.shape == (2, len(columns))
    for number, column in enumerate(columns):
        step = 1e-6 * np.eye(4)[column]
        high, low = (
            getattr(found.grounds(points + sign * step), names[number]) for sign in (1, -1)
        )
        assert slopes[:, number] == pytest.approx((high - low) / 2e-6, rel=1e-6)
    assert [name == "inverse_depth" for name in names] == [c == 3 for c in columns]


def test_names_and_columns() -> None:
    found = space(density=2000.0)
    assert found.index(DEPTH) == 2
    assert found.index(DENSITY) is None
    points = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    assert found.values(DENSITY, points) == pytest.approx([2000.0, 2000.0])
    assert found.values(DEPTH, points) == pytest.approx(found.fitted[2].value(points[:, 2]))


@pytest.mark.parametrize("depth", [0.0, -1.0, math.nan])
def test_depth_must_be_positive(depth: float) -> None:
    with pytest.raises(
        ModelError, match=f"bedrock depth: expected a value > 0 m or inf.*{depth:g}"
    ):
        space(bedrock_depth=depth)


def test_a_parameter_is_not_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        PLAIN.lower = 1.0  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        space().fixed = {}  # type: ignore[misc]
    assert not PLAIN.natural
    assert not Parameter("any", "-", 0.0, 1.0).logarithmic
