"""Operators on the channels, each against a closed form or another kind of calculation."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulators.mesh import Array
from tests.campaigns.effects import channels, unmodelled
from tests.campaigns.effects.signals import Signals
from tests.simulators.conftest import PULSE, STEP, TIME


def test_a_lag_of_whole_samples_is_a_shift(signals: Signals) -> None:
    late = channels.sensor_lag(signals, 7 * STEP)
    np.testing.assert_allclose(late.velocity[:, 7:], signals.velocity[:, :-7], atol=1e-15)
    np.testing.assert_allclose(late.displacement[:, 7:], signals.displacement[:, :-7], atol=1e-15)
    np.testing.assert_array_equal(late.load, signals.load)


def test_a_lag_between_samples_moves_a_sine_by_its_phase() -> None:
    sine = np.sin(2 * math.pi * 60 * TIME)
    late = channels.delayed(sine, 2.4)
    inside = slice(20, -20)
    expected = np.sin(2 * math.pi * 60 * (TIME - 2.4 * STEP))
    np.testing.assert_allclose(late[inside], expected[inside], atol=1e-8)


@pytest.mark.parametrize(("frequency", "damping"), [(4.5, 0.56), (10.0, 0.2)])
def test_a_geophone_is_a_mass_on_a_spring(
    signals: Signals, frequency: float, damping: float
) -> None:
    omega = 2 * math.pi * frequency

    def motion(time: float, state: Array) -> list[float]:
        speed = 0.2 * math.sin(2 * math.pi * time / 0.02) if 0 < time < 0.02 else 0.0
        return [state[1], speed - 2 * damping * omega * state[1] - omega**2 * state[0]]

    solved = solve_ivp(
        motion, (TIME[0], TIME[-1]), [0.0, 0.0], t_eval=TIME, max_step=1e-3, rtol=1e-8, atol=1e-12
    )
    position, rate = solved.y
    expected = signals.velocity[0] - 2 * damping * omega * rate - omega**2 * position
    found = channels.geophone_response(signals, frequency, damping)
    np.testing.assert_allclose(found.velocity[0], expected, atol=2e-5 * 0.2)
    integral = np.concatenate([[0], np.cumsum((expected[1:] + expected[:-1]) / 2 * STEP)])
    np.testing.assert_allclose(found.displacement[0], integral, atol=1e-4 * np.max(integral))


def test_a_filter_halves_the_power_at_its_corner_and_comes_earlier_by_the_advance() -> None:
    sine = np.sin(2 * math.pi * 300 * TIME)
    pure = Signals(TIME, sine, sine[None, :], sine[None, :])
    found = channels.acquisition_filter(pure, 300.0, 4, 0.0, "both")
    tail = slice(800, 1600)  # 12 whole periods
    assert np.sqrt(np.mean(found.load[tail] ** 2)) == pytest.approx(0.5, rel=0.01)
    ahead = channels.acquisition_filter(pure, 300.0, 4, 10 * STEP, "sensors")
    np.testing.assert_array_equal(ahead.velocity[:, :-10], found.velocity[:, 10:])
    np.testing.assert_array_equal(ahead.load, pure.load)
    assert not np.any(found.load[: np.flatnonzero(sine)[0]])  # causal


def test_an_offset_is_a_ramp_and_a_drift_a_parabola(signals: Signals) -> None:
    found = channels.baseline_drift(signals, 1e-3, 0.1)
    since = TIME - TIME[0]
    extra = found.displacement - signals.displacement
    np.testing.assert_allclose(extra, [1e-3 * since + 0.05 * since**2] * 2, atol=1e-12)


def test_hum_is_lines_at_the_mains_and_its_harmonics(signals: Signals) -> None:
    found = channels.mains_hum(signals, 2e-3, 50.0, 0.3)
    extra = (found.velocity - signals.velocity)[0, :1600]  # four whole periods
    spectrum = np.abs(np.fft.rfft(extra)) / 800
    lines = {round(k / 0.08): a for k, a in enumerate(spectrum) if a > 1e-9}
    assert lines == pytest.approx({50: 2e-3, 150: 5e-4, 250: 2e-4})


def test_clipped_channels_have_flat_tops(signals: Signals) -> None:
    found = channels.saturation(signals, 6e3, "load")
    assert np.max(found.load) == 6e3
    np.testing.assert_array_equal(found.load[signals.load < 6e3], signals.load[signals.load < 6e3])
    clipped = channels.saturation(signals, 0.1, "sensors")
    assert np.max(np.abs(clipped.velocity)) == 0.1
    np.testing.assert_array_equal(clipped.velocity[1], signals.velocity[1])


def test_an_oscillator_rings_as_the_closed_form_says() -> None:
    mass, stiffness = 12.0, 2e7
    ratio, omega = 0.05, math.sqrt(stiffness / mass)
    step = 2e-6
    time = np.arange(10000) * step
    force = np.ones(time.size)
    moved, speed = unmodelled.oscillator(force, mass, 2 * ratio * omega * mass, stiffness, step)
    fast = omega * math.sqrt(1 - ratio**2)
    decay = np.exp(-ratio * omega * time)
    share = ratio / math.sqrt(1 - ratio**2)
    expected = (1 - decay * (np.cos(fast * time) + share * np.sin(fast * time))) / stiffness
    np.testing.assert_allclose(moved, expected, atol=2e-5 / stiffness)
    inside = slice(1, -1)
    slope = np.gradient(expected, step)
    np.testing.assert_allclose(speed[inside], slope[inside], atol=1e-3 * np.max(speed))


def test_a_bending_plate_moves_its_centre_alone(signals: Signals) -> None:
    found = unmodelled.plate_flexure(signals, 220.0, 0.02, 0.05)
    np.testing.assert_array_equal(found.velocity[1], signals.velocity[1])
    after = TIME > PULSE
    extra = (found.velocity - signals.velocity)[0][after]
    crossings = np.count_nonzero(np.diff(np.sign(extra)))
    length = float(np.sum(after)) * STEP
    assert crossings / 2 / length == pytest.approx(220, rel=0.05)


def test_crosstalk_is_the_load_through_a_high_pass(signals: Signals) -> None:
    low = unmodelled.cable_crosstalk(signals, 0.1, 1e-6)
    extra = low.velocity - signals.velocity
    np.testing.assert_allclose(
        extra, [0.1 * signals.peak_velocity / 8e3 * signals.load] * 2, atol=1e-7
    )
    high = unmodelled.cable_crosstalk(signals, 0.1, 50.0)
    assert np.min(high.velocity - signals.velocity) < 0  # after the pulse it discharges


def test_a_slow_clock_states_too_short_times(signals: Signals) -> None:
    found = unmodelled.time_base_error(signals, 0.02)
    assert found.time_step == pytest.approx(STEP / 1.02)
    np.testing.assert_array_equal(found.velocity, signals.velocity)
    np.testing.assert_allclose(found.displacement * 1.02, signals.displacement)


def test_a_glitch_changes_the_gain_once(signals: Signals) -> None:
    found = unmodelled.gain_glitch(signals, 0.005, 0.1)
    moving = signals.velocity[0] != 0
    ratio = found.velocity[0][moving] / signals.velocity[0][moving]
    np.testing.assert_allclose(ratio, np.where(TIME[moving] >= 0.005, 1.1, 1.0))


def test_traffic_is_a_burst_around_its_frequency(signals: Signals) -> None:
    found = unmodelled.passing_traffic(signals, 1e-3, 15.0, 0.03, 0.02)
    extra = (found.velocity - signals.velocity)[0]
    assert np.max(np.abs(extra)) <= 1e-3
    quarter = int(np.argmin(np.abs(TIME - (0.03 + 1 / 60))))
    assert extra[quarter] == pytest.approx(1e-3 * math.exp(-((1 / 60 / 0.02) ** 2)), rel=0.01)


def test_a_bent_load_cell_reads_the_square(signals: Signals) -> None:
    found = unmodelled.load_cell_curvature(signals, 0.04)
    assert np.max(found.load) == pytest.approx(1.04 * 8e3)
    half = np.argmin(np.abs(signals.load - 4e3))
    assert found.load[half] / signals.load[half] == pytest.approx(1.02, rel=1e-3)


def test_a_loose_sensor_follows_slow_motion_and_rings_at_its_own_frequency() -> None:
    time = np.arange(8000) * 1e-5
    slow = 1e-3 * np.sin(2 * math.pi * 2.0 * time) ** 2
    moved = Signals(time, np.zeros_like(time), np.gradient(slow, time)[None], slow[None])
    found = unmodelled.loose_sensor(moved, 400.0, 0.1)
    settled = time > 0.03  # the start of the motion has its own ringing
    np.testing.assert_allclose(
        found.velocity[:, settled], moved.velocity[:, settled], atol=1e-3 * moved.peak_velocity
    )
    kicked = np.where(time > 0.001, 1e-3, 0.0)
    sudden = Signals(time, np.zeros_like(time), np.gradient(kicked, time)[None], kicked[None])
    ringing = unmodelled.loose_sensor(sudden, 120.0, 0.03).velocity[0][time > 0.002]
    crossings = np.count_nonzero(np.diff(np.sign(ringing)))
    assert crossings / 2 / (time[-1] - 0.002) == pytest.approx(120.0, rel=0.05)


def test_a_smoothed_load_comes_late_with_its_impulse_whole(signals: Signals) -> None:
    found = channels.load_channel_filter(signals, 60.0, 2)
    np.testing.assert_array_equal(found.velocity, signals.velocity)
    assert np.argmax(found.load) > np.argmax(signals.load)
    assert np.max(found.load) < np.max(signals.load)
    assert np.sum(found.load) == pytest.approx(np.sum(signals.load), rel=1e-3)


def test_lost_samples_move_what_follows_up(signals: Signals) -> None:
    found = unmodelled.lost_samples(signals, 0.005, 7)
    first = int(np.searchsorted(TIME, 0.005))
    np.testing.assert_array_equal(found.velocity[:, :first], signals.velocity[:, :first])
    np.testing.assert_array_equal(found.velocity[:, first:-7], signals.velocity[:, first + 7 :])
    np.testing.assert_array_equal(found.load, signals.load)
