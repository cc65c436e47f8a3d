"""Derivatives of the misfit against differences of it, by every parameter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from inversion import Instrument, Record, Sensor, SurrogateLibrary
from inversion.fitting.misfit import Misfit, WeightedDrop, model_floor
from inversion.fitting.parameters import parameter_space
from inversion.forward.contact import PlateProblem
from inversion.measured.record import prepare
from tests.inversion.differences import by_differences

INSTRUMENT = Instrument(0.15, 12.0, geophone_natural_frequency=4.5, geophone_damping=0.7)
POINTS = np.array([[0.5, 0.1, 0.6, 0.4], [0.3, 0.4, 0.2, 0.9], [0.7, 0.02, 0.9, 0.1]])


@pytest.fixture(scope="module")
def drops(library: SurrogateLibrary) -> tuple[WeightedDrop, ...]:
    """Two drops of different length: what they hold does not matter here."""
    surrogate = library.get(PlateProblem("rigid-smooth", 0.35), None)
    found = []
    for duration in (0.016, 0.022):
        time = np.arange(-100, 500) * 1e-4
        inside = (time > 0) & (time < duration)
        load = np.where(inside, 7000 * np.sin(np.pi * time / duration), 0.0)
        motion = 4e-4 * np.where(inside, np.sin(np.pi * time / duration) ** 2, 0.0)
        sensor = Sensor(0.0, "displacement", motion)
        drop = prepare(Record(time, load, (sensor,), INSTRUMENT, 0.35))
        found.append(WeightedDrop(drop, surrogate, INSTRUMENT, drop.load, model_floor(drop, None)))
    return tuple(found)


@pytest.mark.parametrize(
    ("density", "depth", "elastic"),
    [(None, None, False), (None, 0.8, False), (1900.0, math.inf, False), (None, None, True)],
)
@pytest.mark.parametrize("band", [640.0, 1600.0])
def test_derivatives_are_differences(
    drops: tuple[WeightedDrop, ...],
    density: float | None,
    depth: float | None,
    elastic: bool,
    band: float,
) -> None:
    space = parameter_space(40e6, 0.15, density, depth, elastic)
    misfit = Misfit(drops, space, band, 64)
    points = POINTS[:, : len(space.fitted)]
    for free in (np.arange(points.shape[1]), np.array([points.shape[1] - 1])):
        values, slopes = misfit.linearise(points, free)
        right_values, right = by_differences(misfit.residual, 1e-5)(points, free)
        assert values == pytest.approx(right_values, rel=1e-9, abs=1e-9 * np.abs(values).max())
        for column in range(free.size):
            size = np.abs(right[..., column]).max()
            assert np.max(np.abs(slopes[..., column] - right[..., column])) < 1e-5 * size
