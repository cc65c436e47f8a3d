"""The model of a drop with effects against the forward model, stage by stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import (
    MAX_SAMPLES,
    DropModel,
    PointRecords,
)
from inversion.diagnosis.problem import Point, response_of
from inversion.effects import BY_NAME
from inversion.effects.base import forced_motion
from inversion.forward.contact import PlateProblem
from tests.inversion.synthetic import GROUND, POISSON_RATIO, Scene, record


def made(library: SurrogateLibrary, scene: Scene, largest: float = 8000.0) -> DropModel:
    drop = record(library, scene)
    surrogate = library.get(PlateProblem("rigid-smooth", POISSON_RATIO), None)
    response = response_of(drop, surrogate, library)
    return DropModel(drop, largest, 0, PointRecords("a", (drop,), (1,)), response)


@pytest.fixture(scope="module")
def model(library: SurrogateLibrary) -> DropModel:
    return made(library, Scene())


def test_without_effects_it_is_the_forward_model(model: DropModel) -> None:
    result = model.predict(GROUND, [])[:, model.before :]
    # The record was computed with a wider band.
    assert result == pytest.approx(model.observed, abs=2e-3 * model.observed.max())
    assert model.residual_over_peak(result, contact_only=False) < 1e-3
    assert model.residual_over_peak(2 * result, contact_only=True) == pytest.approx(
        np.sqrt(np.mean((model.observed[0, _contact(model)] / model.peak[0]) ** 2)), rel=0.01
    )


def _contact(model: DropModel) -> np.ndarray:
    time = model.context.time
    return (time >= model.drop.trigger) & (time <= model.drop.contact_end * (1 + 1e-9))


def test_a_prediction_covers_the_rest_before_the_pulse_and_a_limited_number_of_samples(
    library: SurrogateLibrary, model: DropModel
) -> None:
    assert model.observed.shape == (1, model.rows.size)
    assert np.abs(model.predict(GROUND, [])[:, : model.before]).max() < 1e-8
    long = made(library, Scene(length=0.1))
    assert long.rows.size <= MAX_SAMPLES
    assert long.rows.size > MAX_SAMPLES / 2


@pytest.mark.parametrize(
    ("pulse", "lowest", "highest"), [(0.035, 300, 300), (0.02, 400, 500), (0.006, 900, 900)]
)
def test_the_band_of_a_coarse_point_is_that_of_its_load(
    pulse: float, lowest: float, highest: float, library: SurrogateLibrary
) -> None:
    drop = record(library, Scene(offsets=(0.0, 0.3, 0.6), pulse=pulse))
    point = Point(PointRecords("a", (drop,), (1,)), library)
    model, coarse = point.drops[0], point.coarse().drops[0]
    before = model.predict(GROUND, [])
    assert lowest <= model.min_band_hz <= highest
    assert _band(coarse) == pytest.approx(model.min_band_hz, abs=20)
    # The record was computed with a wider band.
    result = coarse.predict(GROUND, [])[:, coarse.before :]
    for item, expected in zip(result, model.observed, strict=True):
        assert item == pytest.approx(expected, abs=3e-3 * np.abs(expected).max())
    # The point itself stays as it is.
    assert _band(model) == pytest.approx(900, abs=20)
    assert model.predict(GROUND, []) == pytest.approx(before)


def test_the_band_of_a_coarse_point_is_that_of_its_widest_load(library: SurrogateLibrary) -> None:
    scenes = [Scene(offsets=(0.0, 0.3, 0.6), pulse=pulse) for pulse in (0.035, 0.02)]
    drops = tuple(record(library, scene) for scene in scenes)
    point = Point(PointRecords("a", drops, (1, 2)), library)
    first, second = point.coarse().drops
    assert _band(first) == _band(second) == pytest.approx(point.drops[1].min_band_hz, abs=20)
    # A single sensor is never solved for in layers.
    alone = Point(PointRecords("a", (record(library, Scene(pulse=0.035)),), (1,)), library)
    assert alone.coarse() is alone


def _band(model: DropModel) -> float:
    return float(model.s[-2].imag / (2 * np.pi))


def test_a_motion_under_a_force_is_that_of_impulses(model: DropModel) -> None:
    # The load itself, applied sample by sample, moves the plate as the model says.
    impulse_motion = model._impulse_response(model._stages(GROUND, []))
    result = forced_motion(impulse_motion, model.context.load, model.context.step)
    expected = model.predict(GROUND, [])[:, model.before :]
    assert result == pytest.approx(expected, abs=0.01 * expected.max())


def test_effects_act_in_their_stage(model: DropModel) -> None:
    plain = model.predict(GROUND, [])
    heavy = model.predict(GROUND, [(BY_NAME["plate_inertia"], {"mass": 5.0})])
    assert heavy == pytest.approx(model.predict(replace(GROUND, plate_mass=15.0), []))
    rock = model.predict(replace(GROUND, inverse_depth=0.0), [(BY_NAME["bedrock"], {"depth": 1.1})])
    assert rock == pytest.approx(plain)
    step = model.context.step
    late = model.predict(GROUND, [(BY_NAME["sensor_lag"], {"delay": step})])
    assert late[0, 1:] == pytest.approx(plain[0, :-1], abs=1e-8)
    rig = {"stiffness": 2e7, "moving_mass": 12.0, "damping_ratio": 0.2}
    spring = model.predict(GROUND, [(BY_NAME["spring_rig"], rig)])
    assert spring.max() == pytest.approx(
        model.predict(replace(GROUND, modulus=3e7), [(BY_NAME["spring_rig"], rig)]).max()
    )


def test_the_secant_of_nonlinear_ground_at_the_largest_load_holds(
    library: SurrogateLibrary,
) -> None:
    stress = BY_NAME["stress_dependence"]
    model = made(library, Scene())
    plain = model.predict(GROUND, [])
    bent = model.predict(GROUND, [(stress, {"exponent": 0.3})])
    assert bent.max() == pytest.approx(plain.max(), rel=0.05)
    # Of a drop of half the load the ground is softer.
    low = made(library, Scene(peak=4000.0))
    soft = low.predict(GROUND, [(stress, {"exponent": 0.3})])
    assert soft.max() > 1.1 * low.predict(GROUND, []).max()


def test_effects_receive_the_declared_plate_and_rock(
    library: SurrogateLibrary, model: DropModel
) -> None:
    drop = model.context
    assert (drop.index, drop.count, drop.plate_radius, drop.plate_mass) == (0, 1, 0.15, 10.0)
    assert drop.peak_load == pytest.approx(8000.0, rel=1e-3)
    assert not drop.has_bedrock
    for depth, has_rock in ((np.inf, False), (2.0, True)):
        declared = replace(record(library, Scene()), bedrock_depth=depth)
        variant = Point(PointRecords("a", (declared,), (1,)), library).drops[0]
        assert variant.context.has_bedrock == has_rock
