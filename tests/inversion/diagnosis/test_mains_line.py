"""Hum before the pulse is told from noise, and found as the effect that it is."""

import numpy as np
import pytest
from scipy.signal import lfilter

from inversion import Record, Sensor
from inversion.diagnosis.mains_line import Hum, find_line, hum_before
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.rest import estimate_pre_trigger_noise
from inversion.forward.model import Instrument
from inversion.inference.diagnose import diagnose_point
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile

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
def test_a_line_is_found_with_its_harmonics(frequency: float, integrations: int) -> None:
    time = STEP * np.arange(90)
    noise = np.random.default_rng(2).standard_normal(time.size)
    line, small = hum(time, 3e-3, frequency), 1e-5
    if integrations == 0:
        line, small = displaced(time, 3e-3, frequency), 3e-9
    elif integrations == 2:
        step = 1e-7
        line = (hum(time + step, 3e-3, frequency) - hum(time - step, 3e-3, frequency)) / (2 * step)
        small = 3e-3
    found = find_line(3e-3 + 0.1 * time + line + small * noise, STEP, integrations)
    assert found is not None
    assert np.sqrt(np.mean(found.residual**2)) == pytest.approx(small, rel=0.3)
    amplitude, hertz, turns = found.as_tuple
    assert (amplitude, hertz) == pytest.approx((3e-3, frequency), rel=0.02)
    # `hum` has its phase at the first sample, half a time before the pulse earlier.
    expected = 0.7 / (2 * np.pi) + frequency * 0.5 * STEP * (time.size - 1)
    assert abs((turns - expected + 0.5) % 1.0 - 0.5) < 0.02
    (third, share, phase), (fifth, least, last) = found.harmonics
    assert (third, fifth) == (3, 5)
    assert (share, least) == pytest.approx((0.25, 0.1), rel=0.05)
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
    found = hum_before(0.2 + line, STEP, int(velocity))
    assert found.max_amplitude == pytest.approx(3e-3, rel=rel)
    (right,) = [line for line in found.lines if line[1] == frequency]
    assert right[0] == pytest.approx(3e-3, rel=1e-6)
    turns = 0.4 / (2 * np.pi) + frequency * time.mean()
    assert abs((right[2] - turns + 0.5) % 1.0 - 0.5) < 1e-6


@pytest.mark.parametrize(("rate", "shown"), [(10.0, 0), (100.0, 0), (112.0, 1), (140.0, 2)])
def test_hum_is_asked_only_of_samples_that_show_it(rate: float, shown: int) -> None:
    noise = np.random.default_rng(5).standard_normal(40)
    assert len(hum_before(1e-6 * noise, 1.0 / rate, 1).lines) == shown


def test_a_quiet_time_before_the_pulse_leaves_no_room_for_hum() -> None:
    # Ten samples of a record at 3.7 kHz that move by 10 nm.
    step, noise = 2.667e-4, np.random.default_rng(5).standard_normal((50, 10))
    most = [hum_before(1e-8 * row, step, 0).max_amplitude for row in noise]
    assert max(most) < 2e-4
    # More noise leaves more, a longer time less.
    assert hum_before(1e-6 * noise[0], step, 0).max_amplitude == pytest.approx(100 * most[0])
    longer = np.random.default_rng(5).standard_normal(60)
    assert hum_before(1e-8 * longer, step, 0).max_amplitude < 0.1 * np.median(most)


@pytest.mark.parametrize("samples", [0, 3])
def test_too_few_samples_tell_nothing_of_hum(samples: int) -> None:
    assert hum_before(np.zeros(samples), STEP, 1) == Hum(np.inf, ())


@pytest.fixture(scope="module")
def drop() -> SimulatedDrop:
    ground = SoilProfile.uniform(45e6, 5e4, 1900.0, 0.35, 1.2)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=4.0)
    return simulate_drop(ground, Plate(0.15, 12.0), hammer, duration=0.05, time_step=1e-4)


@pytest.mark.parametrize("velocity", [True, False])
def test_hum_before_the_pulse_tells_where_its_fit_begins(
    drop: SimulatedDrop, velocity: bool
) -> None:
    before = 220
    time = 1e-4 * np.arange(-before, drop.time.size)
    moved = np.concatenate([np.zeros(before), drop.plate_displacement])
    if velocity:
        values = np.gradient(moved, 1e-4) + hum(time, 0.02, 60.0, 0.3)
    else:
        values = moved + displaced(time, 0.02, 60.0)
    load = np.concatenate([np.zeros(before), drop.load])
    sensor = Sensor(0.0, "velocity" if velocity else "displacement", values)
    (at_rest,) = estimate_pre_trigger_noise([Record(time, load, (sensor,), Instrument(0.15))])
    turns = (0.3 if velocity else 0.7) / (2 * np.pi) + 60.0 * at_rest.drop.start
    # The line that was found, and the one of the right mains whether one was found or not.
    assert len(at_rest.hum) == 3
    for amplitude, frequency, phase in (at_rest.hum[0], at_rest.hum[2]):
        assert (amplitude, frequency) == pytest.approx((0.02, 60.0), rel=0.2)
        assert abs((phase - turns + 0.5) % 1.0 - 0.5) < 0.05


def test_hum_that_was_there_before_the_pulse_is_found(drop: SimulatedDrop) -> None:
    before = 160
    time = 1e-4 * np.arange(-before, drop.time.size)
    velocity = np.gradient(np.concatenate([np.zeros(before), drop.plate_displacement]), 1e-4)
    amplitude = 0.05 * float(velocity.max())
    noise = 1e-4 * velocity.max() * np.random.default_rng(4).standard_normal(time.size)
    record = Record(
        time,
        np.concatenate([np.zeros(before), drop.load]),
        (Sensor(0.0, "velocity", velocity + hum(time, amplitude) + noise),),
        Instrument(plate_radius=0.15, plate_mass=12.0),
        poisson_ratio=0.35,
        bedrock_depth=1.2,
    )
    found = diagnose_point(PointRecords("test", (record,), (1,)))
    assert [effect.name for effect in found.effects] == ["mains_hum"]
    told = {p.name: p.value for p in found.effects[0].parameters}
    assert told["amplitude"] == pytest.approx(amplitude, rel=0.02)
    assert told["frequency"] == pytest.approx(50.0, abs=0.3)
    assert found.verdict == "explained"
    assert abs(found.after.modulus_pa / 45e6 - 1.0) < 0.005
