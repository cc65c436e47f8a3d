"""Signals of a drop that the operators of the blind campaign change."""

import math

import numpy as np
import pytest

from simulators.mesh import Array
from tests.campaigns.effects.signals import Signals

STEP = 5e-5
TIME = np.arange(-300, 1400, dtype=float) * STEP
PULSE = 0.012


def half_sine(time: Array, duration: float = PULSE) -> Array:
    return np.where((time > 0) & (time < duration), np.sin(math.pi * time / duration), 0.0)


@pytest.fixture
def signals() -> Signals:
    """Velocity like one period of a sine: the displacement comes back to zero."""
    inside = (TIME > 0) & (TIME < 0.02)
    speed = np.where(inside, np.sin(2 * math.pi * TIME / 0.02), 0.0)
    moved = np.where(inside, 1 - np.cos(2 * math.pi * TIME / 0.02), 0.0) * 0.01 / math.pi
    sizes = 0.2 * np.array([1.0, 0.3])[:, None]
    return Signals(TIME, 8e3 * half_sine(TIME), sizes * speed, sizes * moved)
