"""Predictions a small step away, all at once, against each of them by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects import BY_NAME, CATALOGUE, Effect, Ground
from inversion.effects.parameters import Parameter
from inversion.measured.record import Record, Sensor
from tests.inversion.synthetic import GROUND, Scene, record

# Unit values, as the Jacobian takes them.
STEP = 1e-4
# Derivatives of layered ground are right to 0.6 % of the largest (docs/layers.md).
RIGHT = 0.015
BENT: Any = [
    (BY_NAME["stress_dependence"], {"exponent": 0.35, "rest_stress": 9e3, "within": 0.8}),
    (BY_NAME["hysteretic_unloading"], {"exponent": 1.4, "unrecovered": 0.1, "tension_share": 0.5}),
]
Active = Sequence[tuple[Effect, dict[str, float]]]


def clipped(drops: tuple[Record, ...]) -> tuple[Record, ...]:
    """Return the drops with load and velocities clipped at levels of the device."""
    lowest = drops[0]
    levels = [0.7 * float(np.abs(sensor.values).max()) for sensor in lowest.sensors]
    return tuple(
        replace(
            drop,
            sensors=tuple(
                Sensor(s.offset, s.quantity, np.clip(s.values, -level, level))
                for s, level in zip(drop.sensors, levels, strict=True)
            ),
            load=np.minimum(drop.load, 0.85 * lowest.load.max()),
        )
        for drop in drops
    )


@cache
def made(
    library: SurrogateLibrary, offsets: tuple[float, ...], name: str, copy: int = 0
) -> DropModel:
    """Return the first of two drops that could show an effect; each copy has its own cache."""
    quantity: Any = "velocity" if name == "saturation" else "displacement"
    drops = tuple(
        record(library, Scene(quantity, peak=peak, offsets=offsets)) for peak in (6000.0, 8000.0)
    )
    if name == "saturation":
        drops = clipped(drops)
    if name == "load_shape":
        drops = tuple(
            replace(drop, load=drop.load * (drop.load / drop.load.max()) ** 0.5) for drop in drops
        )
    load: Any = "half-sine" if name == "load_shape" else "measured"
    records = PointRecords("a", drops, (1, 2), elastic=name == "viscosity", load=load)
    return Point(records, library).drops[0]


SPECIAL = ("saturation", "load_shape", "viscosity")
"""Effects that need a drop of their kind."""


def unit_value(parameter: Parameter, value: float) -> float:
    """Return the point of the unit interval with this physical value."""
    ends = np.array([parameter.lower, parameter.upper, value])
    low, high, owner = np.log(ends) if parameter.logarithmic else ends
    return float(np.clip((owner - low) / (high - low), 0.0, 1.0))


def in_order(active: Active) -> Active:
    return sorted(active, key=lambda item: CATALOGUE.index(item[0]))


def steps_of(
    start: Ground, effect: Effect, values: dict[str, float], companions: Active, model: DropModel
) -> tuple[list[str], list[tuple[Ground, Active]]]:
    """Grounds and effects a step away, one for each number."""
    active = in_order([*companions, (effect, values)])
    names = ["modulus", "viscosity", "density", "plate_mass"]
    moved: list[tuple[Ground, Active]] = [
        (replace(start, **{name: getattr(start, name) * (1 + STEP)}), active) for name in names
    ]
    if start.inverse_depth > 0.0:
        names.append("inverse_depth")
        moved.append((replace(start, inverse_depth=start.inverse_depth * (1 + STEP)), active))
    for owner, now in active:
        for parameter in owner.parameters_for(model.context):
            place = unit_value(parameter, now[parameter.name])
            step = -STEP if place > 0.5 else STEP
            changed_values = now | {parameter.name: float(parameter.value(place + step))}
            changed_effects = [(e, changed_values if e is owner else v) for e, v in active]
            names.append(f"{owner.name}.{parameter.name}")
            moved.append((start, changed_effects))
    return names, moved


GROWTHS = ("modulus_gradient", "modulus_gradient_root")
CASES = [
    pytest.param(
        effect,
        offsets,
        bent,
        id=f"{effect.name}-{len(offsets)}-{kind}",
        # Tables of growing ground beside the plate are not shipped: building them takes seconds.
        marks=[pytest.mark.slow] * (effect.name in GROWTHS and len(offsets) > 1),
    )
    for effect in CATALOGUE
    for offsets in ((0.0,), (0.0, 0.3, 0.6))
    for kind, bent in (("linear", []), ("bent", BENT))
    if effect.name != "layer" or len(offsets) > 1
]


@pytest.mark.parametrize(("effect", "offsets", "bent"), CASES)
def test_a_step_of_any_number_is_the_step_that_it_makes_alone(
    effect: Effect, offsets: tuple[float, ...], bent: Active, library: SurrogateLibrary
) -> None:
    name = effect.name if effect.name in SPECIAL else ""
    model, alone = (made(library, offsets, name, copy) for copy in range(2))
    values = {
        p.name: float(p.value(0.98 * unit_value(p, p.starts[0]) + 0.01))
        for p in effect.parameters_for(model.context)
    }
    companions = [(e, v) for e, v in bent if e.name != effect.name and not e.conflicts_with(effect)]
    there = in_order([*companions, (effect, values)])
    on_rock = not effect.conflicts_with(BY_NAME["bedrock"])
    start = GROUND if on_rock else replace(GROUND, inverse_depth=0.0)
    names, moved = steps_of(start, effect, values, companions, model)
    result = model.predict_nearby(start, there, moved)
    base = model.predict(start, there)
    assert result.shape == (len(moved), *base.shape)
    still = alone.predict(start, there)
    assert base == pytest.approx(still, abs=1e-9 * np.abs(still).max())
    for name, computed, (ground, active) in zip(names, result, moved, strict=True):
        expected = alone.predict(ground, active) - still
        change = computed - base
        # What Newton's method leaves at its end is no step (1e-6 of the displacement).
        granted = RIGHT * np.abs(expected).max() + 1e-7 * np.abs(still).max()
        assert np.abs(change - expected).max() <= granted, name


def test_from_straight_ground_to_bent_and_back(library: SurrogateLibrary) -> None:
    """An effect may begin where it is absent: there the ground is linear, and nearby it is not."""
    stress = BY_NAME["stress_dependence"]
    straight: Any = [(stress, {"exponent": 0.0, "within": 1.0})]
    bent: Any = [(stress, {"exponent": 1e-4, "within": 1.0})]
    model, alone = (made(library, (0.0,), "", copy) for copy in range(2))
    for base, active in ((straight, bent), (bent, straight)):
        result = model.predict_nearby(GROUND, base, [(GROUND, active)])[0]
        change = result - model.predict(GROUND, base)
        expected = alone.predict(GROUND, active) - alone.predict(GROUND, base)
        assert np.abs(change - expected).max() < 0.02 * np.abs(expected).max()
