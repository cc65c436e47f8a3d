"""The fitness of the published method by its equation written out, and its search."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.inference.published import published_fitness, published_unknowns
from tests.inversion.synthetic import RADIUS, Scene, record

TIME = np.linspace(0.0, 1.0, 60)
MEASURED = 4e-4 * np.sin(np.pi * TIME) ** 2


def test_the_fitness_is_equation_16() -> None:
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


def test_a_peak_that_agrees_by_accident_counts_no_more_than_the_shape_when_tempered() -> None:
    # The same peak, half as wide.
    wrong = MEASURED.max() * np.sin(np.pi * TIME) ** 8
    wrong *= MEASURED.max() / wrong.max()
    rms = math.sqrt(np.mean((wrong - MEASURED) ** 2))
    assert published_fitness(MEASURED, wrong) == pytest.approx(
        1 / rms + 1 / (1e-6 * MEASURED.max())
    )
    assert published_fitness(MEASURED, wrong, tempered=True) == pytest.approx(2 / rms)


@pytest.mark.parametrize("tempered", [False, True])
def test_a_perfect_fit_has_a_finite_fitness(tempered: bool) -> None:
    perfect = published_fitness(MEASURED, MEASURED, tempered)
    assert perfect == pytest.approx(2 / (1e-6 * MEASURED.max()))


def test_undeclared_quantities_are_searched_between_bounds(library: SurrogateLibrary) -> None:
    drop = record(library, Scene())

    def bounds(elastic: bool = False, **declared: float) -> dict[str, tuple[float, float]]:
        records = PointRecords("p", (replace(drop, **declared),), (1,), elastic)
        point = Point(records, library, "rigid-smooth")
        return {
            p.name: (p.lower / (point.peak_modulus if p.name == "modulus" else 1.0), p.upper)
            for p in published_unknowns(point)
        }

    every = bounds()
    assert list(every) == ["modulus", "viscosity", "density", "bedrock_depth"]
    assert every["modulus"][0] == pytest.approx(0.12)
    assert every["viscosity"][1] >= 4e5
    assert every["density"] == (1000.0, 2800.0)
    assert every["bedrock_depth"] == pytest.approx((1.6 * RADIUS, 60 * RADIUS), rel=2e-3)
    assert list(bounds(True, density=1900.0, bedrock_depth=1.0)) == ["modulus"]
