"""The bounded fit of unknowns in blocks, on residuals that are straight lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.diagnosis.fit import Fit, fit
from inversion.diagnosis.model import WHOLE, FitScope
from inversion.diagnosis.problem import Problem, Unknown
from inversion.effects import Parameter

Array = NDArray[np.float64]
PLAIN = Parameter("size", "-", 0.0, 1.0, (0.5,))
NATURAL = Parameter("size", "-", 0.0, 1.0, (0.5,), natural=True)


@dataclass
class Lines:
    """Residuals A_i (d, o_i) - b_i of points with shared unknowns d and own ones o_i."""

    matrices: Sequence[Array]
    right: Sequence[Array]
    width: int
    parameter: Parameter = PLAIN
    prior_weight: float = 0.0
    scope: FitScope = WHOLE

    @property
    def points(self) -> Sequence[Array]:
        return self.matrices

    @property
    def device(self) -> list[Unknown]:
        return [Unknown(self.parameter)] * self.width

    @property
    def own(self) -> list[list[Unknown]]:
        return [[Unknown(self.parameter)] * (m.shape[1] - self.width) for m in self.matrices]

    @property
    def size(self) -> int:
        return self.width + sum(map(len, self.own))

    @property
    def independent(self) -> float:
        return float(sum(r.size for r in self.right))

    def residual(self, index: int, device: Array, own: Array) -> Array:
        result: Array = self.matrices[index] @ np.concatenate([device, own]) - self.right[index]
        return result

    def jacobian(self, index: int, device: Array, own: Array, there: Array) -> Array:
        return self.matrices[index]

    def whole(self) -> tuple[Array, Array]:
        """One matrix and right side for all unknowns."""
        blocks, start = [], self.width
        for matrix in self.matrices:
            block = np.zeros((matrix.shape[0], self.size))
            count = matrix.shape[1] - self.width
            block[:, : self.width] = matrix[:, : self.width]
            block[:, start : start + count] = matrix[:, self.width :]
            start += count
            blocks.append(block)
        return np.concatenate(blocks), np.concatenate(self.right)


def lines(counts: Sequence[int], width: int, truth: Array, noise: float = 0.02) -> Lines:
    """Points with so many unknowns of their own."""
    rng = np.random.default_rng(3)
    matrices, right, start = [], [], width
    for count in counts:
        matrix = rng.standard_normal((30, width + count))
        at = np.concatenate([truth[:width], truth[start : start + count]])
        start += count
        matrices.append(matrix)
        right.append(matrix @ at + noise * rng.standard_normal(30))
    return Lines(matrices, right, width)


def fitted(problem: Lines, start: float = 0.5) -> Fit:
    given: Problem = problem  # type: ignore[assignment]
    own = [np.full(len(unknowns), start) for unknowns in problem.own]
    return fit(given, np.full(problem.width, start), own)


INSIDE = np.array([0.3, 0.6, 0.8, 0.2, 0.45])


@pytest.mark.parametrize("counts", [(4,), (2, 2)])
def test_a_minimum_inside_is_that_of_least_squares(counts: tuple[int, ...]) -> None:
    problem = lines(counts, 1, INSIDE)
    matrix, right = problem.whole()
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0]
    found = fitted(problem)
    assert found.unit_values == pytest.approx(expected, abs=1e-3)
    assert found.cost == pytest.approx(float(np.sum((matrix @ expected - right) ** 2)), rel=1e-3)
    assert found.normal == pytest.approx(matrix.T @ matrix)
    assert found.at_bound() == []
    assert len(found.unknowns) == 5
    assert found.independent == 30 * len(counts)


@pytest.mark.parametrize("counts", [(4,), (2, 2)])
@pytest.mark.parametrize(("beyond", "end"), [(1.4, 1.0), (-0.3, 0.0)])
def test_what_would_go_on_stays_at_the_bound_and_is_named(
    counts: tuple[int, ...], beyond: float, end: float
) -> None:
    truth = INSIDE.copy()
    truth[2] = beyond
    problem = lines(counts, 1, truth)
    found = fitted(problem)
    assert found.unit_values[2] == pytest.approx(end, abs=1e-3)
    (unknown,) = found.at_bound()
    assert unknown.parameter is PLAIN
    # The others are as good as they can be with that one held.
    matrix, right = problem.whole()
    free = np.array([0, 1, 3, 4])
    held = np.linalg.lstsq(matrix[:, free], right - end * matrix[:, 2], rcond=None)[0]
    assert found.unit_values[free] == pytest.approx(held, abs=5e-3)


class Halved(Parameter):
    """A value that jumps in the middle of its range."""

    def stretch(self, unit_value: float) -> tuple[float, float]:
        return (0.0, 0.5) if unit_value < 0.5 else (0.5, 1.0)


@pytest.mark.parametrize("counts", [(4,), (2, 2)])
@pytest.mark.parametrize(
    ("start", "there", "end"), [(0.4, 0.7, 0.5), (0.6, 0.3, 0.5), (0.4, 0.3, 0.3)]
)
def test_a_fit_does_not_go_beyond_a_jump(
    counts: tuple[int, ...], start: float, there: float, end: float
) -> None:
    # The others lie where all of them may go to.
    truth = np.full(5, 0.2 if start < 0.5 else 0.8)
    truth[2] = there
    problem = lines(counts, 1, truth)
    problem.parameter = Halved("size", "-", 0.0, 1.0)
    found = fitted(problem, start)
    assert found.unit_values[2] == pytest.approx(end, abs=0.02 if end == there else 1e-3)
    assert len(found.at_bound()) == (end != there)


def test_a_bound_of_nature_is_not_named() -> None:
    truth = INSIDE.copy()
    truth[2] = -0.3
    problem = lines((4,), 1, truth)
    problem.parameter = NATURAL
    assert fitted(problem).at_bound() == []


def test_deviations_are_those_of_the_noise_or_of_what_is_left() -> None:
    # The residual counts in units of its noise.
    problem = lines((4,), 1, INSIDE, noise=0.5)
    problem.matrices = [20.0 * m for m in problem.matrices]
    problem.right = [20.0 * r for r in problem.right]
    matrix, _ = problem.whole()
    plain = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    found = fitted(problem)
    assert found.excess == pytest.approx(np.sqrt(found.cost / 30))
    assert found.excess > 5
    assert found.deviations() == pytest.approx(found.excess * plain, rel=1e-3)
    quiet = fitted(lines((4,), 1, INSIDE, noise=1e-3))
    matrix, _ = lines((4,), 1, INSIDE).whole()
    assert quiet.excess < 1
    assert quiet.deviations() == pytest.approx(
        np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))), rel=1e-3
    )


def test_what_nothing_depends_on_is_not_known() -> None:
    problem = lines((4,), 1, INSIDE)
    problem.matrices[0][:, 3] = 0.0
    deviations = fitted(problem).deviations()
    assert deviations[3] > 1e3
    assert max(np.delete(deviations, 3)) < 1


@pytest.mark.parametrize("start", [-0.5, 0.0, 1.0, 1.5])
@pytest.mark.parametrize("counts", [(4,), (2, 2)])
def test_a_start_outside_is_brought_inside(counts: tuple[int, ...], start: float) -> None:
    problem = lines(counts, 1, INSIDE)
    matrix, right = problem.whole()
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0]
    assert fitted(problem, start).unit_values == pytest.approx(expected, abs=2e-3)
