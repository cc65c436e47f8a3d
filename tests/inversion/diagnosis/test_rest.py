"""Noise of a point's drops, estimated from all of them."""

import numpy as np
import pytest
from scipy.signal import lfilter

from inversion import Record, Sensor
from inversion.diagnosis.rest import estimate_pre_trigger_noise
from inversion.forward.model import Instrument
from inversion.measured.record import NoiseModel, prepare

STEP, QUIET = 2e-4, 60


def drop(seed: int, loudness: float, correlation: float = 0.8) -> Record:
    """A pulse of 16 ms with slow noise of a velocity channel, and a silent displacement channel."""
    time = STEP * np.arange(-2 * QUIET, 300)
    load = 8000.0 * np.sin(np.pi * np.clip(time / 0.016, 0.0, 1.0))
    steps = np.random.default_rng(seed).standard_normal(time.size + 500)
    noise = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], steps)[500:]
    velocity = 0.1 * np.sin(2 * np.pi * np.clip(time / 0.016, 0.0, 1.0))
    sensors = (
        Sensor(0.3, "displacement", velocity),
        Sensor(0.0, "velocity", velocity + loudness * noise),
    )
    return Record(time, load, sensors, Instrument(0.15, 10.0), bedrock_depth=np.inf)


def noisy(records: list[Record]) -> list[NoiseModel]:
    """Return the noise models of the sensor at the plate, the last in the records."""
    return [is_common.drop.channels[0].model for is_common in estimate_pre_trigger_noise(records)]


def test_drops_of_equal_noise_share_a_noise_model() -> None:
    records = [drop(seed, 1e-3) for seed in range(3)]
    result = noisy(records)
    alone = [prepare(record.nearest_first()).channels[0].model for record in records]
    variances = np.array([model.autocovariance[0] for model in alone])
    next_ones = np.array([model.autocovariance[1] for model in alone])
    counts = np.array([model.samples for model in alone])
    for model in result:
        assert model.autocovariance[0] == pytest.approx(counts @ variances / counts.sum())
        assert model.autocovariance[1] == pytest.approx(counts @ next_ones / counts.sum())
        assert model.samples == counts.sum()
        ratios = model.autocovariance[1:6] / model.autocovariance[:5]
        assert ratios == pytest.approx(np.full(5, ratios[0]))


def test_how_slow_noise_is_comes_out_closer_by_more_drops() -> None:
    def errors(count: int) -> float:
        result = []
        for group in range(40):
            records = [drop(1000 * count + 10 * group + k, 1e-3) for k in range(count)]
            model = noisy(records)[0]
            result.append(model.autocovariance[1] / model.autocovariance[0] - 0.8)
        return float(np.sqrt(np.mean(np.square(result))))

    assert errors(4) < 0.75 * errors(1)


@pytest.mark.parametrize(("times", "is_common"), [(1.85, True), (2.2, False)])
def test_a_louder_drop_has_a_separate_noise_model(times: float, is_common: bool) -> None:
    # The same noise, so that nothing but the loudness differs.
    records = [drop(5, 1e-3), drop(5, 1e-3), drop(5, times * 1e-3)]
    quiet, _, loud = (model.rms for model in noisy(records))
    if is_common:
        assert loud == quiet
    else:
        assert loud == pytest.approx(times * quiet, rel=1e-6)
    softer = [drop(5, 1e-3), drop(5, 1e-3), drop(5, 1e-3 / times)]
    assert (noisy(softer)[2].rms == noisy(softer)[0].rms) == is_common


def test_the_displacements_noise_is_that_of_the_common_model() -> None:
    records = [drop(seed, 1e-3) for seed in range(3)]
    together = [is_common.drop.noise[0] for is_common in estimate_pre_trigger_noise(records)]
    assert together == pytest.approx([together[0]] * 3)
    alone = [prepare(record.nearest_first()).with_tail().noise[0] for record in records]
    assert min(alone) < together[0] < max(alone)


def test_a_channel_without_noise_stays_without() -> None:
    result = estimate_pre_trigger_noise([drop(seed, 1e-3) for seed in range(2)])
    assert all(is_common.drop.noise[1] == 0.0 for is_common in result)


def test_a_single_drop_has_its_pre_trigger_noise() -> None:
    record = drop(3, 1e-3)
    assert noisy([record])[0].rms == prepare(record.nearest_first()).channels[0].model.rms
