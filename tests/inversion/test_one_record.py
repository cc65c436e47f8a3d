"""Other grounds under other instruments that give the same record (docs/validation.md).

Each follows from w/F = Phi(p, h/a) / (G* a + m s^2 Phi) R with p = s a sqrt(rho/G*).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from inversion import ForwardModel, Grounds, Instrument, SurrogateLibrary
from inversion.forward.laplace import FULL_BAND_HZ
from tests.inversion.synthetic import (
    DENSITY,
    DEPTH,
    MODULUS,
    RADIUS,
    STEP,
    TRUTH,
    VISCOSITY,
    Array,
    Scene,
    half_sine,
    surrogate,
)

MASS, FREQUENCY, DAMPING = 10.0, 4.5, 0.6


@dataclass(frozen=True)
class Factors:
    """Factors on ground, instrument and record."""

    modulus: float = 1.0
    viscosity: float = 1.0
    density: float = 1.0
    depth: float = 1.0
    radius: float = 1.0
    mass: float = 1.0
    frequency: float = 1.0
    load: float = 1.0
    time: float = 1.0
    displacement: float = 1.0


def displacement(library: SurrogateLibrary, factors: Factors) -> Array:
    time = STEP * np.arange(250)
    values = (
        factors.modulus * TRUTH[MODULUS],
        factors.viscosity * TRUTH[VISCOSITY],
        factors.density * TRUTH[DENSITY],
        1.0 / (factors.depth * TRUTH[DEPTH]),
    )
    instrument = Instrument(
        factors.radius * RADIUS,
        factors.mass * MASS,
        geophone_natural_frequency=factors.frequency * FREQUENCY,
        geophone_damping=DAMPING,
    )
    model = ForwardModel(
        surrogate(library, (0.0,)),
        instrument,
        factors.time * time,
        factors.load * half_sine(time, Scene()),
        factors.time * time[1:],
        FULL_BAND_HZ / factors.time,
    )
    grounds = Grounds(*(np.array([value]) for value in values))
    return np.asarray(model.displacement(grounds)[0, -1])


@pytest.mark.parametrize(
    "factors",
    [
        Factors(load=2.0, modulus=2.0, viscosity=2.0, density=2.0, mass=2.0),
        Factors(radius=0.5, modulus=2.0, viscosity=2.0, density=8.0, depth=0.5),
        # The integral of a velocity over half the time is half the displacement.
        Factors(time=0.5, displacement=0.5, modulus=2.0, density=0.5, mass=0.5, frequency=2.0),
        Factors(time=0.5, viscosity=0.5, density=0.25, mass=0.25, frequency=2.0),
    ],
    ids=["load gain", "plate radius", "time axis of velocities", "time axis of displacements"],
)
def test_another_ground_gives_the_same_record(factors: Factors, library: SurrogateLibrary) -> None:
    expected = factors.displacement * displacement(library, Factors())
    result = displacement(library, factors)
    assert result == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
