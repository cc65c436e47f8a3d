"""Parameter spaces of one medium and of layers: what is fitted, bounds and priors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from inversion.errors import ModelError
from inversion.fitting.ground_parameters import (
    DENSITY,
    DEPTH,
    MODULUS,
    VISCOSITY,
    depth_parameter,
    homogeneous_space,
    layered_space,
)
from inversion.fitting.parameters import ParameterSpace
from inversion.forward.surrogate import MIN_DEPTH_RADII
from tests.inversion.synthetic import names as names_of

RADIUS, POISSON_RATIO, SURFACE = 0.15, 0.35, 6.0e7


def one_medium(**options: Any) -> ParameterSpace:
    return homogeneous_space(40e6, RADIUS, POISSON_RATIO, **options)


def space(media: int = 3, **options: Any) -> ParameterSpace:
    return layered_space(media, SURFACE, RADIUS, POISSON_RATIO, **options)


def unknown(of: ParameterSpace, name: str) -> Any:
    return of.unknowns[names_of(of).index(name)]


@pytest.mark.parametrize(
    ("density", "rock_depth", "elastic", "names"),
    [
        (None, None, False, (MODULUS, VISCOSITY, DENSITY, DEPTH)),
        (None, 1.0, False, (MODULUS, VISCOSITY, DENSITY)),
        (2000.0, math.inf, False, (MODULUS, VISCOSITY)),
        (2000.0, 1.0, True, (MODULUS,)),
        (None, None, True, (MODULUS, DENSITY, DEPTH)),
    ],
)
def test_of_one_medium_what_is_not_given_is_fitted(
    density: float | None, rock_depth: float | None, elastic: bool, names: tuple[str, ...]
) -> None:
    found = one_medium(density=density, rock_depth=rock_depth, elastic=elastic)
    assert names_of(found) == names


def test_given_values_reach_the_grounds() -> None:
    points = np.array([[0.2], [0.9]])
    grounds = one_medium(density=1950.0, rock_depth=1.25, elastic=True).grounds(points)
    assert np.all(grounds.density == 1950.0)
    assert np.all(grounds.thickness == 1.25)
    assert np.all(grounds.viscosity == 0.0)
    assert np.all(grounds.poisson_ratio == POISSON_RATIO)
    assert grounds.modulus[0] < 40e6 < grounds.modulus[1]
    bare = one_medium(density=1950.0, rock_depth=math.inf, elastic=True).grounds(points)
    assert np.all(np.isinf(bare.thickness))
    assert not bare.rock


def test_bounds_hold_the_grounds_of_the_field() -> None:
    found = one_medium()
    low, high = found.grounds(np.zeros((1, 4))), found.grounds(np.ones((1, 4)))
    # Inertia, viscosity and rock bend the peak method by less than a factor of three.
    assert low.modulus < 40e6 / 3 < 40e6 * 3 < high.modulus
    assert low.viscosity == 0
    assert high.viscosity >= 3e5
    assert low.density <= 1200 < 2600 <= high.density
    assert MIN_DEPTH_RADII * RADIUS < low.thickness[0, 0] < 2 * RADIUS
    assert high.thickness[0, 0] == pytest.approx(60 * RADIUS)


def test_stiff_ground_may_be_as_viscous_for_its_modulus() -> None:
    stiff = homogeneous_space(400e6, RADIUS, POISSON_RATIO)
    high = stiff.grounds(np.ones((1, 4)))
    assert high.viscosity[0] > one_medium().grounds(np.ones((1, 4))).viscosity[0]


def test_soil_is_searched_around_the_peak_method() -> None:
    of = homogeneous_space(50e6, RADIUS, POISSON_RATIO, rock_depth=math.inf)
    modulus, viscosity, density = (u.parameter for u in of.unknowns)
    assert (modulus.lower, modulus.upper) == pytest.approx((6e6, 300e6))
    assert (viscosity.lower, viscosity.upper) == pytest.approx((0.0, 6e5))
    assert homogeneous_space(10e6, RADIUS, POISSON_RATIO).unknowns[
        1
    ].parameter.upper == pytest.approx(4e5)
    assert (density.lower, density.upper) == (1000.0, 2800.0)
    assert [p.logarithmic for p in (modulus, viscosity, density)] == [True, False, True]
    assert [p.unit for p in (modulus, viscosity, density)] == ["Pa", "Pa s", "kg/m3"]


def test_rock_is_searched_where_the_tables_reach() -> None:
    depth = depth_parameter(0.2)
    assert (depth.lower, depth.upper) == pytest.approx((1.001 * MIN_DEPTH_RADII * 0.2, 12.0))
    assert depth.logarithmic
    assert (depth.name, depth.unit) == (DEPTH, "m")


@pytest.mark.parametrize("depth", [0.0, -1.0, math.nan])
def test_depth_must_be_positive(depth: float) -> None:
    with pytest.raises(
        ModelError, match=f"bedrock depth: expected a value > 0 m or inf.*{depth:g}"
    ):
        one_medium(rock_depth=depth)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (
            {},
            "modulus_1 modulus_2 thickness_1 thickness_2 relaxation density_1 density_2",
        ),
        (
            {"rock_depth": math.inf},
            "modulus_1 modulus_2 thickness_1 relaxation density_1 density_2",
        ),
        (
            {"rock_depth": 1.0, "elastic": True, "density": 2000.0},
            "modulus_1 modulus_2 thickness_1",
        ),
        (
            {"thickness": (0.3,), "rock_depth": 1.0, "elastic": True, "density": 2000.0},
            "modulus_1 modulus_2",
        ),
    ],
)
def test_what_is_not_given_is_fitted(options: dict[str, Any], names: str) -> None:
    assert names_of(space(2, **options)) == tuple(names.split())


def test_declared_rock_leaves_the_lowest_medium_the_rest() -> None:
    of = space(rock_depth=1.4)
    corners = np.array([np.zeros(of.size), np.ones(of.size), np.full(of.size, 0.5)])
    ground = of.grounds(corners)
    assert ground.thickness.sum(axis=1) == pytest.approx(np.full(3, 1.4))
    # Even with the thickest media above something is left: a twentieth of the depth.
    assert ground.thickness[:, -1].min() == pytest.approx(0.05 * 1.4)
    shallow = unknown(space(2, rock_depth=0.1), "thickness_1").parameter
    assert (shallow.lower, shallow.upper) == pytest.approx((0.2 * 0.095, 0.095))


def test_bounds() -> None:
    of = space(2)
    ends = {
        "modulus_1": (1e6, 3e10),
        "modulus_2": (1e6, 3e10),
        "thickness_1": (0.2 * RADIUS, 20 * RADIUS),
        "thickness_2": (0.5 * RADIUS, 60 * RADIUS),
        "relaxation": (1e-4, 0.012),
        "density_1": (1200.0, 2700.0),
    }
    for name, (low, high) in ends.items():
        parameter = unknown(of, name).parameter
        assert (parameter.lower, parameter.upper) == pytest.approx((low, high)), name
    logarithmic = {u.name for u in of.unknowns if u.parameter.logarithmic}
    assert logarithmic == {
        *("modulus_1", "modulus_2", "thickness_1", "thickness_2"),
        *("density_1", "density_2"),
    }
    units = {u.quantity: u.parameter.unit for u in of.unknowns}
    assert units == {
        "modulus": "Pa",
        "thickness": "m",
        "relaxation": "s",
        "density": "kg/m3",
    }


def test_priors_are_centred_on_what_soils_are_like() -> None:
    """Value at the centre, and one standard deviation above it."""
    of = space(2)
    expected = {
        "modulus_1": (SURFACE, SURFACE * math.exp(2.0)),
        "modulus_2": (SURFACE, SURFACE * math.exp(2.0)),
        "thickness_1": (1.7 * RADIUS, 1.7 * RADIUS * math.exp(1.0)),
        "relaxation": (0.8e-3, 1.8e-3),
        "density_1": (2000.0, 2000.0 * math.exp(0.08)),
        "density_2": (2000.0, 2000.0 * math.exp(0.08)),
    }
    for column, u in enumerate(of.unknowns):
        if u.name == "thickness_2":  # of the medium on rock: wherever the record says
            assert u.parameter.prior is None
            continue
        for number, value in enumerate(expected.pop(u.name)):
            point = np.full((1, of.size), 0.5)
            point[0, column] = u.parameter.unit_value(value)
            distance, _ = of.prior_distances(point)
            assert distance[0, column] == pytest.approx(number, abs=1e-9), u.name
    assert not expected


def test_a_layer_above_shallow_rock_is_expected_above_it() -> None:
    of = space(2, rock_depth=0.3)
    assert unknown(of, "thickness_1").parameter.prior[0] == pytest.approx(
        math.log(0.7 * 0.95 * 0.3)
    )


@pytest.mark.parametrize(
    ("media", "options", "message"),
    [
        (0, {}, "layers: expected at least 1, got 0"),
        (2, {"thickness": (0.1, 0.2)}, "thickness: expected 1 values for 2 layers, got 2"),
        (
            3,
            {"thickness": (0.5, 0.5), "rock_depth": 1.0},
            "thickness: expected layers above the rock at 1 m, got 1 m",
        ),
    ],
)
def test_what_cannot_be_is_refused(media: int, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        space(media, **options)
