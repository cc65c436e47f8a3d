"""Drop and Channel: shapes, units, and that a record stays as it was recorded."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks


def test_sampling_rate_is_samples_per_second() -> None:
    assert measured_drop().sampling_rate == pytest.approx(1000.0, rel=1e-12)


def test_arrays_become_read_only_copies_of_floats() -> None:
    load = np.ones(100, dtype=np.int32)
    drop = Drop(1, np.arange(100) / 1000, load, ())
    load[0] = 7
    assert drop.load.dtype == np.float64
    assert drop.load[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        drop.load[0] = 2.0


@pytest.mark.parametrize(
    ("load", "channel", "message"),
    [
        (99, 100, r"drop 3: expected 100 samples .* got \[99, 100\]"),
        (100, 101, r"got \[100, 101\]"),
    ],
)
def test_arrays_of_different_lengths_are_refused(load: int, channel: int, message: str) -> None:
    channels = (Channel(0.0, "velocity", np.zeros(channel)),)
    with pytest.raises(ValueError, match=message):
        Drop(3, np.arange(100) / 1000, np.ones(load), channels)


def test_two_dimensions_or_a_single_sample_are_refused() -> None:
    with pytest.raises(ValueError, match=r"values: expected one dimension, got shape \(2, 2\)"):
        Channel(0.0, "velocity", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="at least 2 samples, got 1"):
        Drop(1, np.zeros(1), np.zeros(1), ())


def measured_drop() -> Drop:
    time = np.arange(-10, 90) / 1000
    channels = (Channel(0.0, "velocity", np.sin(time)), Channel(0.3, "velocity", np.cos(time)))
    return Drop(1, time, np.ones(100), channels)


def with_second_sensor(**changes: Any) -> Drop:
    first, second = measured_drop().channels
    return replace(measured_drop(), channels=(first, replace(second, **changes)))


def test_a_copy_of_a_drop_has_its_samples_whatever_its_number() -> None:
    drop = measured_drop()
    assert drop.has_samples_of(measured_drop())
    assert drop.has_samples_of(replace(drop, number=9))


@pytest.mark.parametrize(
    "different",
    [
        replace(measured_drop(), time=np.nextafter(measured_drop().time, 1.0)),
        replace(measured_drop(), load=np.nextafter(measured_drop().load, 0.0)),
        replace(measured_drop(), channels=measured_drop().channels[:1]),
        replace(measured_drop(), channels=measured_drop().channels[::-1]),
        with_second_sensor(values=np.cos(np.arange(100))),
        with_second_sensor(offset=0.6),
        with_second_sensor(quantity="displacement"),
    ],
    ids=["time", "load", "fewer", "order", "values", "offset", "quantity"],
)
def test_a_drop_with_any_difference_has_different_samples(different: Drop) -> None:
    assert not measured_drop().has_samples_of(different)
    assert not different.has_samples_of(measured_drop())


def test_a_drop_of_peaks_alone_has_no_samples() -> None:
    drop = Drop.of_peaks(1, Peaks(8000.0, ((0.0, 5e-4), (0.3, 2e-4))))
    assert not drop.has_samples_of(measured_drop())
    assert not measured_drop().has_samples_of(drop)
    assert not drop.has_samples_of(drop)
