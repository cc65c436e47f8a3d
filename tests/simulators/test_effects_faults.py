"""Faults of plate, cell, sensor and converter, each against a closed form."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulators.mesh import Array
from tests.campaigns.effects import faults, unmodelled
from tests.campaigns.effects.catalogue import EFFECTS
from tests.campaigns.effects.signals import Signals
from tests.simulators.conftest import PULSE, STEP, TIME, half_sine


def test_a_rocking_disc_has_the_textbook_stiffness_and_damping() -> None:
    shear, density, nu, radius = 15e6, 1900.0, 1 / 3, 0.15
    inertia = 8 * density * radius**5 / (3 * (1 - nu))  # B = 1
    frequency, damping = faults.rocking_mode(2 * (1 + nu) * shear, density, nu, radius, inertia)
    assert inertia * (2 * math.pi * frequency) ** 2 == pytest.approx(4 * shear * radius**3)
    assert damping == pytest.approx(0.075)


def test_a_tilt_at_rest_is_in_proportion_to_the_load() -> None:
    load = np.minimum(np.maximum(TIME, 0.0) / 0.05, 1.0) * 8e3
    slow = Signals(TIME, load, np.zeros((2, TIME.size)), np.vstack([load, load]) * 1e-7)
    found = unmodelled.plate_rocking(slow, 300.0, 0.7, -0.03)
    extra = found.displacement - slow.displacement
    np.testing.assert_array_equal(extra[1], 0.0)
    late = TIME > 0.06
    np.testing.assert_allclose(extra[0][late], -0.03 * 8e-4, rtol=1e-3)
    integral = np.cumsum(found.velocity[0]) * STEP
    np.testing.assert_allclose(integral, extra[0], atol=1e-3 * 0.03 * 8e-4)


def test_the_tilt_is_one_and_a_half_times_the_product_of_the_eccentricities() -> None:
    """Of K = 4 G a/(1 - nu) and the rocking stiffness 8 G a^3/(3 (1 - nu))."""
    shear, nu, radius, off_load, off_sensor, force = 15e6, 0.3, 0.15, 0.02, 0.03, 1e4
    deflection = force * (1 - nu) / (4 * shear * radius)
    tilt = force * off_load * 3 * (1 - nu) / (8 * shear * radius**3)
    assert tilt * off_sensor / deflection == pytest.approx(1.5 * off_load * off_sensor / radius**2)


def test_a_creeping_sensor_returns_exponentially(signals: Signals) -> None:
    found = faults.creep(signals, [0.2, -0.1], [0.03, 0.08])
    extra = found.displacement - signals.displacement
    late = TIME > 0.021
    for row, time in ((0, 0.03), (1, 0.08)):
        decay = np.log(np.abs(extra[row][late]))
        slope = np.polyfit(TIME[late], decay, 1)[0]
        assert slope == pytest.approx(-1 / time, rel=2e-3)
    step = Signals(TIME, signals.load, 0 * signals.velocity, 0 * signals.displacement)
    jump = np.zeros(TIME.size)
    jump[300] = 1e-3 / STEP  # 1 mm at once
    crept = faults.creep(step.with_velocity(np.vstack([jump, jump])), [0.2, 0.0], [0.03, 0.03])
    moved = np.cumsum(crept.velocity[0] - jump) * STEP
    np.testing.assert_allclose(moved[301:], 2e-4 * (1 - np.exp(-(TIME[301:]) / 0.03)), atol=3e-7)


def test_a_load_cell_rings_at_its_frequency_and_keeps_the_impulse(signals: Signals) -> None:
    found = faults.load_cell_ringing(signals, 400.0, 0.02)
    np.testing.assert_array_equal(found.velocity, signals.velocity)
    ringing = found.load[TIME > PULSE + 1e-3]
    crossings = np.count_nonzero(np.diff(np.sign(ringing)))
    assert crossings / 2 / (ringing.size * STEP) == pytest.approx(400, rel=0.03)
    assert np.sum(found.load) == pytest.approx(np.sum(signals.load), rel=2e-3)
    stiff = faults.load_cell_ringing(signals, 6000.0, 0.05)
    np.testing.assert_allclose(stiff.load, signals.load, atol=0.03 * 8e3)


@pytest.mark.parametrize("on_load", [True, False])
def test_a_rod_rings_on_after_the_pulse_as_strong_as_stated(
    signals: Signals, on_load: bool
) -> None:
    found = faults.rod_ringing(signals, 0.05, 60.0, 0.02, on_load)
    if on_load:
        np.testing.assert_array_equal(found.velocity, signals.velocity)
        extra, peak = found.load - signals.load, signals.peak_load
    else:
        np.testing.assert_array_equal(found.load, signals.load)
        extra, peak = found.velocity[1] - signals.velocity[1], signals.peak_velocity
    assert np.max(np.abs(extra)) == pytest.approx(0.05 * peak)
    np.testing.assert_array_equal(extra[TIME <= 0], 0.0)
    crossings = np.flatnonzero(np.diff(np.sign(extra[TIME > PULSE])))
    assert np.mean(np.diff(crossings)) * STEP == pytest.approx(1 / 120, rel=0.02)


def test_a_coil_without_a_stop_reads_the_velocity_of_its_case() -> None:
    time = np.arange(2000) * STEP
    speed = 0.3 * half_sine(time, 0.03)
    travel, reading = faults.coil_travel(speed, 4.5, 0.5, STEP)
    np.testing.assert_allclose(reading, speed, atol=1e-12)
    omega = 2 * math.pi * 4.5

    def motion(t: float, state: Array) -> list[float]:
        """Coil: x' = p - v, p' = -2 D w x' - w^2 x."""
        rate = state[1] - float(np.interp(t, time, speed))
        return [rate, -2 * 0.5 * omega * rate - omega**2 * state[0]]

    solved = solve_ivp(motion, (0, time[-1]), [0.0, 0.0], t_eval=time, max_step=1e-3, rtol=1e-8)
    np.testing.assert_allclose(travel, solved.y[0], atol=3e-3 * np.max(np.abs(travel)))


def test_a_coil_at_its_stop_rides_along_and_reads_too_little() -> None:
    time = np.arange(2000) * STEP
    speed = 0.3 * half_sine(time, 0.03)
    free, _ = faults.coil_travel(speed, 4.5, 0.5, STEP)
    stop = 0.6 * float(np.max(np.abs(free)))
    travel, reading = faults.coil_travel(speed, 4.5, 0.5, STEP, stop)
    assert np.max(np.abs(travel)) == pytest.approx(stop)
    first = int(np.argmax(np.abs(free) > stop))
    np.testing.assert_allclose(reading[:first], speed[:first], atol=1e-12)
    # the stop carries the coil along; the instrument, which does not know, lacks that speed
    assert np.all(reading[first + 1 : first + 40] < 0.3 * speed[first])
    assert np.sum(reading[:600]) < 0.8 * np.sum(speed[:600])


def test_missing_codes_leave_gaps_and_nothing_else() -> None:
    values = np.linspace(-1.0, 1.0, 20_001)
    found = faults.without_codes(values, 1.0, 0.02)
    for level in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        assert not np.any(np.abs(found - level) < 0.01 - 1e-9)
    assert np.max(np.abs(found - values)) == pytest.approx(0.01)
    away = np.abs(values * 4 - np.round(values * 4)) > 0.041
    np.testing.assert_array_equal(found[away], values[away])
    near_zero = np.abs(values) < 0.2
    np.testing.assert_array_equal(found[near_zero], values[near_zero])
    assert np.all(np.diff(found) >= 0)


def test_crosstalk_goes_both_ways(signals: Signals) -> None:
    found = faults.crosstalk(signals, 0.05, signals.peak_load, signals.peak_velocity)
    to_load = (found.load - signals.load) / (0.05 * signals.peak_load)
    np.testing.assert_allclose(to_load, signals.velocity[0] / signals.peak_velocity, atol=1e-12)
    for row in (0, 1):
        to_sensor = (found.velocity - signals.velocity)[row] / (0.05 * signals.peak_velocity)
        np.testing.assert_allclose(to_sensor, signals.load / signals.peak_load, atol=1e-12)


def test_drawn_strengths_fill_the_stated_range_evenly_in_logarithm() -> None:
    generator = np.random.default_rng(1)
    for key in ("channel_crosstalk", "coil_at_stop", "ringing_load_cell"):
        effect = EFFECTS[key]
        low, high = sorted((effect.strengths[0], effect.strengths[-1]))
        drawn = np.array([effect.drawn(generator) for _ in range(400)])
        assert np.all((drawn >= low) & (drawn <= high))
        assert np.mean(np.log(drawn)) == pytest.approx(
            math.log(low * high) / 2, abs=0.1 * math.log(high / low)
        )
    law = EFFECTS["damping_law"]
    assert {law.drawn(generator) for _ in range(60)} == set(law.strengths)


@pytest.mark.parametrize(
    "key",
    [
        "tilted_plate",
        "sensor_creep",
        "ringing_load_cell",
        "ringing_guide_rod",
        "coil_at_stop",
        "missing_codes",
        "channel_crosstalk",
    ],
)
def test_each_builder_records_what_it_did_and_grows_with_its_strength(
    key: str, signals: Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disturbance of the strongest is several times that of the weakest."""
    from simulators.mesh import SoilProfile
    from tests.campaigns.effects.scene import SimulatedPoint

    clean = SimulatedPoint([signals], 40e6, {})
    monkeypatch.setattr(faults, "undisturbed", lambda scene: clean)
    effect = EFFECTS[key]
    assert effect.group == "unknown"
    sizes = []
    for strength in (effect.strengths[0], effect.strengths[-1]):
        scene: Any = SimpleNamespace(
            ground=SoilProfile.uniform(40e6, 5e4, 1900.0, 0.35),
            modulus=40e6,
            radius=0.15,
            plate_mass=12.0,
            sensors=2,
            generator=np.random.default_rng(3),
            device=np.random.default_rng(3),
        )
        point = effect.build(scene, strength)
        assert point.modulus == 40e6
        assert point.parameters
        (changed,) = point.signals
        load = np.max(np.abs(changed.load - signals.load)) / signals.peak_load
        speed = np.max(np.abs(changed.velocity - signals.velocity)) / signals.peak_velocity
        sizes.append(max(load, speed))
    assert sizes[1] > 2 * sizes[0] > 0
