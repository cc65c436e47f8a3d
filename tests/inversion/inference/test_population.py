"""What points say of each other: priors, and the law of the next drop."""

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
    found = []
    for ratio in np.exp(rng.uniform(-0.1, 0.0, count)):
        step = constant + slope * math.log(ratio) + scatter * rng.standard_normal()
        found.append(summary(step, ratio))
    return found


def test_the_law_of_many_points_is_the_one_that_they_follow() -> None:
    law = learn_next_drop(points(0.03, -4.0, 0.0, 40), first=False)
    assert law.constant == pytest.approx(0.03, abs=0.005)
    assert law.slopes == pytest.approx([-4.0, 0.0], rel=0.05)
    assert law.stiffening(0.95, 1.0) == pytest.approx(0.03 - 4.0 * math.log(0.95), abs=0.01)


def test_without_other_points_nothing_hardens() -> None:
    law = learn_next_drop([], first=False)
    assert law.stiffening(0.9, 0.9) == 0.0
    assert law.speed_step == 0.0


def test_another_drop_height_says_nothing_of_the_ground() -> None:
    law = learn_next_drop(points(0.03, -4.0, 0.0, 40), first=False)
    expected = pytest.approx(0.03, abs=0.005)
    assert law.stiffening(1.5, 1.0) == law.stiffening(1.0, 1.0) == expected
    assert law.stiffening(0.5, 1.0) == pytest.approx(0.03 + 0.4, abs=0.02)


def test_points_of_two_drops_teach_the_slope_by_their_first_step() -> None:
    others = points(0.03, -4.0, 0.0, 20)
    two = [
        replace(o, stiffness={0: o.stiffness[0], 1: o.stiffness[1]}, take_off_speeds={})
        for o in others
    ]
    law = learn_next_drop(two, first=False)
    # The first step of these points is 1 at a ratio of 1 / 1.2.
    assert law.constant == 0.0
    assert law.slopes == pytest.approx([-1.0 / math.log(1.2), 0.0], rel=0.1)


def test_few_points_are_believed_less() -> None:
    few, many = (
        learn_next_drop([summary(0.2, 1.0) for _ in range(n)], first=False) for n in (1, 50)
    )
    assert 0.0 < few.constant < many.constant < 0.2


def test_the_step_after_the_first_drop_has_a_law_of_its_own() -> None:
    others = points(0.03, -4.0, 0.0, 40)
    law = learn_next_drop(others, first=True)
    assert law.stiffening(1.0 / 1.2, 1.0) == pytest.approx(1.0, abs=0.05)


def test_a_shorter_pulse_tells_harder_ground() -> None:
    rng = np.random.default_rng(5)
    others = []
    for load, width in np.exp(rng.uniform(-0.1, 0.0, (40, 2))):
        step = 0.02 - 3.0 * math.log(load) - 2.0 * math.log(width)
        others.append(summary(step, load, width_ratio=width))
    law = learn_next_drop(others, first=False)
    assert law.slopes == pytest.approx([-3.0, -2.0], rel=0.05)
    expected = 0.02 - 2.0 * math.log(0.95)
    assert law.stiffening(1.0, 0.95) == pytest.approx(expected, abs=0.01)


def test_the_width_of_a_half_sine_at_a_tenth_of_its_peak(library: SurrogateLibrary) -> None:
    drop = prepare(record(library, Scene()))
    expected = (1.0 - 2.0 * math.asin(0.1) / math.pi) * PULSE
    assert pulse_width(drop) == pytest.approx(expected, rel=1e-3)


def test_take_off_speeds_change_by_what_the_points_have_in_common() -> None:
    others = [summary(0.0, 1.0, 0.96) for _ in range(20)]
    assert learn_next_drop(others, first=False).speed_step == pytest.approx(
        math.log(0.96), rel=0.05
    )


def test_one_point_that_ended_elsewhere_hardly_widens_the_population() -> None:
    rng = np.random.default_rng(1)
    sample = 0.5 + 0.05 * rng.standard_normal(12)
    spread = population_spread(sample, 0.5, 0.4)
    assert spread == pytest.approx(0.05, rel=0.5)
    outlier = np.append(sample, 1.5)
    assert population_spread(outlier, 0.5, 0.4) < 0.2
    # A single other point says little: the guess stays.
    assert population_spread(sample[:1], 0.5, 0.4) > 0.2


def test_a_summary_survives_being_sent_to_a_process() -> None:
    import pickle

    one = replace(summary(0.1, 0.9), values={("", "modulus"): 0.3})
    assert pickle.loads(pickle.dumps(one)) == one
