"""Carrier of a sensor: a damped oscillation that the plate's motion drives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inversion.effects.carrier_resonance import CarrierResonance
from tests.inversion.effects.drop_contexts import context

STEP = 2e-5
TIME = STEP * np.arange(10_000)
VALUES = {"strength": 0.05, "frequency": 50.0, "damping": 0.04}


DROP = context(time=TIME, offsets=np.zeros(1), load=np.zeros_like(TIME))


def test_a_step_of_the_plate_lets_the_carrier_swing_in_closed_form() -> None:
    step = np.ones((1, TIME.size))
    swing = CarrierResonance().record(step, VALUES, DROP) - step
    omega, damping = 2 * math.pi * VALUES["frequency"], VALUES["damping"]
    damped = omega * math.sqrt(1 - damping**2)
    # Inverse transform of s / (s^2 + 2 h omega s + omega^2).
    ratio = damping * omega / damped
    expected = np.exp(-damping * omega * TIME) * (
        np.cos(damped * TIME) - ratio * np.sin(damped * TIME)
    )
    assert swing[0, 10:] == pytest.approx(VALUES["strength"] * expected[10:], abs=1e-4)
