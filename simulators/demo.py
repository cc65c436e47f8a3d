"""Drops at one imagined test point, for showing the program with nothing attached."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simulators.drop import DropSimulator, Hammer, SimulatedDrop
from simulators.mesh import Ground, Plate
from simulators.traces import Recording, write_traces

PLATE = Plate(radius=0.15, mass=10.6)
# Hammer and spring of the published finite-element study; the peak is about 10 kN.
HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=4.2)
OFFSETS = (0.0, 0.3, 0.6)
POISSON_RATIO = 0.35
DURATION = 0.06
TIME_STEP = 2e-4
NOISE = 0.003  # of the peak of each channel kind


def demo_ground(seed: int) -> Ground:
    """The ground under the demonstration: soil near 45 MPa on rock near 1.2 m."""
    generator = np.random.default_rng([seed, 0])
    return Ground.uniform(
        modulus=45e6 * float(np.exp(0.12 * generator.standard_normal())),
        viscosity=54e3 * float(np.exp(0.1 * generator.standard_normal())),
        density=1900.0,
        poisson_ratio=POISSON_RATIO,
        bedrock_depth=1.2 * float(np.exp(0.08 * generator.standard_normal())),
    )


def demo_simulations(count: int, seed: int) -> list[SimulatedDrop]:
    """Ideal records of `count` drops whose height scatters by some per cent.

    The system is linear and the spring only pushes, so every drop is one computed drop scaled.
    """
    simulator = DropSimulator(
        demo_ground(seed), PLATE, OFFSETS, DURATION, TIME_STEP, HAMMER.pulse_duration
    )
    drop = simulator.run(HAMMER)
    scatter = 0.015 * np.random.default_rng([seed, 1]).standard_normal(count)
    return [drop.scaled(1 + float(shift)) for shift in scatter]


def demo_drops(count: int, seed: int, folder: Path) -> Path:
    """Trace file of `count` drops at one point, noise included; equal seeds give equal files.

    Parameters
    ----------
    count : number of drops, >= 1
    folder : is made if it does not exist; the file is named after the seed
    """
    drops = demo_simulations(count, seed)
    recording = Recording(
        load_noise=NOISE * float(np.max(drops[0].load)),
        sensor_noise=NOISE * float(np.max(np.abs(drops[0].ground_velocity))),
    )
    folder.mkdir(parents=True, exist_ok=True)
    declared = {"device": "demo", "point": f"demo-{seed}", "source": "simulated drops"}
    path = folder / f"demo-{seed}.csv"
    return write_traces(path, drops, PLATE, POISSON_RATIO, recording, seed, declared)
