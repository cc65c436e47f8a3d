"""Drops by finite elements on constant-Q soil, soil that grows stiffer with depth, and rock."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis.findings import PointDiagnosis
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.forward.model import Instrument
from inversion.inference.diagnose import diagnose_point
from inversion.inference.structures import candidate_structures
from simulators.drop import Hammer, PrescribedLoad, simulate_drop
from simulators.finite_elements import effective_modulus
from simulators.mesh import ConstantQ, Growth, Plate, SoilProfile
from tests.records import known

RADIUS, MASS, STEP, BEFORE = 0.15, 12.0, 1e-4, 200
NOISE = 1e-3
"""Of the peak."""
NU = 0.35
BESIDE = (0.3, 0.6)
GIBSON = replace(
    SoilProfile.uniform(25e6, 25e3, 1900.0, NU, math.inf), growth=Growth(0.4, 1.0, 5.0)
)


def rock(depth: float) -> SoilProfile:
    return SoilProfile.uniform(50e6, 5e4, 1900.0, NU, depth)


def constant_q(quality: float, depth: float = math.inf) -> SoilProfile:
    """Return ground of 50 MPa at 30 Hz."""
    elastic = SoilProfile.uniform(50e6, 0.0, 1900.0, NU, depth)
    return replace(elastic, damping_law=ConstantQ(quality, 2.0 * math.pi * 30.0))


@cache
def simulated(ground: SoilProfile, offsets: tuple[float, ...] = ()) -> tuple[PointRecords, float]:
    """Return a drop, and the duration of the half-sine of its peak and impulse, s.

    Parameters
    ----------
    offsets : m, of sensors beside the plate
    """
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    drop = simulate_drop(ground, Plate(RADIUS, MASS), hammer, offsets, 0.05, STEP)
    rng = np.random.default_rng(1)
    sensors = []
    for offset, motion in zip(
        (0.0, *offsets), (drop.plate_displacement, *drop.ground_displacement), strict=True
    ):
        recorded = np.concatenate([np.zeros(BEFORE), motion])
        recorded += NOISE * recorded.max() * rng.standard_normal(recorded.size)
        sensors.append(Sensor(offset, "displacement", recorded))
    record = Record(
        STEP * np.arange(-BEFORE, drop.time.size),
        np.concatenate([np.zeros(BEFORE), drop.load]),
        tuple(sensors),
        Instrument(plate_radius=RADIUS, plate_mass=MASS),
        poisson_ratio=NU,
    )
    return PointRecords("simulated", (record,), (1,)), PrescribedLoad(
        drop.time, drop.load
    ).pulse_duration


def names_of(found: PointDiagnosis) -> set[str]:
    return {effect.name for effect in found.effects}


def value_of(found: PointDiagnosis, name: str, parameter: str) -> float:
    (effect,) = (effect for effect in found.effects if effect.name == name)
    return effect.values_by_name[parameter]


def test_growth_under_one_sensor_is_no_rock(library: SurrogateLibrary) -> None:
    # One sensor hardly tells growth from a carrier of the sensor.
    records, _ = simulated(GIBSON)
    found = diagnose_point(records, library)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    assert "bedrock" not in names_of(found)
    assert found.verdict == "explained"
    assert found.after.modulus_pa == pytest.approx(truth, rel=0.03)
    low, high = known(found.after.modulus_interval_pa)
    assert low < truth < high < 1.15 * low


@pytest.mark.slow
def test_growth_under_a_plate_with_undeclared_mass_is_no_rock(library: SurrogateLibrary) -> None:
    radius, declared, undeclared = 0.1, 7.8, 3.9
    ground = replace(
        SoilProfile.uniform(13e6, 11e3, 2100.0, NU, math.inf), growth=Growth(0.1, 1.0, 5.0)
    )
    hammer = Hammer(mass=10.0, stiffness=8e5, velocity=3.0)
    drop = simulate_drop(ground, Plate(radius, declared + undeclared), hammer, (), 0.1, STEP)
    before = np.zeros(BEFORE)
    velocity = np.concatenate([before, np.gradient(drop.plate_displacement, STEP)])
    noise = np.random.default_rng(1).standard_normal(velocity.size)
    velocity += 2.0 * NOISE * np.abs(velocity).max() * noise
    record = Record(
        STEP * np.arange(-BEFORE, drop.time.size),
        np.concatenate([before, drop.load]),
        (Sensor(0.0, "velocity", velocity),),
        Instrument(plate_radius=radius, plate_mass=declared),
        poisson_ratio=NU,
    )
    diagnosis = diagnose_point(PointRecords("simulated", (record,), (1,)), library)
    assert names_of(diagnosis) == {"plate_inertia", "modulus_gradient"}
    assert value_of(diagnosis, "plate_inertia", "mass") == pytest.approx(undeclared, rel=0.15)
    truth = effective_modulus(ground, Plate(radius, 0.0))
    assert diagnosis.after.modulus_pa == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
def test_growth_under_three_sensors_is_found(library: SurrogateLibrary) -> None:
    records, _ = simulated(GIBSON, BESIDE)
    found = diagnose_point(records, library)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    assert names_of(found) == {"modulus_gradient"}
    assert found.after.modulus_pa == pytest.approx(truth, rel=0.02)
    inverse_depth = value_of(found, "modulus_gradient", "inverse_growth_depth")
    assert 1.0 / inverse_depth == pytest.approx(0.4, rel=0.05)


@pytest.mark.parametrize(
    ("depth", "offsets"),
    [
        (0.6, ()),
        pytest.param(0.9, (), marks=pytest.mark.slow),
        pytest.param(1.4, (), marks=pytest.mark.slow),
        (2.0, ()),
        pytest.param(0.6, BESIDE, marks=pytest.mark.slow),
        pytest.param(2.0, BESIDE, marks=pytest.mark.slow),
    ],
)
def test_rock_is_no_growth(
    depth: float, offsets: tuple[float, ...], library: SurrogateLibrary
) -> None:
    records, _ = simulated(rock(depth), offsets)
    found = diagnose_point(records, library)
    assert names_of(found) == {"bedrock"}
    assert value_of(found, "bedrock", "depth") == pytest.approx(depth, rel=0.02)
    assert found.after.modulus_pa == pytest.approx(50e6, rel=0.02)


@pytest.mark.parametrize(
    ("quality", "depth"),
    [
        pytest.param(20.0, math.inf, marks=pytest.mark.slow),
        pytest.param(10.0, math.inf, marks=pytest.mark.slow),
        pytest.param(5.0, math.inf, marks=pytest.mark.slow),
        (5.0, 1.0),
    ],
)
def test_constant_q_is_found(quality: float, depth: float, library: SurrogateLibrary) -> None:
    ground = constant_q(quality, depth)
    records, pulse = simulated(ground)
    found = diagnose_point(records, library)
    rocks = {"bedrock"} if math.isfinite(depth) else set()
    assert names_of(found) == {"damping_law"} | rocks
    law = ground.damping_law
    assert law is not None
    expected = 50e6 * law.stiffening(math.pi / pulse)
    assert found.after.modulus_pa == pytest.approx(expected, rel=0.01)
    exponent = value_of(found, "damping_law", "loss_exponent")
    assert exponent == pytest.approx(law.exponent, abs=0.005)


def test_uniform_ground_with_a_dashpot_is_neither(library: SurrogateLibrary) -> None:
    records, _ = simulated(rock(math.inf))
    assert diagnose_point(records, library).verdict == "clean"


def test_exponents_of_growth_are_compared_where_sensors_stand_beside_the_plate(
    library: SurrogateLibrary,
) -> None:
    for offsets, growths in (
        ((), {"modulus_gradient_root"}),
        (BESIDE, {"modulus_gradient_root", "modulus_gradient"}),
    ):
        records, _ = simulated(rock(0.6), offsets)
        contexts = [model.context for model in Point(records, library).drops]
        candidates = candidate_structures(contexts)
        names = frozenset[str]().union(*candidates)
        assert names & {"modulus_gradient_root", "modulus_gradient"} == growths
        # What excludes each other is in no structure together.
        for pair in ({"bedrock", "modulus_gradient_root"}, {"layer", "damping_law"}):
            assert not any(structure >= pair for structure in candidates)
