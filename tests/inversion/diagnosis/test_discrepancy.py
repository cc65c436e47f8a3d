"""How well parameters are known where the residual has a memory, against what is known of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from inversion.diagnosis.discrepancy import Discrepancy
from inversion.diagnosis.fit import Fit
from inversion.threads import single_threaded_blas
from tests.inversion.synthetic import Array

SIZE = 400


@pytest.fixture(autouse=True)
def on_one_thread() -> Iterator[None]:
    """As the diagnosis has it."""
    with single_threaded_blas():
        yield


@dataclass
class Lines:
    """Residuals that are straight lines of the unknowns, as those of a point.

    Parameters
    ----------
    matrix : (n + p, k) ndarray, the rows of the priors last
    residual_there : (n + p,) ndarray
    drops : samples of each drop, all sensors; 0: left out
    sensors : int
    """

    matrix: Array
    residual_there: Array
    drops: Sequence[int]
    sensors: int = 1
    prior_weight: float = 0.0
    asked: list[Array] = field(default_factory=list)

    @property
    def points(self) -> list[Any]:
        drop = SimpleNamespace(observed=np.zeros((self.sensors, 1)))
        return [SimpleNamespace(drops=[drop] * len(self.drops))]

    def sizes(self, index: int) -> list[int]:
        return list(self.drops)

    def residual(self, index: int, device: Array, own: Array) -> Array:
        return self.residual_there

    def jacobian(self, index: int, device: Array, own: Array, there: Array) -> Array:
        self.asked.append(there)
        return self.matrix


def of(
    matrix: Array,
    residual: Array,
    drops: Sequence[int] | None = None,
    independent: float | None = None,
    **options: Any,
) -> Discrepancy:
    """Of a fit that left this."""
    count = sum(drops) if drops else residual.size
    problem: Any = Lines(matrix, residual, drops or [residual.size], **options)
    independent = float(count) if independent is None else independent
    cost = float(residual[:count] @ residual[:count])
    found = Fit(problem, np.zeros(0), (np.zeros(matrix.shape[1]),), cost, independent, np.eye(1))
    return Discrepancy.of(found)


def smooth(count: int = SIZE, unknowns: int = 3) -> Array:
    """Slow waves: what parameters of the ground change."""
    time = np.arange(count) / count
    return np.stack([np.cos(2 * np.pi * (k + 1) * time + k) for k in range(unknowns)], axis=1)


def with_memory(rng: np.random.Generator, tau: float, count: int = SIZE, rows: int = 1) -> Array:
    """Records of variance 1 whose correlation is e^(-lag / tau), (rows, n)."""
    rho = math.exp(-1.0 / tau)
    white = math.sqrt(1.0 - rho**2) * rng.standard_normal((rows, count + 400))
    found: Array = lfilter([1.0], [1.0, -rho], white, axis=1)[:, 400:]
    return found


# Drops of 1000 samples.
MANY = [1000] * 8


def many(tau: float) -> Array:
    """Of all of them, each for itself."""
    return with_memory(np.random.default_rng(2), tau, 1000, len(MANY)).ravel()


# --- memory --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [3.0, 8.0, 20.0])
def test_the_memory_of_a_known_residual(tau: float) -> None:
    found = of(smooth(8000), many(tau), drops=MANY)
    assert found.memory == pytest.approx(tau, rel=0.15)


def test_noise_without_memory_has_none() -> None:
    residual = np.random.default_rng(2).standard_normal(SIZE)
    found = of(smooth(), residual)
    assert found.memory == 0.0
    assert found.independent == SIZE


def test_the_memory_lies_between_the_samples_where_it_falls_through_1_over_e() -> None:
    # A moving sum of three: its correlation is 2/3 and 1/3 after one and two samples.
    white = np.random.default_rng(4).standard_normal((8, 1002))
    residual = (white[:, 2:] + white[:, 1:-1] + white[:, :-2]).ravel()
    expected = 1.0 + (2.0 / 3.0 - math.exp(-1.0)) / (1.0 / 3.0)
    found = of(smooth(8000), residual, drops=MANY)
    assert found.memory == pytest.approx(expected, abs=0.1)


def test_a_memory_is_at_most_a_quarter_of_a_record() -> None:
    found = of(smooth(), np.ones(SIZE))
    assert found.memory == SIZE / 4
    # The shortest record says how much.
    two = of(smooth(SIZE + 100), np.ones(SIZE + 100), drops=[SIZE, 100])
    assert two.memory == 25.0


def test_a_long_memory_leaves_few_that_tell_something_of_their_own() -> None:
    tau = 8.0
    found = of(smooth(8000), many(tau), drops=MANY)
    # The variance of a mean: (1 + rho) / (1 - rho) times that of white noise, about 2 tau.
    rho = math.exp(-1.0 / tau)
    of_drops = 1.0 + found.between * (len(MANY) - 1)
    assert found.independent == pytest.approx(8000 * (1 - rho) / (1 + rho) / of_drops, rel=0.15)
    # Never more than the problem counts.
    assert of(smooth(8000), many(tau), drops=MANY, independent=100.0).independent == 100.0


# --- between drops -------------------------------------------------------------------------------


@pytest.mark.parametrize("common", [0.0, 0.5, 0.9])
def test_drops_that_err_alike(common: float) -> None:
    rng = np.random.default_rng(6)
    shared = rng.standard_normal(1500)
    drops = [
        math.sqrt(common) * shared + math.sqrt(1 - common) * rng.standard_normal(1500)
        for _ in range(3)
    ]
    found = of(smooth(4500), np.concatenate(drops), drops=[1500] * 3)
    assert found.between == pytest.approx(common, abs=0.03)
    assert found.independent == pytest.approx(4500 / (1 + 2 * common), rel=0.05)


def test_drops_that_err_the_other_way_are_not_taken_for_less_than_independent() -> None:
    noise = np.random.default_rng(6).standard_normal(600)
    found = of(smooth(1200), np.concatenate([noise, -noise]), drops=[600, 600])
    assert found.between == 0.0


def test_sensors_of_a_drop_are_compared_each_with_its_own() -> None:
    """Two sensors, two drops: each sensor errs alike in both, and not as the other does."""
    rng = np.random.default_rng(6)
    first, second = rng.standard_normal((2, 750))
    residual = np.concatenate([first, second, first, second])
    found = of(smooth(3000), residual, drops=[1500, 1500], sensors=2)
    assert found.between == pytest.approx(1.0)
    turned = np.concatenate([first, second, second, first])
    assert of(smooth(3000), turned, drops=[1500, 1500], sensors=2).between < 0.05


def test_a_drop_that_is_left_out_has_no_part() -> None:
    residual = np.random.default_rng(6).standard_normal(SIZE)
    found = of(smooth(), residual, drops=[0, SIZE])
    alone = of(smooth(), residual)
    assert found.covariance == pytest.approx(alone.covariance)


def test_drops_of_other_lengths_are_compared_as_far_as_both_go() -> None:
    noise = np.random.default_rng(6).standard_normal(600)
    residual = np.concatenate([noise, noise[:400]])
    found = of(smooth(1000), residual, drops=[600, 400])
    common = float(noise[:400] @ noise[:400])
    assert found.between == pytest.approx(common / common)


# --- covariance ----------------------------------------------------------------------------------


def ordinary(matrix: Array) -> Array:
    found: Array = np.linalg.inv(matrix.T @ matrix)
    return found


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_white_noise_gives_the_ordinary_covariance(size: float) -> None:
    matrix = smooth(2000)
    residual = size * np.random.default_rng(3).standard_normal(2000)
    found = of(matrix, residual)
    assert found.covariance == pytest.approx(
        size**2 * ordinary(matrix), rel=0.04, abs=0.04 * size**2 * ordinary(matrix)[0, 0]
    )


def test_less_than_noise_counts_as_noise() -> None:
    matrix = smooth(2000)
    residual = 0.1 * np.random.default_rng(3).standard_normal(2000)
    found = of(matrix, residual)
    assert np.diag(found.covariance) == pytest.approx(np.diag(ordinary(matrix)), rel=1e-4)


def test_white_noise_counts_as_many_values_as_the_problem_does() -> None:
    """The residual's scale holds how many of its values are independent."""
    matrix = smooth(2000)
    residual = np.sqrt(0.25) * np.random.default_rng(3).standard_normal(2000)
    found = of(matrix, residual, independent=1000.0)
    expected = np.diag(ordinary(matrix))
    assert np.diag(found.covariance) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("tau", [5.0, 15.0])
def test_the_covariance_of_a_residual_with_memory(tau: float) -> None:
    """Against its closed form; the fit took nothing of a record so long."""
    count = 3000
    matrix = smooth(count)
    residual = with_memory(np.random.default_rng(8), tau, count=count)[0]
    found = of(matrix, residual)
    gain = np.linalg.solve(matrix.T @ matrix, matrix.T)
    expected = gain @ toeplitz(np.exp(-np.arange(count) / tau)) @ gain.T
    assert np.diag(found.covariance) == pytest.approx(np.diag(expected), rel=0.2)
    # White noise of the same size would be told to be known far better.
    assert np.all(np.diag(found.covariance) > 5.0 * np.diag(ordinary(matrix)))


def test_deviations_are_those_of_repeated_fits() -> None:
    """Parameters of many records whose errors have a memory and a part that drops share."""
    rng = np.random.default_rng(12)
    tau, common, repeats, size = 12.0, 0.6, 300, 300
    matrix = np.tile(smooth(size, 2), (3, 1))
    shared = with_memory(rng, tau, size, repeats)
    own = [with_memory(rng, tau, size, repeats) for _ in range(3)]
    noise = np.concatenate(
        [math.sqrt(common) * shared + math.sqrt(1 - common) * part for part in own], axis=1
    )
    gain = np.linalg.solve(matrix.T @ matrix, matrix.T)
    fits = noise @ gain.T
    told = []
    for errors, fitted in zip(noise[:60], fits[:60], strict=True):
        found = of(matrix, errors - matrix @ fitted, drops=[size] * 3)
        told.append(np.sqrt(np.diag(found.covariance)))
    spread = np.std(fits, axis=0)
    assert np.mean(told, axis=0) == pytest.approx(spread, rel=0.25)
    # As if it were white they would be known several times better.
    assert np.all(spread > 3.0 * np.sqrt(np.diag(ordinary(matrix))))


def test_what_drops_share_is_not_averaged_away() -> None:
    rng = np.random.default_rng(5)
    noise = 3.0 * rng.standard_normal(500)
    matrix = np.tile(smooth(500), (4, 1))
    alike = of(matrix, np.tile(noise, 4), drops=[500] * 4)
    single = of(matrix[:500], noise)
    # Four drops that err alike say no more than one.
    assert np.diag(alike.covariance) == pytest.approx(np.diag(single.covariance), rel=0.02)
    apart = of(matrix, 3.0 * rng.standard_normal(2000), drops=[500] * 4)
    assert np.diag(apart.covariance) == pytest.approx(0.25 * np.diag(single.covariance), rel=0.15)


def test_correlations_of_the_covariance_are_those_of_the_unknowns() -> None:
    waves = smooth(3000, 2)
    matrix = np.stack([waves[:, 0], 0.9 * waves[:, 0] + waves[:, 1]], axis=1)
    found = of(matrix, np.random.default_rng(3).standard_normal(3000)).covariance
    assert found == pytest.approx(found.T)
    expected = ordinary(matrix)
    correlation = expected[0, 1] / math.sqrt(expected[0, 0] * expected[1, 1])
    assert found[0, 1] / math.sqrt(found[0, 0] * found[1, 1]) == pytest.approx(
        correlation, abs=0.01
    )


def test_each_record_counts_with_its_own_size() -> None:
    """An unknown that one noisy drop alone shows is known as badly as that drop says."""
    rng = np.random.default_rng(9)
    quiet, loud = rng.standard_normal(1000), 10.0 * rng.standard_normal(1000)
    matrix = np.zeros((2000, 2))
    matrix[:1000, 0] = matrix[1000:, 1] = smooth(1000, 1)[:, 0]
    found = of(matrix, np.concatenate([quiet, loud]), drops=[1000, 1000])
    deviations = np.sqrt(np.diag(found.covariance))
    assert deviations[1] == pytest.approx(10.0 * math.sqrt(1 / 500.0), rel=0.1)
    # What the white residual of all of it says is the least.
    excess = math.sqrt((1.0 + 100.0) / 2.0)
    assert deviations[0] == pytest.approx(excess * math.sqrt(1 / 500.0), rel=0.1)


def test_what_the_fit_took_of_a_short_record_is_put_back() -> None:
    rng = np.random.default_rng(9)
    count, unknowns, repeats = 40, 10, 200
    matrix = smooth(count, unknowns)
    gain = np.linalg.solve(matrix.T @ matrix, matrix.T)
    told = []
    for _ in range(repeats):
        errors = 5.0 * rng.standard_normal(count)
        told.append(np.diag(of(matrix, errors - matrix @ (gain @ errors)).covariance))
    expected = 25.0 * np.diag(ordinary(matrix))
    assert np.mean(told, axis=0) == pytest.approx(expected, rel=0.15)


def test_a_fit_that_could_take_all_is_given_no_more_than_a_quarter_to_be_free() -> None:
    count = 40
    matrix = np.concatenate([smooth(count, 3)] * 1, axis=1)
    residual = 100.0 * np.ones(count)
    found = of(matrix, residual)
    # 40 samples of memory 10: two that are independent, for three unknowns.
    assert found.memory == count / 4
    gain = np.linalg.solve(matrix.T @ matrix, matrix.T)
    within = toeplitz(np.exp(-np.arange(count) / 10.0))
    expected = 100.0**2 / 0.25 * np.diag(gain @ within @ gain.T)
    white = 100.0**2 * np.diag(ordinary(matrix))
    assert np.diag(found.covariance) == pytest.approx(np.maximum(expected, white), rel=1e-6)


# --- priors --------------------------------------------------------------------------------------


def test_a_prior_counts_with_its_own_error() -> None:
    """An unknown that the records do not show is known as well as nature says."""
    matrix = np.zeros((2000 + 2, 2))
    matrix[:2000, 0] = smooth(2000, 1)[:, 0]
    weight, slope = 4.0, 25.0  # of the unit value: 1 / 25 is a standard deviation
    matrix[2001, 1] = weight * slope
    residual = np.append(np.random.default_rng(1).standard_normal(2000), [0.0, 2.0])
    found = of(matrix, residual, drops=[2000], prior_weight=weight)
    deviations = np.sqrt(np.diag(found.covariance))
    assert deviations[1] == pytest.approx(1 / slope, rel=0.05)
    assert deviations[0] == pytest.approx(math.sqrt(1 / 1000.0), rel=0.05)


def test_what_a_prior_leaves_is_no_residual_of_the_records() -> None:
    matrix = np.concatenate([smooth(), np.eye(3)])
    noise = np.random.default_rng(1).standard_normal(SIZE)
    near, far = (
        of(matrix, np.append(noise, np.full(3, apart)), drops=[SIZE], prior_weight=1.0)
        for apart in (0.0, 50.0)
    )
    assert far.memory == near.memory
    assert far.independent == near.independent
    assert far.covariance == pytest.approx(near.covariance)


def test_records_and_prior_share_what_both_tell() -> None:
    """As the mean of two observations, each weighed by its variance."""
    column = np.append(smooth(2000, 1)[:, 0], 30.0)[:, None]
    residual = np.append(np.random.default_rng(1).standard_normal(2000), 0.0)
    found = of(column, residual, drops=[2000], prior_weight=1.0)
    assert found.covariance[0, 0] == pytest.approx(1.0 / (1000.0 + 30.0**2), rel=0.05)


def test_the_derivatives_are_those_where_the_fit_ended() -> None:
    residual = np.random.default_rng(1).standard_normal(SIZE)
    problem: Any = Lines(smooth(), residual, [SIZE])
    Discrepancy.of(Fit(problem, np.zeros(0), (np.zeros(3),), SIZE, float(SIZE), np.eye(1)))
    assert problem.asked[0] is residual


def test_what_nothing_depends_on_is_not_known() -> None:
    """The mass of a plate that does not jump, the phase of a hum that is not there."""
    matrix = smooth(2000)
    matrix[:, 1] = 0.0
    found = of(matrix, np.random.default_rng(3).standard_normal(2000))
    assert found.covariance[1, 1] > 1e6
    assert np.isfinite(np.delete(np.delete(found.covariance, 1, 0), 1, 1)).all()
