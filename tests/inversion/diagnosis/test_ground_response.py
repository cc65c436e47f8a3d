"""Responses that are remembered, and those nearby by derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from inversion import Instrument, PlateProblem, SurrogateLibrary
from inversion.arrays import ComplexArray
from inversion.diagnosis import ground_response as module
from inversion.diagnosis.ground_response import GroundResponse
from inversion.effects.base import Ground
from inversion.errors import ModelError
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import Medium
from inversion.forward.model import Grounds, transfer_function
from inversion.forward.surrogate import PlateResponse

RADIUS, OFFSETS = 0.15, (0.0, 0.3)
S = DampedTransform(0.05, 500.0).s
BELOW = Ground(4e7, 5e4, 1900.0, 0.0, 6.0)
TOP = Medium(1.2e8, 8e4, 2000.0, 0.35, 0.25)
LAYERED = replace(BELOW, above=(TOP,))
ON_ROCK = replace(LAYERED, inverse_depth=1.0 / 1.5)
CONSTANT_Q = replace(BELOW, loss_exponent=0.06)
GROWING = replace(BELOW, growth_exponent=1.0, inverse_growth_depth=2.5)


@pytest.fixture
def response(library: SurrogateLibrary) -> GroundResponse:
    problem = PlateProblem("rigid-rough", 0.35, tuple(r / RADIUS for r in OFFSETS))
    return GroundResponse(library.get(problem, None), Instrument(RADIUS), OFFSETS, 0.35)


def moved(ground: Ground, step: float) -> list[Ground]:
    """Grounds a small step away, one a parameter."""
    found = [
        replace(ground, modulus=ground.modulus * (1 + step)),
        replace(ground, viscosity=ground.viscosity * (1 + step)),
        replace(ground, density=ground.density * (1 + step)),
    ]
    for name in ("inverse_depth", "loss_exponent", "inverse_growth_depth"):
        if (value := getattr(ground, name)) > 0.0:
            found.append(replace(ground, **{name: value * (1 + step)}))
    for name in ("modulus", "viscosity", "density", "thickness"):
        for medium in ground.above:
            value = getattr(medium, name) * (1 + step)
            found.append(replace(ground, above=(replace(medium, **{name: value}),)))
    return found


@pytest.fixture
def under_plate(library: SurrogateLibrary) -> GroundResponse:
    """The plate alone, for which surrogates of growing ground ship."""
    surrogate = library.get(PlateProblem("rigid-rough", 0.35), None)
    return GroundResponse(surrogate, Instrument(RADIUS), (0.0,), 0.35, library)


@pytest.mark.parametrize(
    "ground",
    [
        CONSTANT_Q,
        replace(CONSTANT_Q, inverse_depth=1.0),
        GROWING,
        replace(GROWING, growth_exponent=0.5, loss_exponent=0.1),
    ],
)
def test_other_soils_are_those_of_the_forward_model(
    under_plate: GroundResponse, library: SurrogateLibrary, ground: Ground
) -> None:
    surrogate: PlateResponse = under_plate.surrogate
    depth = ground.inverse_depth
    if ground.growth_exponent > 0.0:
        surrogate = library.growth(surrogate.problem, ground.growth_exponent)
        depth = ground.inverse_growth_depth
    fields = (ground.modulus, ground.viscosity, ground.density, depth, ground.loss_exponent)
    grounds = Grounds(*np.array(fields)[:, None])
    instrument = Instrument(RADIUS, plate_mass=ground.plate_mass)
    expected = transfer_function(surrogate, instrument, S, grounds)[0]
    np.testing.assert_allclose(under_plate.compliance(ground, S), expected, rtol=1e-12)
    steps = moved(ground, 1e-4)
    here, *others = under_plate.nearby(ground, steps, S)
    for other, step in zip(others, steps, strict=True):
        change = GroundResponse.compliance(under_plate, step, S) - here
        assert np.abs(other - here - change).max() < 1e-3 * np.abs(change).max()


def test_steps_into_loss_are_solved_for(under_plate: GroundResponse) -> None:
    _, lossy = under_plate.nearby(BELOW, [CONSTANT_Q], S)
    np.testing.assert_array_equal(lossy, under_plate.compliance(CONSTANT_Q, S))


@pytest.mark.parametrize("ground", [CONSTANT_Q, replace(GROWING, loss_exponent=0.06)])
def test_lossy_ground_at_rest_is_as_stiff_as_its_modulus(
    under_plate: GroundResponse, ground: Ground
) -> None:
    at_rest = np.append(S, 1e-3)
    without_loss = replace(ground, viscosity=0.0, loss_exponent=0.0)
    expected = under_plate.compliance(without_loss, at_rest)[0, -1].real
    found = under_plate.compliance(replace(ground, viscosity=0.0), at_rest)[0]
    assert found[-1].real == pytest.approx(expected, rel=1e-3)
    # And so in derivatives: a stiffness that no exponent changes.
    more = replace(ground, loss_exponent=2.0 * ground.loss_exponent)
    here, there = under_plate.nearby(ground, [more], at_rest)
    assert there[0, -1] == here[0, -1]
    assert np.all(there[0, :-1] != here[0, :-1])


def test_grounds_that_no_solver_has_are_refused() -> None:
    for ground in (LAYERED, replace(BELOW, inverse_depth=1.0)):
        with pytest.raises(ModelError, match="no layers or rock where the modulus grows"):
            replace(ground, growth_exponent=0.5)
    with pytest.raises(ModelError, match="no layers with constant-Q damping"):
        replace(LAYERED, loss_exponent=0.1)


@pytest.mark.parametrize("ground", [BELOW, replace(BELOW, inverse_depth=1.0), LAYERED, ON_ROCK])
def test_a_small_step_by_derivatives_is_the_step(response: GroundResponse, ground: Ground) -> None:
    step = 1e-3
    here = response.compliance(ground, S)
    near = moved(ground, step)
    exact = [GroundResponse.compliance(response, other, S) for other in near]
    fresh = GroundResponse(response.surrogate, Instrument(RADIUS), OFFSETS, 0.35)
    first, *others = fresh.nearby(ground, near, S)
    np.testing.assert_array_equal(first, here)
    for other, expected in zip(others, exact, strict=True):
        change = expected - here
        found = other - first
        # The fast rule's derivatives are right to 0.6 % of the largest (docs/layers.md).
        assert np.abs(found - change).max() < 0.012 * np.abs(change).max()


def test_a_depth_that_is_given_is_not_moved(library: SurrogateLibrary) -> None:
    problem = PlateProblem("rigid-rough", 0.35, tuple(r / RADIUS for r in OFFSETS))
    every = library.get(problem, None)
    node = every.inverse_depths[5:6]
    one = replace(every, inverse_depths=node, echo_coefficients=every.echo_coefficients[5:6])
    given = GroundResponse(one, Instrument(RADIUS), OFFSETS, 0.35)
    ground = replace(BELOW, inverse_depth=float(node[0]) / RADIUS)
    near = [replace(ground, modulus=ground.modulus * (1 + 1e-3))]
    here, there = given.nearby(ground, near, S)
    change = given.compliance(near[0], S) - given.compliance(ground, S)
    assert np.abs(there - here - change).max() < 0.012 * np.abs(change).max()


def test_one_call_serves_all_steps(
    response: GroundResponse, monkeypatch: pytest.MonkeyPatch
) -> None:
    solves = 0

    def counted(*arguments: object) -> object:
        nonlocal solves
        solves += 1
        return solve(*arguments)

    solve = module.layered_transfer
    monkeypatch.setattr(module, "layered_transfer", counted)
    near = moved(LAYERED, 1e-4)
    response.nearby(LAYERED, near, S)
    # Of the ground itself.
    assert solves == 1
    found = response.nearby(LAYERED, near[::-1], S)
    assert solves == 1
    assert len(found) == 1 + len(near)


def test_another_mass_and_the_step_onto_rock_are_solved(response: GroundResponse) -> None:
    others = [replace(LAYERED, plate_mass=20.0), replace(LAYERED, inverse_depth=1e-3)]
    found = response.nearby(LAYERED, [*others, *moved(LAYERED, 1e-4)], S)
    lone = GroundResponse(response.surrogate, Instrument(RADIUS), OFFSETS, 0.35)
    for row, other in zip(found[1:3], others, strict=True):
        np.testing.assert_array_equal(row, lone.compliance(other, S))


def test_a_medium_like_the_ground_below_is_that_ground(response: GroundResponse) -> None:
    same = replace(BELOW, above=(Medium(4e7, 5e4, 1900.0, 0.35, 0.3),))
    expected = response.compliance(BELOW, S)
    found = response.compliance(same, S)
    # The tables of homogeneous ground are right to some 1e-4 of the response at rest.
    assert np.abs(found - expected).max() < 1.5e-3 * np.abs(expected).max()


def test_what_is_remembered_is_bounded(response: GroundResponse) -> None:
    for number in range(44):
        response.compliance(replace(BELOW, modulus=4e7 + number), S)
    assert len(response._cache) == 24


def test_another_record_length_is_another_response(response: GroundResponse) -> None:
    longer = DampedTransform(0.06, 500.0).s[: S.size]
    short, long = response.compliance(BELOW, S), response.compliance(BELOW, longer)
    assert np.abs(short - long).max() > 0.01 * np.abs(short).max()


def under_part(
    library: SurrogateLibrary, share: float, ground: Ground
) -> tuple[ComplexArray, ComplexArray]:
    """Under a plate of that share of the radius, and under a whole one that touches so far."""
    found = []
    for radius, here in ((share * RADIUS, ground), (RADIUS, replace(ground, contact_share=share))):
        problem = PlateProblem("rigid-rough", 0.35, (0.0, 0.3 / radius))
        response = GroundResponse(
            library.get(problem, None), Instrument(radius), OFFSETS, problem.poisson_ratio
        )
        found.append(response.compliance(here, S))
    return found[0], found[1]


@pytest.mark.parametrize("mass", [0.0, 12.0])
def test_a_plate_that_touches_part_is_a_smaller_plate(
    library: SurrogateLibrary, mass: float
) -> None:
    """To the error of the tables; beside it, where a static ratio stands in, to a twentieth."""
    expected, found = under_part(library, 0.8, replace(BELOW, plate_mass=mass))
    np.testing.assert_allclose(found[0], expected[0], rtol=2e-3)
    np.testing.assert_allclose(found[1], expected[1], atol=0.05 * np.abs(expected[1]).max())


def test_what_comes_back_from_rock_does_not_know_how_far_the_plate_touches(
    library: SurrogateLibrary,
) -> None:
    ground = replace(BELOW, inverse_depth=1.0)
    expected, found = under_part(library, 0.9, ground)
    largest = np.abs(expected[0]).max()
    np.testing.assert_allclose(found[0], expected[0], atol=0.01 * largest)
    whole, _ = under_part(library, 1.0, ground)
    assert np.abs(whole[0] - expected[0]).max() > 0.08 * largest


def test_small_steps_of_a_plate_that_touches_part(response: GroundResponse) -> None:
    ground, step = replace(BELOW, inverse_depth=1.0, contact_share=0.9), 1e-3
    near = [*moved(ground, step), replace(ground, contact_share=0.9 * (1 + step))]
    near.append(replace(ground, plate_mass=6.0 * (1 + step)))
    exact = [response.compliance(other, S) - response.compliance(ground, S) for other in near]
    fresh = GroundResponse(response.surrogate, Instrument(RADIUS), OFFSETS, 0.35)
    first, *others = fresh.nearby(ground, near, S)
    for other, change in zip(others, exact, strict=True):
        assert np.abs(other - first - change).max() < 0.012 * np.abs(change).max()
