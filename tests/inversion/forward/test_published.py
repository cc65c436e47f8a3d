"""The published method as a program: its accuracy, and the whole chain by another route."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests import reference
from tests.inversion.forward import published_method as published

RADIUS = 0.15
PRESSURE = 142e3
PULSE = 0.0133
SOIL: dict[str, float] = {
    "modulus": 40e6,
    "viscosity": 54e3,
    "density": 2000.0,
    "poisson_ratio": 0.35,
}
DROP: dict[str, float] = {
    "plate_radius": RADIUS,
    "peak_pressure": PRESSURE,
    "pulse_duration": PULSE,
}
USABLE = slice(0, 96)  # three quarters of the window of 128 steps


def displacement(**changes: Any) -> np.ndarray:
    """Trace of the default soil and drop with some parameters changed."""
    return published.published_displacement(**{**SOIL, **DROP, **changes})[1]


@pytest.mark.parametrize(
    ("modulus", "viscosity", "depth"),
    [(20e6, 0.0, 0.5), (60e6, 0.0, 3.0), (100e6, 0.0, 2.0), (30e6, 54e3, 1.0), (40e6, 0.0, None)],
)
def test_default_nodes_reach_the_stated_accuracy(
    modulus: float, viscosity: float, depth: float | None
) -> None:
    changes = {"modulus": modulus, "viscosity": viscosity, "bedrock_depth": depth}
    refined = displacement(**changes, segments=250, upper_limit=40.5 * math.pi / RADIUS)[USABLE]
    default = displacement(**changes)[USABLE]
    assert np.max(np.abs(default - refined)) < 2e-3 * refined.max()


@pytest.mark.parametrize("vector", reference.PHI_VECTORS)
def test_transfer_function_of_the_centre(vector: reference.PhiVector) -> None:
    shear = reference.shear_modulus(40e6, vector.poisson_ratio)
    s = np.sqrt(np.array(vector.z * shear / (2000.0 * RADIUS**2)))
    depth = None if vector.depth_over_radius is None else vector.depth_over_radius * RADIUS
    transfer = published.published_transfer(
        s,
        40e6,
        0.0,
        2000.0,
        vector.poisson_ratio,
        RADIUS,
        depth,
        segments=1000,
        upper_limit=200.5 * math.pi / RADIUS,
    )
    # The tail cut off at x = 200.5 pi is 1/x^2 of (1 - nu) / (2 pi).
    phi = complex(transfer) * shear / (math.pi * RADIUS)
    assert abs(phi - vector.centre) < 5e-7
