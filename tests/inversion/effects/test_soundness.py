"""Values that do not describe what an effect is meant to be."""

from __future__ import annotations

import numpy as np
import pytest

from inversion.effects import BY_NAME, Ground
from inversion.forward.layered import Medium
from tests.inversion.effects.test_effects import context

GROUND = Ground(45e6, 45e3, 1900.0, 1.0, 12.0)
FOUR = np.array([0.0, 0.3, 0.6, 0.9])


@pytest.mark.parametrize(
    ("frequency", "sound"), [(50.0, True), (60.9, True), (51.0, False), (59.0, False)]
)
def test_hum_keeps_to_what_mains_do(frequency: float, sound: bool) -> None:
    values = {"amplitude": 1e-3, "frequency": frequency, "phase": 0.0}
    assert BY_NAME["mains_hum"].is_sound(GROUND, values, context()) == sound


@pytest.mark.parametrize(("damping", "sound"), [(0.29, True), (0.31, False)])
def test_what_swings_is_damped_little(damping: float, sound: bool) -> None:
    values = {"strength": 0.05, "frequency": 45.0, "damping": damping}
    assert BY_NAME["carrier_resonance"].is_sound(GROUND, values, context()) == sound


@pytest.mark.parametrize(
    ("ratio", "thickness", "sound"),
    [
        (2.0, 0.3, True),
        (0.06, 0.3, True),
        (0.04, 0.3, False),
        (2.0, 0.78, True),
        (2.0, 0.82, False),
    ],
)
def test_a_layer_lies_on_ground_that_is_left_and_is_no_rock(
    ratio: float, thickness: float, sound: bool
) -> None:
    above = (Medium(ratio * 45e6, 45e3, 1900.0, 0.35, thickness),)
    ground = Ground(45e6, 45e3, 1900.0, 1.0, 12.0, above=above)
    values = {"modulus_ratio": ratio, "thickness": thickness}
    assert BY_NAME["layer"].is_sound(ground, values, context(offsets=FOUR)) == sound
