"""Effects of instrument, plate and converter on the signals, against closed forms."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simulators.mesh import Array, SoilProfile
from simulators.traces import Geophone, geophone_output
from tests.campaigns.effects import channels, faults, mechanics, unmodelled
from tests.campaigns.effects.catalogue import CLEAN, EFFECTS
from tests.campaigns.effects.scene import SimulatedPoint
from tests.campaigns.effects.signals import Signals

STEP = 5e-5
TIME = np.arange(-300, 1400, dtype=float) * STEP
PULSE = 0.012


def half_sine(time: Array, duration: float = PULSE) -> Array:
    return np.where((time > 0) & (time < duration), np.sin(math.pi * time / duration), 0.0)


@pytest.fixture
def signals() -> Signals:
    """Signals whose velocity is one period of a sine, so that the displacement returns to zero."""
    inside = (TIME > 0) & (TIME < 0.02)
    speed = np.where(inside, np.sin(2 * math.pi * TIME / 0.02), 0.0)
    moved = np.where(inside, 1 - np.cos(2 * math.pi * TIME / 0.02), 0.0) * 0.01 / math.pi
    sizes = 0.2 * np.array([1.0, 0.3])[:, None]
    return Signals(TIME, 8e3 * half_sine(TIME), sizes * speed, sizes * moved)


def hum(phase: float) -> Array:
    angle = 2 * math.pi * 50.0 * TIME + phase
    return np.sin(angle) + 0.25 * np.sin(3 * angle + 1) + 0.1 * np.sin(5 * angle + 2)


def late(values: Array, samples: int) -> Array:
    return np.concatenate([np.repeat(values[..., :1], samples, -1), values[..., :-samples]], -1)


Operator = Callable[[Signals], Signals]
Expected = Callable[[Signals], Array]
OPERATORS: dict[str, tuple[Operator, Expected | None, Expected | None]] = {
    "sensor_lag": (
        lambda s: channels.sensor_lag(s, 7 * STEP),
        None,
        lambda s: late(s.velocity, 7),
    ),
    "mains_hum": (
        lambda s: channels.mains_hum(s, 2e-3, 50.0, 0.3),
        None,
        lambda s: s.velocity + 2e-3 * hum(0.3),
    ),
    "saturation of the load": (
        lambda s: channels.saturation(s, 6e3, "load"),
        lambda s: np.minimum(s.load, 6e3),
        None,
    ),
    "saturation of the sensors": (
        lambda s: channels.saturation(s, 0.1, "sensors"),
        None,
        lambda s: np.maximum(np.minimum(s.velocity, 0.1), -0.1),
    ),
    "lost_samples": (
        lambda s: unmodelled.lost_samples(s, 0.005, 7),
        None,
        lambda s: np.hstack([s.velocity[:, :400], s.velocity[:, 407:], 0 * s.velocity[:, :7]]),
    ),
    "cable_crosstalk without a high-pass": (
        lambda s: unmodelled.cable_crosstalk(s, 0.1, 1e-6),
        None,
        lambda s: s.velocity + 0.1 * 0.2 / 8e3 * s.load,
    ),
}


@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_changes_its_channels_as_defined_and_no_other(
    name: str, signals: Signals
) -> None:
    operator, load, velocity = OPERATORS[name]
    changed = operator(signals)
    expected_load = signals.load if load is None else load(signals)
    expected_velocity = signals.velocity if velocity is None else velocity(signals)
    np.testing.assert_allclose(changed.load, expected_load, atol=1e-9 * 8e3)
    np.testing.assert_allclose(changed.velocity, expected_velocity, atol=1e-7)
    change = np.cumsum(expected_velocity - signals.velocity, axis=1) * STEP
    np.testing.assert_allclose(changed.displacement - signals.displacement, change, atol=6e-6)


def test_a_fractional_delay_shifts_the_phase_of_a_sine() -> None:
    delayed = channels.delayed(np.sin(2 * math.pi * 60 * TIME), 2.4)
    expected = np.sin(2 * math.pi * 60 * (TIME - 2.4 * STEP))
    np.testing.assert_allclose(delayed[20:-20], expected[20:-20], atol=1e-8)


def test_a_filter_halves_the_power_at_its_corner_and_is_advanced_by_whole_samples() -> None:
    sine = np.sin(2 * math.pi * 300 * TIME)
    pure = Signals(TIME, sine, sine[None, :], sine[None, :])
    filtered = channels.acquisition_filter(pure, 300.0, 4, 0.0, "both")
    twelve_periods = slice(800, 1600)
    assert np.sqrt(np.mean(filtered.load[twelve_periods] ** 2)) == pytest.approx(0.5, rel=0.01)
    advanced = channels.acquisition_filter(pure, 300.0, 4, 10 * STEP, "sensors")
    np.testing.assert_array_equal(advanced.velocity[:, :-10], filtered.velocity[:, 10:])
    np.testing.assert_array_equal(advanced.load, pure.load)
    assert not np.any(filtered.load[: np.flatnonzero(sine)[0]])


def test_a_load_filter_delays_the_load_and_preserves_its_impulse(signals: Signals) -> None:
    smoothed = channels.load_channel_filter(signals, 60.0, 2)
    assert np.argmax(smoothed.load) > np.argmax(signals.load)
    assert np.max(smoothed.load) < np.max(signals.load)
    assert np.sum(smoothed.load) == pytest.approx(np.sum(signals.load), rel=1e-3)


def test_an_oscillator_has_the_step_response_of_the_closed_form() -> None:
    mass, stiffness, ratio, step = 12.0, 2e7, 0.05, 2e-6
    omega = math.sqrt(stiffness / mass)
    time = np.arange(10000) * step
    moved, speed = unmodelled.oscillator(
        np.ones(time.size), mass, 2 * ratio * omega * mass, stiffness, step
    )
    damped = omega * math.sqrt(1 - ratio**2)
    share = ratio / math.sqrt(1 - ratio**2)
    wave = np.cos(damped * time) + share * np.sin(damped * time)
    expected = (1 - np.exp(-ratio * omega * time) * wave) / stiffness
    np.testing.assert_allclose(moved, expected, atol=2e-5 / stiffness)
    slope = np.gradient(expected, step)
    np.testing.assert_allclose(speed[1:-1], slope[1:-1], atol=1e-3 * np.max(speed))


def test_cable_crosstalk_discharges_after_the_pulse(signals: Signals) -> None:
    changed = unmodelled.cable_crosstalk(signals, 0.1, 50.0)
    assert np.min(changed.velocity - signals.velocity) < 0


def test_a_slow_clock_records_too_short_times(signals: Signals) -> None:
    changed = unmodelled.time_base_error(signals, 0.02)
    assert changed.time_step == pytest.approx(STEP / 1.02)
    np.testing.assert_array_equal(changed.velocity, signals.velocity)
    np.testing.assert_allclose(changed.displacement * 1.02, signals.displacement)


def frequency_of(ringing: Array, step: float = STEP) -> float:
    """Return the frequency of a vibration by its zero crossings, Hz."""
    crossings = np.flatnonzero(np.diff(np.sign(ringing)))
    return 1 / (2 * step * float(np.mean(np.diff(crossings))))


def test_plate_load_cell_and_rod_ring_at_their_natural_frequencies(signals: Signals) -> None:
    after = TIME > PULSE + 1e-3
    plate = unmodelled.plate_mode(signals, 220.0, 0.02, 0.05)
    np.testing.assert_array_equal(plate.velocity[1], signals.velocity[1])
    motion = (plate.velocity - signals.velocity)[0][after]
    assert frequency_of(motion) == pytest.approx(220, rel=0.05)
    cell = faults.load_cell_ringing(signals, 400.0, 0.02)
    assert frequency_of(cell.load[after]) == pytest.approx(400, rel=0.03)
    assert np.sum(cell.load) == pytest.approx(np.sum(signals.load), rel=2e-3)
    for on_load in (True, False):
        rod = faults.rod_ringing(signals, 0.05, 60.0, 0.02, on_load)
        load = (rod.load - signals.load) / signals.peak_load
        velocity = (rod.velocity - signals.velocity)[1] / signals.peak_velocity
        disturbed, undisturbed = (load, velocity) if on_load else (velocity, load)
        assert not np.any(undisturbed)
        assert np.max(np.abs(disturbed)) == pytest.approx(0.05)
        assert not np.any(disturbed[TIME <= 0])
        assert frequency_of(disturbed[after]) == pytest.approx(60, rel=0.02)


def test_a_loose_sensor_follows_slow_motion_and_rings_after_a_step() -> None:
    time = np.arange(8000) * 1e-5

    def loose(moved: Array, frequency: float, damping: float) -> tuple[Array, Array]:
        speed = np.gradient(moved, time)
        plate = Signals(time, np.zeros_like(time), speed[None], moved[None])
        return speed, unmodelled.loose_sensor(plate, frequency, damping).velocity[0]

    speed, reading = loose(1e-3 * np.sin(2 * math.pi * 2.0 * time) ** 2, 400.0, 0.1)
    settled = time > 0.03
    np.testing.assert_allclose(reading[settled], speed[settled], atol=1e-3 * np.max(speed))
    _, ringing = loose(np.where(time > 0.001, 1e-3, 0.0), 120.0, 0.03)
    assert frequency_of(ringing[time > 0.002], 1e-5) == pytest.approx(120.0, rel=0.05)


def test_a_rocking_disc_has_the_textbook_stiffness_and_damping() -> None:
    shear, density, nu, radius = 15e6, 1900.0, 1 / 3, 0.15
    inertia = 8 * density * radius**5 / (3 * (1 - nu))  # B = 1
    frequency, damping = faults.rocking_mode(2 * (1 + nu) * shear, density, nu, radius, inertia)
    assert inertia * (2 * math.pi * frequency) ** 2 == pytest.approx(4 * shear * radius**3)
    assert damping == pytest.approx(0.075)


def test_a_static_tilt_is_proportional_to_the_load() -> None:
    load = np.minimum(np.maximum(TIME, 0.0) / 0.05, 1.0) * 8e3
    slow = Signals(TIME, load, np.zeros((2, TIME.size)), np.vstack([load, load]) * 1e-7)
    tilted = unmodelled.plate_mode(slow, 300.0, 0.7, -0.03)
    extra = tilted.displacement - slow.displacement
    np.testing.assert_array_equal(extra[1], 0.0)
    np.testing.assert_allclose(extra[0][TIME > 0.06], -0.03 * 8e-4, rtol=1e-3)
    integral = np.cumsum(tilted.velocity[0]) * STEP
    np.testing.assert_allclose(integral, extra[0], atol=1e-3 * 0.03 * 8e-4)


def test_a_creeping_sensor_relaxes_with_its_time_constant(signals: Signals) -> None:
    rest = Signals(TIME, signals.load, 0 * signals.velocity, 0 * signals.displacement)
    jump = np.zeros(TIME.size)
    jump[300] = 1e-3 / STEP  # a displacement of 1 mm within one sample
    crept = faults.creep(rest.with_velocity(np.vstack([jump, jump])), [0.2, -0.1], [0.03, 0.08])
    for row, gain, time in ((0, 0.2, 0.03), (1, -0.1, 0.08)):
        moved = np.cumsum(crept.velocity[row] - jump) * STEP
        expected = gain * 1e-3 * (1 - np.exp(-TIME[301:] / time))
        np.testing.assert_allclose(moved[301:], expected, atol=3e-7)


def test_a_coil_reads_the_velocity_of_its_case_until_it_is_at_the_stop() -> None:
    time = np.arange(2000) * STEP
    speed = 0.3 * half_sine(time, 0.03)
    free, reading = faults.coil_travel(speed, 4.5, 0.5, STEP)
    np.testing.assert_allclose(reading, speed, atol=1e-12)
    relative = geophone_output(speed, STEP, Geophone(4.5, 0.5))
    expected = -np.cumsum(relative) * STEP
    np.testing.assert_allclose(free, expected, atol=5e-3 * np.max(np.abs(free)))
    stop = 0.6 * float(np.max(np.abs(free)))
    travel, stopped = faults.coil_travel(speed, 4.5, 0.5, STEP, stop)
    assert np.max(np.abs(travel)) == pytest.approx(stop)
    first = int(np.argmax(np.abs(free) > stop))
    np.testing.assert_allclose(travel[:first], free[:first], atol=1e-15)
    np.testing.assert_allclose(stopped[: first - 1], speed[: first - 1], atol=1e-12)
    assert stopped[first + 20] < 0.8 * speed[first + 20]


def test_missing_codes_leave_gaps_and_change_no_other_value() -> None:
    values = np.linspace(-1.0, 1.0, 20_001)
    converted = faults.without_codes(values, 1.0, 0.02)
    for level in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        assert not np.any(np.abs(converted - level) < 0.01 - 1e-9)
    assert np.max(np.abs(converted - values)) == pytest.approx(0.01)
    outside = np.abs(values * 4 - np.round(values * 4)) > 0.041
    outside |= np.abs(values) < 0.2
    np.testing.assert_array_equal(converted[outside], values[outside])
    assert np.all(np.diff(converted) >= 0)


def test_drawn_strengths_are_log_uniform_in_the_range() -> None:
    generator = np.random.default_rng(1)
    for key in ("channel_crosstalk", "coil_at_stop"):
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
        key
        for key, e in EFFECTS.items()
        if key != CLEAN and e.build.__module__ != mechanics.__name__
    ],
)
def test_an_effect_states_its_parameters_and_grows_with_its_strength(
    key: str, signals: Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean = SimulatedPoint([signals], 40e6, {})
    for module in ("catalogue", "faults", "scene"):
        monkeypatch.setattr(f"tests.campaigns.effects.{module}.undisturbed", lambda scene: clean)
    sizes = []
    for strength in (EFFECTS[key].strengths[0], EFFECTS[key].strengths[-1]):
        scene: Any = SimpleNamespace(
            ground=SoilProfile.uniform(40e6, 5e4, 1900.0, 0.35),
            modulus=40e6,
            radius=0.15,
            plate_mass=12.0,
            hammer_pulse=PULSE,
            sensors=2,
            generator=np.random.default_rng(3),
            device=np.random.default_rng(3),
        )
        point = EFFECTS[key].build(scene, strength)
        assert point.modulus == 40e6
        assert point.parameters
        (changed,) = point.signals
        load = np.max(np.abs(changed.load - signals.load)) / signals.peak_load
        speed = np.max(np.abs(changed.velocity - signals.velocity)) / signals.peak_velocity
        clock = abs(changed.time_step / signals.time_step - 1)
        sizes.append(max(load, speed, clock))
    assert sizes[1] > 2 * sizes[0] > 0
