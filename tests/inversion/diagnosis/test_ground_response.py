"""Responses that are remembered, and those nearby by derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from inversion import Instrument, PlateProblem, SurrogateLibrary
from inversion.arrays import ComplexArray
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
    result = [
        replace(ground, modulus=ground.modulus * (1 + step)),
        replace(ground, viscosity=ground.viscosity * (1 + step)),
        replace(ground, density=ground.density * (1 + step)),
    ]
    for name in ("inverse_depth", "loss_exponent", "inverse_growth_depth"):
        if (value := getattr(ground, name)) > 0.0:
            result.append(replace(ground, **{name: value * (1 + step)}))
    for name in ("modulus", "viscosity", "density", "thickness"):
        for medium in ground.above:
            value = getattr(medium, name) * (1 + step)
            result.append(replace(ground, above=(replace(medium, **{name: value}),)))
    return result


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
def test_lossy_and_growing_grounds_are_those_of_the_forward_model(
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
    base, *variants = under_plate.nearby(ground, steps, S)
    for variant, step in zip(variants, steps, strict=True):
        change = GroundResponse.compliance(under_plate, step, S) - base
        assert np.abs(variant - base - change).max() < 1e-3 * np.abs(change).max()


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
    result = under_plate.compliance(replace(ground, viscosity=0.0), at_rest)[0]
    assert result[-1].real == pytest.approx(expected, rel=1e-3)
    # And so in derivatives: a stiffness that no exponent changes.
    more = replace(ground, loss_exponent=2.0 * ground.loss_exponent)
    base, ahead = under_plate.nearby(ground, [more], at_rest)
    assert ahead[0, -1] == base[0, -1]
    assert np.all(ahead[0, :-1] != base[0, :-1])


def test_grounds_that_no_solver_has_are_refused() -> None:
    for ground in (LAYERED, replace(BELOW, inverse_depth=1.0)):
        with pytest.raises(ModelError, match="no layers or rock where the modulus grows"):
            replace(ground, growth_exponent=0.5)
    with pytest.raises(ModelError, match="no layers with constant-Q damping"):
        replace(LAYERED, loss_exponent=0.1)


@pytest.mark.parametrize("ground", [BELOW, replace(BELOW, inverse_depth=1.0), LAYERED, ON_ROCK])
def test_a_small_step_by_derivatives_is_the_step(response: GroundResponse, ground: Ground) -> None:
    step = 1e-3
    base = response.compliance(ground, S)
    inner = moved(ground, step)
    exact = [GroundResponse.compliance(response, variant, S) for variant in inner]
    fresh = GroundResponse(response.surrogate, Instrument(RADIUS), OFFSETS, 0.35)
    first, *variants = fresh.nearby(ground, inner, S)
    np.testing.assert_array_equal(first, base)
    for variant, expected in zip(variants, exact, strict=True):
        change = expected - base
        result = variant - first
        # The fast rule's derivatives are right to 0.6 % of the largest (docs/layers.md).
        assert np.abs(result - change).max() < 0.012 * np.abs(change).max()


def test_the_depth_of_a_single_table_stays_fixed(library: SurrogateLibrary) -> None:
    problem = PlateProblem("rigid-rough", 0.35, tuple(r / RADIUS for r in OFFSETS))
    every = library.get(problem, None)
    node = every.inverse_depths[5:6]
    item = replace(every, inverse_depths=node, echo_coefficients=every.echo_coefficients[5:6])
    tabulated = GroundResponse(item, Instrument(RADIUS), OFFSETS, 0.35)
    ground = replace(BELOW, inverse_depth=float(node[0]) / RADIUS)
    inner = [replace(ground, modulus=ground.modulus * (1 + 1e-3))]
    base, ahead = tabulated.nearby(ground, inner, S)
    change = tabulated.compliance(inner[0], S) - tabulated.compliance(ground, S)
    assert np.abs(ahead - base - change).max() < 0.012 * np.abs(change).max()


def test_another_mass_and_the_step_onto_rock_are_solved(response: GroundResponse) -> None:
    variants = [replace(LAYERED, plate_mass=20.0), replace(LAYERED, inverse_depth=1e-3)]
    result = response.nearby(LAYERED, [*variants, *moved(LAYERED, 1e-4)], S)
    lone = GroundResponse(response.surrogate, Instrument(RADIUS), OFFSETS, 0.35)
    for row, variant in zip(result[1:3], variants, strict=True):
        np.testing.assert_array_equal(row, lone.compliance(variant, S))


def test_another_record_length_is_another_response(response: GroundResponse) -> None:
    longer = DampedTransform(0.06, 500.0).s[: S.size]
    short, long = response.compliance(BELOW, S), response.compliance(BELOW, longer)
    assert np.abs(short - long).max() > 0.01 * np.abs(short).max()


def under_part(
    library: SurrogateLibrary, share: float, ground: Ground
) -> tuple[ComplexArray, ComplexArray]:
    """Under a plate of that share of the radius, and under a whole one that touches so far."""
    result = []
    for radius, base in ((share * RADIUS, ground), (RADIUS, replace(ground, contact_share=share))):
        problem = PlateProblem("rigid-rough", 0.35, (0.0, 0.3 / radius))
        response = GroundResponse(
            library.get(problem, None), Instrument(radius), OFFSETS, problem.poisson_ratio
        )
        result.append(response.compliance(base, S))
    return result[0], result[1]


@pytest.mark.parametrize("mass", [0.0, 12.0])
def test_a_plate_in_partial_contact_is_a_smaller_plate(
    library: SurrogateLibrary, mass: float
) -> None:
    """To the error of the tables; beside it, where a static ratio stands in, to a twentieth."""
    expected, result = under_part(library, 0.8, replace(BELOW, plate_mass=mass))
    np.testing.assert_allclose(result[0], expected[0], rtol=2e-3)
    np.testing.assert_allclose(result[1], expected[1], atol=0.05 * np.abs(expected[1]).max())


def test_the_echo_of_rock_does_not_depend_on_the_contact_share(
    library: SurrogateLibrary,
) -> None:
    ground = replace(BELOW, inverse_depth=1.0)
    expected, result = under_part(library, 0.9, ground)
    largest = np.abs(expected[0]).max()
    np.testing.assert_allclose(result[0], expected[0], atol=0.01 * largest)
    complete, _ = under_part(library, 1.0, ground)
    assert np.abs(complete[0] - expected[0]).max() > 0.08 * largest
