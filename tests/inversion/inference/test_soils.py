"""Drops by finite elements on constant-Q soil, soil that grows stiffer with depth, and rock."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.findings import PointDiagnosis
from inversion.forward.model import Instrument
from inversion.inference.diagnose import diagnose_point
from simulators.drop import Hammer, PrescribedLoad, simulate_drop
from simulators.finite_elements import effective_modulus
from simulators.mesh import ConstantQ, Growth, Plate, SoilProfile
from tests.inversion.simulated_drops import (
    NOISE,
    OFFSETS,
    POISSON_RATIO,
    RADIUS,
    STEP,
    point_of,
    record_of,
    recorded,
    simulated,
    uniform_ground,
)
from tests.records import known

GIBSON = replace(uniform_ground(25e6, viscosity=25e3), growth=Growth(0.4, 1.0, 5.0))


def constant_q(quality: float, depth: float = math.inf) -> SoilProfile:
    """Return ground of 50 MPa at 30 Hz."""
    law = ConstantQ(quality, 2.0 * math.pi * 30.0)
    return replace(uniform_ground(depth=depth, viscosity=0.0), damping_law=law)


def diagnosed(
    library: SurrogateLibrary, ground: SoilProfile, offsets: tuple[float, ...] = ()
) -> PointDiagnosis:
    return diagnose_point(point_of(recorded(ground, offsets)), library)


def names_of(result: PointDiagnosis) -> set[str]:
    return {effect.name for effect in result.effects}


def value_of(result: PointDiagnosis, name: str, parameter: str) -> float:
    (effect,) = (effect for effect in result.effects if effect.name == name)
    return effect.values_by_name[parameter]


def test_growth_under_a_single_sensor_is_not_rock(library: SurrogateLibrary) -> None:
    # One sensor hardly tells growth from a carrier of the sensor.
    result = diagnosed(library, GIBSON)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    assert "bedrock" not in names_of(result)
    assert result.verdict == "explained"
    assert result.after.modulus_pa == pytest.approx(truth, rel=0.03)
    low, high = known(result.after.modulus_interval_pa)
    assert low < truth < high < 1.15 * low


@pytest.mark.slow
def test_growth_under_a_plate_with_undeclared_mass_is_no_rock(library: SurrogateLibrary) -> None:
    radius, declared, undeclared = 0.1, 7.8, 3.9
    ground = replace(
        SoilProfile.uniform(13e6, 11e3, 2100.0, POISSON_RATIO, math.inf),
        growth=Growth(0.1, 1.0, 5.0),
    )
    hammer = Hammer(mass=10.0, stiffness=8e5, velocity=3.0)
    drop = simulate_drop(ground, Plate(radius, declared + undeclared), hammer, (), 0.1, STEP)
    record = record_of(
        STEP,
        drop.load,
        drop.plate_velocity,
        quantity="velocity",
        noise=2.0 * NOISE * float(np.abs(drop.plate_velocity).max()),
        instrument=Instrument(plate_radius=radius, plate_mass=declared),
    )
    diagnosis = diagnose_point(point_of(record), library)
    assert names_of(diagnosis) == {"plate_inertia", "modulus_gradient"}
    assert value_of(diagnosis, "plate_inertia", "mass") == pytest.approx(undeclared, rel=0.15)
    truth = effective_modulus(ground, Plate(radius, 0.0))
    assert diagnosis.after.modulus_pa == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
def test_growth_under_three_sensors_is_detected(library: SurrogateLibrary) -> None:
    result = diagnosed(library, GIBSON, OFFSETS)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    assert names_of(result) == {"modulus_gradient"}
    assert result.after.modulus_pa == pytest.approx(truth, rel=0.02)
    inverse_depth = value_of(result, "modulus_gradient", "inverse_growth_depth")
    assert 1.0 / inverse_depth == pytest.approx(0.4, rel=0.05)


@pytest.mark.parametrize(
    ("depth", "offsets"),
    [
        (0.6, ()),
        pytest.param(0.9, (), marks=pytest.mark.slow),
        pytest.param(1.4, (), marks=pytest.mark.slow),
        pytest.param(2.0, (), marks=pytest.mark.slow),
        pytest.param(0.6, OFFSETS, marks=pytest.mark.slow),
        pytest.param(2.0, OFFSETS, marks=pytest.mark.slow),
    ],
)
def test_rock_is_no_growth(
    depth: float, offsets: tuple[float, ...], library: SurrogateLibrary
) -> None:
    result = diagnosed(library, uniform_ground(depth=depth), offsets)
    assert names_of(result) == {"bedrock"}
    assert value_of(result, "bedrock", "depth") == pytest.approx(depth, rel=0.02)
    assert result.after.modulus_pa == pytest.approx(50e6, rel=0.02)


@pytest.mark.parametrize(
    ("quality", "depth"),
    [
        pytest.param(20.0, math.inf, marks=pytest.mark.slow),
        pytest.param(10.0, math.inf, marks=pytest.mark.slow),
        pytest.param(5.0, math.inf, marks=pytest.mark.slow),
        (5.0, 1.0),
    ],
)
def test_constant_q_is_detected(quality: float, depth: float, library: SurrogateLibrary) -> None:
    ground = constant_q(quality, depth)
    result = diagnosed(library, ground)
    drop = simulated(ground)
    pulse = PrescribedLoad(drop.time, drop.load).pulse_duration
    rocks = {"bedrock"} if math.isfinite(depth) else set()
    assert names_of(result) == {"damping_law"} | rocks
    law = ground.damping_law
    expected = 50e6 * law.stiffening(math.pi / pulse)
    assert result.after.modulus_pa == pytest.approx(expected, rel=0.01)
    exponent = value_of(result, "damping_law", "loss_exponent")
    assert exponent == pytest.approx(law.exponent, abs=0.005)


def test_uniform_ground_with_a_dashpot_is_neither(library: SurrogateLibrary) -> None:
    assert diagnosed(library, uniform_ground()).verdict == "clean"
