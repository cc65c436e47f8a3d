"""The plate on layered ground: the homogeneous model, closed forms, laws and derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion import Instrument, ModelError
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import (
    CONVERGED,
    FAST,
    LAYERED_PLATE_MODELS,
    LayeredGround,
    LayeredGrounds,
    LayeredPlateModel,
    Medium,
    MediumParameter,
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
    layered_transfer,
    layered_transfer_slopes,
)
from inversion.forward.model import Synthesis
from tests import reference
from tests.inversion.forward.converged import half_sine_transform
from tests.inversion.forward.layered.references import uniform_pressure_deflection

Array = NDArray[Any]

RADIUS = 0.15
OFFSETS = (0.0, 0.3, 0.6, 0.9)
NINE = (0.0, 0.203, 0.305, 0.457, 0.61, 0.914, 1.219, 1.524, 1.829)
TRANSFORM = DampedTransform(0.06, 640.0)
TIME = np.linspace(0.0, 0.06, 241)[1:]
AT_REST = np.array([0j])
PRESSURE = 1.0 / (math.pi * RADIUS**2)  # of a unit force

PAVEMENT = LayeredGround(
    (
        Medium(4e9, 3e6, 2350.0, 0.35, 0.15),
        Medium(4e8, 3e5, 2100.0, 0.35, 0.30),
        Medium(1e8, 1e5, 1900.0, 0.40),
    )
)
SOFT_ON_ROCK = LayeredGround(
    (Medium(3e7, 4e4, 1900.0, 0.30, 0.25), Medium(9e7, 8e4, 2000.0, 0.42, 1.1)), rock=True
)


def alone(ground: LayeredGround) -> LayeredGrounds:
    return LayeredGrounds.of([ground])


def homogeneous(
    modulus: float, viscosity: float, poisson_ratio: float, depth: float
) -> LayeredGround:
    medium = Medium(modulus, viscosity, 2000.0, poisson_ratio, depth)
    return LayeredGround((medium,), math.isfinite(depth))


def histories(transfer: Array, duration: float = 0.015) -> Array:
    """Under a half-sine of 1 N, (..., n_times)."""
    s = TRANSFORM.s
    return np.asarray(
        ((transfer * half_sine_transform(s, duration)) @ TRANSFORM.synthesis(TIME)).real
    )


def error_over_peak(result: Array, expected: Array) -> float:
    """Largest over sensors; a far sensor's peak counts at least a tenth of the plate's."""
    peak = np.max(np.abs(expected), axis=-1)
    peak = np.maximum(peak, 0.1 * np.max(peak))
    return float(np.max(np.max(np.abs(result - expected), axis=-1) / peak))


# --- at rest -------------------------------------------------------------------------------------


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.25, 0.35, 0.45, 0.49])
def test_rigid_plates_on_a_half_space_at_rest(poisson_ratio: float) -> None:
    modulus = 5e7
    ground = alone(homogeneous(modulus, 0.0, poisson_ratio, math.inf))
    smooth = reference.smooth_disc_stiffness(modulus, poisson_ratio, RADIUS)
    rough = reference.rough_disc_stiffness(modulus, poisson_ratio, RADIUS)
    for plate, stiffness, tolerance in (
        ("rigid-smooth", smooth, 1e-9),
        ("averaged", smooth, 1e-9),
        # Eight terms of a pressure that oscillates at the edge, most at nu = 0.
        ("rigid-rough", rough, 3e-4 if poisson_ratio == 0.0 else 1e-4),
    ):
        setup = PlateSetup(plate, RADIUS, (0.0, 0.5))  # type: ignore[arg-type]
        centre, outer = displacement_per_force(setup, ground, AT_REST)[0, :, 0]
        assert centre == pytest.approx(1 / stiffness, rel=tolerance)
        if plate != "rigid-rough":
            assert outer / centre == pytest.approx(2 / math.pi * math.asin(RADIUS / 0.5), rel=1e-9)


@pytest.mark.parametrize("offset", [0.0, 0.1, RADIUS, 0.3, 3.0])
@pytest.mark.parametrize(
    ("moduli", "ratios", "thicknesses"),
    [
        ([5e7, 5e7], [0.35, 0.35], [0.3]),
        ([5e9, 5e7], [0.4999999, 0.4999999], [0.15]),
        ([1e8, 2e7], [0.3, 0.4], [0.2]),
        ([3e9, 3e8, 5e7], [0.35, 0.25, 0.45], [0.12, 0.3]),
        ([3e7, 3e8, 5e7, 2e8], [0.35, 0.25, 0.45, 0.1], [0.12, 0.3, 0.2]),
    ],
)
def test_layers_under_uniform_pressure_at_rest(
    moduli: list[float], ratios: list[float], thicknesses: list[float], offset: float
) -> None:
    ground = LayeredGround(
        tuple(
            Medium(modulus, 0.0, 2000.0, nu, h)
            for modulus, nu, h in zip(moduli, ratios, [*thicknesses, math.inf], strict=True)
        )
    )
    setup = PlateSetup("uniform", RADIUS, (offset,))
    result = displacement_per_force(setup, alone(ground), AT_REST)[0, 0, 0]
    expected = uniform_pressure_deflection(moduli, ratios, thicknesses, RADIUS, PRESSURE, offset)
    assert result == pytest.approx(expected, rel=2e-5)


# --- rules, batches, derivatives -----------------------------------------------------------------


THIN_CRUST = LayeredGround(
    (
        Medium(3e9, 3e6, 2400.0, 0.30, 0.02),
        Medium(6e7, 5e4, 1900.0, 0.35, 0.50),
        Medium(1.5e8, 1e5, 2000.0, 0.30),
    )
)
ELASTIC = LayeredGround((Medium(1e7, 0.0, 1800.0, 0.35, 0.3), Medium(2e7, 0.0, 1900.0, 0.30)))


@pytest.mark.parametrize("plate", LAYERED_PLATE_MODELS)
@pytest.mark.parametrize("ground", [PAVEMENT, SOFT_ON_ROCK, THIN_CRUST, ELASTIC])
def test_the_fast_rule_keeps_a_thousandth(ground: LayeredGround, plate: LayeredPlateModel) -> None:
    setup = PlateSetup(plate, RADIUS, NINE)
    fast, exact = (
        histories(displacement_per_force(setup, alone(ground), TRANSFORM.s, rule)[0], 0.02)
        for rule in (FAST, CONVERGED)
    )
    assert error_over_peak(fast, exact) < 1e-3


@pytest.mark.parametrize("ground", [PAVEMENT, SOFT_ON_ROCK, THIN_CRUST])
def test_the_converged_rule_is_converged(ground: LayeredGround) -> None:
    """To 398 Hz, over the centre's compliance at the same frequency."""
    finer = replace(
        CONVERGED,
        order=20,
        width_over_distance=1.0,
        travelling=3.0,
        growth=1.3,
        min_end=200.0,
        end_over_root=25.0,
        end_over_layer=30.0,
        negligible=60.0,
    )
    setup = PlateSetup("rigid-rough", RADIUS, NINE)
    s = np.array([93 + 0j, 93 + 400j, 93 + 2500j])
    result, expected = (
        displacement_per_force(setup, alone(ground), s, rule)[0] for rule in (CONVERGED, finer)
    )
    assert np.max(np.abs(result - expected) / np.abs(expected[0])) < 1e-6


@pytest.mark.parametrize(
    ("top", "s", "tolerance"),
    [
        # A skin of 6 mm, which bends over less than the plate's radius: the thinnest layer ends
        # the integrals.
        (Medium(2e9, 2e6, 2400.0, 0.30, 0.006), 93 + 0j, 3e-4),
        # 533 Hz on soft ground: the shortest wave does.
        (Medium(1e7, 1e3, 1800.0, 0.35, 0.3), 93 + 3349j, 1.5e-3),
    ],
)
def test_the_fast_rule_ends_where_the_integrand_vanishes(
    top: Medium, s: complex, tolerance: float
) -> None:
    ground = alone(LayeredGround((top, Medium(2e7, 1e3, 1900.0, 0.30))))
    setup = PlateSetup("rigid-smooth", RADIUS)
    fast, exact = (
        displacement_per_force(setup, ground, np.array([s]), rule)[0, 0, 0]
        for rule in (FAST, CONVERGED)
    )
    assert abs(fast / exact - 1) < tolerance


@pytest.mark.parametrize("plate", LAYERED_PLATE_MODELS)
@pytest.mark.parametrize("mass", [0.0, 15.0])
def test_slopes_agree_with_differences(plate: LayeredPlateModel, mass: float) -> None:
    grounds = LayeredGrounds.of(
        [
            LayeredGround((*PAVEMENT.media[:2], Medium(1e8, 1e5, 1900.0, 0.4, 2.0)), rock=True),
            LayeredGround(
                (
                    Medium(1e9, 4e5, 2300.0, 0.30, 0.20),
                    Medium(2e7, 3e4, 2000.0, 0.20, 0.25),
                    Medium(1e8, 1e5, 1900.0, 0.45, 1.0),
                ),
                rock=True,
            ),
        ]
    )
    time = np.linspace(0, 0.05, 251)
    load = np.sin(np.pi * np.minimum(time, 0.02) / 0.02)
    setup = PlateSetup(plate, RADIUS, (0.0, 0.1, 0.4))
    synthesis = Synthesis(Instrument(RADIUS, mass), time, load, time[10::10], 200.0)

    def displacement(some: LayeredGrounds) -> Array:
        return synthesis.histories(layered_transfer(setup, mass, synthesis.s, some, CONVERGED))

    values, slopes = map(
        synthesis.histories,
        layered_transfer_slopes(setup, mass, synthesis.s, grounds, grounds.parameters, CONVERGED),
    )
    assert len(grounds.parameters) == 15
    np.testing.assert_allclose(values, displacement(grounds), rtol=1e-9, atol=1e-18)
    for i, (field, medium) in enumerate(grounds.parameters):
        base = getattr(grounds, field)
        step = 1e-4 * base[:, medium]
        sides = []
        for sign in (1, -1):
            moved = base.copy()
            moved[:, medium] += sign * step
            sides.append(displacement(replace(grounds, **{field: moved})))
        change = (sides[0] - sides[1]) / (2 * step[:, None, None])
        size = np.max(np.abs(change), axis=(1, 2), keepdims=True)
        assert np.max(np.abs(slopes[:, i] - change) / size) < 1e-5, (field, medium)


def test_slopes_of_chosen_parameters_and_of_the_fast_rule() -> None:
    setup = PlateSetup("rigid-rough", RADIUS, OFFSETS)
    grounds, s = alone(PAVEMENT), TRANSFORM.s
    chosen = (
        MediumParameter("viscosity", 1),
        MediumParameter("modulus", 2),
        MediumParameter("thickness", 0),
    )
    _, exact = displacement_slopes(setup, grounds, s, chosen)
    values, fast = displacement_slopes(setup, grounds, s, chosen, FAST)
    np.testing.assert_allclose(values, displacement_per_force(setup, grounds, s, FAST), rtol=1e-12)
    assert fast.shape == (1, 3, 4, s.size)
    for i in range(3):
        assert error_over_peak(histories(fast[0, i]), histories(exact[0, i])) < 1e-2


def test_the_mass_of_the_plate_is_outside_the_ground() -> None:
    setup, s = PlateSetup("uniform", RADIUS, OFFSETS), TRANSFORM.s
    free, loaded = (layered_transfer(setup, m, s, alone(SOFT_ON_ROCK))[0] for m in (0.0, 20.0))
    # F_cell = F_contact + m s^2 w_centre
    np.testing.assert_allclose(loaded, free * (1 - 20.0 * s**2 * loaded[0]), rtol=1e-9)


# --- what is refused -----------------------------------------------------------------------------


FINITE, ENDLESS = Medium(5e7, 0.0, 2000.0, 0.35, 1.0), Medium(5e7, 0.0, 2000.0, 0.35)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(FINITE, modulus=0.0), "modulus: expected a value > 0 Pa, got 0"),
        (lambda: replace(FINITE, viscosity=-1.0), "viscosity: expected >= 0 Pa s"),
        (lambda: replace(FINITE, density=-5.0), "density: expected > 0 kg/m3"),
        (lambda: replace(FINITE, poisson_ratio=0.5), "Poisson's ratio: expected 0 <= value < 0.5"),
        (lambda: replace(FINITE, thickness=0.0), "thickness: expected a value > 0 m"),
        (lambda: LayeredGround(()), "at least one medium"),
        (lambda: LayeredGround((ENDLESS, ENDLESS)), "above the last medium: expected finite"),
        (lambda: LayeredGround((FINITE, FINITE)), "finite on rock, infinite without"),
        (lambda: LayeredGround((FINITE, ENDLESS), True), "finite on rock, infinite without"),
        (lambda: LayeredGrounds.of([PAVEMENT, SOFT_ON_ROCK]), "same number of media"),
        (
            lambda: replace(alone(PAVEMENT), modulus=-alone(PAVEMENT).modulus),
            "modulus: expected values > 0 Pa",
        ),
        (lambda: PlateSetup("soft", RADIUS), "expected one of .*uniform, got 'soft'"),  # type: ignore[arg-type]
        (lambda: PlateSetup("uniform", 0.0), "plate radius: expected a value > 0 m"),
        (lambda: PlateSetup("uniform", RADIUS, (-0.3,)), "sensor offsets: expected values >= 0 m"),
    ],
)
def test_values_out_of_range_are_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make()


def test_the_depth_of_rock_is_the_sum_of_the_thicknesses() -> None:
    assert SOFT_ON_ROCK.rock_depth == pytest.approx(1.35)
    assert PAVEMENT.rock_depth == math.inf


def test_laplace_variables_that_have_no_answer() -> None:
    setup = PlateSetup("uniform", RADIUS)
    with pytest.raises(ModelError, match=r"Laplace variables: expected Re s > 0, or s = 0, got"):
        displacement_per_force(setup, alone(PAVEMENT), np.array([100j, 10 + 0j]))
    elastic = alone(ELASTIC)
    with pytest.raises(ModelError, match="try a larger real part"):
        displacement_per_force(setup, elastic, np.array([1e-4 + 5000j]))


def test_rest_and_waves_may_share_a_call() -> None:
    setup = PlateSetup("rigid-smooth", RADIUS, OFFSETS)
    together = displacement_per_force(setup, alone(SOFT_ON_ROCK), np.array([0j, 93 + 400j]))
    for i, s in enumerate((0j, 93 + 400j)):
        single = displacement_per_force(setup, alone(SOFT_ON_ROCK), np.array([s]))
        np.testing.assert_allclose(together[..., i], single[..., 0], rtol=1e-6)
