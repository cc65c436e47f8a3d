"""The box of a layered search: grounds, derivatives, what is known beforehand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from inversion.errors import ModelError
from inversion.fitting.layered.parameters import LayeredSpace, layered_space

RADIUS, POISSON_RATIO, SURFACE = 0.15, 0.35, 6.0e7

# Every kind of unknown in at least one of them.
SPACES: dict[str, dict[str, Any]] = {
    "no rock, one relaxation": {"rock_depth": math.inf},
    "rock anywhere, own relaxation": {"own_relaxation": True},
    "rock declared": {"rock_depth": 1.4, "own_relaxation": True},
    "thickness given": {"thickness": (0.2, 0.4), "rock_depth": 1.4},
    "elastic, density given": {"elastic": True, "density": 2000.0, "rock_depth": math.inf},
    "instrument": {"rock_depth": math.inf, "geophone": True, "lag": True},
    "lags of sensors": {"rock_depth": math.inf, "sensor_lags": (1, 2)},
}


def space(media: int = 3, **options: Any) -> LayeredSpace:
    return layered_space(media, SURFACE, RADIUS, POISSON_RATIO, **options)


def points(of: LayeredSpace, seed: int = 0) -> np.ndarray:
    return 0.2 + 0.6 * np.random.default_rng(seed).random((3, of.size))


def unknown(of: LayeredSpace, name: str) -> Any:
    return of.unknowns[of.names.index(name)]


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (
            {},
            "modulus_1 modulus_2 thickness_1 thickness_2 relaxation density_1 density_2",
        ),
        (
            {"rock_depth": math.inf, "own_relaxation": True},
            "modulus_1 modulus_2 thickness_1 relaxation_1 relaxation_2 density_1 density_2",
        ),
        (
            {"rock_depth": 1.0, "elastic": True, "density": 2000.0},
            "modulus_1 modulus_2 thickness_1",
        ),
        (
            {"thickness": (0.3,), "rock_depth": 1.0, "elastic": True, "density": 2000.0},
            "modulus_1 modulus_2",
        ),
        (
            {
                "rock_depth": math.inf,
                "elastic": True,
                "density": 2000.0,
                "lag": True,
                "sensor_lags": (2,),
                "geophone": True,
            },
            "modulus_1 modulus_2 thickness_1 lag lag_of_sensor_3 natural_frequency "
            "geophone_damping",
        ),
    ],
)
def test_what_is_not_given_is_fitted(options: dict[str, Any], names: str) -> None:
    assert space(2, **options).names == tuple(names.split())


@pytest.mark.parametrize("name", SPACES)
def test_values_and_points_are_inverse(name: str) -> None:
    of = space(**SPACES[name])
    for point in points(of):
        assert of.point(list(of.values(point[None])[0])) == pytest.approx(point, abs=1e-12)
    low, high = of.values(np.zeros((1, of.size)))[0], of.values(np.ones((1, of.size)))[0]
    assert low == pytest.approx([u.parameter.lower for u in of.unknowns])
    assert high == pytest.approx([u.parameter.upper for u in of.unknowns])


def test_values_reach_the_ground_they_name() -> None:
    of = space(own_relaxation=True)
    values = dict(
        zip(of.names, of.values(points(of)[:1])[0], strict=True),
    )
    ground = of.grounds(points(of)[:1])
    for j in range(3):
        modulus = values[f"modulus_{j + 1}"]
        assert ground.modulus[0, j] == pytest.approx(modulus)
        assert ground.viscosity[0, j] == pytest.approx(modulus * values[f"relaxation_{j + 1}"])
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
    assert column == of.index("relaxation", 0) == of.names.index("relaxation")
    assert times[:, 0] == pytest.approx(of.values(points(of))[:, column])


def test_given_values_reach_the_ground() -> None:
    of = space(thickness=(0.2, 0.4), rock_depth=1.4, elastic=True, density=1950.0)
    ground = of.grounds(points(of))
    assert ground.thickness == pytest.approx(np.tile([0.2, 0.4, 0.8], (3, 1)))
    assert np.all(ground.density == 1950.0)
    assert np.all(ground.viscosity == 0.0)
    without = space(rock_depth=math.inf).grounds(points(space(rock_depth=math.inf)))
    assert np.all(np.isinf(without.thickness[:, -1]))
    assert not without.rock


def test_declared_rock_leaves_the_lowest_medium_the_rest() -> None:
    of = space(rock_depth=1.4)
    corners = np.array([np.zeros(of.size), np.ones(of.size), np.full(of.size, 0.5)])
    ground = of.grounds(corners)
    assert ground.thickness.sum(axis=1) == pytest.approx(np.full(3, 1.4))
    # Even with the thickest media above something is left: a twentieth of the depth.
    assert ground.thickness[:, -1].min() == pytest.approx(0.05 * 1.4)
    shallow = unknown(space(2, rock_depth=0.1), "thickness_1").parameter
    assert (shallow.lower, shallow.upper) == pytest.approx((0.2 * 0.095, 0.095))


@pytest.mark.parametrize("name", SPACES)
def test_chain_holds_the_derivatives_of_the_ground(name: str) -> None:
    of = space(**SPACES[name])
    place = points(of)
    chain = of.chain(place)
    assert chain.shape == (3, len(of.varied), of.size)
    step = 1e-6
    for column in range(of.size):
        move = step * np.eye(of.size)[column]
        high, low = of.grounds(place + move), of.grounds(place - move)
        for row, varied in enumerate(of.varied):
            ends = [getattr(g, varied.field)[:, varied.medium] for g in (high, low)]
            expected = (ends[0] - ends[1]) / (2 * step)
            assert chain[:, row, column] == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", SPACES)
def test_nothing_that_moves_is_missing_from_the_chain(name: str) -> None:
    of = space(**SPACES[name])
    place = points(of)[:1]
    known = {(v.field, v.medium) for v in of.varied}
    for column in range(of.size):
        moved = place + 1e-3 * np.eye(of.size)[column]
        before, after = of.grounds(place), of.grounds(moved)
        for field in ("modulus", "viscosity", "density", "thickness"):
            a, b = getattr(before, field)[0], getattr(after, field)[0]
            for medium in np.flatnonzero((a != b) & np.isfinite(a)):
                assert (field, int(medium)) in known
    assert len(known) == len(of.varied)


@pytest.mark.parametrize("name", ["instrument", "lags of sensors"])
def test_slopes_of_the_response_are_logarithmic_derivatives(name: str) -> None:
    of, s = space(**SPACES[name]), 30.0 + 2j * np.pi * np.array([5.0, 60.0, 300.0])
    place, step = points(of), 1e-6
    value, slopes = of.response(place, s, 4)
    assert value.shape == (3, 4, 3)
    assert set(slopes) == set(of.of_instrument)
    for column in range(of.size):
        move = step * np.eye(of.size)[column]
        high, low = of.response(place + move, s, 4)[0], of.response(place - move, s, 4)[0]
        expected = (high - low) / (2 * step) / value
        found = slopes.get(column, np.zeros_like(value))
        assert np.broadcast_to(found, value.shape) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_the_response_is_that_of_a_geophone_and_a_delay() -> None:
    of = space(1, rock_depth=math.inf, geophone=True, lag=True, sensor_lags=(1,))
    wanted = {
        "natural_frequency": 4.5,
        "geophone_damping": 0.6,
        "lag": 3e-4,
        "lag_of_sensor_2": -2e-4,
    }
    values = dict(zip(of.names, of.values(np.full((1, of.size), 0.5))[0], strict=True)) | wanted
    point = of.point([values[name] for name in of.names])
    s = 20.0 + 2j * np.pi * np.array([3.0, 30.0])
    omega = 2 * np.pi * 4.5
    geophone = s**2 / (s**2 + 2 * 0.6 * omega * s + omega**2)
    found, _ = of.response(point[None], s, 2)
    assert found[0, 0] == pytest.approx(geophone * np.exp(-3e-4 * s), rel=1e-9)
    assert found[0, 1] == pytest.approx(geophone * np.exp(-1e-4 * s), rel=1e-9)
    plain = space(1, rock_depth=math.inf)
    assert np.all(plain.response(points(plain), s, 2)[0] == 1.0)
    assert plain.of_instrument == ()


def test_bounds() -> None:
    of = space(2, own_relaxation=True, geophone=True, lag=True)
    ends = {
        "modulus_1": (1e6, 3e10),
        "modulus_2": (1e6, 3e10),
        "thickness_1": (0.2 * RADIUS, 20 * RADIUS),
        "thickness_2": (0.5 * RADIUS, 60 * RADIUS),
        "relaxation_1": (1e-4, 0.012),
        "density_1": (1200.0, 2700.0),
        "lag": (-4e-3, 4e-3),
        "natural_frequency": (0.2, 30.0),
        "geophone_damping": (0.1, 2.0),
    }
    for name, (low, high) in ends.items():
        parameter = unknown(of, name).parameter
        assert (parameter.lower, parameter.upper) == pytest.approx((low, high)), name
    logarithmic = {u.name for u in of.unknowns if u.parameter.logarithmic}
    assert logarithmic == {
        *("modulus_1", "modulus_2", "thickness_1", "thickness_2"),
        *("density_1", "density_2", "natural_frequency"),
    }
    units = {u.quantity: u.parameter.unit for u in of.unknowns}
    assert units == {
        "modulus": "Pa",
        "thickness": "m",
        "relaxation": "s",
        "density": "kg/m3",
        "lag": "s",
        "natural_frequency": "Hz",
        "geophone_damping": "-",
    }


def test_ends_of_nature_are_no_warning() -> None:
    of = space(2, rock_depth=math.inf)
    point = np.full(of.size, 0.5)
    point[of.names.index("relaxation")] = 0.0
    point[of.names.index("modulus_2")] = 1.0
    assert of.at_bound(point) == ("modulus_2",)


# --- priors --------------------------------------------------------------------------------------


def test_priors_are_centred_on_what_soils_and_instruments_are_like() -> None:
    """Value at the centre, and one standard deviation above it."""
    of = space(2, own_relaxation=True, geophone=True, lag=True, sensor_lags=(1,))
    expected = {
        "modulus_1": (SURFACE, SURFACE * math.exp(2.0)),
        "modulus_2": (SURFACE, SURFACE * math.exp(2.0)),
        "thickness_1": (1.7 * RADIUS, 1.7 * RADIUS * math.exp(1.0)),
        "relaxation_1": (0.8e-3, 1.8e-3),
        "relaxation_2": (0.8e-3, 1.8e-3),
        "density_1": (2000.0, 2000.0 * math.exp(0.08)),
        "density_2": (2000.0, 2000.0 * math.exp(0.08)),
        "lag": (0.0, 0.5e-3),
        "lag_of_sensor_2": (0.0, 0.5e-3),
        "natural_frequency": (3.0, 3.0 * math.exp(1.0)),
        "geophone_damping": (0.7, 1.0),
    }
    for column, u in enumerate(of.unknowns):
        if u.name == "thickness_2":  # of the medium on rock: wherever the record says
            assert u.prior is None
            continue
        for number, value in enumerate(expected.pop(u.name)):
            point = np.full((1, of.size), 0.5)
            point[0, column] = u.parameter.unit_value(value)
            left, _ = of.prior_residuals(point)
            assert left[0, column] == pytest.approx(number, abs=1e-9), u.name
    assert not expected


def test_a_layer_above_shallow_rock_is_expected_above_it() -> None:
    of = space(2, rock_depth=0.3)
    assert unknown(of, "thickness_1").prior[0] == pytest.approx(math.log(0.7 * 0.95 * 0.3))


def test_slopes_of_the_priors_are_derivatives() -> None:
    of = space(own_relaxation=True, geophone=True, lag=True)
    place, step = points(of), 1e-6
    _, slopes = of.prior_residuals(place)
    for column in range(of.size):
        move = step * np.eye(of.size)[column]
        ends = [of.prior_residuals(place + sign * move)[0] for sign in (1, -1)]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert slopes[column] == pytest.approx(expected[:, column], rel=1e-6, abs=1e-6)
        others = np.delete(expected, column, axis=1)
        assert np.all(np.abs(others) < 1e-6)


# --- what is refused -----------------------------------------------------------------------------


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
