"""Steps in records: missing samples, switched ranges, and records without steps."""

from __future__ import annotations

import numpy as np
import pytest

from inversion.measured.bad_sensors import find_step
from tests.inversion.synthetic import Array

STEP_S = 1e-4
TIME = STEP_S * np.arange(-200, 400)
FIRST, END = 200, 400
PULSE_S = 0.018


def pulse(noise: float = 3e-3, seed: int = 1) -> Array:
    """Velocity of a plate under a pulse, over its peak."""
    inside = (TIME > 0.0) & (TIME < PULSE_S)
    velocity = np.where(inside, np.sin(2 * np.pi * TIME / PULSE_S), 0.0)
    rng = np.random.default_rng(seed)
    result: Array = velocity + noise * rng.standard_normal(TIME.size)
    return result


def test_missing_samples_are_detected() -> None:
    complete = pulse()
    lost = np.append(np.delete(complete, slice(250, 256)), complete[-6:])
    assert find_step(lost, FIRST, END) == 250
    assert find_step(complete, FIRST, END) is None


def test_a_switched_range_is_detected() -> None:
    record = pulse()
    record[240:] *= 1.1
    assert find_step(record, FIRST, END) == 240


def test_steps_outside_the_pulse_do_not_count() -> None:
    for place in (100, 450):
        record = pulse()
        record[place:] += 0.3
        assert find_step(record, FIRST, END) is None


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_bends_are_no_steps(seed: int) -> None:
    clipped = np.minimum(pulse(seed=seed), 0.6)
    assert find_step(clipped, FIRST, END) is None
    rng = np.random.default_rng(seed)
    ringing = 0.1 * np.sin(2 * np.pi * 260.0 * TIME) * (TIME > 0.004)
    slow = np.cumsum(1e-3 * rng.standard_normal(TIME.size))
    assert find_step(pulse(seed=seed) + ringing + slow, FIRST, END) is None


@pytest.mark.parametrize(("deviations", "result"), [(7.9, False), (8.1, True)])
def test_a_step_is_larger_than_eight_deviations(deviations: float, result: bool) -> None:
    """The reference is a separate fit to fourteen samples, with the noise before the pulse."""
    rng = np.random.default_rng(3)
    record = rng.standard_normal(TIME.size)
    around = np.arange(14) - 6.5
    shapes = np.column_stack([around**0, around, around**2, around**3, around > 0.0])

    def rest(values: Array) -> float:
        return float(np.sqrt(np.linalg.lstsq(shapes, values, rcond=None)[1][0] / 9.0))

    median_deviation = np.median([rest(record[i : i + 14]) for i in range(FIRST - 14)])
    # Around the step nothing but the step, so that noise is what there is before the pulse.
    record[FIRST:END] = 0.0
    deviation = median_deviation * np.sqrt(np.linalg.inv(shapes.T @ shapes)[4, 4])
    record[300:] += deviations * deviation
    assert (find_step(record, FIRST, END - 20) == 300) == result
    assert (find_step(record, FIRST, END - 20) is not None) == result


def test_a_short_record_has_no_step() -> None:
    assert find_step(np.array([0.0] * 6 + [1.0] * 7), 0, 13) is None
