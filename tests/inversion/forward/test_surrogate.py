"""The surrogate against the converged rule it stands for, and what any linear ground must obey."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion import SurrogateLibrary
from inversion.errors import ModelError
from inversion.forward.contact import PlateModel, PlateProblem
from inversion.forward.laplace import DampedTransform
from inversion.forward.model import Grounds, Instrument, transfer_slopes
from inversion.forward.rational import numerators
from inversion.forward.surrogate import MIN_DEPTH_RADII, Surrogate
from inversion.forward.surrogate_building import build_surrogate
from tests.inversion.forward.converged import (
    converged_compliance,
    half_sine_transform,
    motion_before_load,
    slope_error,
)

Array = NDArray[Any]

RADIUS = 0.15
TRANSFORM = DampedTransform(0.1, 1600.0)
TIME = np.linspace(2.5e-4, 0.1, 400)
SYNTHESIS = TRANSFORM.synthesis(TIME)


@pytest.fixture(scope="module")
def every_depth(library: SurrogateLibrary) -> Surrogate:
    """Smooth plate, nu = 0.35, all depths."""
    return library.get(PlateProblem("rigid-smooth", 0.35), None)


@pytest.fixture(scope="module")
def progress() -> list[float]:
    """Progress reports of the build of `fixed_depth`."""
    return []


@pytest.fixture(scope="module")
def fixed_depth(progress: list[float]) -> Surrogate:
    """Rough plate, nu = 0.25, rock at 5 radii, built afresh."""
    return build_surrogate(PlateProblem("rigid-rough", 0.25), 5.0, progress.append)


# --- against the converged rule ------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A ground (Pa, Pa s, kg/m3, plate radii) and the duration of a half-sine, s."""

    modulus: float
    viscosity: float
    density: float
    depth: float
    pulse: float


def draw_cases(count: int, viscosities: tuple[float, float], seed: int) -> list[Case]:
    """Random grounds and pulses of the whole range a survey meets."""
    rng = random.Random(seed)

    def spread(low: float, high: float) -> float:
        return low * (high / low) ** rng.random()

    return [
        Case(
            modulus=spread(10e6, 300e6),
            viscosity=rng.uniform(*viscosities),
            density=spread(1000.0, 2800.0),
            depth=spread(1.02 * MIN_DEPTH_RADII, 60.0),
            pulse=rng.uniform(8e-3, 30e-3),
        )
        for _ in range(count)
    ]


def shear_and_p(case: Case, poisson_ratio: float) -> tuple[Array, Array]:
    shear = (case.modulus + case.viscosity * TRANSFORM.s) / (2 * (1 + poisson_ratio))
    return shear, TRANSFORM.s * RADIUS * np.sqrt(case.density / shear)


def error_of(surrogate: Surrogate, case: Case) -> Array:
    """Largest difference over 100 ms to the converged rule, over the plate's peak, per offset."""
    problem = surrogate.problem
    shear, p = shear_and_p(case, problem.poisson_ratio)
    exact = converged_compliance(problem, p**2, case.depth)
    fast = surrogate.compliance(p[None], np.array([1 / case.depth]))[0]
    spectrum = half_sine_transform(TRANSFORM.s, case.pulse) / shear
    right, result = (((phi * spectrum) @ SYNTHESIS).real for phi in (exact, fast))
    difference: Array = np.abs(result - right).max(axis=1) / np.abs(right[0]).max()
    return difference


DAMPED = (5e3, 130e3)


def test_every_depth_of_damped_ground(every_depth: Surrogate) -> None:
    errors = [error_of(every_depth, case)[0] for case in draw_cases(30, DAMPED, seed=1)]
    assert max(errors) < 1e-3
    assert np.median(errors) < 1e-4


def test_every_depth_of_undamped_ground(every_depth: Surrogate) -> None:
    errors = [error_of(every_depth, case)[0] for case in draw_cases(10, (0.0, 0.0), seed=2)]
    assert max(errors) < 1e-3


def test_a_fixed_depth_agrees_with_the_converged_rule(fixed_depth: Surrogate) -> None:
    cases = [replace(case, depth=5.0) for case in draw_cases(12, DAMPED, seed=3)]
    errors = [error_of(fixed_depth, case)[0] for case in cases]
    assert max(errors) < 1e-3
    assert np.median(errors) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plate", "poisson_ratio"),
    [
        ("rigid-rough", 0.35),
        ("rigid-rough", 0.25),
        ("rigid-rough", 0.45),
        pytest.param(
            "published",
            0.35,
        ),
    ],
)
def test_each_plate_agrees_with_the_converged_rule(plate: PlateModel, poisson_ratio: float) -> None:
    surrogate = build_surrogate(PlateProblem(plate, poisson_ratio))
    errors = [error_of(surrogate, case)[0] for case in draw_cases(40, DAMPED, seed=4)]
    assert max(errors) < 1e-3
    assert np.median(errors) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("depth", [MIN_DEPTH_RADII, 4.0, 20.0])
def test_several_sensors_agree_with_the_converged_rule(depth: float) -> None:
    surrogate = build_surrogate(PlateProblem("rigid-rough", 0.35, (0.0, 2.0, 4.0, 6.0)), depth)
    cases = [replace(case, depth=depth) for case in draw_cases(10, DAMPED, seed=5)]
    errors = [error_of(surrogate, case) for case in cases]
    assert np.max(errors) < 1e-3
    assert np.median(errors) < 1e-4


def test_progress_of_the_build(fixed_depth: Surrogate, progress: list[float]) -> None:
    assert fixed_depth.inverse_depths == pytest.approx([0.2])
    assert progress == sorted(progress)
    assert progress[0] > 0
    assert progress[-1] == 1


@pytest.fixture(scope="module")
def shallow() -> Surrogate:
    """Rock shallower than the tables of all depths hold."""
    return build_surrogate(PlateProblem("rigid-smooth", 0.35), 1.3)


def test_a_shallow_depth_agrees_with_the_converged_rule(shallow: Surrogate) -> None:
    cases = [replace(case, depth=1.3) for case in draw_cases(6, DAMPED, seed=6)]
    assert max(error_of(shallow, case)[0] for case in cases) < 1e-3


def test_half_space_alone() -> None:
    surrogate = build_surrogate(PlateProblem("rigid-smooth", 0.35), math.inf)
    case = Case(40e6, 54e3, 2000.0, math.inf, 0.0133)
    assert error_of(surrogate, case)[0] < 1e-4


# --- what any linear, causal ground obeys --------------------------------------------------------


def test_every_pole_is_in_the_left_half_plane(
    every_depth: Surrogate, fixed_depth: Surrogate
) -> None:
    for surrogate in (every_depth, fixed_depth):
        assert np.all(surrogate.half_space_poles.real < 0)
        assert np.all(surrogate.echo_poles.real < 0)


@pytest.mark.parametrize("viscosity", [0.0, 20e3])
@pytest.mark.parametrize("depth", [2.0, 8.0, math.inf])
def test_motion_begins_with_the_load(
    viscosity: float, depth: float, every_depth: Surrogate
) -> None:
    shear, p = shear_and_p(Case(40e6, viscosity, 2000.0, depth, 0.0133), 0.35)
    phi = every_depth.compliance(p[None], np.array([1 / depth]))[0]
    assert motion_before_load(phi[0] / shear, TRANSFORM, TIME, 0.03) < 1e-4


# --- depths --------------------------------------------------------------------------------------


def test_interpolation_is_the_polynomial_through_the_nodes(every_depth: Surrogate) -> None:
    nodes, place = every_depth.inverse_depths, 0.1234
    lagrange = [math.prod((place - b) / (a - b) for b in nodes if b != a) for a in nodes]
    coefficients = np.tensordot(lagrange, every_depth.echo_coefficients, axes=1)
    right = numerators(every_depth.echo_poles, coefficients)
    size = np.abs(right).max()
    result = every_depth.echo_at(np.array([place]))[0]
    assert np.max(np.abs(result - right)) < 1e-10 * size


def test_a_batch_of_depths_equals_each_depth(every_depth: Surrogate) -> None:
    _, p = shear_and_p(Case(40e6, 54e3, 2000.0, 0.0, 0.0133), 0.35)
    ratios = np.array([0.5, 0.0, 0.1, 0.1])
    together = every_depth.compliance(np.repeat(p[None], 4, axis=0), ratios)
    for row, ratio in enumerate(ratios):
        alone = every_depth.compliance(p[None], np.array([ratio]))[0]
        assert together[row] == pytest.approx(alone, rel=1e-9)
    half_space = every_depth.compliance(p[None], np.zeros(1))[0]
    assert np.array_equal(together[1], half_space)


def test_depths_outside_the_tables_are_refused(
    every_depth: Surrogate, fixed_depth: Surrogate
) -> None:
    p = np.array([[0.1 + 0.5j]])
    with pytest.raises(ModelError, match=r"bedrock depth: expected at least 1\.6 .*got 1\.5"):
        every_depth.compliance(p, np.array([1 / 1.5]))
    with pytest.raises(ModelError, match=r"built for 5 plate radii alone, got 5\.1"):
        fixed_depth.compliance(p, np.array([1 / 5.1]))


FIELDS = ("modulus", "viscosity", "density", "inverse_depth")


def test_slopes_without_depth_and_over_a_half_space(
    every_depth: Surrogate, fixed_depth: Surrogate
) -> None:
    s, several = TRANSFORM.s[::20], np.array([0.0, 1 / 0.9])
    two = np.full(2, 1.0)
    ground = Grounds(40e6 * two, 20e3 * two, 1900.0 * two, several)
    instrument = Instrument(RADIUS, 15.0)
    complete = transfer_slopes(every_depth, instrument, s, ground, FIELDS)[1]
    some = transfer_slopes(every_depth, instrument, s, ground, ("density", "modulus"))[1]
    assert np.allclose(some, complete[:, [2, 0]], rtol=1e-12, atol=0.0)
    assert np.all(complete[0, 3] == 0.0)  # no rock, none that could come nearer
    equal = replace(ground, inverse_depth=np.full(2, 1 / (5.0 * RADIUS)))
    assert slope_error(fixed_depth, instrument, s, equal, ("modulus",), "modulus") < 1e-6
