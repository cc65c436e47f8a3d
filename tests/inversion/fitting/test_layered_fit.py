"""The fit of layered ground to drops of finite elements: starts, windows, minima."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from inversion.fitting import layered_fit as module
from inversion.fitting.ground_fit import AlternativeRule, GroundFit, Minimum, Window
from inversion.fitting.ground_parameters import layered_space
from inversion.fitting.layered_fit import fit_layers, starting_points
from inversion.fitting.misfit import WeightedDrop, independent_errors
from inversion.fitting.parameters import ParameterSpace
from tests.inversion.layered_drops import (
    ALONE,
    DEPTH,
    OFFSETS,
    POISSON_RATIO,
    RADIUS,
    TWO,
    changed,
    prepared,
    recorded,
)


def space(media: int = 2, **options: Any) -> ParameterSpace:
    known = {"rock_depth": DEPTH, "separate_relaxation": media > 1} | options
    return layered_space(media, 9e7, RADIUS, POISSON_RATIO, **known)


def fitted(
    drops: Sequence[WeightedDrop], of: ParameterSpace, seed: int = 0, **how: Any
) -> GroundFit:
    return fit_layers(drops, of, "rigid-rough", np.random.default_rng(seed), **how)


def values(fit: GroundFit) -> dict[str, float]:
    found = fit.space.values(fit.best.point[None])[0]
    return dict(zip(fit.space.names, found.tolist(), strict=True))


@pytest.fixture(scope="module")
def drop() -> WeightedDrop:
    return prepared(recorded())


@pytest.fixture(scope="module")
def fit(drop: WeightedDrop) -> GroundFit:
    return fitted([drop], space())


# --- what is found -------------------------------------------------------------------------------


def is_the_ground_of_the_mesh(fit: GroundFit) -> None:
    upper, lower = TWO.layers
    found = values(fit)
    # The mesh is good to a thousandth; thickness and modulus of the top trade for one another.
    assert found["modulus_1"] == pytest.approx(upper.modulus, rel=0.01)
    assert found["modulus_2"] == pytest.approx(lower.modulus, rel=3e-3)
    assert found["thickness_1"] == pytest.approx(upper.thickness, rel=0.01)
    for number, layer in enumerate(TWO.layers, 1):
        time = layer.viscosity / layer.modulus
        assert found[f"relaxation_{number}"] == pytest.approx(time, rel=0.02)
        assert found[f"density_{number}"] == pytest.approx(layer.density, rel=0.02)
    assert fit.converged
    assert fit.window == "whole"


def test_the_ground_of_finite_elements_is_found(fit: GroundFit) -> None:
    is_the_ground_of_the_mesh(fit)
    assert fit.best.cost < 0.1


def test_rock_is_found_where_it_is_not_declared(drop: WeightedDrop) -> None:
    found = fitted([drop], space(rock_depth=None))
    assert values(found)["thickness_2"] == pytest.approx(1.0, rel=0.01)


def test_the_genetic_search_ends_in_the_same_ground(drop: WeightedDrop, fit: GroundFit) -> None:
    found = fitted([drop], space(), genetic=True)
    is_the_ground_of_the_mesh(found)
    assert found.best.point == pytest.approx(fit.best.point, abs=1e-3)
    # It does add a search of its own.
    assert found.solves > fit.solves + 200


def test_the_same_seed_gives_the_same_fit_and_another_seed_the_same_ground(
    drop: WeightedDrop, fit: GroundFit
) -> None:
    again, other = fitted([drop], space()), fitted([drop], space(), seed=5)
    assert np.array_equal(again.best.point, fit.best.point)
    assert again.solves == fit.solves
    assert other.best.point == pytest.approx(fit.best.point, abs=1e-3)
    assert not np.array_equal(other.others[0].point, fit.others[0].point)


def test_one_medium_is_found_as_one() -> None:
    found = fitted([prepared(recorded(ALONE))], space(1))
    (layer,) = ALONE.layers
    assert values(found)["modulus_1"] == pytest.approx(layer.modulus, rel=3e-3)
    assert values(found)["density_1"] == pytest.approx(layer.density, rel=0.01)


def test_drops_of_a_point_have_one_ground(fit: GroundFit) -> None:
    drops = [prepared(recorded(noise=0.002, seed=seed, scale=1 + 0.2 * seed)) for seed in range(3)]
    found = fitted(drops, space())
    truth = {"modulus_1": 1.8e8, "modulus_2": 5e7, "thickness_1": 0.2}
    for name, value in truth.items():
        assert values(found)[name] == pytest.approx(value, rel=0.03)
    assert found.misfit.n_independent == pytest.approx(3 * fit.misfit.n_independent, rel=0.1)
    assert len(found.drops) == 3


def test_a_start_that_is_given_is_the_only_one(drop: WeightedDrop, fit: GroundFit) -> None:
    near = np.clip(fit.best.point + 0.02, 0.0, 1.0)
    found = fitted([drop], space(), start=near)
    is_the_ground_of_the_mesh(found)
    assert len(found.others) == 1
    assert found.solves < fit.solves


def test_a_sensor_that_does_not_count_moves_nothing() -> None:
    others = [0, 1, 3]
    before, after = (
        fitted([prepared(record)], space(), sensors=others)
        for record in (recorded(), changed(recorded(), 2, 1.5))
    )
    assert np.array_equal(before.best.point, after.best.point)
    assert before.misfit.sensors.tolist() == others
    counting = fitted([prepared(changed(recorded(), 2, 1.5))], space())
    assert np.abs(counting.best.point - before.best.point).max() > 0.01


# --- windows -------------------------------------------------------------------------------------


def test_a_tail_that_the_model_does_not_explain_is_left_out(drop: WeightedDrop) -> None:
    """A second pulse of the ground that no load is measured for, from 20 ms on."""
    late = np.clip((drop.drop.time - 0.025) / 2e-3, 0.0, 1.0)
    moved = drop.drop.displacement + 0.05 * drop.drop.peak_displacement[:, None] * late
    struck = replace(drop, drop=replace(drop.drop, displacement=moved))
    found = fitted([struck], space())
    assert found.window == "contact"
    is_ground = values(found)
    assert is_ground["modulus_2"] == pytest.approx(5e7, rel=0.02)
    asked = fitted([struck], space(), window="whole")
    assert asked.window == "whole"
    assert asked.best.cost > 2.25
    assert found.drops[0].drop.window_end == pytest.approx(drop.drop.contact_end, abs=2e-4)


@pytest.mark.parametrize("window", ["contact", "whole"])
def test_a_window_that_is_asked_for_is_taken(window: Window, drop: WeightedDrop) -> None:
    found = fitted([drop], space(), window=window)
    assert found.window == window
    end = drop.drop.contact_end if window == "contact" else drop.drop.tail_end
    assert found.drops[0].drop.window_end == pytest.approx(end, abs=2e-4)
    assert values(found)["modulus_2"] == pytest.approx(5e7, rel=5e-3)


@pytest.mark.parametrize(
    ("whole", "contact", "window"),
    [
        (1.0, 0.01, "whole"),  # explained within the error of the model
        (9.0, 0.01, "contact"),
        (40.0, 35.0, "whole"),  # nearly as well as the contact
        (40.0, 10.0, "contact"),
    ],
)
def test_the_whole_record_counts_where_it_is_explained_as_the_contact_is(
    whole: float, contact: float, window: str, drop: WeightedDrop, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stage:
        def __init__(self, drops: Any, *_: Any) -> None:
            longer = drops[0].drop.window_end > drops[0].drop.contact_end
            self.drops, self.cost = drops, whole if longer else contact
            self.coarse = SimpleNamespace(solves=1)

        def search(self, starts: Any) -> Any:
            return SimpleNamespace(points=starts)

        def polish(self, _: Any) -> GroundFit:
            best, misfit = Minimum(np.zeros(1), self.cost), cast(Any, self.coarse)
            rule = AlternativeRule(max_rise=3.84)
            return GroundFit(best, (), True, 1, misfit, tuple(self.drops), rule)

    monkeypatch.setattr(module, "_Stage", Stage)
    assert fitted([drop], space()).window == window


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


# --- starts --------------------------------------------------------------------------------------


def test_starts_lie_where_the_deflections_at_rest_allow(drop: WeightedDrop) -> None:
    of = space(3, rock_depth=None, lag=True, geophone=True)
    low, high = (of.values(end[None])[0] for end in module._start_box(of, drop))
    ends = {name: (low[i], high[i]) for i, name in enumerate(of.names)}
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
    assert ends["relaxation_2"] == pytest.approx((0.2e-3, 2e-3))
    assert ends["natural_frequency"] == pytest.approx((1.0, 8.0))
    # What is known beforehand begins there.
    assert ends["density_2"] == pytest.approx((2000.0, 2000.0))
    assert ends["lag"] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert ends["geophone_damping"] == pytest.approx((0.7, 0.7))


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
    low = of.values(module._start_box(of, replace(drop, drop=motion))[0][None])[0]
    ratio = low[of.names.index("modulus_2")] / low[of.names.index("modulus_1")]
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


def test_bands_and_samples_follow_the_contact(fit: GroundFit, drop: WeightedDrop) -> None:
    contact = drop.drop.contact_end
    assert fit.coarse.transform.band == pytest.approx(5.2 / contact)
    assert fit.misfit.transform.band == pytest.approx(12.8 / contact)
    longest = drop.drop.with_tail().window
    count = longest.stop - longest.start
    for misfit, most in ((fit.coarse, 64), (fit.misfit, 160)):
        stride = -(-count // most)
        assert misfit.rows[0].size == -(-count // stride)


def test_a_deviation_from_a_prior_weighs_as_an_independent_error(
    fit: GroundFit, drop: WeightedDrop
) -> None:
    """The level is at least 1, however small the residual is."""
    assert fit.level == 1.0
    for misfit in (fit.misfit, fit.coarse):
        assert misfit.prior_scale == pytest.approx(
            math.sqrt(misfit.count / fit.misfit.n_independent)
        )
    strict = replace(drop, model_floor=drop.model_floor / 40)
    found = fitted([strict], space(), start=fit.best.point, window="whole")
    assert found.level == pytest.approx(
        float(found.misfit.data_cost(found.best.point[None])[0]), rel=1e-6
    )
    assert found.level > 2.0
    expected = math.sqrt(found.level * found.misfit.count / found.misfit.n_independent)
    assert found.misfit.prior_scale == pytest.approx(expected)


def test_other_minima_stand_best_first(fit: GroundFit) -> None:
    costs = [other.cost for other in fit.others]
    assert costs == sorted(costs)
    assert len(costs) <= 10
