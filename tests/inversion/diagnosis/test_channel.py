"""Observed displacement of a channel in a diagnosis, its baseline and its noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from inversion.diagnosis.channel import MotionChannel
from inversion.measured.record import ChannelNoise, NoiseModel, Sensor
from inversion.threads import single_threaded_blas

STEP, FIRST, COUNT = 1e-4, 200, 700
TIME = STEP * (np.arange(COUNT) - FIRST)
SAMPLES = np.arange(0, COUNT, 5)


def noise(correlation: float, baseline: int, quantity: str) -> ChannelNoise:
    covariance = correlation ** np.arange(1 if correlation == 0 else 120)
    return ChannelNoise(NoiseModel(covariance, FIRST), quantity == "velocity", baseline)


def channel(values: np.ndarray, quantity: str, correlation: float = 0.0) -> MotionChannel:
    baseline = 100 if quantity == "velocity" else 20
    sensor = Sensor(0.0, quantity, values)
    return MotionChannel(sensor, noise(correlation, baseline, quantity), FIRST, SAMPLES, STEP)


def pulse(time: np.ndarray) -> np.ndarray:
    inside = (time > 0) & (time < 0.02)
    return np.where(inside, 4e-4 * np.sin(np.pi * time / 0.02) ** 2, 0.0)


def speed(time: np.ndarray) -> np.ndarray:
    inside = (time > 0) & (time < 0.02)
    return np.where(inside, 4e-4 * np.pi / 0.02 * np.sin(2 * np.pi * time / 0.02), 0.0)


def test_a_velocity_is_integrated_without_its_offset() -> None:
    motion = channel(speed(TIME) + 0.003, "velocity")
    # The trapezoidal rule is as good as its step.
    np.testing.assert_allclose(motion.observed, pulse(TIME[SAMPLES]), atol=5e-8)


def test_a_displacement_is_zero_where_the_pulse_begins() -> None:
    motion = channel(pulse(TIME) + 5e-4, "displacement")
    np.testing.assert_allclose(motion.observed, pulse(TIME[SAMPLES]), atol=1e-12)


def test_a_prediction_is_read_like_the_record() -> None:
    # Drift of a velocity: its mean before the pulse goes, in the record and in the prediction.
    drift = 0.02 * TIME + 0.004
    motion = channel(drift, "velocity")
    predicted = 0.004 * TIME[SAMPLES] + 0.01 * TIME[SAMPLES] ** 2
    np.testing.assert_allclose(motion.read(predicted), motion.observed, atol=2e-9)
    assert np.abs(motion.observed).max() > 2e-5  # it is the drift that is compared, not nothing


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_weighted_noise_is_white(quantity: str, correlation: float) -> None:
    rng = np.random.default_rng(4)
    white = np.sqrt(1 - correlation**2) * rng.standard_normal((300, COUNT + 100))
    values = lfilter([1.0], [1.0, -correlation], white, axis=1)[:, 100:]
    with single_threaded_blas():
        motion = channel(values[0], quantity, correlation)
        covariance = motion.noise_covariance(slice(0, SAMPLES.size), np.full(SAMPLES.size, 1e-9))
        covariance += 1e-6 * np.trace(covariance) / SAMPLES.size * np.eye(SAMPLES.size)
        whitener = np.linalg.inv(np.linalg.cholesky(covariance))
        observed = [channel(row, quantity, correlation).observed for row in values]
        weighted = np.array(observed) @ whitener.T
    square = np.mean(weighted**2, axis=0)
    # Where the record is taken to zero nothing is left to be weighted.
    assert np.median(square) == pytest.approx(1.0, abs=0.1)
    assert np.mean(square) == pytest.approx(1.0, abs=0.15)
    assert abs(np.mean(weighted[:, 1:] * weighted[:, :-1])) < 0.1
