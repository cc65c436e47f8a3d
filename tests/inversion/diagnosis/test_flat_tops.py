"""Where a record was cut off, and where a rounded top only looks like it."""

import numpy as np
import pytest

from inversion.diagnosis.flat_tops import flat_level, flat_velocity
from inversion.measured.record import Sensor

TIME = np.arange(600) * 1e-4
PULSE = np.where(TIME < 0.02, np.sin(np.pi * TIME / 0.02) ** 2, 0.0)


@pytest.mark.parametrize("level", [0.6, 0.85, 0.95])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_cut_off_top_is_seen_and_a_rounded_one_is_not(level: float, noise: float) -> None:
    rng = np.random.default_rng(2)
    pulse = np.sin(np.pi * np.arange(300) / 100) * np.exp(-np.arange(300) / 150)
    pulse = pulse / pulse.max()
    hiss = noise * rng.standard_normal(300)
    assert flat_level(pulse + hiss, noise) is None
    cut = np.clip(pulse, -level, level) + hiss
    assert flat_level(cut, noise) == pytest.approx(level, abs=3 * noise + 1e-9)


def test_a_noisy_displacement_is_not_taken_for_a_clipped_velocity() -> None:
    rng = np.random.default_rng(3)
    still = Sensor(0.0, "displacement", 1e-6 * rng.standard_normal(400))
    assert flat_velocity(still, 1e-6, 1e-4, largest=True) is None
    moving = Sensor(0.0, "displacement", 5e-4 * PULSE)
    level = flat_velocity(moving, 1e-8, 1e-4, largest=True)
    assert level is not None
    assert 0.9 * 5e-4 * np.pi / 0.02 < level <= 5e-4 * np.pi / 0.02
    assert flat_velocity(moving, 1e-8, 1e-4, largest=False) is None
