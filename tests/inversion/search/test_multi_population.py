"""The multi-population search."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inversion.arrays import FloatArray
from inversion.errors import ModelError
from inversion.search import genetic_operators as operators
from inversion.search.multi_population import (
    MultiPopulationSearch,
    SearchSettings,
    paper_settings,
)
from tests.inversion.search.objectives import Objective, ackley_at, rastrigin_at, seeds, sphere

PRESETS = [SearchSettings(), paper_settings()]
PRESET_NAMES = ["default", "paper"]
SHORT = SearchSettings(generations=20)


def search_of(
    objective: Objective,
    size: int = 3,
    half_width: float = 5.0,
    seed: int = 1,
    settings: SearchSettings = SHORT,
) -> MultiPopulationSearch:
    bounds = np.full(size, half_width)
    rng = np.random.default_rng(seed)
    return MultiPopulationSearch(objective, -bounds, bounds, rng, settings)


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_same_seed_gives_the_same_result(preset: SearchSettings) -> None:
    objective = rastrigin_at(np.array([0.3, -1.2, 2.1]))
    short = replace(preset, generations=25)
    first, repeated, variant = (
        search_of(objective, seed=s, settings=short).run() for s in (7, 7, 8)
    )
    np.testing.assert_array_equal(first.parameters, repeated.parameters)
    np.testing.assert_array_equal(first.candidates, repeated.candidates)
    assert first.misfit == repeated.misfit == objective(first.parameters[None])[0]
    assert not np.array_equal(first.parameters, variant.parameters)


@settings(max_examples=15, deadline=None)
@given(
    seed=seeds,
    size=st.integers(1, 5),
    preset=st.sampled_from(PRESETS),
    low=st.floats(-1e6, 1e6),
    width=st.floats(1e-3, 1e6),
)
def test_every_row_is_within_the_bounds(
    seed: int, size: int, preset: SearchSettings, low: float, width: float
) -> None:
    lower = np.full(size, low)
    upper = lower + width
    rows: list[FloatArray] = []

    def downhill_out_of_the_box(points: FloatArray) -> FloatArray:
        rows.append(points.copy())
        return -points.sum(axis=1)

    short = replace(preset, generations=12)
    rng = np.random.default_rng(seed)
    fitness = operators.contrast_fitness
    search = MultiPopulationSearch(downhill_out_of_the_box, lower, upper, rng, short, fitness)
    result = search.run()
    evaluated = np.concatenate(rows)
    assert (evaluated >= lower).all()
    assert (evaluated <= upper).all()
    assert len(evaluated) == result.evaluations <= short.evaluations


def test_paper_preset_breeds_four_populations_of_twenty_for_a_hundred_generations() -> None:
    batches: list[int] = []

    def counted(points: FloatArray) -> FloatArray:
        batches.append(len(points))
        return sphere(points)

    search = search_of(counted, settings=paper_settings())
    result = search.run()
    assert batches == [80] * 100
    assert result.evaluations == 8000
    assert search.settings.populations == 4


@pytest.mark.parametrize(
    ("make", "half_width"), [(rastrigin_at, 5.12), (ackley_at, 32.768)], ids=["Rastrigin", "Ackley"]
)
def test_the_basin_of_the_minimum_is_reached_from_every_seed(
    make: Callable[[FloatArray], Objective], half_width: float
) -> None:
    for seed in range(10):
        place = np.random.default_rng(900 + seed).uniform(-0.8, 0.8, 3) * half_width
        search = search_of(make(place), 3, half_width, seed, SearchSettings())
        result = search.run()
        assert result.evaluations <= 8000
        # The next basins are one unit away; the caller goes down to the bottom.
        np.testing.assert_allclose(result.parameters, place, atol=0.1)


def test_the_best_minima_are_returned() -> None:
    def two_minima(points: FloatArray) -> FloatArray:
        return np.minimum(sphere(points - 2.0), 0.1 + sphere(points + 2.0))

    result = search_of(two_minima, settings=SearchSettings()).run()
    assert result.misfit < 1e-3
    np.testing.assert_allclose(result.candidates[:2], [[2.0] * 3, [-2.0] * 3], atol=0.2)
    misfits = two_minima(result.candidates)
    np.testing.assert_array_equal(misfits, np.sort(misfits))
    assert misfits[0] == result.misfit


def test_a_round_ends_early_once_the_populations_have_converged() -> None:
    result = search_of(sphere, settings=SearchSettings(rounds=1)).run()
    assert result.misfit < 1e-3
    assert result.evaluations < 5000


def test_failed_evaluations_are_never_chosen() -> None:
    def fails_below_zero(points: FloatArray) -> FloatArray:
        values = sphere(points - 1.0)
        values[points[:, 0] < 0.0] = np.nan
        values[points[:, 1] < 0.0] = np.inf
        values[points[:, 2] < 0.0] = -np.inf
        return values

    result = search_of(fails_below_zero).run()
    assert result.misfit < 0.05
    assert np.isfinite(fails_below_zero(result.candidates)).all()


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_failures_only_are_an_outcome_and_no_error(preset: SearchSettings) -> None:
    search = search_of(
        lambda points: np.full(len(points), np.nan), settings=replace(preset, generations=10)
    )
    result = search.run()
    assert result.misfit == np.inf
    assert result.candidates.shape == (0, 3)


def test_wrong_shape_of_the_objective_raises() -> None:
    search = search_of(lambda points: points, settings=replace(SHORT, sample_factor=1))
    with pytest.raises(ModelError, match=r"shape \(80,\).*got \(80, 3\).*one number per row"):
        search.run()


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0.0, 1.0], [1.0, 1.0], "lower < upper"),
        ([0.0, np.nan], [1.0, 1.0], "finite"),
        ([0.0], [1.0, 1.0], r"one shape \(d,\)"),
    ],
)
def test_bounds_that_do_not_fit_raise(lower: list[float], upper: list[float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        MultiPopulationSearch(sphere, lower, upper, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"individuals": 81}, "multiple of 4"), ({"individuals": 12}, "at least 16")],
)
def test_invalid_settings_raise(wrong: dict[str, int], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        SearchSettings(**wrong)
