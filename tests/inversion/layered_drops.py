"""Drops on layered ground by the simulators' finite elements, which share nothing with the model.

Each drop is computed once a run; the ground of a name is the truth that an inversion has to find.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inversion import Instrument, Record, Sensor
from pfwd_plugins.quantities import MotionName
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilLayer, SoilProfile

Array = NDArray[Any]

RADIUS, PLATE_MASS, POISSON_RATIO = 0.15, 10.0, 0.35
OFFSETS = (0.0, 0.3, 0.6, 0.9)
STEP, DURATION = 2e-4, 0.04
INSTRUMENT = Instrument(RADIUS, PLATE_MASS)

# On rock, so that the mesh ends there: seconds less than without end.
TWO = SoilProfile(
    (
        SoilLayer(1.8e8, 1.2e5, 2050.0, POISSON_RATIO, 0.2),
        SoilLayer(5.0e7, 5.0e4, 1950.0, POISSON_RATIO, 1.0),
    )
)
ALONE = SoilProfile.uniform(6.0e7, 5.0e4, 1950.0, POISSON_RATIO, 1.2)
DEPTH = 1.2


@cache
def simulated(ground: SoilProfile = TWO) -> SimulatedDrop:
    """A hammer of 10 kg on the ground, some 12 kN for 14 ms."""
    plate, hammer = Plate(RADIUS, PLATE_MASS), Hammer(10.0, 5.6e5, 3.0)
    return simulate_drop(ground, plate, hammer, OFFSETS, DURATION, STEP)


def recorded(
    ground: SoilProfile = TWO,
    sensors: int = len(OFFSETS),
    *,
    noise: float = 0.0,
    seed: int = 0,
    scale: float = 1.0,
    quantity: MotionName = "velocity",
    rock_depth: float | None = DEPTH,
    density: float | None = None,
) -> Record:
    """The drop as instruments record it, the first sensors alone, 20 ms of rest before it.

    Parameters
    ----------
    noise : standard deviation over the largest value of the plate's channel, and of the load's
    """
    drop = simulated(ground)
    quiet = np.zeros(100)
    time = STEP * np.arange(-quiet.size, drop.time.size)
    rng = np.random.default_rng(seed)
    histories = drop.ground_velocity if quantity == "velocity" else drop.ground_displacement
    largest = float(np.abs(histories[0]).max())

    def channel(values: Array, size: float) -> Array:
        complete = np.concatenate([quiet, values]) * scale
        return np.asarray(complete + noise * size * rng.standard_normal(complete.size))

    load = channel(drop.load, float(drop.load.max()))
    motion = tuple(
        Sensor(offset, quantity, channel(values, largest))
        for offset, values in zip(OFFSETS[:sensors], histories, strict=False)
    )
    return Record(time, load, motion, INSTRUMENT, POISSON_RATIO, density, rock_depth)


def changed(record: Record, sensor: int, factor: float) -> Record:
    """The same record with one sensor multiplied."""
    sensors = list(record.sensors)
    sensors[sensor] = replace(sensors[sensor], values=factor * sensors[sensor].values)
    return replace(record, sensors=tuple(sensors))
