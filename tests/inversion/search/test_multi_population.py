"""The multi-population search."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inversion.arrays import FloatArray
from inversion.errors import InversionError, ModelError
from inversion.search import genetic_operators as operators
from inversion.search.genetic_operators import PopulationRole
from inversion.search.multi_population import (
    MultiPopulationSearch,
    SearchResult,
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
    start: FloatArray | None = None,
) -> MultiPopulationSearch:
    bounds = np.full(size, half_width)
    rng = np.random.default_rng(seed)
    return MultiPopulationSearch(objective, -bounds, bounds, rng, settings, start=start)


def run(search: MultiPopulationSearch) -> SearchResult:
    while search.has_next():
        search.next()
    return search.result()


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_same_seed_gives_the_same_result(preset: SearchSettings) -> None:
    objective = rastrigin_at(np.array([0.3, -1.2, 2.1]))
    short = replace(preset, generations=25)
    first, again, other = (run(search_of(objective, seed=s, settings=short)) for s in (7, 7, 8))
    np.testing.assert_array_equal(first.parameters, again.parameters)
    np.testing.assert_array_equal(first.history, again.history)
    assert not np.array_equal(first.parameters, other.parameters)


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
    result = run(search)
    evaluated = np.concatenate(rows)
    assert (evaluated >= lower).all()
    assert (evaluated <= upper).all()
    assert len(evaluated) == result.evaluations <= short.evaluations


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_best_misfit_never_worsens_and_belongs_to_the_best_parameters(
    preset: SearchSettings,
) -> None:
    objective = rastrigin_at(np.array([0.3, -1.2, 2.1]))
    search = search_of(objective, settings=replace(preset, generations=30))
    while search.has_next():
        search.next()
        assert objective(search.best_parameters[None])[0] == pytest.approx(search.best_misfit)
    history = search.result().history
    assert len(history) == search.generation
    assert (np.diff(history) <= 0.0).all()
    assert history[-1] == search.best_misfit


def test_paper_preset_breeds_four_populations_of_twenty_for_a_hundred_generations() -> None:
    batches: list[int] = []

    def counted(points: FloatArray) -> FloatArray:
        batches.append(len(points))
        return sphere(points)

    search = search_of(counted, settings=paper_settings())
    result = run(search)
    assert batches == [80] * 100
    assert result.evaluations == 8000
    assert result.generations == 100
    assert search.settings.populations == 4


def test_paper_preset_draws_the_probabilities_of_step_2() -> None:
    preset = paper_settings()
    assert preset.crossover_probability == (0.95, 1.0)
    assert preset.mutation_probability == (0.02, 0.05)


@pytest.mark.parametrize(
    ("make", "half_width"), [(rastrigin_at, 5.12), (ackley_at, 32.768)], ids=["Rastrigin", "Ackley"]
)
def test_the_basin_of_the_minimum_off_the_centre_is_found_whatever_the_seed(
    make: Callable[[FloatArray], Objective], half_width: float
) -> None:
    for seed in range(10):
        place = np.random.default_rng(900 + seed).uniform(-0.8, 0.8, 3) * half_width
        search = search_of(make(place), 3, half_width, seed, SearchSettings())
        result = run(search)
        assert result.evaluations <= 8000
        # The next basins are one unit away; the caller goes down to the bottom.
        np.testing.assert_allclose(result.parameters, place, atol=0.1)


def test_the_best_minima_are_left_to_the_caller() -> None:
    def two_minima(points: FloatArray) -> FloatArray:
        return np.minimum(sphere(points - 2.0), 0.1 + sphere(points + 2.0))

    result = run(search_of(two_minima, settings=SearchSettings()))
    assert result.misfit < 1e-3
    np.testing.assert_allclose(result.candidates[:2], [[2.0] * 3, [-2.0] * 3], atol=0.2)
    np.testing.assert_array_equal(result.candidate_misfits, np.sort(result.candidate_misfits))
    assert result.candidate_misfits[0] == result.misfit


def test_one_round_ends_early_once_the_populations_have_drawn_together() -> None:
    result = run(search_of(sphere, settings=SearchSettings(rounds=1)))
    assert result.misfit < 1e-3
    assert result.evaluations < 5000


def test_start_individuals_belong_to_the_first_generation() -> None:
    place = np.array([1.234, -2.345, 3.456])
    first: list[FloatArray] = []

    def remember(points: FloatArray) -> FloatArray:
        first.append(points.copy())
        return sphere(points - place)

    beyond = np.array([9.0, 0.0, -9.0])
    search = search_of(remember, start=np.stack([place, beyond]))
    search.next()
    np.testing.assert_allclose(first[0][0], place)
    np.testing.assert_allclose(first[0][1], [5.0, 0.0, -5.0])
    assert search.best_misfit == pytest.approx(0.0, abs=1e-20)


def test_an_unpromising_start_individual_is_not_sorted_out_of_the_first_populations() -> None:
    corner = np.full((1, 3), 5.0)
    search = search_of(sphere, start=corner, settings=SHORT)
    search.next()
    assert (search.result().candidate_misfits <= 75.0).all()
    assert np.isclose(search._misfit, 75.0).sum() == 1


def test_failed_evaluations_are_counted_and_never_chosen() -> None:
    def fails_on_one_side(points: FloatArray) -> FloatArray:
        values = sphere(points - 1.0)
        values[points[:, 0] < 0.0] = np.nan
        values[points[:, 1] < 0.0] = np.inf
        values[points[:, 2] < 0.0] = -np.inf
        return values

    counted = 0

    def objective(points: FloatArray) -> FloatArray:
        nonlocal counted
        values = fails_on_one_side(points)
        counted += int(np.count_nonzero(~np.isfinite(values)))
        return values

    result = run(search_of(objective))
    assert result.failed_evaluations == counted > 100
    assert result.misfit < 0.05
    assert np.isfinite(result.candidate_misfits).all()


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_nothing_but_failures_is_an_outcome_not_an_error(preset: SearchSettings) -> None:
    search = search_of(
        lambda points: np.full(len(points), np.nan), settings=replace(preset, generations=10)
    )
    result = run(search)
    assert result.misfit == np.inf
    assert result.failed_evaluations == result.evaluations
    assert result.candidates.shape == (0, 3)


def test_a_search_stopped_by_its_caller_has_a_result() -> None:
    search = search_of(sphere)
    assert np.isnan(search.best_parameters).all()
    for _ in range(3):
        search.next()
    result = search.result()
    assert result.generations == 3
    assert np.isfinite(result.misfit)


@pytest.mark.parametrize("size", [1, 2, 6])
def test_any_number_of_genes(size: int) -> None:
    result = run(search_of(lambda points: sphere(points - 0.7), size, settings=SearchSettings()))
    assert result.misfit < 1e-3
    assert result.parameters.shape == (size,)


@pytest.mark.parametrize("generations", [1, 2, 5])
def test_small_budgets_are_kept(generations: int) -> None:
    result = run(search_of(sphere, settings=SearchSettings(generations=generations)))
    assert result.evaluations <= 80 * generations


def test_wrong_shape_of_the_objective_raises() -> None:
    search = search_of(lambda points: points, settings=replace(SHORT, sample_factor=1))
    with pytest.raises(ModelError, match=r"shape \(80,\).*got \(80, 3\).*one number per row"):
        search.next()


def test_next_after_the_end_raises() -> None:
    search = search_of(sphere)
    run(search)
    with pytest.raises(InversionError, match="only while has_next"):
        search.next()


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0.0, 1.0], [1.0, 1.0], "lower < upper"),
        ([0.0, np.nan], [1.0, 1.0], "finite"),
        ([-1e308], [1e308], "finite"),
        ([0.0], [1.0, 1.0], r"one shape \(d,\)"),
        ([], [], r"one shape \(d,\)"),
    ],
)
def test_bounds_that_do_not_fit_raise(lower: list[float], upper: list[float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        MultiPopulationSearch(sphere, lower, upper, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.zeros((1, 2)), r"shape \(k, 3\).*got \(1, 2\)"),
        (np.zeros(3), r"shape \(k, 3\)"),
        (np.zeros((81, 3)), "k <= 80"),
        (np.full((1, 3), np.nan), "finite start"),
    ],
)
def test_start_that_does_not_fit_raises(start: FloatArray, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        search_of(sphere, start=start)


@pytest.mark.parametrize(
    ("settings", "wrong", "message"),
    [
        (SearchSettings, {"individuals": 81}, "multiple of 4"),
        (SearchSettings, {"individuals": 12}, "at least 16"),
        (SearchSettings, {"populations": 1}, "populations >= 2"),
        (SearchSettings, {"generations": 0}, "generations >= 1"),
        (SearchSettings, {"candidates": 0}, "candidates >= 1"),
        (SearchSettings, {"breeding": "cloning"}, "cloning"),
        (SearchSettings, {"roles": ()}, "at least one role"),
        (PopulationRole, {"pull": 1.5}, "pull"),
        (PopulationRole, {"weight": (0.9, 0.2)}, "weight"),
        (PopulationRole, {"crossover_rate": 0.0}, "crossover_rate"),
    ],
)
def test_invalid_settings_raise(settings: type, wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        settings(**wrong)
