"""The search for layered ground under drops of finite elements: starts and minima."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion.fitting import layered_search as module
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layered_search import layered_minima, starting_points
from inversion.fitting.misfit import PriorDistances, WeightedDrop, independent_errors
from inversion.fitting.parameters import ParameterSpace
from tests.inversion.layered_drops import (
    DEPTH,
    OFFSETS,
    POISSON_RATIO,
    RADIUS,
    TWO,
    prepared,
    recorded,
)
from tests.inversion.synthetic import names, values_at


def space(media: int = 2, **options: Any) -> ParameterSpace:
    return layered_space(media, 9e7, RADIUS, POISSON_RATIO, **({"rock_depth": DEPTH} | options))


@pytest.fixture(scope="module")
def drop() -> WeightedDrop:
    return prepared(recorded())


@pytest.mark.parametrize("prior", [None, lambda grounds: np.zeros(len(grounds))])
def test_the_ground_of_finite_elements_is_among_the_minima(
    prior: PriorDistances | None, drop: WeightedDrop
) -> None:
    """Near it: the search has one relaxation time, which the media do not share."""
    of = space()
    minima, solves = layered_minima([drop], of, "rigid-rough", np.random.default_rng(0), prior)
    upper, lower = TWO.layers
    close = [
        minimum
        for minimum in minima
        if (found := dict(zip(names(of), values_at(of, minimum.point[None])[0], strict=True)))
        and found["modulus_1"] == pytest.approx(upper.modulus, rel=0.1)
        and found["modulus_2"] == pytest.approx(lower.modulus, rel=0.1)
        and found["thickness_1"] == pytest.approx(upper.thickness, rel=0.1)
    ]
    assert close
    assert [m.cost for m in minima] == sorted(m.cost for m in minima)
    assert solves > (100 if prior is None else 700)


@pytest.mark.parametrize(
    ("contacts", "sensors", "expected"),
    [
        # A Gaussian of a third of the contact is sqrt(pi)/3 = 0.591 contacts long.
        ((1.0,), 1, 1.6926),
        ((3.0,), 1, 5.0777),
        ((1.0,), 4, 6.7703),
        ((1.0, 2.0), 2, 10.1554),
        ((0.2,), 3, 3.0),  # a window holds at least one
    ],
)
def test_independent_errors(
    contacts: tuple[float, ...], sensors: int, expected: float, drop: WeightedDrop
) -> None:
    drops = [
        replace(drop, drop=replace(drop.drop, contact_end=0.012, window_end=0.012 * factor))
        for factor in contacts
    ]
    assert independent_errors(drops, sensors) == pytest.approx(expected, abs=1e-4)


def test_starts_lie_where_the_deflections_at_rest_allow(drop: WeightedDrop) -> None:
    of = space(3, rock_depth=None)
    low, high = (values_at(of, end[None])[0] for end in module._start_box(of, drop))
    ends = {name: (low[i], high[i]) for i, name in enumerate(names(of))}
    force, peak = drop.drop.peak_load, drop.drop.peak_displacement
    share = (1 - POISSON_RATIO**2) * force
    # Boussinesq: a rigid plate, and a point load at the farthest sensor.
    plate = share / (2 * RADIUS * peak[0])
    below = share / (math.pi * OFFSETS[-1] * peak[-1])
    between = math.sqrt(plate * below)
    assert ends["modulus_1"] == pytest.approx((plate * math.exp(-1.0), plate * math.exp(2.7)))
    assert ends["modulus_2"] == pytest.approx((between * math.exp(-1.2), between * math.exp(1.8)))
    assert ends["modulus_3"] == pytest.approx((below * math.exp(-1.0), below * math.exp(0.3)))
    assert ends["thickness_1"] == pytest.approx((0.5 * RADIUS, 4 * RADIUS))
    assert ends["thickness_2"] == pytest.approx((0.5 * RADIUS, 4 * RADIUS))
    assert ends["thickness_3"] == pytest.approx((2 * RADIUS, 40 * RADIUS))
    assert ends["relaxation"] == pytest.approx((0.2e-3, 2e-3))
    # What is known beforehand begins there.
    assert ends["density_2"] == pytest.approx((2000.0, 2000.0))


@pytest.mark.parametrize(("place", "far"), [(0.22, False), (0.23, True)])
def test_a_sensor_tells_of_what_is_below_from_one_and_a_half_radii_on(
    place: float, far: bool, drop: WeightedDrop
) -> None:
    motion = replace(
        drop.drop,
        offsets=np.array([0.0, place]),
        peak_displacement=drop.drop.peak_displacement[:2],
    )
    of = space(2)
    low = values_at(of, module._start_box(of, replace(drop, drop=motion))[0][None])[0]
    ratio = low[names(of).index("modulus_2")] / low[names(of).index("modulus_1")]
    peak = motion.peak_displacement
    expected = 2 * RADIUS * peak[0] / (math.pi * place * peak[1])
    assert ratio == pytest.approx(expected if far else 1.0)


def test_starts_fill_their_box(drop: WeightedDrop) -> None:
    of = space()
    found = starting_points(of, drop, np.random.default_rng(3))
    assert found.shape == (16, of.size)
    low, high = module._start_box(of, drop)
    assert np.all((found >= low) & (found <= high))
    wide = high > low
    # Each sixteenth of each side holds one of a Sobol sequence.
    share = np.sort((found - low)[:, wide] / (high - low)[wide], axis=0)
    assert np.all(np.floor(16 * share) == np.arange(16)[:, None])
