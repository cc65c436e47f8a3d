"""The multi-population search, its operators and its polish."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inversion import genetic_operators as operators
from inversion.errors import InversionError, ModelError
from inversion.genetic_operators import FloatArray, Role, RoleTable
from inversion.minima import Minima
from inversion.quadratic_polish import bounded_newton_step, iteration_cost
from inversion.search import (
    MultiPopulationSearch,
    SearchResult,
    SearchSettings,
    paper_settings,
    polish,
)
from inversion.search_settings import DEFAULT_ROLES

Objective = Callable[[FloatArray], FloatArray]

PRESETS = [SearchSettings(), paper_settings()]
PRESET_NAMES = ["default", "paper"]
SHORT = SearchSettings(generations=20)

seeds = st.integers(0, 2**32 - 1)


def sphere(points: FloatArray) -> FloatArray:
    return (points**2).sum(axis=1)


def rastrigin_at(place: FloatArray) -> Objective:
    def objective(points: FloatArray) -> FloatArray:
        z = points - place
        return 10.0 * place.size + (z**2 - 10.0 * np.cos(2.0 * np.pi * z)).sum(axis=1)

    return objective


def ackley_at(place: FloatArray) -> Objective:
    def objective(points: FloatArray) -> FloatArray:
        z = points - place
        cone = -20.0 * np.exp(-0.2 * np.sqrt((z**2).mean(axis=1)))
        return cone - np.exp(np.cos(2.0 * np.pi * z).mean(axis=1)) + 20.0 + np.e

    return objective


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


def individuals(seed: int, size: int = 3) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.random((4, 20, size)), rng.random((4, 20))


# The search


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_same_seed_gives_the_same_result(preset: SearchSettings) -> None:
    objective = rastrigin_at(np.array([0.3, -1.2, 2.1]))
    short = replace(preset, generations=25)
    one, two, other = (run(search_of(objective, seed=s, settings=short)) for s in (7, 7, 8))
    np.testing.assert_array_equal(one.parameters, two.parameters)
    np.testing.assert_array_equal(one.history, two.history)
    assert not np.array_equal(one.parameters, other.parameters)


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
def test_finds_the_minimum_off_the_centre_whatever_the_seed(
    make: Callable[[FloatArray], Objective], half_width: float
) -> None:
    for seed in range(10):
        place = np.random.default_rng(900 + seed).uniform(-0.8, 0.8, 3) * half_width
        search = search_of(make(place), 3, half_width, seed, SearchSettings())
        result = run(search)
        assert result.misfit < 1e-6, seed
        assert result.evaluations <= 8000
        assert result.success, result.message
        np.testing.assert_allclose(result.parameters, place, atol=1e-3)


def test_scouts_find_a_narrow_basin_that_the_populations_leave() -> None:
    def two_basins(points: FloatArray) -> FloatArray:
        narrow = 4.0 * np.linalg.norm((points - [-3.5, -3.5, 0.0]) / [1.6, 1.6, 4.0], axis=1)
        wide = 1.0 + 0.2 * np.linalg.norm(points - [2.0, 1.0, 1.0], axis=1)
        return np.minimum(narrow, wide)

    # The narrow basin is 1 % of the box.
    one_round = SearchSettings(rounds=1)
    without = replace(one_round, scout_evaluations=0)
    found = [run(search_of(two_basins, seed=s, settings=one_round)).misfit < 0.1 for s in range(8)]
    missed = [run(search_of(two_basins, seed=s, settings=without)).misfit > 0.9 for s in range(8)]
    assert sum(found) >= 7
    assert sum(missed) >= 2


def test_search_without_polish_leaves_the_candidates_to_the_caller() -> None:
    def two_minima(points: FloatArray) -> FloatArray:
        return np.minimum(sphere(points - 2.0), 0.1 + sphere(points + 2.0))

    settings = SearchSettings(polish_evaluations=0)
    result = run(search_of(two_minima, settings=settings))
    assert result.evaluations <= 8000
    assert result.misfit < 1e-3
    np.testing.assert_allclose(result.candidates[:2], [[2.0] * 3, [-2.0] * 3], atol=0.2)
    np.testing.assert_array_equal(result.candidate_misfits, np.sort(result.candidate_misfits))
    assert result.candidate_misfits[0] == result.misfit


def test_one_round_ends_early_once_the_populations_have_drawn_together() -> None:
    result = run(search_of(sphere, settings=SearchSettings(rounds=1)))
    assert result.success
    assert result.misfit < 1e-12
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
    search = search_of(sphere, start=corner, settings=replace(SHORT, scout_evaluations=0))
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
    assert result.misfit < 1e-6
    assert np.isfinite(result.candidate_misfits).all()


@pytest.mark.parametrize("preset", PRESETS, ids=PRESET_NAMES)
def test_nothing_but_failures_is_an_outcome_not_an_error(preset: SearchSettings) -> None:
    search = search_of(
        lambda points: np.full(len(points), np.nan), settings=replace(preset, generations=10)
    )
    result = run(search)
    assert not result.success
    assert "none of" in result.message
    assert result.misfit == np.inf
    assert result.failed_evaluations == result.evaluations
    assert result.candidates.shape == (0, 3)


def test_a_search_stopped_by_its_caller_has_a_result() -> None:
    search = search_of(sphere)
    assert np.isnan(search.best_parameters).all()
    for _ in range(3):
        search.next()
    result = search.result()
    assert not result.success
    assert "stopped by the caller" in result.message
    assert result.generations == 3
    assert np.isfinite(result.misfit)


def test_a_search_that_still_improves_at_its_end_says_so() -> None:
    settings = replace(paper_settings(), generations=3)
    result = run(search_of(sphere, settings=settings))
    assert not result.success
    assert "still improving" in result.message


@pytest.mark.parametrize("size", [1, 2, 6])
def test_any_number_of_genes(size: int) -> None:
    result = run(search_of(lambda points: sphere(points - 0.7), size, settings=SearchSettings()))
    assert result.misfit < 1e-9
    assert result.parameters.shape == (size,)


@pytest.mark.parametrize("generations", [1, 2, 5])
def test_small_budgets_are_kept(generations: int) -> None:
    result = run(search_of(sphere, settings=SearchSettings(generations=generations)))
    assert result.evaluations <= 80 * generations


def test_wrong_shape_of_the_objective_raises() -> None:
    search = search_of(lambda points: points, settings=replace(SHORT, sample_factor=1))
    with pytest.raises(ModelError, match=r"shape \(80,\).*came \(80, 3\).*one number per row"):
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
        (np.zeros((1, 2)), r"shape \(k, 3\).*came \(1, 2\)"),
        (np.zeros(3), r"shape \(k, 3\)"),
        (np.zeros((81, 3)), "k <= 80"),
        (np.full((1, 3), np.nan), "finite start"),
    ],
)
def test_start_that_does_not_fit_raises(start: FloatArray, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        search_of(sphere, start=start)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"individuals": 81}, "multiple of 4"),
        ({"individuals": 12}, "at least 16"),
        ({"populations": 1}, "populations >= 2"),
        ({"generations": 0}, "generations >= 1"),
        ({"polish_evaluations": -1}, "polish_evaluations >= 0"),
        ({"breeding": "cloning"}, "cloning"),
        ({"roles": ()}, "at least one role"),
    ],
)
def test_settings_that_make_no_sense_raise(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        SearchSettings(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pull": 1.5}, "pull"),
        ({"weight": (0.9, 0.2)}, "weight"),
        ({"crossover_rate": 0.0}, "crossover_rate"),
    ],
)
def test_roles_that_make_no_sense_raise(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Role(**wrong)  # type: ignore[arg-type]


# Operators


@given(seed=seeds, count=st.integers(1, 40), size=st.integers(1, 5))
def test_stratified_sample_puts_one_point_into_every_slice(
    seed: int, count: int, size: int
) -> None:
    sample = operators.stratified_sample(count, size, np.random.default_rng(seed))
    slices = np.sort((sample * count).astype(int), axis=0)
    np.testing.assert_array_equal(slices, np.tile(np.arange(count)[:, None], size))


def test_nearest_better_distance_marks_the_bottoms_of_basins() -> None:
    points = np.array([[0.0], [0.1], [0.2], [0.9], [1.0]])
    misfit = np.array([1.0, 2.0, 3.0, 1.5, 2.5])
    distance = operators.nearest_better_distance(points, misfit)
    np.testing.assert_allclose(distance, [np.inf, 0.1, 0.1, 0.9, 0.1], atol=1e-7)


def test_fitness_is_scaled_from_0_to_100_within_each_population() -> None:
    fitness = np.array([[1.0, 2.0, 5.0], [-3.0, -2.0, -3.0]])
    np.testing.assert_allclose(
        operators.scale_fitness(fitness), [[0.0, 25.0, 100.0], [0.0, 100.0, 0.0]]
    )


def test_equal_individuals_all_score_100() -> None:
    fitness = np.array([[2.0, 2.0, 2.0], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(
        operators.scale_fitness(fitness), [[100.0, 100.0, 100.0], [0.0, 50.0, 100.0]]
    )


@pytest.mark.parametrize("fitness_of", [operators.reciprocal_fitness, operators.contrast_fitness])
def test_fitness_ranks_like_the_misfit_and_survives_failures(
    fitness_of: Callable[[FloatArray], FloatArray],
) -> None:
    misfit = np.array([[0.0, 1.0, 3.0, np.inf], [np.inf, np.inf, np.inf, np.inf]])
    scores = operators.scale_fitness(fitness_of(misfit))
    assert np.isfinite(scores).all()
    assert (np.diff(scores[0]) <= 0.0).all()
    assert scores[0, 0] == 100.0
    np.testing.assert_array_equal(scores[1], 100.0)


@given(seed=seeds, offset=st.floats(-1e3, 1e3), scale=st.floats(1e-3, 1e3))
def test_contrast_does_not_depend_on_offset_or_unit(seed: int, offset: float, scale: float) -> None:
    _, misfit = individuals(seed)
    expected = operators.scale_fitness(operators.contrast_fitness(misfit))
    moved = operators.scale_fitness(operators.contrast_fitness(offset + scale * misfit))
    np.testing.assert_allclose(moved, expected, rtol=1e-3, atol=1e-3)


@given(seed=seeds)
def test_selection_follows_the_scores_to_within_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores = operators.scale_fitness(rng.random((4, 20)))
    chosen = operators.select(scores, rng)
    assert chosen.shape == scores.shape
    for row, share in zip(chosen, scores / scores.sum(axis=1, keepdims=True), strict=True):
        times = np.bincount(row, minlength=20)
        assert (np.abs(times - 20 * share) < 1.0 + 1e-9).all()


@given(seed=seeds)
def test_shuffling_keeps_everybody(seed: int) -> None:
    genes, _ = individuals(seed)
    order = operators.shuffled((4, 20), np.random.default_rng(seed))
    mixed = operators.take(genes, order)
    np.testing.assert_array_equal(np.sort(mixed, axis=1), np.sort(genes, axis=1))


@given(seed=seeds, size=st.integers(1, 5))
def test_children_of_every_kind_stay_in_the_unit_box_and_leave_the_parents_alone(
    seed: int, size: int
) -> None:
    rng = np.random.default_rng(seed)
    genes = np.round(rng.random((4, 22, size)))  # corners: as far out as parents can be
    before = genes.copy()
    parents = genes[:, :20]
    sure = np.ones(4)
    roles = RoleTable((*DEFAULT_ROLES[:3], Role(pull=1.0, weight=(1.0, 1.0))))
    for children in (
        operators.cross_intermediate(parents, sure, rng),
        operators.mutate(parents, sure, rng),
        operators.differential_children(genes, parents[:, ::-1], roles, rng),
    ):
        assert children.shape == parents.shape
        assert (children >= 0.0).all()
        assert (children <= 1.0).all()
    np.testing.assert_array_equal(genes, before)


def test_crossover_and_mutation_of_probability_0_change_nothing() -> None:
    genes, _ = individuals(3)
    rng = np.random.default_rng(0)
    never = np.zeros(4)
    np.testing.assert_allclose(operators.cross_intermediate(genes, never, rng), genes)
    np.testing.assert_allclose(operators.mutate(genes, never, rng), genes)


def test_crossover_mixes_pairs_only() -> None:
    genes = np.repeat(np.arange(10.0) / 10.0, 2)[None, :, None] * np.ones(3)
    children = operators.cross_intermediate(genes, np.ones(1), np.random.default_rng(0))
    # Both of a pair are alike here, so whoever mates outside the pair would show.
    np.testing.assert_allclose(children, genes)


def test_mutation_changes_about_the_given_part_of_the_genes() -> None:
    genes = np.full((2, 5000, 3), 0.5)
    mutants = operators.mutate(genes, np.array([0.02, 0.5]), np.random.default_rng(0))
    changed = (mutants != genes).mean(axis=(1, 2))
    np.testing.assert_allclose(changed, [0.02, 0.5], rtol=0.1)
    assert np.mean(mutants > genes) == pytest.approx(np.mean(mutants < genes), rel=0.05)


def test_every_differential_child_differs_from_its_parent() -> None:
    rng = np.random.default_rng(0)
    genes = rng.random((4, 22, 3))
    rare = RoleTable((Role(crossover_rate=1e-9),) * 4)
    children = operators.differential_children(genes, genes[:, 2:], rare, rng)
    np.testing.assert_array_equal((children != genes[:, :20]).sum(axis=2), 1)


@given(seed=seeds)
def test_survivors_are_never_worse_than_before(seed: int) -> None:
    genes, misfit = individuals(seed)
    children, child_misfit = individuals(seed + 1)
    kept, kept_misfit = operators.keep_better(genes, misfit, children, child_misfit)
    np.testing.assert_array_equal(kept_misfit, np.minimum(misfit, child_misfit))
    elite, elite_misfit = operators.keep_elite(genes, misfit, children, child_misfit)
    assert kept.shape == elite.shape == genes.shape
    assert (elite_misfit.min(axis=1) <= misfit.min(axis=1)).all()
    assert (elite_misfit.min(axis=1) <= child_misfit.min(axis=1)).all()


@given(seed=seeds, pair=st.permutations(range(4)))
def test_immigration_keeps_sizes_and_the_best(seed: int, pair: list[int]) -> None:
    genes, misfit = individuals(seed)
    first, second = pair[:2]
    mixed, mixed_misfit = operators.immigrate(genes, misfit, first, second)
    assert mixed.shape == genes.shape
    assert mixed_misfit.shape == misfit.shape
    # Both now hold the better of the two bests, and nobody else has changed.
    best = min(misfit[first].min(), misfit[second].min())
    assert mixed_misfit[first].min() == mixed_misfit[second].min() == best
    others = [k for k in range(4) if k not in (first, second)]
    np.testing.assert_array_equal(mixed[others], genes[others])
    # Each of the two exchanged one individual and kept the other nineteen.
    assert (mixed_misfit[[first, second]] != misfit[[first, second]]).sum() == 2


def test_an_immigrant_brings_its_own_misfit() -> None:
    genes, _ = individuals(5)
    misfit = sphere(genes.reshape(-1, 3)).reshape(4, 20)
    mixed, mixed_misfit = operators.immigrate(genes, misfit, 1, 3)
    np.testing.assert_allclose(sphere(mixed.reshape(-1, 3)).reshape(4, 20), mixed_misfit)


def test_minima_apart_are_the_best_of_each_place() -> None:
    points = np.array([[0.10, 0.1], [0.12, 0.1], [0.9, 0.1], [0.9, 0.9]])
    minima = Minima(points, np.array([2.0, 1.0, 3.0, 4.0]), np.ones(4))
    np.testing.assert_array_equal(minima.apart(2, 0.05).misfits, [1.0, 3.0])
    np.testing.assert_array_equal(minima.apart(9, 0.05).misfits, [1.0, 3.0, 4.0])
    assert len(Minima.none(2).apart(3, 0.05)) == 0


# Polish


def rotation(seed: int, size: int = 3) -> FloatArray:
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((size, size)))[0]


@pytest.mark.parametrize("power", [1.0, 0.5], ids=["bowl", "cone"])
@pytest.mark.parametrize("condition", [1.0, 1e6])
def test_polish_solves_bowls_and_cones_of_any_condition(power: float, condition: float) -> None:
    turn, place = rotation(2), np.array([0.4, 0.6, 0.3])
    curvature = condition ** np.array([0.0, 0.5, 1.0])

    def objective(points: FloatArray) -> FloatArray:
        return (((points - place) @ turn) ** 2 @ curvature) ** power

    best, misfit, used = polish(objective, place + 0.05, np.zeros(3), np.ones(3), 120)
    assert misfit < 1e-6
    assert used <= 120
    np.testing.assert_allclose(best, place, atol=1e-4)


def test_polish_follows_a_curved_valley() -> None:
    def rosenbrock(points: FloatArray) -> FloatArray:
        x, y = points.T
        return 100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2

    start = np.array([-0.5, 0.25])
    _, misfit, _ = polish(rosenbrock, start, np.full(2, -2.0), np.full(2, 2.0), 500)
    assert misfit < 1e-12


def test_polish_ends_on_a_bound() -> None:
    turn = rotation(4)

    def objective(points: FloatArray) -> FloatArray:
        z = points - np.array([0.0, 0.5, 0.5])
        return (z @ turn) ** 2 @ np.array([1.0, 10.0, 100.0]) + 20.0 * z[:, 0]

    best, misfit, _ = polish(objective, np.array([0.05, 0.45, 0.55]), np.zeros(3), np.ones(3), 100)
    assert misfit < 1e-12
    assert best[0] == 0.0


def test_polish_stops_when_the_minimum_is_found() -> None:
    start = np.full(3, 0.2)
    _, misfit, used = polish(sphere, start, -np.ones(3), np.ones(3), 100_000)
    assert misfit < 1e-20
    assert used < 300


@given(seed=seeds, evaluations=st.integers(1, 60))
@settings(max_examples=20, deadline=None)
def test_polish_keeps_bounds_and_budget_and_never_worsens(seed: int, evaluations: int) -> None:
    rng = np.random.default_rng(seed)
    slope, start = rng.standard_normal(3), rng.random(3)
    rows: list[FloatArray] = []

    def objective(points: FloatArray) -> FloatArray:
        rows.append(points.copy())
        return np.sin(9.0 * points).sum(axis=1) + points @ slope

    best, misfit, used = polish(objective, start, np.zeros(3), np.ones(3), evaluations)
    evaluated = np.concatenate(rows)
    assert len(evaluated) == used <= evaluations
    assert (evaluated >= 0.0).all()
    assert (evaluated <= 1.0).all()
    assert misfit <= objective(start[None])[0]
    assert objective(best[None])[0] == pytest.approx(misfit)


def test_polish_survives_a_region_that_cannot_be_evaluated() -> None:
    def objective(points: FloatArray) -> FloatArray:
        return np.where(points[:, 0] > 0.49, np.inf, sphere(points - 0.45))

    _, misfit, _ = polish(objective, np.full(3, 0.48), np.zeros(3), np.ones(3), 400)
    assert misfit < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_polish_survives_what_no_quadratic_describes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place, turn = rng.random(3), rotation(seed)
    weights = 10.0 ** rng.uniform(-12.0, 12.0, 3)
    nasty: list[Objective] = [
        lambda points: np.abs(points - place) @ weights,
        lambda points: np.sqrt(((points - place) @ turn) ** 2 @ weights),
        lambda points: np.floor(9.0 * points).sum(axis=1),
        lambda points: np.sign(points[:, 0] - place[0]) * 1e300,
        lambda points: 1e15 + sphere(points - place),
        lambda points: np.where(np.floor(50.0 * points).sum(axis=1) % 3 == 0, np.inf, 1.0),
        lambda points: sphere(points - place) + 0.01 * rng.random(len(points)),
    ]
    for objective in nasty:
        best, misfit, used = polish(objective, rng.random(3), np.zeros(3), np.ones(3), 2000)
        assert np.isfinite(best).all()
        assert not np.isnan(misfit)
        assert used <= 2000


def test_polish_of_a_constant_ends_at_once() -> None:
    _, misfit, used = polish(
        lambda points: np.ones(len(points)), np.full(2, 0.5), np.zeros(2), np.ones(2), 1000
    )
    assert misfit == 1.0
    assert used <= 1 + iteration_cost(2)


def test_polish_raises_on_a_wrong_shape_and_without_evaluations() -> None:
    bounds = np.zeros(3), np.ones(3)
    with pytest.raises(ModelError, match="one number per row"):
        polish(lambda points: points, np.full(3, 0.5), *bounds, 50)
    with pytest.raises(ModelError, match="at least one evaluation, came 0"):
        polish(sphere, np.full(3, 0.5), *bounds, 0)


@given(seed=seeds)
def test_bounded_newton_step_is_the_minimum_of_the_model_in_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((2, 2))
    hessian = root @ root.T + 0.1 * np.eye(2)
    gradient, point = rng.standard_normal(2), rng.random(2)
    step = bounded_newton_step(gradient[None], hessian[None], point[None])[0]
    end = point + step
    assert (end >= -1e-9).all()
    assert (end <= 1.0 + 1e-9).all()
    # Downhill, and no better along any single gene that is free.
    height = gradient @ step + 0.5 * step @ hessian @ step
    assert height <= 1e-12
    slope = gradient + hessian @ step
    inside = (end > 1e-6) & (end < 1.0 - 1e-6)
    np.testing.assert_allclose(slope[inside], 0.0, atol=1e-6)
