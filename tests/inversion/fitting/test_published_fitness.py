"""The published fitness and its scaling, by their equations written out."""

import math

import numpy as np
import pytest

from inversion.errors import ModelError, RecordError
from inversion.fitting.published_fitness import published_fitness, published_score

TIME = np.linspace(0.0, 1.0, 60)
MEASURED = 4e-4 * np.sin(np.pi * TIME) ** 2


def test_it_is_equation_16() -> None:
    predicted = np.stack([1.1 * MEASURED, 0.7 * MEASURED + 1e-5])
    expected = [
        1 / math.sqrt(sum((a - b) ** 2 for a, b in zip(row, MEASURED, strict=True)) / 60)
        + 1 / abs(max(row) - max(MEASURED))
        for row in predicted
    ]
    assert published_fitness(MEASURED, predicted) == pytest.approx(expected)
    # Of many individuals, and of one.
    assert published_fitness(MEASURED, predicted[None]).shape == (1, 2)
    assert float(published_fitness(MEASURED, predicted[0])) == pytest.approx(expected[0])


def test_the_best_of_a_population_is_the_nearest() -> None:
    fitness = published_fitness(MEASURED, np.array([[0.8], [0.98], [1.03], [1.4]]) * MEASURED)
    assert np.argmax(fitness) == 1
    assert published_score(fitness).argmax() == 1


@pytest.mark.parametrize("tempered", [False, True])
def test_floor_bounds_both_halves(tempered: bool) -> None:
    perfect = published_fitness(MEASURED, MEASURED, 1e-3, tempered)
    assert perfect == pytest.approx(2 / (1e-3 * MEASURED.max()))
    assert published_fitness(MEASURED, MEASURED) == pytest.approx(2 / (1e-6 * MEASURED.max()))


def test_a_peak_that_agrees_by_accident_counts_no_more_than_the_shape_when_tempered() -> None:
    # The same peak, half as wide.
    wrong = MEASURED.max() * np.sin(np.pi * TIME) ** 8
    wrong *= MEASURED.max() / wrong.max()
    rms = math.sqrt(np.mean((wrong - MEASURED) ** 2))
    assert published_fitness(MEASURED, wrong) == pytest.approx(
        1 / rms + 1 / (1e-6 * MEASURED.max())
    )
    assert published_fitness(MEASURED, wrong, tempered=True) == pytest.approx(2 / rms)


def test_scores_go_from_0_to_100() -> None:
    found = published_score([2.0, 5.0, 3.0])
    assert found == pytest.approx([0.0, 100.0, 100 / 3])
    assert published_score([2.0, 2.0]) == pytest.approx([100.0, 100.0])


def test_records_that_do_not_fit_are_refused() -> None:
    with pytest.raises(RecordError, match=r"got \(3,\) and \(2, 4\)"):
        published_fitness(np.ones(3), np.ones((2, 4)))
    with pytest.raises(RecordError, match=r"got \(2, 3\) and \(2, 3\)"):
        published_fitness(np.ones((2, 3)), np.ones((2, 3)))
    for nothing in (-np.ones(3), np.zeros(3), np.ones(0)):
        with pytest.raises(RecordError, match="positive peak"):
            published_fitness(nothing, np.ones(nothing.size))


@pytest.mark.parametrize("floor", [0.0, -1e-6, math.nan, math.inf])
def test_a_floor_has_to_be_positive(floor: float) -> None:
    with pytest.raises(ModelError, match=f"relative_floor > 0 and finite, got {floor}"):
        published_fitness(np.ones(3), np.ones(3), relative_floor=floor)
