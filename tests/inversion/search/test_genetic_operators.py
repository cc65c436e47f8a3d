"""The operators of the multi-population search."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion.arrays import FloatArray
from inversion.search import genetic_operators as operators
from tests.inversion.search.objectives import seeds, sphere


def individuals(seed: int, size: int = 3) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.random((4, 20, size)), rng.random((4, 20))


@given(seed=seeds, count=st.integers(1, 40), size=st.integers(1, 5))
def test_a_stratified_sample_has_a_point_in_every_slice(seed: int, count: int, size: int) -> None:
    sample = operators.stratified_sample(count, size, np.random.default_rng(seed))
    slices = np.sort((sample * count).astype(int), axis=0)
    np.testing.assert_array_equal(slices, np.tile(np.arange(count)[:, None], size))


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


def test_fitness_ranks_like_the_misfit_and_survives_failures() -> None:
    misfit = np.array([[0.0, 1.0, 3.0, np.inf], [np.inf, np.inf, np.inf, np.inf]])
    scores = operators.scale_fitness(operators.contrast_fitness(misfit))
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
def test_selection_follows_the_scores(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scores = operators.scale_fitness(rng.random((4, 20)))
    chosen = operators.select(scores, rng)
    assert chosen.shape == scores.shape
    for row, share in zip(chosen, scores / scores.sum(axis=1, keepdims=True), strict=True):
        times = np.bincount(row, minlength=20)
        assert (np.abs(times - 20 * share) < 1.0 + 1e-9).all()


@given(seed=seeds, size=st.integers(1, 5))
def test_children_stay_in_the_unit_box_and_leave_the_parents_unchanged(
    seed: int, size: int
) -> None:
    rng = np.random.default_rng(seed)
    genes = np.round(rng.random((4, 22, size)))  # corners: as far out as parents can be
    before = genes.copy()
    parents = genes[:, :20]
    sure = np.ones(4)
    rates = np.array([0.9, 0.7, 0.5, 1.0])
    for children in (
        operators.cross_intermediate(parents, sure, rng),
        operators.mutate(parents, sure, rng),
        operators.differential_children(genes, parents[:, ::-1], rates, rng),
    ):
        assert children.shape == parents.shape
        assert (children >= 0.0).all()
        assert (children <= 1.0).all()
    np.testing.assert_array_equal(genes, before)


def test_crossover_and_mutation_of_probability_0_leave_the_genes() -> None:
    genes, _ = individuals(3)
    rng = np.random.default_rng(0)
    never = np.zeros(4)
    np.testing.assert_allclose(operators.cross_intermediate(genes, never, rng), genes)
    np.testing.assert_allclose(operators.mutate(genes, never, rng), genes)


def test_mutation_changes_the_stated_share_of_genes() -> None:
    genes = np.full((2, 5000, 3), 0.5)
    mutants = operators.mutate(genes, np.array([0.02, 0.5]), np.random.default_rng(0))
    changed = (mutants != genes).mean(axis=(1, 2))
    np.testing.assert_allclose(changed, [0.02, 0.5], rtol=0.1)
    assert np.mean(mutants > genes) == pytest.approx(np.mean(mutants < genes), rel=0.05)


def test_every_differential_child_differs_from_its_parent() -> None:
    rng = np.random.default_rng(0)
    genes = rng.random((4, 22, 3))
    rare = np.full(4, 1e-9)
    children = operators.differential_children(genes, genes[:, 2:], rare, rng)
    np.testing.assert_array_equal((children != genes[:, :20]).sum(axis=2), 1)


@given(seed=seeds)
def test_survivors_are_never_worse_than_before(seed: int) -> None:
    genes, misfit = individuals(seed)
    children, child_misfit = individuals(seed + 1)
    better, better_misfit = operators.keep_better(genes, misfit, children, child_misfit)
    np.testing.assert_array_equal(better_misfit, np.minimum(misfit, child_misfit))
    elite, elite_misfit = operators.keep_elite(genes, misfit, children, child_misfit)
    assert better.shape == elite.shape == genes.shape
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
    variants = [k for k in range(4) if k not in (first, second)]
    np.testing.assert_array_equal(mixed[variants], genes[variants])
    # Each of the two exchanged one individual and kept the other nineteen.
    assert (mixed_misfit[[first, second]] != misfit[[first, second]]).sum() == 2


def test_an_immigrant_brings_its_misfit() -> None:
    genes, _ = individuals(5)
    misfit = sphere(genes.reshape(-1, 3)).reshape(4, 20)
    mixed, mixed_misfit = operators.immigrate(genes, misfit, 1, 3)
    np.testing.assert_allclose(sphere(mixed.reshape(-1, 3)).reshape(4, 20), mixed_misfit)
