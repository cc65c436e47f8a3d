"""Drops computed by the forward model, with a known ground and any noise.

They prove nothing about the model itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from inversion import ForwardModel, Grounds, Instrument, PlateProblem, Record, Sensor
from inversion import SurrogateLibrary as Library
from inversion.effects import Ground
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.surrogate import Surrogate
from inversion.measured.record import prepare
from inversion.measured.weighted_drop import WeightedDrop
from pfwd_plugins.quantities import MotionName

Array = NDArray[np.float64]

MODULUS, VISCOSITY, DENSITY, DEPTH = "modulus", "viscosity", "density", "bedrock_depth"
RADIUS, POISSON_RATIO = 0.15, 0.35
INSTRUMENT = Instrument(RADIUS, 10.0)
STEP, PULSE = 2e-4, 0.018
TRUTH = {MODULUS: 45e6, VISCOSITY: 5e4, DENSITY: 1900.0, DEPTH: 1.1}
GROUND = Ground(TRUTH[MODULUS], TRUTH[VISCOSITY], TRUTH[DENSITY], 1 / TRUTH[DEPTH], 10.0)


@dataclass(frozen=True)
class Scene:
    """Recording of a drop; standard deviations of white noise in the channel's unit."""

    quantity: MotionName = "displacement"
    sensor_noise: float = 0.0
    load_noise: float = 0.0
    pre_trigger: float = 0.04
    length: float = 0.05
    seed: int = 0
    peak: float = 8000.0
    pulse: float = PULSE
    offsets: tuple[float, ...] = (0.0,)
    """The centre alone, or any of 0.3 and 0.6 m."""
    instrument: Instrument = INSTRUMENT


def surrogate(library: Library, offsets: tuple[float, ...]) -> Surrogate:
    """One that comes with the package."""
    if offsets == (0.0,):
        return library.get(PlateProblem("rigid-smooth", POISSON_RATIO), None)
    return library.get(PlateProblem("rigid-rough", POISSON_RATIO, (0.0, 2.0, 4.0)), None)


def grounds(depth: float = TRUTH[DEPTH]) -> Grounds:
    values = (TRUTH[MODULUS], TRUTH[VISCOSITY], TRUTH[DENSITY], 1 / depth)
    return Grounds(*(np.array([value]) for value in values))


def half_sine(time: Array, scene: Scene) -> Array:
    inside = (time > 0) & (time < scene.pulse)
    return np.where(inside, scene.peak * np.sin(np.pi * time / scene.pulse), 0.0)


@cache
def record(library: Library, scene: Scene, depth: float = TRUTH[DEPTH]) -> Record:
    """One drop on the ground of TRUTH."""
    time = STEP * np.arange(-round(scene.pre_trigger / STEP), round(scene.length / STEP))
    since_trigger = time[time >= -STEP / 2]
    model = ForwardModel(
        surrogate(library, scene.offsets),
        scene.instrument,
        since_trigger,
        half_sine(since_trigger, scene),
        since_trigger[1:],
        FULL_BAND_HZ,
    )
    moved = np.zeros((len(scene.offsets), time.size))
    moved[:, -since_trigger.size + 1 :] = model.displacement(grounds(depth))[
        0, -len(scene.offsets) :
    ]
    if scene.quantity == "velocity":
        moved = np.gradient(moved, STEP, axis=1)
    rng = np.random.default_rng(scene.seed)
    moved = moved + scene.sensor_noise * rng.standard_normal(moved.shape)
    load = half_sine(time, scene) + scene.load_noise * rng.standard_normal(time.size)
    sensors = tuple(
        Sensor(offset, scene.quantity, values)
        for offset, values in zip(scene.offsets, moved, strict=True)
    )
    return Record(time, load, sensors, scene.instrument, POISSON_RATIO)


def weighted(drop: Record) -> WeightedDrop:
    prepared = prepare(drop)
    return WeightedDrop.of(prepared, drop.instrument, prepared.load, drop.model_floor)
