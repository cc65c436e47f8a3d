"""What nature gives decides between grounds that fit alike, and between those alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from inversion import InversionResult, Record, Settings, SurrogateLibrary, invert
from inversion.fitting.ground_parameters import (
    DENSITY,
    DEPTH,
    MODULUS,
    VISCOSITY,
    homogeneous_space,
)
from inversion.fitting.homogeneous_fit import fit_homogeneous
from inversion.fitting.misfit import Misfit
from inversion.forward.model import Instrument
from inversion.measured.record import Sensor
from simulators.drop import DropSimulator, Hammer
from simulators.mesh import Ground, Plate
from tests.inversion.synthetic import Scene, record, responses, space, weighted

MODULUS_PA = 30e6


@pytest.fixture(scope="module")
def without_rock() -> Record:
    """A drop of 8 ms on a half-space, by finite elements; the depth is not declared."""
    radius, mass, pulse = 0.05, 2.0, 0.008
    weight = 300e3 * math.pi * radius**2 * pulse / (math.pi * 3.0)
    hammer = Hammer(weight, weight * (math.pi / pulse) ** 2, 3.0)
    ground = Ground.uniform(MODULUS_PA, 40e3, 1850.0, 0.35, math.inf)
    simulator = DropSimulator(
        ground, Plate(radius, mass), (0.0,), 0.036, 1e-4, hammer.pulse_duration
    )
    drop = simulator.run(hammer)
    rest = 200
    rng = np.random.default_rng(5)

    def recorded(values: np.ndarray) -> np.ndarray:
        noise = 0.002 * float(np.max(np.abs(values)))
        whole = np.concatenate([np.zeros(rest), values])
        return whole + noise * rng.standard_normal(whole.size)

    load, speed = recorded(drop.load), recorded(drop.ground_velocity[0])
    time = 1e-4 * np.arange(-rest, drop.load.size)
    sensor = Sensor(0.0, "velocity", speed)
    return Record(time, load, (sensor,), Instrument(radius, mass), 0.35)


@pytest.fixture(scope="module")
def found(without_rock: Record, library: SurrogateLibrary) -> dict[bool, InversionResult]:
    """With and without priors."""
    return {
        priors: invert(without_rock, Settings(method="least-squares", priors=priors), library)
        for priors in (True, False)
    }


def test_ground_without_rock_is_known_by_the_centre_alone(
    found: dict[bool, InversionResult],
) -> None:
    natural = found[True]
    assert natural.model == "half-space"
    assert natural.modulus_pa == pytest.approx(MODULUS_PA, rel=0.02)
    low, high = natural.modulus_interval_pa
    assert low < MODULUS_PA < high < 1.2 * low
    assert natural.priors


def test_without_priors_the_record_leaves_it_open(found: dict[bool, InversionResult]) -> None:
    free = found[False]
    assert not free.priors
    assert free.model == "layer"
    low, high = free.modulus_interval_pa
    assert low < MODULUS_PA < high
    assert high > 1.5 * low
    assert any("depth not unique" in warning for warning in free.warnings)


def test_what_the_data_tell_is_not_bent(library: SurrogateLibrary) -> None:
    """A depth that the tail shows: to the last digit the same with and without priors."""
    drop = weighted(library, record(library, Scene("velocity", 2e-4, 10.0, length=0.06, seed=2)))
    with_priors, without = (
        fit_homogeneous(
            (drop,),
            space(density=None),
            responses(library, drop),
            "least-squares",
            np.random.default_rng(4),
            priors=priors,
        )
        for priors in (True, False)
    )
    assert np.array_equal(with_priors.best.point, without.best.point)
    assert with_priors.best.cost == without.best.cost


def test_a_declared_depth_knows_of_no_priors(
    without_rock: Record, library: SurrogateLibrary
) -> None:
    declared = replace(without_rock, bedrock_depth=math.inf)
    with_priors, without = (
        invert(declared, Settings(method="least-squares", priors=priors), library)
        for priors in (True, False)
    )
    assert with_priors.layers == without.layers


def test_one_deviation_weighs_as_one_of_six_errors_a_drop(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene()))
    of = homogeneous_space(45e6, 0.15, 0.35)
    points = np.array([[0.5, 0.1, 0.6, 0.4], [0.4, 0.3, 0.9, 0.1]])
    for count in (1, 2):
        free = Misfit((drop,) * count, of, responses(library, drop), 640.0, 64)
        held = Misfit((drop,) * count, of, responses(library, drop), 640.0, 64, prior_level=2.5)
        away = of.prior_distances(points)[0]
        expected = 2.5 * np.sum(away**2, axis=1) / (6.0 * count)
        samples = free.residual(points).shape[1]
        total = held.objective(points) * (samples + 4) / samples
        np.testing.assert_allclose(total - free.objective(points), expected, rtol=1e-9)
        np.testing.assert_allclose(held.data_cost(points), free.objective(points), rtol=1e-12)


def test_slopes_of_priors_are_differences(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene()))
    of = homogeneous_space(45e6, 0.15, 0.35)
    held = Misfit((drop,), of, responses(library, drop), 640.0, 64, prior_level=2.5)
    here = np.array([[0.5, 0.1, 0.6, 0.4]])
    values, slopes = held.linearise(here, np.arange(4))
    for column in range(4):
        step = np.zeros((1, 4))
        step[0, column] = 1e-6
        moved = (held.residual(here + step) - held.residual(here - step)) / 2e-6
        np.testing.assert_allclose(slopes[0, -4:, column], moved[0, -4:], rtol=1e-5, atol=1e-6)
    assert values.shape[1] == held.residual(here).shape[1]


def test_what_nature_gives() -> None:
    of = homogeneous_space(50e6, 0.15, 0.35)
    by_name = {u.name: u.parameter for u in of.unknowns}
    assert by_name[MODULUS].prior is None

    def away(name: str, value: float) -> float:
        parameter = by_name[name]
        return float(parameter.prior_distance(parameter.unit_value(value))[0])

    assert away(DENSITY, 1900.0) == pytest.approx(0.0, abs=1e-9)
    assert away(DENSITY, 1900.0 * math.exp(0.12)) == pytest.approx(1.0)
    assert away(VISCOSITY, 50e6 * 1.0e-3) == pytest.approx(0.0, abs=1e-9)
    assert away(VISCOSITY, 50e6 * 2.5e-3) == pytest.approx(1.0)
    assert away(DEPTH, 0.8) == pytest.approx(1.0)
    assert away(DEPTH, 0.4) == pytest.approx(2.0)


def test_grounds_fit_alike_up_to_six_of_chi_square(library: SurrogateLibrary) -> None:
    drop = weighted(library, record(library, Scene("velocity", 2e-4, 10.0, length=0.06, seed=2)))
    fit = fit_homogeneous(
        (drop, drop),
        space(density=None),
        responses(library, drop),
        "least-squares",
        np.random.default_rng(4),
        priors=False,
    )
    assert fit.best.cost < 1.0
    assert fit.max_cost - fit.best.cost == pytest.approx(6.0 / 12.0)
