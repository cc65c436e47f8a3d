"""Hammer, plate and non-linear contact on finite-element ground, against independent results."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulators.drop import STANDARD_GRAVITY, DropSimulator, Hammer
from simulators.mesh import Array, GroundError, Plate, SoilProfile
from tests.campaigns.effects.march import Indentation, strike
from tests.campaigns.effects.response import (
    MIN_PULSE_S,
    RESOLUTION,
    RESPONSE_STEP_S,
    GroundResponse,
    ground_response,
)
from tests.campaigns.effects.soil import Hysteresis, PowerLaw

GROUND = SoilProfile.uniform(40e6, 54e3, 1900.0, 0.35, 0.5)
RADIUS, OFFSETS, DURATION = 0.15, (0.0, 0.3), 0.045
HAMMER = Hammer(10.0, 3e5, 2.0)
MASS, SAMPLES = 10.0, 800
# The march takes its ground from these finite elements, however coarse they are.
COARSE = replace(RESOLUTION, edge_element=0.01, elements_per_wavelength=2.0)


@pytest.fixture(scope="module")
def response() -> GroundResponse:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.campaigns.effects.response.RESOLUTION", COARSE)
        return ground_response(GROUND, RADIUS, OFFSETS, duration=DURATION)


def slow_force(peak: float) -> Array:
    """Return a force so slow that the ground is practically at rest, N."""
    return peak * np.sin(math.pi * np.arange(SAMPLES) / SAMPLES) ** 2


def test_the_march_agrees_with_finite_elements_that_include_the_plate(
    response: GroundResponse,
) -> None:
    drop = strike(response, MASS, HAMMER, SAMPLES)
    duration = (SAMPLES - 1) * RESPONSE_STEP_S
    simulator = DropSimulator(
        GROUND, Plate(RADIUS, MASS), OFFSETS, duration, RESPONSE_STEP_S, MIN_PULSE_S, COARSE
    )
    reference = simulator.run(HAMMER)
    for name in ("load", "contact_force", "ground_displacement", "ground_velocity"):
        marched, expected = getattr(drop, name), getattr(reference, name)
        # the grids differ in size, because the record is shorter than the response
        np.testing.assert_allclose(marched, expected, atol=2e-4 * np.max(np.abs(expected)))


def test_a_rescaled_response_is_that_of_the_rescaled_ground(response: GroundResponse) -> None:
    scaled = response.rescaled(time=1.25, density=0.9)
    layer = scaled.ground.layers[0]
    assert layer.density == pytest.approx(0.9 * 1900)
    assert layer.modulus == pytest.approx(40e6 * 0.9 / 1.25**2)
    assert layer.viscosity == pytest.approx(54e3 * 0.9 / 1.25)
    plate = Plate(RADIUS, MASS)
    duration = (SAMPLES - 1) * scaled.time_step
    simulator = DropSimulator(
        scaled.ground, plate, OFFSETS, duration, scaled.time_step, 0.01, COARSE
    )
    expected = simulator.run(HAMMER)
    drop = strike(scaled, MASS, HAMMER, SAMPLES)
    peak = float(np.max(expected.plate_displacement))
    np.testing.assert_allclose(
        drop.ground_displacement, expected.ground_displacement, atol=3e-4 * peak
    )


def test_responses_are_stored_in_the_cache(tmp_path: Path) -> None:
    ground = SoilProfile.uniform(40e6, 54e3, 1900.0, 0.35, 0.3)
    first = ground_response(ground, 0.15, (0.0,), duration=0.002, cache=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    stored = ground_response(ground, 0.15, (0.0,), duration=0.002, cache=tmp_path)
    np.testing.assert_array_equal(first.velocity, stored.velocity)
    assert first.static_stiffness == stored.static_stiffness


def test_the_plate_flies_on_a_parabola(response: GroundResponse) -> None:
    weight = MASS * STANDARD_GRAVITY
    begin, tug = 0.016, 0.002

    def pull(time: float) -> float:
        return 2e3 if begin < time < begin + tug else 0.0

    drop = strike(response, MASS, HAMMER, SAMPLES, weight=weight, pull=pull)
    assert np.min(drop.contact_force) == -weight
    assert np.min(drop.load) < -1e3  # the pull passes through the load cell
    flying = (drop.contact_force == -weight) & (drop.load == 0)
    index = np.flatnonzero(flying)
    index = index[: np.argmax(np.diff(np.append(index, 10**6)) > 1) + 1][5:]
    assert index.size > 60
    time, height = drop.time[index], drop.plate_displacement[index]
    curve = np.polynomial.Polynomial.fit(time, height, 2).convert()
    assert 2 * curve.coef[2] == pytest.approx(STANDARD_GRAVITY, rel=1e-3)
    np.testing.assert_allclose(height, curve(time), atol=1e-6 * np.ptp(height))


def test_indentation_is_permanent_and_concerns_the_plate_only(response: GroundResponse) -> None:
    force = slow_force(5e3)
    plain = strike(response, MASS, force, SAMPLES)
    set_ = Indentation(depth=5e-5, force=float(np.max(plain.contact_force)))
    sunk = strike(response, MASS, force, SAMPLES, indentation=set_)
    extra = sunk.plate_displacement - plain.plate_displacement
    assert extra[-1] == pytest.approx(5e-5, rel=0.01)
    rising = slice(0, SAMPLES // 2)
    share = plain.contact_force[rising] / np.max(plain.contact_force)
    np.testing.assert_allclose(extra[rising], 5e-5 * share**2, atol=1e-6)
    ground, sunk_ground = plain.ground_displacement[1], sunk.ground_displacement[1]
    np.testing.assert_allclose(sunk_ground, ground, atol=0.01 * np.max(ground))


@pytest.mark.parametrize("exponent", [-0.2, 0.5])
def test_a_slow_load_follows_the_power_law(response: GroundResponse, exponent: float) -> None:
    stiffness = response.static_stiffness
    law = PowerLaw(stiffness, reference=2e-4, exponent=exponent, rest=1e-5)
    drop = strike(response, MASS, slow_force(stiffness * 2e-4), SAMPLES, law=law)
    top = int(np.argmax(drop.plate_displacement))
    # no viscous force at the turning point, and little inertia
    assert drop.plate_displacement[top] == pytest.approx(2e-4, rel=0.06)
    assert law.curve(2e-4)[0] == pytest.approx(2e-4)


def test_the_power_law_states_its_slope_and_exponent() -> None:
    law = PowerLaw(1e7, 2e-4, 0.4, 1e-5)
    for w in (-2e-5, -1e-6, 1e-5, 1e-4, 3e-4):
        slope = (law.curve(w + 1e-10)[0] - law.curve(w - 1e-10)[0]) / 2e-10
        assert law.curve(w)[1] == pytest.approx(slope, rel=1e-4)
    # modulus ~ stress^n: the secant grows so where the weight at rest is forgotten
    free = PowerLaw(1e7, 2e-4, 0.4, 1e-9)
    secants = [free.curve(w)[0] / w for w in (1e-4, 2e-4)]
    stresses = [free.curve(w)[0] for w in (1e-4, 2e-4)]
    assert math.log(secants[1] / secants[0]) == pytest.approx(
        0.4 * math.log(stresses[1] / stresses[0]), rel=1e-3
    )


def test_hysteresis_leaves_the_stated_settlement(response: GroundResponse) -> None:
    law = Hysteresis(response.static_stiffness, exponent=1.0, unrecovered=0.2)
    force = np.concatenate([slow_force(5e3)[::2], np.zeros(SAMPLES // 2)])
    drop = strike(response, MASS, force, SAMPLES, law=law)
    plain = strike(response, MASS, force, SAMPLES)
    rising = slice(0, int(np.argmax(plain.plate_displacement)) - 5)
    np.testing.assert_allclose(
        drop.plate_displacement[rising], plain.plate_displacement[rising], rtol=1e-9, atol=1e-12
    )
    assert drop.plate_displacement[-1] == pytest.approx(law.largest * 0.2, rel=0.02)
    assert plain.plate_displacement[-1] == pytest.approx(0.0, abs=0.002 * law.largest)


def test_hysteresis_dissipates_the_energy_between_its_curves() -> None:
    law = Hysteresis(1.0, exponent=1.5, unrecovered=0.2)
    path = np.linspace(0.0, 3.0, 2001)
    loading = [law.curve(w)[0] for w in path]
    law.commit(3.0)
    unloading = [law.curve(w)[0] for w in path]
    above = path >= 0.6
    recovered = np.trapezoid(np.array(unloading)[above], path[above])
    # K w^2 / 2 and K w^2 (1 - f) / (m + 1)
    assert np.trapezoid(loading, path) == pytest.approx(9 / 2, rel=1e-5)
    assert recovered == pytest.approx(9 * 0.8 / 2.5, rel=1e-4)
    for w in (0.3, 1.0, 2.5):
        slope = (law.curve(w + 1e-6)[0] - law.curve(w - 1e-6)[0]) / 2e-6
        assert law.curve(w)[1] == pytest.approx(slope, rel=1e-4)


def test_invalid_values_are_rejected(response: GroundResponse) -> None:
    with pytest.raises(GroundError, match="plate_mass"):
        strike(response, 0.0, HAMMER, SAMPLES)
    with pytest.raises(GroundError, match="samples"):
        strike(response, MASS, HAMMER, 10**6)
    with pytest.raises(GroundError, match="0 at the first sample"):
        response.motion(np.ones(5))
    with pytest.raises(GroundError, match="one force per sample"):
        strike(response, MASS, np.zeros(3), SAMPLES)
    with pytest.raises(GroundError, match="exponent"):
        PowerLaw(1e7, 1e-4, 1.0, 1e-5)
    with pytest.raises(GroundError, match="unrecovered"):
        Hysteresis(1e7, 1.5, 1.0)
