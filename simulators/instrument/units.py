"""Unit drops: drops from the height of the scenario, computed once by finite elements.

The ground is linear, so drops from other heights, rebounds and knocks are multiples of a unit drop.
Another modulus needs another computation. The unit drops of the built-in scenarios are part of the
program (`python -m simulators.instrument.units` computes them); others are computed in a thread.
"""

from __future__ import annotations

import dataclasses
import json
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from simulators.drop import STANDARD_GRAVITY, Hammer, simulate_drop
from simulators.instrument.scenario import (
    Scenario,
    ScenarioError,
    builtin_scenarios,
    load_scenario,
)
from simulators.mesh import Array

UNIT_DROP_DURATION_S = 0.2  # by then the motion is below 0.1 % of the peak
UNIT_DROP_STEP_S = 2e-4  # sixty samples in a pulse
TABLES = files("simulators").joinpath("scenarios").joinpath("unit_drops.npz")
_SOIL = 8  # stream of random numbers
SHIPPED_OFFSETS = (0.0, 0.2, 0.3, 0.45, 0.6, 0.9, 1.2)


@dataclass(frozen=True)
class UnitDrop:
    """Computed drop from the height of the scenario, without noise."""

    load: Array
    """Load (n,), N, every `UNIT_DROP_STEP_S` from the first touch."""
    velocity: Array
    """Velocities at the offsets of the channels (channels, n), m/s."""
    displacement: Array
    """Displacements at the offsets of the channels (channels, n), m."""


class UnitDrops:
    """Store of the unit drops of a scenario, which are computed in a thread if necessary.

    Parameters
    ----------
    scenario : Scenario
        Scenario whose soil has no scatter.
    factors : sequence of float
        Moduli of the soil relative to the scenario, in the order of their use.
    """

    def __init__(self, scenario: Scenario, factors: Sequence[float]) -> None:
        self._scenario = scenario
        self._drops: dict[float, UnitDrop | BaseException] = {}
        self._changed = threading.Condition()
        needed = list(dict.fromkeys(factors))
        for factor in needed:
            drop = _shipped(scenario, factor)
            if drop is not None:
                self._drops[factor] = drop
        missing = [factor for factor in needed if factor not in self._drops]
        if missing:
            threading.Thread(target=self._compute, args=(missing,), daemon=True).start()

    def get(self, factor: float) -> UnitDrop:
        """Return the unit drop on soil with `factor` times the modulus of the scenario.

        The call waits until the drop has been computed, and raises the error of a failed
        computation.
        """
        with self._changed:
            self._changed.wait_for(lambda: factor in self._drops)
            drop = self._drops[factor]
        if isinstance(drop, BaseException):
            raise drop
        return drop

    def ready(self, factor: float) -> bool:
        """Return True if `get` returns the drop for this factor without waiting."""
        with self._changed:
            return factor in self._drops

    def _compute(self, factors: Sequence[float]) -> None:
        for factor in factors:
            drop: UnitDrop | BaseException
            try:
                drop = compute_unit_drop(self._scenario, factor, sensor_offsets(self._scenario))
            except Exception as err:  # raised by `get`
                drop = err
            with self._changed:
                self._drops[factor] = drop
                self._changed.notify_all()


def with_drawn_soil(scenario: Scenario, seed: int) -> Scenario:
    """Return a scenario whose modulus and viscosity are drawn at random within their scatter.

    A scenario without scatter is returned unchanged; equal seeds give equal soils.
    """
    soil = scenario.soil
    if soil.scatter == 0:
        return scenario
    generator = np.random.default_rng([seed, _SOIL])
    modulus, viscosity = np.exp(soil.scatter * generator.standard_normal(2)).tolist()
    drawn = dataclasses.replace(
        soil, modulus=soil.modulus * modulus, viscosity=soil.viscosity * viscosity, scatter=0.0
    )
    return dataclasses.replace(scenario, soil=drawn)


def sensor_offsets(scenario: Scenario) -> tuple[float, ...]:
    """Return the distance of each channel from the plate centre, m, in their order."""
    return tuple(abs(channel.offset) for channel in scenario.device.channels)


def compute_unit_drop(scenario: Scenario, factor: float, offsets: Sequence[float]) -> UnitDrop:
    """Return a drop that is computed by finite elements, which takes some seconds.

    Parameters
    ----------
    scenario : Scenario
        Soil, falling weight and plate.
    factor : float
        Modulus of the soil relative to the scenario.
    offsets : sequence of float, m
        Distances from the plate centre at which the motion is computed.
    """
    settings = scenario.hammer
    gravity = STANDARD_GRAVITY if settings.damping else 0.0
    hammer = Hammer(settings.mass, settings.stiffness, settings.velocity, gravity, settings.damping)
    places = tuple(dict.fromkeys(offsets))
    ground, plate = scenario.soil.ground(factor), scenario.device.plate
    drop = simulate_drop(ground, plate, hammer, places, UNIT_DROP_DURATION_S, UNIT_DROP_STEP_S)
    if settings.damping and np.count_nonzero(np.diff(drop.load > 0)) > 2:  # up and down
        raise ScenarioError(
            f"{scenario.name}: hammer: expected a flight beyond {UNIT_DROP_DURATION_S} s, got a "
            "second contact before; reduce damping or increase drop_height"
        )
    rows = [places.index(offset) for offset in offsets]
    return UnitDrop(drop.load, drop.ground_velocity[rows], drop.ground_displacement[rows])


def _fingerprint(scenario: Scenario) -> dict[str, Any]:
    """Return all settings on which a unit drop depends, except the factor and the offsets."""
    return {
        "soil": dataclasses.asdict(scenario.soil),
        "hammer": {key: value for key, value in vars(scenario.hammer).items() if value},
        "plate": [scenario.device.plate_radius, scenario.device.plate_mass],
        "record": [UNIT_DROP_DURATION_S, UNIT_DROP_STEP_S],
    }


def _shipped(scenario: Scenario, factor: float) -> UnitDrop | None:
    """Return a unit drop that is part of the program; None if there is none for this scenario."""
    if not TABLES.is_file():
        return None
    with TABLES.open("rb") as file, np.load(file) as tables:
        entries = json.loads(str(tables["index"]))
        for number, entry in enumerate(entries):
            offsets = entry["offsets"]
            same = entry["drop"] == _fingerprint(scenario) and entry["factor"] == factor
            if same and set(sensor_offsets(scenario)) <= set(offsets):
                rows = [offsets.index(offset) for offset in sensor_offsets(scenario)]
                load, *velocities = tables[f"drop{number}"].astype(float)
                velocity = np.array(velocities)[rows]
                time = np.arange(velocity.shape[-1]) * UNIT_DROP_STEP_S
                displacement = CubicSpline(time, velocity, axis=-1).antiderivative()(time)
                return UnitDrop(load, velocity, np.asarray(displacement))
    return None


def make_tables(path: Any) -> None:
    """Compute the unit drops of the built-in scenarios and write them to a file."""
    index: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for name in ["default", *builtin_scenarios()]:
        scenario = load_scenario(name)
        offsets = SHIPPED_OFFSETS if name == "default" else (0.0, 0.3, 0.6)
        for factor in (*scenario.drops.seating, 1.0):
            entry = {"drop": _fingerprint(scenario), "factor": factor}
            if any(entry.items() <= previous.items() for previous in index):
                continue
            drop = compute_unit_drop(scenario, factor, offsets)
            data = np.vstack([drop.load, drop.velocity])
            arrays[f"drop{len(index)}"] = data.astype(np.float32)
            index.append({**entry, "offsets": list(offsets)})
            print(f"{name}: modulus times {factor:g}")
    np.savez_compressed(path, index=np.array(json.dumps(index)), **arrays)


if __name__ == "__main__":
    make_tables(str(TABLES))
