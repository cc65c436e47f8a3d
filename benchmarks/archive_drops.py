"""Simulated drops in large numbers at little cost, on finite-element ground.

The ground's response to a short force is computed once for each site. The
responses for other moduli, viscosities and densities follow from it exactly by similarity. Hammer
and plate are computed in time for every variant. Other heights only scale a drop, and every drop
has its own noise and converter. The model of the inversion is not used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulators.drop import Hammer, SimulatedDrop
from simulators.mesh import Ground
from tests.campaigns.effects.march import strike
from tests.campaigns.effects.recording import Converter, write_signals
from tests.campaigns.effects.response import RESPONSE_DURATION_S, ground_response
from tests.campaigns.effects.signals import signals_of

DROPS_PER_POINT = 5
_OFFSETS = (0.0, 0.3, 0.6)
_RADIUS = 0.15
_DENSITY = 1900.0
_POISSON_RATIO = 0.35
_FILES_PER_FOLDER = 200


@dataclass(frozen=True)
class Site:
    """Ground of a finite-element run: modulus (Pa), viscosity (Pa s), depth of rock (m)."""

    modulus: float
    viscosity: float
    depth: float


SITES = (
    Site(40e6, 54e3, 0.6),
    Site(30e6, 30e3, 1.0),
    Site(60e6, 80e3, 1.5),
    Site(45e6, 54e3, 2.5),
    Site(50e6, 60e3, math.inf),
)


def write_archive(
    folder: Path,
    drops: int,
    cache: Path,
    *,
    depth_declared: bool,
    sensors: int | None = None,
    seed: int = 0,
) -> list[float]:
    """Write trace files of five drops per point; return the true modulus of each point, Pa.

    Parameters
    ----------
    folder : created with a folder for every 200 files
    drops : number of drops, > 0
    cache : folder for the responses of the finite elements
    depth_declared : True if the headers declare the bedrock depth; otherwise it is fitted
    sensors : number of sensors in every file; None: one in three files of four, otherwise three
    seed : seed of all random numbers
    """
    points = math.ceil(drops / DROPS_PER_POINT)
    variants = _variants(max(1, min(200, points)), cache, seed)
    truth = []
    for number in range(points):
        drop, modulus, depth, mass = variants[number % len(variants)]
        generator = np.random.default_rng([seed, number])
        place = folder / f"area-{number // _FILES_PER_FOLDER:04d}"
        place.mkdir(parents=True, exist_ok=True)
        count = min(DROPS_PER_POINT, drops - number * DROPS_PER_POINT)
        n_sensors = sensors or (3 if number % 4 == 3 else 1)
        heights = np.sort(generator.uniform(0.8, 1.0, count))
        signals = [signals_of(drop.scaled(float(h)), n_sensors, 0.015) for h in heights]
        converter = Converter("velocity", float(generator.uniform(5e-4, 3e-3)), 0.0, 4, 16)
        header: dict[str, str | float | int] = {
            "pfwd-traces": 1,
            "plate_radius_m": _RADIUS,
            "plate_mass_kg": mass,
            "poisson_ratio": _POISSON_RATIO,
            "point": f"{number:06d}",
        }
        if depth_declared:
            header["bedrock_depth_m"] = depth
        path = place / f"point-{number:06d}.csv"
        write_signals(path, signals, _OFFSETS[:n_sensors], header, converter, generator)
        truth.append(modulus)
    return truth


def _variants(
    count: int, cache: Path, seed: int
) -> list[tuple[SimulatedDrop, float, float, float]]:
    """Return drops on different grounds, each with modulus (Pa), depth (m) and plate mass (kg)."""
    variants = []
    for number in range(count):
        generator = np.random.default_rng([seed, number, 1])
        site = SITES[number % len(SITES)]
        ground = Ground.uniform(site.modulus, site.viscosity, _DENSITY, _POISSON_RATIO, site.depth)
        response = ground_response(ground, _RADIUS, _OFFSETS, cache=cache).rescaled(
            float(generator.uniform(0.92, 1.1)), float(generator.uniform(0.85, 1.12))
        )
        mass = round(float(generator.uniform(9.0, 18.0)), 1)
        pulse = float(generator.uniform(0.010, 0.020))
        weight = float(generator.uniform(8.0, 14.0))
        hammer = Hammer(weight, weight * (math.pi / pulse) ** 2, 1.0)
        available = round(RESPONSE_DURATION_S * response.time_step / 5e-5 / response.time_step)
        samples = min(math.ceil((2.5 * pulse + 0.025) / response.time_step), available)
        drop = strike(response, mass, hammer, samples)
        peak = float(generator.uniform(60e3, 180e3)) * math.pi * _RADIUS**2
        drop = drop.scaled(peak / float(np.max(drop.load)))
        variants.append((drop, response.ground.layers[0].modulus, site.depth, mass))
    return variants
