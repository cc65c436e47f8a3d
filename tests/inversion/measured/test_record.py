"""Prepared drops: displacement, windows and noise of signals with closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from inversion.errors import RecordError
from inversion.forward.model import Instrument
from inversion.measured.record import (
    MAX_SIDE_DIFFERENCE_M,
    ChannelNoise,
    NoiseModel,
    PreparedDrop,
    Record,
    Sensor,
    displacement_rms,
    prepare,
)
from pfwd_plugins.quantities import MotionName

Array = NDArray[Any]

RATE = 5000.0
PULSE = 0.0133
PEAK = 8000.0
PRE_TRIGGER = 0.02
RECORD_END = 0.08


def time_axis(pre_trigger: float = PRE_TRIGGER, end: float = RECORD_END) -> Array:
    """Uniform times, s, with 0 at the trigger."""
    return np.arange(-round(pre_trigger * RATE), round(end * RATE)) / RATE


def half_sine(time: Array, start: float = 0.0, duration: float = PULSE) -> Array:
    phase = (time - start) / duration
    return np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase), 0.0)


def swing(time: Array) -> tuple[Array, Array]:
    """A velocity that starts smoothly at 0 and its exact integral: t^2 e^(-t/d), d = 4 ms."""
    t, d = np.maximum(time, 0.0), 4e-3
    velocity = t**2 * np.exp(-t / d)
    displacement = 2 * d**3 - np.exp(-t / d) * (d * t**2 + 2 * d**2 * t + 2 * d**3)
    scale = 5e-4 / (2 * d**3)
    return scale * velocity, scale * displacement


def make_record(
    values: Array | None = None,
    quantity: MotionName = "velocity",
    load: Array | None = None,
    time: Array | None = None,
) -> Record:
    """A record of one centre sensor; a half-sine load and the swing where nothing is given."""
    time = time_axis() if time is None else time
    load = PEAK * half_sine(time) if load is None else load
    values = swing(time)[0] if values is None else values
    return Record(time, load, (Sensor(0.0, quantity, values),), Instrument(0.15))


# --- baseline and integration --------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 0.03, -0.2])
def test_velocity_is_integrated_and_its_offset_removed(offset: float) -> None:
    time = time_axis()
    velocity, _ = swing(time)
    drop = prepare(make_record(velocity + offset))
    _, right = swing(drop.time + drop.start)
    assert np.max(np.abs(drop.displacement[0] - right)) < 1e-3 * np.max(right)
    assert drop.displacement[0, 0] == 0.0


def test_offset_of_the_load_is_removed() -> None:
    time = time_axis()
    drop = prepare(make_record(load=PEAK * half_sine(time) + 350.0))
    right = PEAK * half_sine(drop.time + drop.start)
    assert np.max(np.abs(drop.load - right)) < 1e-9 * PEAK
    assert drop.peak_load == pytest.approx(PEAK, rel=1e-3)


def test_displacement_is_zero_where_the_pulse_begins() -> None:
    time = time_axis()
    _, displacement = swing(time)
    # Whatever drifted before: an integrated channel has no zero of its own.
    drifted = displacement + 2e-4 + 1e-4 * np.minimum(time, 0.0)
    drop = prepare(make_record(drifted, "displacement"))
    _, right = swing(drop.time + drop.start)
    assert np.max(np.abs(drop.displacement[0] - right)) < 1e-6


def test_record_without_pre_trigger() -> None:
    time = time_axis(0.0)
    drop = prepare(make_record(time=time))
    _, right = swing(drop.time + drop.start)
    assert np.max(np.abs(drop.displacement[0] - right)) < 1e-3 * np.max(right)
    assert drop.noise == pytest.approx([0.0])
    assert drop.channels[0].model.samples == 0
    assert drop.load_noise.samples == 0


def test_start_is_just_before_the_pulse() -> None:
    drop = prepare(make_record())
    assert drop.time[0] == 0.0
    assert -1.6e-3 < drop.start < -0.8e-3
    assert drop.trigger == pytest.approx(-drop.start)
    assert drop.step == pytest.approx(1 / RATE)
    assert np.max(np.abs(drop.load[:4])) == 0.0


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_a_load_that_is_recorded_late_is_not_where_the_motion_starts(quantity: MotionName) -> None:
    """Motion before the load counts neither as noise nor as a baseline."""
    time = time_axis()
    velocity, displacement = swing(time)
    values = velocity if quantity == "velocity" else displacement
    noise = 1e-4 * values.max() * np.random.default_rng(3).standard_normal(time.size)
    late = make_record(values + noise, quantity, load=PEAK * half_sine(time, start=5e-3))
    drop = prepare(late)
    assert -2.5e-3 < drop.start <= 0.5e-3
    (channel,) = drop.channels
    assert channel.model.rms == pytest.approx(1e-4 * values.max(), rel=0.3)
    assert drop.displacement[0].max() == pytest.approx(displacement.max(), rel=0.02)
    # Less than a hundredth of the peak is no motion, and neither are a few deviations.
    for bump in (0.008 * values.max(), 4e-4 * values.max()):
        early = noise + np.where((time > -4e-3) & (time < 0.0), bump, 0.0)
        still = make_record(late.sensors[0].values * (time >= 5e-3) + early, quantity, late.load)
        assert prepare(still).start > 3e-3


@pytest.mark.parametrize(("samples", "starts_early"), [(2, False), (3, True)])
def test_a_spike_before_the_pulse_is_no_motion(samples: int, starts_early: bool) -> None:
    still = make_record()
    start = prepare(still).start
    values = still.sensors[0].values.copy()
    place = int(np.searchsorted(still.time, start - 0.25 / RATE))
    values[place - samples : place] = values.max()
    drop = prepare(make_record(values))
    assert (drop.start < start) == starts_early


def test_sensors_keep_their_order() -> None:
    time = time_axis()
    velocity, displacement = swing(time)
    sensors = (
        Sensor(0.6, "displacement", 0.1 * displacement),
        Sensor(0.0, "velocity", velocity),
        Sensor(0.3, "velocity", -0.5 * velocity),
    )
    drop = prepare(Record(time, PEAK * half_sine(time), sensors, Instrument(0.15)))
    assert drop.offsets == pytest.approx([0.6, 0.0, 0.3])
    _, right = swing(drop.time + drop.start)
    for row, factor in enumerate((0.1, 1.0, -0.5)):
        assert drop.displacement[row] == pytest.approx(factor * right, abs=1e-6)
        assert drop.peak_displacement[row] == pytest.approx(abs(factor) * right.max(), rel=1e-3)


def test_peak_of_a_sensor_that_rises() -> None:
    # Far from the plate on shallow rock the ground rises, and hardly sinks.
    time = time_axis()
    _, displacement = swing(time)
    lifted = -displacement + 1e-3 * np.interp(time, [0.0, 1e-3, 2e-3], [0, 5e-4, 0])
    drop = prepare(make_record(lifted, "displacement"))
    assert drop.peak_displacement[0] == pytest.approx(displacement.max(), rel=1e-2)


# --- windows -------------------------------------------------------------------------------------


def test_contact_ends_at_three_per_cent() -> None:
    drop = prepare(make_record())
    # sin(pi t/T0) = 0.03 near the end: t = T0 (1 - arcsin(0.03)/pi).
    right = PULSE * (1 - math.asin(0.03) / math.pi) - drop.start
    assert right <= drop.contact_end < right + 1.01 * drop.step
    assert drop.window_end >= drop.contact_end
    assert drop.tail_end == pytest.approx(RECORD_END - drop.start - drop.step)


def test_window_and_tail() -> None:
    drop = prepare(make_record())
    last = drop.time[drop.window][-1]
    assert last == pytest.approx(drop.window_end)
    assert drop.window.start == 1
    longer = drop.with_tail()
    assert longer.time[longer.window][-1] == pytest.approx(drop.tail_end)
    assert longer.contact_end == drop.contact_end


@pytest.mark.parametrize("height", [0.1, 0.5])
def test_second_contact_ends_the_tail(height: float) -> None:
    time, repeated = time_axis(), 0.05
    drop = prepare(make_record(load=PEAK * (half_sine(time) + height * half_sine(time, repeated))))
    # The bounce passes 8 % of the first peak a little after its begin.
    passed = repeated + PULSE / math.pi * math.asin(0.08 / height) - drop.start
    assert passed - 1.01 * drop.step <= drop.tail_end <= passed
    assert drop.contact_end < repeated


def held(values: Array, samples: int) -> Array:
    """The last samples are all the one before them."""
    result = values.copy()
    result[-samples:] = result[-samples - 1]
    return result


def makers_record(samples: int, quantity: MotionName = "displacement") -> Record:
    """Return the record of a filter that looks ahead: constant motion, zero load at the end."""
    time = time_axis(end=0.04)
    velocity, displacement = swing(time)
    load = PEAK * half_sine(time) - 90.0 * (time > PULSE)
    load[-samples:] = 0.0
    values = displacement if quantity == "displacement" else velocity
    return make_record(held(values, samples), quantity, load, time)


@pytest.mark.parametrize(("samples", "ends"), [(5, True), (27, True), (4, False)])
def test_channels_that_are_held_end_the_tail(samples: int, ends: bool) -> None:
    drop = prepare(makers_record(samples))
    residual = drop.time[-1] - drop.tail_end
    assert residual == pytest.approx(samples * drop.step if ends else 0.0, abs=1e-9)


@pytest.mark.parametrize("together", [False, True])
def test_channels_that_come_to_rest_by_their_smallest_step_are_not_held(together: bool) -> None:
    """The load came to rest long ago, or with the sensor."""
    time = time_axis(end=0.3)
    displacement = np.round(swing(time)[1], 6)
    assert displacement[-1] == displacement[-30]
    load = 1e7 * displacement if together else None
    drop = prepare(make_record(displacement, "displacement", load, time))
    assert drop.tail_end == pytest.approx(drop.time[-1])


def test_a_single_constant_channel_does_not_end_the_tail() -> None:
    record = makers_record(27)
    moves = Sensor(0.3, "displacement", 0.5 * swing(record.time)[1])
    drop = prepare(replace(record, sensors=(*record.sensors, moves)))
    assert drop.tail_end == pytest.approx(drop.time[-1])


def test_ripple_is_no_second_contact() -> None:
    time = time_axis()
    drop = prepare(make_record(load=PEAK * (half_sine(time) + 0.05 * half_sine(time, 0.05))))
    assert drop.tail_end == pytest.approx(drop.time[-1])


def test_load_that_never_ends() -> None:
    time = time_axis(end=0.010)
    drop = prepare(make_record(time=time))
    assert drop.contact_end == pytest.approx(drop.time[-1])
    assert drop.window_end == drop.tail_end == drop.contact_end


# --- noise ---------------------------------------------------------------------------------------

SIGMA = 1e-3


def white(rng: np.random.Generator, count: int) -> Array:
    return SIGMA * rng.standard_normal(count)


def correlated(rng: np.random.Generator, count: int, memory: float = 0.8) -> Array:
    """AR(1) of the same variance as the white noise."""
    driven = SIGMA * math.sqrt(1 - memory**2) * rng.standard_normal(count + 200)
    result: Array = signal.lfilter([1.0], [1.0, -memory], driven)[200:]
    return result


def drops_of_noise(
    make: Any, quantity: MotionName, pre_trigger: float, count: int = 300
) -> list[PreparedDrop]:
    """Drops whose sensor recorded nothing but noise."""
    rng = np.random.default_rng(20)
    time = time_axis(pre_trigger, 0.03)
    load = PEAK * half_sine(time)
    return [prepare(make_record(make(rng, time.size), quantity, load, time)) for _ in range(count)]


def stated_over_true(drops: list[PreparedDrop]) -> float:
    """Stated rms of the displacement noise over that of the displacements, over the window."""
    stated = math.sqrt(np.mean([drop.noise[0] ** 2 for drop in drops]))
    true = math.sqrt(np.mean([drop.displacement[0, drop.window] ** 2 for drop in drops]))
    return stated / true


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
@pytest.mark.parametrize("pre_trigger", [0.02, 0.05, 0.2])
def test_white_noise(pre_trigger: float, quantity: MotionName) -> None:
    drops = drops_of_noise(white, quantity, pre_trigger)
    assert stated_over_true(drops) == pytest.approx(1, abs=0.15)


def test_correlated_noise_of_a_velocity() -> None:
    # The integral of AR(1) noise wanders sqrt((1 + 0.8)/(1 - 0.8)) = 3 times as far.
    drops = drops_of_noise(correlated, "velocity", 0.4)
    assert stated_over_true(drops) == pytest.approx(1, abs=0.15)
    plain = drops_of_noise(white, "velocity", 0.4)
    stated, stated_plain = (np.mean([drop.noise[0] for drop in some]) for some in (drops, plain))
    assert stated / stated_plain == pytest.approx(3, rel=0.2)


def test_drift_before_the_pulse_is_no_noise() -> None:
    time = time_axis(0.2)
    quiet = prepare(make_record(swing(time)[0] + 0.02 * time, time=time))
    assert quiet.channels[0].model.rms < 1e-12


def test_quantisation_is_the_smallest_step() -> None:
    time = time_axis(0.0)
    unit = 1e-6
    _, displacement = swing(time)
    drop = prepare(make_record(unit * np.round(displacement / unit), "displacement", time=time))
    assert drop.quantisation == pytest.approx([unit / math.sqrt(12)], rel=1e-6)


def test_quantisation_of_a_velocity_adds_up() -> None:
    time = time_axis(0.0)
    unit = 5e-4
    velocity, _ = swing(time)
    coarse = prepare(make_record(unit * np.round(velocity / unit), time=time))
    _, right = swing(coarse.time + coarse.start)
    window = coarse.window
    actual = np.sqrt(np.mean((coarse.displacement[0, window] - right[window]) ** 2))
    assert 0.2 < actual / coarse.quantisation[0] < 5


def test_quadratic_form_is_that_of_the_toeplitz_matrix() -> None:
    rng = np.random.default_rng(3)
    autocovariance = np.array([1.0, 0.7, 0.4, 0.15, 0.05])
    rows = rng.standard_normal((3, 40))
    lag = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    full = np.where(lag < 5, np.append(autocovariance, 0.0)[np.minimum(lag, 5)], 0.0)
    result = NoiseModel(autocovariance, 100).quadratic_form(rows)
    assert result == pytest.approx(rows @ full @ rows.T, rel=1e-9, abs=1e-12)


def test_integrated_white_noise_without_a_baseline_is_a_random_walk() -> None:
    # The variance after j steps is about j (sigma dt)^2.
    channel = ChannelNoise(NoiseModel(np.array([SIGMA**2]), 100), True)
    rms = displacement_rms(channel, 401, 1 / RATE)
    assert rms == pytest.approx(SIGMA / RATE * math.sqrt(200), rel=0.03)


# --- errors --------------------------------------------------------------------------------------


def broken(values: Array, value: float = math.nan) -> Array:
    """Return the values with another one in their midst."""
    return np.where(np.arange(values.size) == 100, value, values)


def only(values: Array, offset: float = 0.0) -> tuple[Sensor, ...]:
    return (Sensor(offset, "velocity", values),)


NO_PULSE = r"load: expected a positive pulse .*got none"
UNEVEN = "time: expected uniform, rising steps"
LATER = np.where(np.arange(500) < 100, 0.0, 0.5 / RATE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (lambda r: {"load": broken(r.load)}, "load: expected finite values, got NaN or infinity"),
        (lambda r: {"sensors": only(broken(r.load), 0.3)}, r"sensor at 0\.3 m: expected finite"),
        (lambda r: {"time": r.time[:15]}, "expected at least 16 samples, got 15"),
        (lambda r: {"load": r.load[1:]}, r"load: expected 500 samples, got shape \(499,\)"),
        (lambda r: {"sensors": only(np.zeros((2, 500)))}, "sensor at 0 m: expected 500 samples"),
        (lambda r: {"sensors": ()}, "at least one motion sensor, got none"),
        (lambda r: {"time": r.time + LATER}, UNEVEN),
        (lambda r: {"time": r.time[::-1].copy()}, UNEVEN),
        (lambda r: {"time": broken(r.time)}, UNEVEN),
        (lambda r: {"load": np.zeros(500)}, NO_PULSE),
        (lambda r: {"load": -r.load}, NO_PULSE),
        (lambda r: {"sensors": only(r.load, math.inf)}, "expected finite distances"),
    ],
)
def test_invalid_records_are_refused(
    changes: Callable[[Record], dict[str, Any]], message: str
) -> None:
    record = make_record()
    with pytest.raises(RecordError, match=message):
        prepare(replace(record, **changes(record)))


# --- both sides of the plate ---------------------------------------------------------------------


def test_sensors_on_both_sides_share_a_distance() -> None:
    time = time_axis()
    values = swing(time)[0]
    places = (-0.3, 0.6, 0.0, 0.3)
    sensors = tuple(Sensor(place, "velocity", values / (1 + i)) for i, place in enumerate(places))
    record = replace(make_record(), sensors=sensors)
    drop = prepare(record)
    assert drop.offsets.tolist() == [0.3, 0.6, 0.0, 0.3]
    assert drop.positions.tolist() == list(places)
    outward = record.nearest_first()
    assert [sensor.offset for sensor in outward.sensors] == [0.0, 0.3, -0.3, 0.6]
    assert outward.sensors[2] is sensors[0]


def two_sides(residual: Array, right: Array, *variants: float, place: float = -0.3) -> PreparedDrop:
    """A plate with displacements at `place` and 0.3 m, and the same swing elsewhere."""
    time = time_axis()
    moved = {0.0: swing(time)[1], place: residual, 0.3: right}
    moved |= dict.fromkeys(variants, swing(time)[1])
    sensors = tuple(Sensor(r, "displacement", values) for r, values in moved.items())
    return prepare(replace(make_record(), sensors=sensors))


def test_tilt_counts_equally_for_both_sides() -> None:
    time = time_axis()
    right = swing(time)[1]
    drop = two_sides(1.1 * right, 0.9 * right, 0.6, -0.9)
    rms = np.sqrt(np.mean(drop.displacement[0, drop.window] ** 2))
    assert drop.side_floor[1:3] == pytest.approx(0.2 / np.sqrt(2) * rms)
    # No other side: neither the plate's own sensor nor those at 0.6 and -0.9 m.
    assert drop.side_floor[[0, 3, 4]].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("place", "counts"), [(-0.3009, True), (-0.3011, False), (0.3005, False)])
def test_two_sides_stand_at_equal_distance(place: float, counts: bool) -> None:
    right = swing(time_axis())[1]
    drop = two_sides(1.1 * right, right, place=place)
    assert (drop.side_floor[1:] > 0).tolist() == [counts, counts]
    assert MAX_SIDE_DIFFERENCE_M == 1e-3


def test_the_difference_of_sides_is_taken_over_the_window() -> None:
    time = time_axis()
    right = swing(time)[1]
    late = np.where(time > 0.04, 1e-4, 0.0)
    drop = two_sides(right + late, right)
    assert drop.side_floor[1] == pytest.approx(0.0, abs=1e-12)
    part = np.mean(late[time >= drop.start][drop.with_tail().window] > 0)
    assert drop.with_tail().side_floor[1] == pytest.approx(1e-4 * np.sqrt(part / 2))
