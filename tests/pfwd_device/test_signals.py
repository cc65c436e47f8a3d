"""Offsets and displacements of raw records."""

import numpy as np
import pytest

from pfwd_device import Channel
from pfwd_device.signals import displacement_of, quiet_samples, remove_offset

TIME = np.arange(-10, 90) / 1000


def test_quiet_is_the_first_half_before_the_trigger() -> None:
    assert quiet_samples(TIME) == 5
    assert quiet_samples(TIME[10:]) == 0
    assert quiet_samples(TIME[9:]) == 0


def test_the_foot_of_the_pulse_before_the_trigger_is_not_taken_for_offset() -> None:
    load = 1900.0 + np.where(TIME > -0.004, 500.0, 0.0)
    np.testing.assert_allclose(remove_offset(TIME, load), load - 1900.0)


def test_without_a_pre_trigger_the_offset_is_left() -> None:
    np.testing.assert_array_equal(remove_offset(TIME[10:], np.full(90, 7.0)), np.full(90, 7.0))


def test_a_velocity_is_integrated_without_its_offset() -> None:
    velocity = 0.3 + np.where(TIME > 0, np.cos(20 * TIME) - 1, 0.0)
    expected = np.where(TIME > 0, np.sin(20 * TIME) / 20 - TIME, 0.0)
    found = displacement_of(Channel(0.0, "velocity", velocity), TIME)
    assert found[0] == 0.0
    np.testing.assert_allclose(found, expected, atol=2e-6)  # trapezoids: step^2/12 of the slope


def test_a_displacement_is_freed_of_its_offset_alone() -> None:
    values = 0.01 + np.maximum(TIME, 0.0)
    found = displacement_of(Channel(0.0, "displacement", values), TIME)
    assert found == pytest.approx(np.maximum(TIME, 0.0))
