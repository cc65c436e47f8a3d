"""Modulus from an accelerometer: a simulated drop, recorded with 16 bits over 200 g."""

from pathlib import Path

import numpy as np
import pytest

import pfwd
from simulators.demo import DEMO_PLATE, demo_ground, demo_simulations
from simulators.traces import Recording, write_traces

NOISE = 50e-6 * 9.80665  # m/s2 per root Hz
STEP = 400 * 9.80665 / 2**16


def test_the_modulus_is_that_of_the_ground(tmp_path: Path) -> None:
    seed = 101
    drops = demo_simulations(1, seed)
    bandwidth = 0.5 / float(drops[0].time[1] - drops[0].time[0])
    recording = Recording(
        quantity="acceleration",
        sensor_noise=NOISE * np.sqrt(bandwidth),
        sensor_resolution=STEP,
        load_noise=0.003 * float(drops[0].load.max()),
    )
    path = write_traces(tmp_path / "drop.csv", drops, DEMO_PLATE, 0.35, recording, seed)
    (result,) = pfwd.invert(path)
    truth = demo_ground(seed).layers[0].modulus
    assert result.modulus_pa == pytest.approx(truth, rel=0.01)
    low, high = result.modulus_interval_pa
    assert low <= truth <= high
