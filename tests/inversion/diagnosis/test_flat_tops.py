"""Detection of clipped records; rounded tops are no clipping."""

from dataclasses import replace

import numpy as np
import pytest

from inversion.diagnosis.flat_tops import (
    flat_level,
    flat_load_level,
    flat_sensor_level,
    flat_velocity,
    largest_values,
)
from inversion.diagnosis.model import PointRecords
from inversion.forward.model import Instrument
from inversion.measured.record import Record, Sensor

TIME = np.arange(600) * 1e-4
PULSE = np.where(TIME < 0.02, np.sin(np.pi * TIME / 0.02) ** 2, 0.0)


@pytest.mark.parametrize("level", [0.6, 0.85, 0.95])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_clipped_top_is_detected_and_a_rounded_top_is_not(level: float, noise: float) -> None:
    rng = np.random.default_rng(2)
    pulse = np.sin(np.pi * np.arange(300) / 100) * np.exp(-np.arange(300) / 150)
    pulse = pulse / pulse.max()
    hiss = noise * rng.standard_normal(300)
    assert flat_level(pulse + hiss, noise) is None
    cut = np.clip(pulse, -level, level) + hiss
    assert flat_level(cut, noise) == pytest.approx(level, abs=3 * noise + 1e-9)


def test_a_noisy_displacement_is_not_a_clipped_velocity() -> None:
    rng = np.random.default_rng(3)
    still = Sensor(0.0, "displacement", 1e-6 * rng.standard_normal(400))
    assert flat_velocity(still, 1e-6, 1e-4, largest=True) is None
    moving = Sensor(0.0, "displacement", 5e-4 * PULSE)
    level = flat_velocity(moving, 1e-8, 1e-4, largest=True)
    assert 0.9 * 5e-4 * np.pi / 0.02 < level <= 5e-4 * np.pi / 0.02
    assert flat_velocity(moving, 1e-8, 1e-4, largest=False) is None


QUIET = 40
LATER = np.roll(PULSE, QUIET)
"""A pulse with a quiet time before it."""
SPEED = np.gradient(LATER) / np.gradient(LATER).max()


def clipped_pulse(level: float, scale: float = 1.0) -> Record:
    """A load with its top cut off at a level (N) and a velocity with its top at a level of its own.

    Loads scale with a height of 8 kN, velocities with one of 0.1 m/s.
    """
    load = np.minimum(scale * 8000.0 * LATER, level)
    velocity = np.clip(scale * 0.1 * SPEED, -0.08, 0.08)
    return Record(TIME - 0.004, load, (Sensor(0.0, "velocity", velocity),), Instrument(0.15))


def of_point(*records: Record, device: float = 0.0) -> list[tuple[float | None, float | None]]:
    """Levels of load and velocity that remain in each drop of a point."""
    point = PointRecords("p", records, tuple(range(len(records))), device_largest={None: device})
    return [
        (
            flat_load_level(record, 0.0, point.largest_values),
            flat_sensor_level(record.sensors[0], 0.0, 1e-4, False, point.largest_values),
        )
        for record in records
    ]


def test_a_level_that_no_record_exceeds_remains() -> None:
    assert of_point(clipped_pulse(6400.0)) == [(6400.0, 0.08)]
    assert of_point(clipped_pulse(6400.0), clipped_pulse(6400.0, 1.2)) == [(6400.0, 0.08)] * 2
    assert of_point(clipped_pulse(6400.0), clipped_pulse(6400.0, 0.5))[0] == (6400.0, 0.08)


def test_a_level_that_another_drop_exceeds_is_refuted() -> None:
    """The flat top was the pulse's own shape: the channel can show more."""
    assert of_point(clipped_pulse(6400.0), clipped_pulse(9000.0, 1.0)) == [
        (None, 0.08),
        (None, 0.08),
    ]
    # Within the band in which a top counts as flat nothing is exceeded.
    assert of_point(clipped_pulse(6400.0), clipped_pulse(6490.0))[0] == (6400.0, 0.08)


def test_a_level_that_the_device_exceeds_elsewhere_is_refuted() -> None:
    assert of_point(clipped_pulse(6400.0), device=7000.0) == [(None, 0.08)]
    assert of_point(clipped_pulse(6400.0), device=6400.0) == [(6400.0, 0.08)]


def test_a_velocity_with_a_larger_opposite_peak_is_not_clipped() -> None:
    record = clipped_pulse(9000.0)
    (sensor,) = record.sensors
    farther = replace(sensor, values=np.where(sensor.values < 0, 2 * sensor.values, sensor.values))
    assert of_point(replace(record, sensors=(farther,))) == [(None, None)]


def test_a_displacement_is_compared_by_its_velocity() -> None:
    def integrated(limit: float) -> Record:
        velocity = np.clip(0.1 * SPEED, -limit, limit)
        sensor = Sensor(0.0, "displacement", 1e-4 * np.cumsum(velocity))
        return Record(TIME - 0.004, 8000.0 * LATER, (sensor,), Instrument(0.15))

    cut = integrated(0.07)
    assert of_point(cut)[0][1] == pytest.approx(0.07)
    assert of_point(cut, integrated(1.0))[0] == (None, None)
    largest = largest_values([cut, integrated(1.0)])
    assert largest[0.0, "displacement"] == pytest.approx(0.1, rel=0.02)
    assert largest[None] == pytest.approx(8000.0, rel=1e-3)
