"""Drops by the simulators' finite elements, recorded with noise; each is computed once a run."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from inversion import Instrument, Record, Sensor
from inversion.arrays import FloatArray
from inversion.diagnosis.model import PointRecords
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile

RADIUS, MASS, POISSON_RATIO = 0.15, 12.0, 0.35
STEP, BEFORE = 1e-4, 200
NOISE = 1e-3
"""Standard deviation over the peak of each sensor."""
HAMMER = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)


def uniform_ground(
    modulus: float = 50e6, depth: float = math.inf, viscosity: float = 5e4
) -> SoilProfile:
    return SoilProfile.uniform(modulus, viscosity, 1900.0, POISSON_RATIO, depth)


@cache
def simulated(
    ground: SoilProfile, offsets: tuple[float, ...] = (), hammer: Hammer = HAMMER
) -> SimulatedDrop:
    return simulate_drop(ground, Plate(RADIUS, MASS), hammer, offsets, 0.05, STEP)


def with_rest(values: FloatArray) -> FloatArray:
    """Return samples along the last axis behind the time before the trigger."""
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(BEFORE, 0)])


def recorded(
    ground: SoilProfile,
    offsets: tuple[float, ...] = (),
    *,
    hammer: Hammer = HAMMER,
    seed: int = 1,
    motion: FloatArray | None = None,
    late: int = 0,
    mass: float = MASS,
    depth: float | None = None,
) -> Record:
    """Return a drop recorded by displacement sensors on the plate and beside it.

    Parameters
    ----------
    offsets : of the sensors beside the plate, m
    motion : displacements (n_sensors, n_times) in place of the simulated ones, m
    late : samples by which the displacements are recorded late
    mass, depth : as declared: of the plate, kg, and of rock, m
    """
    drop = simulated(ground, offsets, hammer)
    rows = np.vstack([drop.plate_displacement, *drop.ground_displacement])
    rows = with_rest(rows if motion is None else np.atleast_2d(motion))
    rows = np.pad(rows, ((0, 0), (late, 0)))[:, : BEFORE + drop.time.size]
    noise = np.random.default_rng(seed).standard_normal(rows.shape)
    rows = rows + NOISE * rows.max(axis=1, keepdims=True) * noise
    sensors = zip((0.0, *offsets), rows, strict=True)
    return Record(
        STEP * np.arange(-BEFORE, drop.time.size),
        with_rest(drop.load),
        tuple(Sensor(offset, "displacement", row) for offset, row in sensors),
        Instrument(RADIUS, mass),
        POISSON_RATIO,
        bedrock_depth=depth,
    )


def point_of(*records: Record) -> PointRecords:
    return PointRecords("simulated", records, tuple(range(1, len(records) + 1)))
