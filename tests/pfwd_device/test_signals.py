r"""Offsets and displacements of raw records; correction for the response against closed forms.

A geophone obeys u'' + 2 h w u' + w^2 u = v''. For v a step of 1 at t = 0 and h < 1,
u = exp(-h w t) (cos(d t) - (h w / d) sin(d t)) with d = w sqrt(1 - h^2).
"""

import numpy as np
import pytest

from pfwd_device import Channel
from pfwd_device.signals import correct_response, displacement_of, quiet_samples, remove_offset

TIME = np.arange(-10, 90) / 1000
RATE = 20_000.0
LONG_TIME = np.arange(4000) / RATE


def test_quiet_is_the_first_half_before_the_trigger() -> None:
    assert quiet_samples(TIME) == 5
    assert quiet_samples(TIME[10:]) == 0
    assert quiet_samples(TIME[9:]) == 0


def test_the_foot_of_the_pulse_is_no_offset() -> None:
    load = 1900.0 + np.where(TIME > -0.004, 500.0, 0.0)
    np.testing.assert_allclose(remove_offset(TIME, load), load - 1900.0)


def test_without_a_pre_trigger_no_offset_is_removed() -> None:
    np.testing.assert_array_equal(remove_offset(TIME[10:], np.full(90, 7.0)), np.full(90, 7.0))


def test_a_velocity_is_integrated_without_its_offset() -> None:
    velocity = 0.3 + np.where(TIME > 0, np.cos(20 * TIME) - 1, 0.0)
    expected = np.where(TIME > 0, np.sin(20 * TIME) / 20 - TIME, 0.0)
    displacement = displacement_of(Channel(0.0, "velocity", velocity), TIME)
    assert displacement[0] == 0.0
    np.testing.assert_allclose(
        displacement, expected, atol=2e-6
    )  # trapezoids: step^2/12 of the slope


def test_a_displacement_is_freed_of_its_offset_alone() -> None:
    values = 0.01 + np.maximum(TIME, 0.0)
    displacement = displacement_of(Channel(0.0, "displacement", values), TIME)
    assert displacement == pytest.approx(np.maximum(TIME, 0.0))


def step_response(frequency: float, damping: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    d = w * np.sqrt(1 - damping**2)
    swing = np.cos(d * LONG_TIME) - damping * w / d * np.sin(d * LONG_TIME)
    return np.asarray(np.exp(-damping * w * LONG_TIME) * swing)


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.6), (10.0, 0.3), (4.5, 0.05)])
def test_a_step_comes_back(frequency: float, damping: float) -> None:
    corrected = correct_response(step_response(frequency, damping), RATE, frequency, damping)
    np.testing.assert_allclose(corrected, 1.0, atol=2e-5)


def test_the_error_falls_with_the_square_of_the_step() -> None:
    errors = []
    for stride in (1, 2, 4):
        record = step_response(30.0, 0.5)[::stride]
        errors.append(np.abs(correct_response(record, RATE / stride, 30.0, 0.5) - 1).max())
    assert errors[1] / errors[0] == pytest.approx(4, rel=0.1)
    assert errors[2] / errors[1] == pytest.approx(4, rel=0.1)
