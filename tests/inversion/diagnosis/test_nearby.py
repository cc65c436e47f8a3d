"""Predictions a small step away, all at once, against each of them by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.channel import MotionChannel
from inversion.diagnosis.model import DropModel, PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects import BY_NAME, CATALOGUE, Effect, Ground
from inversion.effects.parameters import Parameter
from inversion.measured.record import ChannelNoise, NoiseModel, Record, Sensor
from tests.inversion.synthetic import TRUTH, Array, Scene, record

GROUND = Ground(
    TRUTH["modulus"], TRUTH["viscosity"], TRUTH["density"], 1 / TRUTH["bedrock_depth"], 10.0
)
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
    """With flat tops in the load and in every velocity, at levels that are those of the device."""
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


def made(library: SurrogateLibrary, offsets: tuple[float, ...], effect: Effect) -> DropModel:
    """The first of two drops that could show an effect."""
    quantity: Any = "velocity" if effect.name == "saturation" else "displacement"
    drops = tuple(
        record(library, Scene(quantity, peak=peak, offsets=offsets)) for peak in (6000.0, 8000.0)
    )
    if effect.name == "saturation":
        drops = clipped(drops)
    if effect.name == "load_shape":
        drops = tuple(
            replace(drop, load=drop.load * (drop.load / drop.load.max()) ** 0.5) for drop in drops
        )
    options: dict[str, Any] = {
        "elastic": effect.name == "viscosity",
        "load": "half-sine" if effect.name == "load_shape" else "measured",
    }
    return Point(PointRecords("a", drops, (1, 2), **options), library).drops[0]


def unit_value(parameter: Parameter, value: float) -> float:
    """Return the point of the unit interval with this physical value."""
    ends = np.array([parameter.lower, parameter.upper, value])
    low, high, own = np.log(ends) if parameter.logarithmic else ends
    return float(np.clip((own - low) / (high - low), 0.0, 1.0))


def in_order(active: Active) -> Active:
    return sorted(active, key=lambda item: CATALOGUE.index(item[0]))


def steps_of(
    start: Ground, effect: Effect, values: dict[str, float], beside: Active, model: DropModel
) -> tuple[list[str], list[tuple[Ground, Active]]]:
    """Grounds and effects a step away, one for each number."""
    there = in_order([*beside, (effect, values)])
    names = ["modulus", "viscosity", "density", "plate_mass"]
    moved: list[tuple[Ground, Active]] = [
        (replace(start, **{name: getattr(start, name) * (1 + STEP)}), there) for name in names
    ]
    if start.inverse_depth > 0.0:
        names.append("inverse_depth")
        moved.append((replace(start, inverse_depth=start.inverse_depth * (1 + STEP)), there))
    for own, now in there:
        for parameter in own.parameters_for(model.context):
            place = unit_value(parameter, now[parameter.name])
            step = -STEP if place > 0.5 else STEP
            other = now | {parameter.name: float(parameter.value(place + step))}
            others = [(e, other if e is own else v) for e, v in there]
            names.append(f"{own.name}.{parameter.name}")
            moved.append((start, others))
    return names, moved


CASES = [
    pytest.param(effect, offsets, bent, id=f"{effect.name}-{len(offsets)}-{kind}")
    for effect in CATALOGUE
    for offsets in ((0.0,), (0.0, 0.3, 0.6))
    for kind, bent in (("linear", []), ("bent", BENT))
    if effect.name != "layer" or len(offsets) > 1
]


@pytest.mark.parametrize(("effect", "offsets", "bent"), CASES)
def test_a_step_of_any_number_is_the_step_that_it_makes_alone(
    effect: Effect, offsets: tuple[float, ...], bent: Active, library: SurrogateLibrary
) -> None:
    model, alone = made(library, offsets, effect), made(library, offsets, effect)
    values = {
        p.name: float(p.value(0.98 * unit_value(p, p.starts[0]) + 0.01))
        for p in effect.parameters_for(model.context)
    }
    beside = [(e, v) for e, v in bent if e.name != effect.name and not e.conflicts_with(effect)]
    there = in_order([*beside, (effect, values)])
    on_rock = not effect.conflicts_with(BY_NAME["bedrock"])
    start = GROUND if on_rock else replace(GROUND, inverse_depth=0.0)
    names, moved = steps_of(start, effect, values, beside, model)
    found = model.predict_nearby(start, there, moved)
    here = model.predict(start, there)
    assert found.shape == (len(moved), *here.shape)
    still = alone.predict(start, there)
    assert here == pytest.approx(still, abs=1e-9 * np.abs(still).max())
    for name, one_found, (ground, active) in zip(names, found, moved, strict=True):
        expected = alone.predict(ground, active) - still
        change = one_found - here
        # What Newton's method leaves at its end is no step (1e-6 of the displacement).
        granted = RIGHT * np.abs(expected).max() + 1e-7 * np.abs(still).max()
        assert np.abs(change - expected).max() <= granted, name


def test_each_stage_is_gone_through_for_what_has_moved_in_it(
    library: SurrogateLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    geophone, lag, rebound = (BY_NAME[n] for n in ("geophone_response", "sensor_lag", "rebound"))
    model = made(library, (0.0,), rebound)
    rows: dict[str, list[int]] = {"geophone_response": [], "sensor_lag": [], "rebound": []}

    def counted(name: str, method: Any) -> Any:
        def called(self: Effect, stack: Array, *others: Any) -> Array:
            rows[name].append(len(stack))
            found: Array = method(self, stack, *others)
            return found

        return called

    for effect, stage in ((geophone, "record"), (lag, "record"), (rebound, "motions")):
        kind = type(effect)
        monkeypatch.setattr(kind, stage, counted(effect.name, getattr(kind, stage)))
    values: Any = {
        rebound: {"level": 0.02, "mass": 20.0, "kick": -0.05},
        geophone: {"natural_frequency": 6.0, "damping": 0.5},
        lag: {"delay": 1e-4},
    }
    there = list(values.items())
    moved: Any = [(replace(GROUND, modulus=GROUND.modulus * k), there) for k in (1.0001, 1.0002)]
    for effect, own in there:
        for name, value in own.items():
            other = {**own, name: 1.0001 * value}
            moved.append((GROUND, [(e, other if e is effect else v) for e, v in there]))
    model.predict_nearby(GROUND, there, moved)
    # As it is, on two other grounds, and with three numbers of the effect's own.
    assert rows["rebound"] == [6]
    # These six together, then the moved numbers one by one.
    assert rows["geophone_response"] == [6, 1, 1]
    assert rows["sensor_lag"] == [8, 1]


def test_without_a_step_nothing_moves(library: SurrogateLibrary) -> None:
    model = made(library, (0.0, 0.3, 0.6), BY_NAME["rebound"])
    for there in ([], BENT):
        other = replace(GROUND, modulus=GROUND.modulus * (1 + STEP))
        found = model.predict_nearby(GROUND, there, [(GROUND, there), (other, there)])
        here = model.predict(GROUND, there)
        assert found[0] == pytest.approx(here, abs=1e-9 * here.max())
        assert np.abs(found[1] - here).max() > 1e-6 * here.max()


def test_from_straight_ground_to_bent_and_back(library: SurrogateLibrary) -> None:
    """An effect may begin where it is absent: there the ground is linear, and nearby it is not."""
    stress = BY_NAME["stress_dependence"]
    straight: Any = [(stress, {"exponent": 0.0, "within": 1.0})]
    bent: Any = [(stress, {"exponent": 1e-4, "within": 1.0})]
    model, alone = (made(library, (0.0,), stress) for _ in range(2))
    for here, there in ((straight, bent), (bent, straight)):
        found = model.predict_nearby(GROUND, here, [(GROUND, there)])[0]
        change = found - model.predict(GROUND, here)
        expected = alone.predict(GROUND, there) - alone.predict(GROUND, here)
        assert np.abs(change - expected).max() < 0.02 * np.abs(expected).max()


def test_records_of_a_flat_top_keep_to_their_own_sensor(library: SurrogateLibrary) -> None:
    """Several steps go through the stages of the record together."""
    saturation = BY_NAME["saturation"]
    model = made(library, (0.0, 0.3, 0.6), saturation)
    assert [level is not None for level in model.context.flat].count(True) >= 1
    (level, *_) = saturation.parameters_for(model.context)
    active: Any = [(saturation, {"level": level.starts[0]})]
    moved: Any = [(replace(GROUND, modulus=GROUND.modulus * k), active) for k in (0.5, 1.0, 2.0)]
    motions = np.stack([model._ground_motion(model._stages(g, [])) for g, _ in moved])
    found = model._record(motions, active)
    for one_found, motion in zip(found, motions, strict=True):
        padded = np.concatenate([np.zeros((3, model.before)), motion], axis=1)
        expected = saturation.record(padded, active[0][1], model._recorded)
        assert one_found == pytest.approx(expected, abs=1e-15)
    # The soft ground moves fast enough to be cut; it is cut.
    assert np.abs(found[0, 0, model.before :] - motions[0, 0]).max() > 0.01 * motions[0].max()


# --- reading -------------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_a_stack_of_predictions_is_read_one_by_one(quantity: Any) -> None:
    rng = np.random.default_rng(3)
    step, first, samples = 1e-4, 200, np.arange(0, 700, 5)
    baseline = 100 if quantity == "velocity" else 20
    noise = ChannelNoise(NoiseModel(np.ones(1), first), quantity == "velocity", baseline)
    sensor = Sensor(0.0, quantity, rng.standard_normal(700))
    channel = MotionChannel(sensor, noise, first, samples, step)
    stack = rng.standard_normal((2, 3, samples.size))
    found = channel.read(stack)
    assert found.shape == stack.shape
    for i in range(2):
        for j in range(3):
            assert found[i, j] == pytest.approx(channel.read(stack[i, j]), abs=1e-12)
    # It is a reading: not what went in.
    assert np.abs(found - stack).max() > 0.1
