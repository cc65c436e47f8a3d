"""Drops at an imaginary test point, for a demonstration without an instrument."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Recording, write_traces

DEMO_PLATE = Plate(radius=0.15, mass=10.6)
# Hammer and spring of the published finite-element study; the peak is about 10 kN.
HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=4.2)
OFFSETS = (0.0, 0.3, 0.6)
POISSON_RATIO = 0.35
RECORD_DURATION_S = 0.06
RECORD_STEP_S = 2e-4
NOISE_OVER_PEAK = 0.003  # for load and sensors


def demo_ground(seed: int) -> SoilProfile:
    """Return the ground of the demonstration: soil of about 45 MPa on rock at about 1.2 m.

    Equal seeds give equal grounds.
    """
    generator = np.random.default_rng([seed, 0])
    return SoilProfile.uniform(
        modulus=45e6 * float(np.exp(0.12 * generator.standard_normal())),
        viscosity=54e3 * float(np.exp(0.1 * generator.standard_normal())),
        density=1900.0,
        poisson_ratio=POISSON_RATIO,
        bedrock_depth=1.2 * float(np.exp(0.08 * generator.standard_normal())),
    )


def demo_simulations(count: int, seed: int) -> list[SimulatedDrop]:
    """Return `count` simulated drops without noise, whose sizes scatter by 1.5 %.

    The ground is linear, so every drop is a scaled copy of one computed drop.
    """
    ground = demo_ground(seed)
    drop = simulate_drop(ground, DEMO_PLATE, HAMMER, OFFSETS, RECORD_DURATION_S, RECORD_STEP_S)
    scatter = 0.015 * np.random.default_rng([seed, 1]).standard_normal(count)
    return [drop.scaled(1 + float(shift)) for shift in scatter]


def demo_drops(count: int, seed: int, folder: Path) -> Path:
    """Write a trace file with noisy drops at one test point and return its path.

    Equal seeds give equal files.

    Parameters
    ----------
    count : int
        Number of drops, >= 1.
    seed : int
        Seed of ground, drops and noise; it is a part of the file name.
    folder : Path
        Folder of the file; it is created if it does not exist.
    """
    drops = demo_simulations(count, seed)
    recording = Recording(
        load_noise=NOISE_OVER_PEAK * float(np.max(drops[0].load)),
        sensor_noise=NOISE_OVER_PEAK * float(np.max(np.abs(drops[0].ground_velocity))),
    )
    folder.mkdir(parents=True, exist_ok=True)
    declared = {"device": "demo", "point": f"demo-{seed}", "source": "simulated drops"}
    path = folder / f"demo-{seed}.csv"
    return write_traces(path, drops, DEMO_PLATE, POISSON_RATIO, recording, seed, declared)
