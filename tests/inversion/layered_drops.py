"""Drops on layered ground by the simulators' finite elements, which share nothing with the model.

Each drop is computed once a run; the ground of a name is the truth that an inversion has to find.
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np

from inversion import Instrument, Record
from inversion.forward.layered import LayeredGround, Medium
from pfwd.analysis.analyse import record_of as analysed_record
from pfwd.files.traces import read_traces
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilLayer, SoilProfile
from tests.inversion.simulated_drops import POISSON_RATIO, RADIUS, record_of

PLATE_MASS = 10.0
OFFSETS = (0.0, 0.3, 0.6, 0.9)
STEP, DURATION, BEFORE = 2e-4, 0.04, 100
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
EXTERNAL = [f"layers{number:02}" for number in range(1, 7)]
"""Names of drops by other finite elements."""


def ground_of(profile: SoilProfile) -> LayeredGround:
    """Return the ground of the forward model."""
    media = (
        Medium(m.modulus, m.viscosity, m.density, m.poisson_ratio, m.thickness)
        for m in profile.layers
    )
    return LayeredGround(tuple(media), profile.base == "rigid")


def external(shared: Path, name: str) -> tuple[Record, LayeredGround, float]:
    """Return a drop by other finite elements, its ground, and its noise over the peak.

    Its licence keeps it out of the project; where it is absent the test is skipped.
    """
    point = read_traces(shared / "layered" / f"{name}.csv")
    record = analysed_record(point.drops[0], point.setup)
    truth = json.loads((shared / "layered" / "truth.json").read_text())[name]
    rock, above = truth["rock_depth_m"], truth["thickness_m"]
    thicknesses = [*above, math.inf if rock is None else rock - sum(above)]
    media = (
        Medium(
            1e6 * layer["modulus_MPa"],
            1e3 * layer["viscosity_kPa_s"],
            layer["density"],
            record.poisson_ratio,
            thickness,
        )
        for layer, thickness in zip(truth["layers"], thicknesses, strict=True)
    )
    return record, LayeredGround(tuple(media), rock is not None), truth["noise"]


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
    rock_depth: float | None = DEPTH,
    density: float | None = None,
) -> Record:
    """The drop as instruments record it, the first sensors alone, 20 ms of rest before it.

    Parameters
    ----------
    noise : standard deviation over the largest value of the plate's channel, and of the load's
    """
    drop = simulated(ground)
    velocity = drop.ground_velocity[:sensors]
    return record_of(
        STEP,
        drop.load,
        velocity,
        OFFSETS[:sensors],
        quantity="velocity",
        noise=noise * float(np.abs(velocity[0]).max()),
        load_noise=noise * float(drop.load.max()),
        seed=seed,
        before=BEFORE,
        instrument=INSTRUMENT,
        density=density,
        bedrock_depth=rock_depth,
    )
