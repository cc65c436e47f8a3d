"""Drops by finite elements on constant-Q soil, soil that grows stiffer with depth, and rock."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inversion import Record, Sensor, SurrogateLibrary
from inversion.diagnosis import PointRecords
from inversion.diagnosis.problem import Point
from inversion.forward.model import Instrument
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import (
    Structure,
    candidate_structures,
    fit_briefly,
    least_gain,
    rank_structures,
)
from simulators.drop import Hammer, PrescribedLoad, simulate_drop
from simulators.finite_elements import effective_modulus
from simulators.mesh import ConstantQ, Ground, Growth, Plate

RADIUS, MASS, STEP, BEFORE = 0.15, 12.0, 1e-4, 200
NOISE = 1e-3
"""Of the peak."""
NU = 0.35
ALWAYS = frozenset({"sensor_lag", "plate_inertia"})
BEND = frozenset({"stress_dependence", "hysteretic_unloading"})
BESIDE = (0.3, 0.6)
GIBSON = replace(Ground.uniform(25e6, 25e3, 1900.0, NU, math.inf), growth=Growth(0.4, 1.0, 5.0))


def rock(depth: float) -> Ground:
    return Ground.uniform(50e6, 5e4, 1900.0, NU, depth)


def constant_q(quality: float, depth: float = math.inf) -> Ground:
    """Return ground of 50 MPa at 30 Hz."""
    elastic = Ground.uniform(50e6, 0.0, 1900.0, NU, depth)
    return replace(elastic, damping_law=ConstantQ(quality, 2.0 * math.pi * 30.0))


@cache
def simulated(ground: Ground, offsets: tuple[float, ...] = ()) -> tuple[PointRecords, float]:
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


@pytest.fixture(scope="module")
def library() -> SurrogateLibrary:
    return SurrogateLibrary()


def fit(records: PointRecords, structure: Structure, library: SurrogateLibrary) -> Posterior:
    """Return the fit of a structure from its brief fit on."""
    brief = fit_briefly(Point(records, library), ALWAYS | structure, 0, {})
    assert brief is not None
    return PointFit(brief.model, brief.values).run()


def modulus(posterior: Posterior) -> float:
    return posterior.model.modulus(posterior.values)


def choose(records: PointRecords, library: SurrogateLibrary) -> Structure:
    """Return the candidate structure of the largest evidence."""
    evidence = rank_structures(Point(records, library), 0, {})
    return max(evidence, key=lambda structure: evidence[structure])


def test_growth_under_one_sensor_is_preferred_to_rock(library: SurrogateLibrary) -> None:
    records, _ = simulated(GIBSON)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    # One sensor hardly tells the exponent, and need not.
    for growth in ("root_growth", "linear_growth"):
        grown = fit(records, frozenset({growth}), library)
        assert modulus(grown) == pytest.approx(truth, rel=0.02)
        for other in (frozenset[str](), frozenset({"bedrock"}), BEND | {"bedrock"}):
            gain = grown.log_evidence - fit(records, other, library).log_evidence
            assert gain > least_gain(frozenset({growth})) > 0.0


@pytest.mark.slow
def test_growth_under_three_sensors_is_found(library: SurrogateLibrary) -> None:
    records, _ = simulated(GIBSON, BESIDE)
    structure = choose(records, library)
    assert "linear_growth" in structure
    grown = fit(records, structure, library)
    truth = effective_modulus(GIBSON, Plate(RADIUS, 0.0))
    assert modulus(grown) == pytest.approx(truth, rel=0.02)
    inverse_depth = grown.by_key["linear_growth", "inverse_growth_depth", None]
    assert 1.0 / inverse_depth == pytest.approx(0.4, rel=0.05)


@pytest.mark.parametrize(
    "depth",
    [
        0.6,
        pytest.param(0.9, marks=pytest.mark.slow),
        pytest.param(1.4, marks=pytest.mark.slow),
        2.0,
    ],
)
def test_rock_is_no_growth(depth: float, library: SurrogateLibrary) -> None:
    records, _ = simulated(rock(depth))
    structure = choose(records, library)
    assert "bedrock" in structure
    found = fit(records, structure, library)
    assert 1.0 / found.by_key["bedrock", "depth", None] == pytest.approx(depth, rel=0.02)
    assert modulus(found) == pytest.approx(50e6, rel=0.02)


@pytest.mark.parametrize(
    ("quality", "depth"),
    [
        pytest.param(20.0, math.inf, marks=pytest.mark.slow),
        pytest.param(10.0, math.inf, marks=pytest.mark.slow),
        (5.0, math.inf),
        (5.0, 1.0),
    ],
)
def test_constant_q_is_found(quality: float, depth: float, library: SurrogateLibrary) -> None:
    ground = constant_q(quality, depth)
    records, pulse = simulated(ground)
    structure = choose(records, library)
    assert "constant_q" in structure
    assert ("bedrock" in structure) == math.isfinite(depth)
    found = fit(records, structure, library)
    law = ground.damping_law
    assert law is not None
    assert modulus(found) == pytest.approx(50e6 * law.stiffening(math.pi / pulse), rel=0.01)
    exponent = found.by_key["constant_q", "loss_exponent", None]
    assert exponent == pytest.approx(law.exponent, abs=0.005)


def test_uniform_ground_with_a_dashpot_is_neither(library: SurrogateLibrary) -> None:
    records, _ = simulated(rock(math.inf))
    assert not choose(records, library) & {"constant_q", "root_growth", "linear_growth", "bedrock"}


def test_exponents_of_growth_are_compared_where_sensors_stand_beside_the_plate(
    library: SurrogateLibrary,
) -> None:
    for offsets, growths in (((), {"root_growth"}), (BESIDE, {"root_growth", "linear_growth"})):
        records, _ = simulated(rock(0.6), offsets)
        contexts = [model.context for model in Point(records, library).drops]
        candidates = candidate_structures(contexts)
        names = frozenset[str]().union(*candidates)
        assert names & {"root_growth", "linear_growth"} == growths
        # What excludes each other is in no structure together.
        for pair in ({"bedrock", "root_growth"}, {"layer", "constant_q"}):
            assert not any(structure >= pair for structure in candidates)
