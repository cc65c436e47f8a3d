"""Hum before the pulse is distinguished from noise and detected as an effect."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from inversion.diagnosis.mains_line import Hum, find_line, hum_before
from inversion.inference.diagnose import diagnose_point
from tests.inversion.simulated_drops import point_of, record_of, simulated, uniform_ground

STEP = 2e-4


def hum(time, amplitude: float, frequency: float = 50.0, phase: float = 0.7):
    """A line with a quarter of its third harmonic and a tenth of its fifth."""
    turn = 2 * np.pi * frequency * time + phase
    return amplitude * (np.sin(turn) + 0.25 * np.sin(3 * turn + 1.0) + 0.1 * np.sin(5 * turn + 2.0))


def displaced(time, amplitude: float, frequency: float):
    """The integral of `hum`."""
    omega = 2 * np.pi * frequency
    turn = omega * time + 0.7
    return (-amplitude / omega) * (
        np.cos(turn) + 0.25 / 3 * np.cos(3 * turn + 1.0) + 0.1 / 5 * np.cos(5 * turn + 2.0)
    )


@pytest.mark.parametrize("frequency", [50.0, 60.0])
@pytest.mark.parametrize("integrations", [0, 1, 2])
def test_a_line_is_detected_with_its_harmonics(frequency: float, integrations: int) -> None:
    time = STEP * np.arange(90)
    noise = np.random.default_rng(2).standard_normal(time.size)
    line, small = hum(time, 3e-3, frequency), 1e-5
    if integrations == 0:
        line, small = displaced(time, 3e-3, frequency), 3e-9
    elif integrations == 2:
        step = 1e-7
        line = (hum(time + step, 3e-3, frequency) - hum(time - step, 3e-3, frequency)) / (2 * step)
        small = 3e-3
    result = find_line(3e-3 + 0.1 * time + line + small * noise, STEP, integrations)
    assert np.sqrt(np.mean(result.residual**2)) == pytest.approx(small, rel=0.3)
    amplitude, hertz, turns = result.as_tuple
    assert (amplitude, hertz) == pytest.approx((3e-3, frequency), rel=0.02)
    # `hum` has its phase at the first sample, half a time before the pulse earlier.
    expected = 0.7 / (2 * np.pi) + frequency * 0.5 * STEP * (time.size - 1)
    assert abs((turns - expected + 0.5) % 1.0 - 0.5) < 0.02
    (third, share, phase), (fifth, fifth_share, last) = result.harmonics
    assert (third, fifth) == (3, 5)
    assert (share, fifth_share) == pytest.approx((0.25, 0.1), rel=0.05)
    turned = np.exp(1j * np.array([phase - 1.0, last - 2.0]))
    np.testing.assert_allclose(turned, 1.0, atol=0.1)


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.98, 0.999])
def test_slow_noise_is_no_line(correlation: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        steps = rng.standard_normal(1090)
        noise = lfilter([1.0], [1.0, -correlation], steps)[1000:]
        assert find_line(noise, STEP, 1) is None


def test_a_line_of_half_a_turn_may_be_any_slow_noise() -> None:
    time = STEP * np.arange(50)
    assert find_line(hum(time, 3e-3), STEP, 1) is None
    assert find_line(np.empty(0), STEP, 1) is None


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("frequency", [50.0, 60.0])
@pytest.mark.parametrize(("samples", "rel"), [(100, 0.15), (30, 0.6)])
def test_how_large_hum_is_by_the_time_before_the_pulse(
    velocity: bool, frequency: float, samples: int, rel: float
) -> None:
    time = STEP * np.arange(samples)
    line = 3e-3 * np.sin(2 * np.pi * frequency * time + 0.4)
    if not velocity:
        line = -3e-3 / (2 * np.pi * frequency) * np.cos(2 * np.pi * frequency * time + 0.4)
    result = hum_before(0.2 + line, STEP, int(velocity))
    assert result.max_amplitude == pytest.approx(3e-3, rel=rel)
    (right,) = [line for line in result.lines if line[1] == frequency]
    assert right[0] == pytest.approx(3e-3, rel=1e-6)
    turns = 0.4 / (2 * np.pi) + frequency * time.mean()
    assert abs((right[2] - turns + 0.5) % 1.0 - 0.5) < 1e-6


@pytest.mark.parametrize(("rate", "n_lines"), [(10.0, 0), (100.0, 0), (112.0, 1), (140.0, 2)])
def test_hum_is_sought_only_in_samples_that_resolve_it(rate: float, n_lines: int) -> None:
    noise = np.random.default_rng(5).standard_normal(40)
    assert len(hum_before(1e-6 * noise, 1.0 / rate, 1).lines) == n_lines


def test_a_quiet_time_before_the_pulse_leaves_no_room_for_hum() -> None:
    # Ten samples of a record at 3.7 kHz that move by 10 nm.
    step, noise = 2.667e-4, np.random.default_rng(5).standard_normal((50, 10))
    amplitudes = [hum_before(1e-8 * row, step, 0).max_amplitude for row in noise]
    assert max(amplitudes) < 2e-4
    # More noise leaves more, a longer time less.
    assert hum_before(1e-6 * noise[0], step, 0).max_amplitude == pytest.approx(100 * amplitudes[0])
    longer = np.random.default_rng(5).standard_normal(60)
    assert hum_before(1e-8 * longer, step, 0).max_amplitude < 0.1 * np.median(amplitudes)


@pytest.mark.parametrize("samples", [0, 3])
def test_a_short_record_does_not_limit_hum(samples: int) -> None:
    assert hum_before(np.zeros(samples), STEP, 1) == Hum(np.inf, ())


def test_hum_before_the_pulse_is_detected_as_an_effect() -> None:
    drop = simulated(uniform_ground(45e6, 1.2))
    velocity = drop.plate_velocity
    amplitude, noise = (share * float(velocity.max()) for share in (0.05, 1e-4))
    record = record_of(
        1e-4, drop.load, velocity, quantity="velocity", noise=noise, seed=4, bedrock_depth=1.2
    )
    (sensor,) = record.sensors
    noisy = replace(sensor, values=sensor.values + hum(record.time, amplitude))
    result = diagnose_point(point_of(replace(record, sensors=(noisy,))))
    assert [effect.name for effect in result.effects] == ["mains_hum"]
    parameters = {p.name: p.value for p in result.effects[0].parameters}
    assert parameters["amplitude"] == pytest.approx(amplitude, rel=0.02)
    assert parameters["frequency"] == pytest.approx(50.0, abs=0.3)
    assert result.verdict == "explained"
    assert abs(result.after.modulus_pa / 45e6 - 1.0) < 0.005
