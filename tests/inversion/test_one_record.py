"""Other grounds under other instruments that give the same record (docs/validation.md).

Each follows from w/F = Phi(p, h/a) / (G* a + m s^2 Phi) R with p = s a sqrt(rho/G*).
"""

from __future__ import annotations

from collections import defaultdict

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


def displacement(library: SurrogateLibrary, **factors: float) -> Array:
    """Return the record with factors on ground, instrument and record."""
    f = defaultdict(lambda: 1.0, factors)
    soil = [f[name] * TRUTH[name] for name in (MODULUS, VISCOSITY, DENSITY, DEPTH)]
    instrument = Instrument(
        f["radius"] * RADIUS,
        f["mass"] * MASS,
        geophone_natural_frequency=f["frequency"] * FREQUENCY,
        geophone_damping=DAMPING,
    )
    time, load = f["time"] * STEP * np.arange(250), half_sine(STEP * np.arange(250), Scene())
    model = ForwardModel(
        surrogate(library, (0.0,)),
        instrument,
        time,
        f["load"] * load,
        time[1:],
        FULL_BAND_HZ / f["time"],
    )
    grounds = Grounds(*np.array([*soil[:3], 1.0 / soil[3]])[:, None])
    return f["displacement"] * np.asarray(model.displacement(grounds)[0, -1])


@pytest.mark.parametrize(
    "factors",
    [
        {"load": 2.0, MODULUS: 2.0, VISCOSITY: 2.0, DENSITY: 2.0, "mass": 2.0},
        {"radius": 0.5, MODULUS: 2.0, VISCOSITY: 2.0, DENSITY: 8.0, DEPTH: 0.5},
        # The integral of a velocity over half the time is half the displacement.
        {"time": 0.5, "displacement": 2.0, MODULUS: 2.0, DENSITY: 0.5, "mass": 0.5, "frequency": 2},
        {"time": 0.5, VISCOSITY: 0.5, DENSITY: 0.25, "mass": 0.25, "frequency": 2.0},
    ],
    ids=["load gain", "plate radius", "time axis of velocities", "time axis of displacements"],
)
def test_another_ground_gives_the_same_record(
    factors: dict[str, float], library: SurrogateLibrary
) -> None:
    expected, result = displacement(library), displacement(library, **factors)
    assert result == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
