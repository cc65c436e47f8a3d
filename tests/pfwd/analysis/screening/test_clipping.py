"""Flat tops: clipped ones are found, natural ones are left alone."""

import numpy as np
import pytest

from pfwd.analysis.screening.drops import clipped_samples


def pulse(samples: int, phase: float = 0.3) -> np.ndarray:
    """A half-sine of so many samples amid rest, on a grid that its middle does not fall on."""
    x = (np.arange(-samples, 3 * samples) + phase) / samples
    return np.where((x > 0) & (x < 1), np.sin(np.pi * x), 0.0)


@pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("samples", [50, 270, 2000])
def test_clipped_samples_of_a_pulse_are_counted(samples: int, level: float) -> None:
    clipped = np.minimum(pulse(samples), level)
    assert clipped_samples(clipped) == np.count_nonzero(clipped == level)


@pytest.mark.parametrize("bits", [8, 10, 12, 16, 24])
@pytest.mark.parametrize("samples", [15, 50, 270, 2000, 20_000])
def test_a_rounded_pulse_is_not_clipped(samples: int, bits: int) -> None:
    step = 2.0**-bits
    assert clipped_samples(np.round(pulse(samples) / step) * step) == 0


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_a_pulse_with_three_digits_is_not_clipped(digits: int) -> None:
    text = [f"{value:.{digits - 1}e}" for value in 9.7e-3 * pulse(270)]
    assert clipped_samples(np.array(text, dtype=float)) == 0


def test_a_noisy_rounded_pulse_is_not_clipped() -> None:
    noise = np.random.default_rng(1).normal(0, 0.003, 2000)
    assert clipped_samples(np.round(pulse(500) + noise, 3)) == 0


def test_noise_below_the_clipping_does_not_hide_it() -> None:
    noise = np.random.default_rng(1).normal(0, 0.01, 2000)
    assert clipped_samples(np.minimum(pulse(500) + noise, 0.8)) > 100


def test_rest_at_either_end_is_no_clipping() -> None:
    assert clipped_samples(-pulse(100)) == 0
    assert clipped_samples(np.cumsum(pulse(100))) == 0


@pytest.mark.parametrize("values", [np.zeros(16), np.ones(3), np.arange(16.0)])
def test_records_without_a_top_are_not_clipped(values: np.ndarray) -> None:
    assert clipped_samples(values) == 0
