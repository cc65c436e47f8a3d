"""Fitted numbers between bounds, their priors, and the grounds of a point of the unit box."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion.fitting.ground_parameters import homogeneous_space, layered_space
from inversion.fitting.parameters import Parameter, ParameterSpace
from tests.inversion.synthetic import names, point_at, values_at

PLAIN = Parameter("viscosity", "Pa s", 0.0, 4e5, logarithmic=False)
LOGARITHMIC = Parameter("modulus", "Pa", 5e6, 3e8, logarithmic=True)
SHIFTED = Parameter("delay", "s", 2e-3, 5e-3)
RADIUS, POISSON_RATIO, SURFACE = 0.15, 0.35, 6.0e7


def space(media: int = 3, **options: Any) -> ParameterSpace:
    return layered_space(media, SURFACE, RADIUS, POISSON_RATIO, **options)


def one_medium(**options: Any) -> ParameterSpace:
    return homogeneous_space(SURFACE, RADIUS, POISSON_RATIO, **options)


# Every kind of unknown in at least one of them.
SPACES: dict[str, ParameterSpace] = {
    "no rock, one relaxation": space(rock_depth=math.inf),
    "rock anywhere": space(),
    "rock declared": space(rock_depth=1.4),
    "thickness given": space(thickness=(0.2, 0.4), rock_depth=1.4),
    "elastic, density given": space(elastic=True, density=2000.0, rock_depth=math.inf),
    "one medium": one_medium(),
    "one medium, rock declared": one_medium(rock_depth=1.4, density=2000.0),
    "one medium, elastic": one_medium(rock_depth=math.inf, elastic=True),
}


def points(of: ParameterSpace, seed: int = 0) -> np.ndarray:
    return 0.2 + 0.6 * np.random.default_rng(seed).random((3, of.size))


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
        PLAIN,
    ],
    ids=["linear", "logarithmic", "none"],
)
def test_a_prior_is_a_distance_in_its_standard_deviations(parameter: Parameter) -> None:
    def expected(unit: float) -> float:
        value = float(parameter.value(unit))
        if parameter.prior is None:
            return 0.0
        centre, deviation = parameter.prior
        return ((math.log(value) if parameter.logarithmic else value) - centre) / deviation

    for unit in (0.2, 0.7):
        away, slope = parameter.prior_distance(unit)
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


@pytest.mark.parametrize("name", SPACES)
def test_values_and_points_are_inverse(name: str) -> None:
    of = SPACES[name]
    for point in points(of):
        assert point_at(
            of, dict(zip(names(of), values_at(of, point[None])[0], strict=True))
        ) == pytest.approx(point, abs=1e-12)
    low, high = (values_at(of, np.full((1, of.size), end))[0] for end in (0.0, 1.0))
    assert low == pytest.approx([u.parameter.lower for u in of.unknowns])
    assert high == pytest.approx([u.parameter.upper for u in of.unknowns])


def test_values_reach_the_ground_they_name() -> None:
    of = space()
    values = dict(zip(names(of), values_at(of, points(of)[:1])[0], strict=True))
    ground = of.grounds(points(of)[:1])
    for j in range(3):
        modulus = values[f"modulus_{j + 1}"]
        assert ground.modulus[0, j] == pytest.approx(modulus)
        assert ground.viscosity[0, j] == pytest.approx(modulus * values["relaxation"])
        assert ground.density[0, j] == pytest.approx(values[f"density_{j + 1}"])
        assert ground.thickness[0, j] == pytest.approx(values[f"thickness_{j + 1}"])
        assert ground.poisson_ratio[0, j] == POISSON_RATIO
    assert ground.rock


def test_one_relaxation_time_serves_all_media() -> None:
    of = space(rock_depth=math.inf)
    ground = of.grounds(points(of))
    times = ground.viscosity / ground.modulus
    assert times == pytest.approx(np.tile(times[:, :1], 3))
    column = of.index("relaxation", 2)
    assert column == of.index("relaxation", 0) == names(of).index("relaxation")
    assert times[:, 0] == pytest.approx(values_at(of, points(of))[:, column])


def test_given_values_reach_the_ground() -> None:
    of = space(thickness=(0.2, 0.4), rock_depth=1.4, elastic=True, density=1950.0)
    ground = of.grounds(points(of))
    assert ground.thickness == pytest.approx(np.tile([0.2, 0.4, 0.8], (3, 1)))
    assert np.all(ground.density == 1950.0)
    assert np.all(ground.viscosity == 0.0)
    without = space(rock_depth=math.inf).grounds(points(space(rock_depth=math.inf)))
    assert np.all(np.isinf(without.thickness[:, -1]))
    assert not without.rock


def test_one_medium_is_a_ground_of_one_layer() -> None:
    of = one_medium(density=1950.0, rock_depth=1.25)
    ground = of.grounds(points(of))
    assert ground.thickness == pytest.approx(np.full((3, 1), 1.25))
    assert ground.rock
    values = values_at(of, points(of))
    assert ground.modulus[:, 0] == pytest.approx(values[:, 0])
    assert ground.viscosity[:, 0] == pytest.approx(values[:, 1])
    fitted_depth = one_medium()
    assert fitted_depth.depth_column == names(fitted_depth).index("bedrock_depth")
    assert of.depth_column is None


@pytest.mark.parametrize("name", SPACES)
def test_chain_holds_the_derivatives_of_the_ground(name: str) -> None:
    of = SPACES[name]
    place = points(of)
    varied_media, derivatives = of.ground_slopes(place, of.grounds(place), np.arange(of.size))
    chain = np.zeros((3, len(varied_media), of.size))
    for column, changes in enumerate(derivatives):
        for row, derivative in changes:
            chain[:, row, column] = derivative
    step = 1e-6
    for column in range(of.size):
        move = step * np.eye(of.size)[column]
        high, low = of.grounds(place + move), of.grounds(place - move)
        for row, varied in enumerate(varied_media):
            ends = [getattr(g, varied.field)[:, varied.medium] for g in (high, low)]
            expected = (ends[0] - ends[1]) / (2 * step)
            assert chain[:, row, column] == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", SPACES)
def test_nothing_that_moves_is_missing_from_the_chain(name: str) -> None:
    of = SPACES[name]
    place = points(of)[:1]
    varied, _ = of.ground_slopes(place, of.grounds(place), np.arange(of.size))
    known = {(v.field, v.medium) for v in varied}
    for column in range(of.size):
        moved = place + 1e-3 * np.eye(of.size)[column]
        before, after = of.grounds(place), of.grounds(moved)
        for field in ("modulus", "viscosity", "density", "thickness"):
            a, b = getattr(before, field)[0], getattr(after, field)[0]
            for medium in np.flatnonzero((a != b) & np.isfinite(a)):
                assert (field, int(medium)) in known
    assert len(known) == len(varied)


@pytest.mark.parametrize("name", SPACES)
def test_slopes_of_the_priors_are_derivatives(name: str) -> None:
    of = SPACES[name]
    place, step = points(of), 1e-6
    _, slopes = of.prior_distances(place)
    for column in range(of.size):
        move = step * np.eye(of.size)[column]
        ends = [of.prior_distances(place + sign * move)[0] for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert slopes[:, column] == pytest.approx(expected[:, column], rel=1e-6, abs=1e-6)
        others = np.delete(expected, column, axis=1)
        assert np.all(np.abs(others) < 1e-6)
