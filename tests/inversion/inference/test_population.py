"""Population of points: spread of priors, and the law of the next drop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.inference.population import (
    PointSummary,
    learn_next_drop,
    population_spread,
    pulse_width,
)
from inversion.measured.record import prepare
from tests.inversion.synthetic import PULSE, Scene, record

LOAD, WIDTH = 80e3, 0.02


def summary(
    step: float, ratio: float, speed_ratio: float = 1.0, width_ratio: float = 1.0
) -> PointSummary:
    """Return a point of three drops whose last one is stiffer by a step."""
    return PointSummary(
        values={},
        deviations={},
        stiffness={0: -1.0 - step, 1: -step, 2: 0.0},
        peak_loads={0: 1.2 * LOAD, 1: LOAD, 2: ratio * LOAD},
        pulse_widths={0: WIDTH, 1: WIDTH, 2: width_ratio * WIDTH},
        take_off_speeds={1: 0.2, 2: 0.2 * speed_ratio},
    )


def points(
    constant: float, slope: float, scatter: float, count: int, seed: int = 3
) -> list[PointSummary]:
    rng = np.random.default_rng(seed)
    result = []
    for ratio in np.exp(rng.uniform(-0.1, 0.0, count)):
        step = constant + slope * math.log(ratio) + scatter * rng.standard_normal()
        result.append(summary(step, ratio))
    return result


def test_the_law_of_forty_points_is_recovered() -> None:
    law = learn_next_drop(points(0.03, -4.0, 0.0, 40), first=False)
    assert law.constant == pytest.approx(0.03, abs=0.005)
    assert law.slopes == pytest.approx([-4.0, 0.0], rel=0.05)
    assert law.stiffening(0.95, 1.0) == pytest.approx(0.03 - 4.0 * math.log(0.95), abs=0.01)


def test_without_peers_the_ground_does_not_harden() -> None:
    law = learn_next_drop([], first=False)
    assert law.stiffening(0.9, 0.9) == 0.0
    assert law.speed_step == 0.0


def test_a_higher_drop_does_not_change_the_stiffening() -> None:
    law = learn_next_drop(points(0.03, -4.0, 0.0, 40), first=False)
    expected = pytest.approx(0.03, abs=0.005)
    assert law.stiffening(1.5, 1.0) == law.stiffening(1.0, 1.0) == expected
    assert law.stiffening(0.5, 1.0) == pytest.approx(0.03 + 0.4, abs=0.02)


def test_points_of_two_drops_give_the_slope_by_their_first_step() -> None:
    variants = points(0.03, -4.0, 0.0, 20)
    two = [
        replace(o, stiffness={0: o.stiffness[0], 1: o.stiffness[1]}, take_off_speeds={})
        for o in variants
    ]
    law = learn_next_drop(two, first=False)
    # The first step of these points is 1 at a ratio of 1 / 1.2.
    assert law.constant == 0.0
    assert law.slopes == pytest.approx([-1.0 / math.log(1.2), 0.0], rel=0.1)


def test_the_law_of_a_single_point_is_shrunk() -> None:
    of_one_point, of_fifty_points = (
        learn_next_drop([summary(0.2, 1.0) for _ in range(n)], first=False) for n in (1, 50)
    )
    assert 0.0 < of_one_point.constant < of_fifty_points.constant < 0.2


def test_the_step_after_the_first_drop_has_a_separate_law() -> None:
    variants = points(0.03, -4.0, 0.0, 40)
    law = learn_next_drop(variants, first=True)
    assert law.stiffening(1.0 / 1.2, 1.0) == pytest.approx(1.0, abs=0.05)


def test_a_shorter_pulse_means_harder_ground() -> None:
    rng = np.random.default_rng(5)
    variants = []
    for load, width in np.exp(rng.uniform(-0.1, 0.0, (40, 2))):
        step = 0.02 - 3.0 * math.log(load) - 2.0 * math.log(width)
        variants.append(summary(step, load, width_ratio=width))
    law = learn_next_drop(variants, first=False)
    assert law.slopes == pytest.approx([-3.0, -2.0], rel=0.05)
    expected = 0.02 - 2.0 * math.log(0.95)
    assert law.stiffening(1.0, 0.95) == pytest.approx(expected, abs=0.01)


def test_the_width_of_a_half_sine_at_a_tenth_of_its_peak(library: SurrogateLibrary) -> None:
    drop = prepare(record(library, Scene()))
    expected = (1.0 - 2.0 * math.asin(0.1) / math.pi) * PULSE
    assert pulse_width(drop) == pytest.approx(expected, rel=1e-3)


def test_take_off_speeds_change_by_the_common_step() -> None:
    variants = [summary(0.0, 1.0, 0.96) for _ in range(20)]
    assert learn_next_drop(variants, first=False).speed_step == pytest.approx(
        math.log(0.96), rel=0.05
    )


def test_an_outlier_hardly_widens_the_population() -> None:
    rng = np.random.default_rng(1)
    sample = 0.5 + 0.05 * rng.standard_normal(12)
    spread = population_spread(sample, 0.5, 0.4)
    assert spread == pytest.approx(0.05, rel=0.5)
    outlier = np.append(sample, 1.5)
    assert population_spread(outlier, 0.5, 0.4) < 0.2
    # A single other point says little: the guess stays.
    assert population_spread(sample[:1], 0.5, 0.4) > 0.2
