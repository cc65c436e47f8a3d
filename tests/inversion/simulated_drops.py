"""Drops by the simulators' finite elements, recorded with noise; each is computed once a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from inversion import Instrument, Record, Sensor
from inversion.arrays import FloatArray
from inversion.diagnosis.model import PointRecords
from pfwd_plugins.quantities import MotionName
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile

RADIUS, MASS, POISSON_RATIO = 0.15, 12.0, 0.35
STEP, BEFORE = 1e-4, 200
NOISE = 1e-3
"""Standard deviation over the peak of each sensor."""
HAMMER = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
OFFSETS = (0.3, 0.6)
"""Offsets of the sensors beside the plate, m."""


def uniform_ground(
    modulus: float = 50e6, depth: float = math.inf, viscosity: float = 5e4
) -> SoilProfile:
    return SoilProfile.uniform(modulus, viscosity, 1900.0, POISSON_RATIO, depth)


@cache
def simulated(ground: SoilProfile) -> SimulatedDrop:
    """Return the motion of the plate and at `OFFSETS`."""
    return simulate_drop(ground, Plate(RADIUS, MASS), HAMMER, OFFSETS, 0.05, STEP)


def with_rest(values: FloatArray, before: int = BEFORE) -> FloatArray:
    """Return samples along the last axis behind the time before the trigger."""
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(before, 0)])


def record_of(
    step: float,
    load: FloatArray,
    motion: FloatArray,
    offsets: Sequence[float] = (0.0,),
    *,
    quantity: MotionName = "displacement",
    noise: float | FloatArray = 0.0,
    load_noise: float = 0.0,
    seed: int = 1,
    before: int = BEFORE,
    **declared: Any,
) -> Record:
    """Return a record of a load (n_times,) and motions (n_sensors, n_times) that begin at time 0.

    Parameters
    ----------
    noise, load_noise : standard deviations in the unit of the channel
    before : samples before the trigger
    declared : what the record states beside its channels
    """
    rng = np.random.default_rng(seed)
    load, rows = with_rest(load, before), with_rest(np.atleast_2d(motion), before)
    load = load + load_noise * rng.standard_normal(load.size) if load_noise else load
    rows = rows + noise * rng.standard_normal(rows.shape)
    sensors = (Sensor(r, quantity, values) for r, values in zip(offsets, rows, strict=True))
    time = step * np.arange(-before, load.size - before)
    values = {"instrument": Instrument(RADIUS, MASS), "poisson_ratio": POISSON_RATIO} | declared
    return Record(time, load, tuple(sensors), **values)


def recorded(
    ground: SoilProfile,
    offsets: tuple[float, ...] = (),
    *,
    speed: float = HAMMER.velocity,
    seed: int = 1,
    motion: FloatArray | None = None,
    late: int = 0,
    mass: float = MASS,
    depth: float | None = None,
) -> Record:
    """Return a drop recorded by displacement sensors on the plate and beside it.

    Parameters
    ----------
    offsets : the first of `OFFSETS`, m
    speed : of the hammer, m/s
    motion : displacements (n_sensors, n_times) in place of the simulated ones, m
    late : samples by which the displacements are recorded late
    mass, depth : as declared: of the plate, kg, and of rock, m
    """
    drop = simulated(ground).scaled(speed / HAMMER.velocity)
    assert offsets == OFFSETS[: len(offsets)]
    rows = np.vstack([drop.plate_displacement, *drop.ground_displacement[: len(offsets)]])
    rows = rows if motion is None else np.atleast_2d(motion)
    rows = np.pad(rows, ((0, 0), (late, 0)))[:, : drop.time.size]
    return record_of(
        STEP,
        drop.load,
        rows,
        (0.0, *offsets),
        noise=NOISE * rows.max(axis=1, keepdims=True),
        seed=seed,
        instrument=Instrument(RADIUS, mass),
        bedrock_depth=depth,
    )


def point_of(*records: Record) -> PointRecords:
    return PointRecords("simulated", records, tuple(range(1, len(records) + 1)))
