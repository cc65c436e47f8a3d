"""Which sensors are not believed: each rule alone, its threshold, and what no rule may name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.forward.model import Instrument
from inversion.measured.bad_sensors import (
    CENTRE_RADIUS_M,
    END_SHARE,
    MAX_END_OVER_PLATE_PEAK,
    MAX_MEDIAN_END_OVER_PEAK,
    MAX_OVER_INNER_SENSORS,
    MIN_OVER_NEIGHBOURS,
    BadSensor,
    bad_sensors,
)
from inversion.measured.record import Record, Sensor

Array = NDArray[Any]

TIME = np.arange(-100, 300) * 2e-4
PULSE = np.where((TIME > 0) & (TIME < 0.015), np.sin(np.pi * TIME / 0.015), 0.0)
PLATE = 5e-4
BOWL = {0.0: 1.0, 0.3: 0.5, -0.3: 0.5, 0.6: 0.25, 0.9: 0.15, 1.2: 0.1}
"""Peaks over the plate's."""


def drifts(part: float) -> Array:
    """A displacement that runs away under the pulse and stays, m; `part` of the plate's peak."""
    return part * PLATE * np.clip(TIME / 0.02, 0.0, 1.0)


def made(changes: dict[float, Array] | None = None, returns: float = 0.0) -> Record:
    """A sound drop of six sensors, each of which keeps a part of its peak, with some changed."""
    left = returns * np.clip(TIME / 0.015, 0.0, 1.0)
    moved = {place: part * PLATE * np.maximum(PULSE, left) for place, part in BOWL.items()}
    moved |= changes or {}
    sensors = tuple(Sensor(place, "displacement", values) for place, values in moved.items())
    return Record(TIME, 8000.0 * PULSE, sensors, Instrument(0.15))


def faults(record: Record) -> dict[float, str]:
    return {sensor.offset: sensor.fault for sensor in bad_sensors(record)}


def test_a_sound_drop_has_none() -> None:
    assert bad_sensors(made()) == ()
    assert bad_sensors(made(returns=0.15)) == ()
    assert bad_sensors(made(returns=0.6)) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sensor_that_ends_far_from_rest_drifts(sign: float) -> None:
    record = made({-0.3: drifts(sign * 0.62)})
    assert bad_sensors(record) == (BadSensor(-0.3, "displacement", "drift"),)
    assert faults(made({-0.3: drifts(sign * 0.58)})) == {}
    assert MAX_END_OVER_PLATE_PEAK == 0.6


def test_what_is_left_is_a_mean_over_the_end() -> None:
    spike = BOWL[0.9] * PLATE * PULSE
    spike[-5:] = PLATE
    assert round(END_SHARE * TIME.size) == 20
    assert faults(made({0.9: spike})) == {}


def test_in_a_record_that_does_not_return_nobody_drifts() -> None:
    drifting = {0.9: drifts(0.9)}
    assert faults(made(drifting, returns=0.19)) == {0.9: "drift"}
    assert faults(made(drifting, returns=0.21)) == {}
    assert MAX_MEDIAN_END_OVER_PEAK == 0.2


def test_nobody_beside_the_plate_moves_more_than_what_is_nearer() -> None:
    assert faults(made({0.6: 1.24 * PLATE * PULSE})) == {}
    assert faults(made({0.6: 1.26 * PLATE * PULSE})) == {0.6: "against the others"}
    assert faults(made({0.6: -1.26 * PLATE * PULSE})) == {0.6: "against the others"}
    assert MAX_OVER_INNER_SENSORS == 1.25


def test_a_bad_sensor_is_no_measure_for_the_next() -> None:
    loose = {0.6: 3.0 * PLATE * PULSE, 1.2: 2.0 * PLATE * PULSE}
    assert set(faults(made(loose))) == {0.6, 1.2}


def test_two_sides_at_one_distance_do_not_judge_each_other() -> None:
    assert faults(made({-0.3: 0.9 * PLATE * PULSE, 0.3: 0.3 * PLATE * PULSE})) == {}


def test_a_sensor_that_stands_still_between_two_that_move_has_no_contact() -> None:
    # 0.1 of the plate's peak at 1.2 m is the lesser neighbour.
    assert faults(made({0.9: 0.0099 * PLATE * PULSE})) == {0.9: "no contact"}
    assert faults(made({0.9: 0.0101 * PLATE * PULSE})) == {}
    # The farthest has one neighbour only: the ground may be still there.
    assert faults(made({1.2: 0.0 * PULSE})) == {}
    assert MIN_OVER_NEIGHBOURS == 0.1


def test_a_neighbour_that_is_bad_says_nothing_of_contact() -> None:
    changes = {0.9: 0.02 * PLATE * PULSE, 1.2: drifts(2.0)}
    assert faults(made(changes)) == {1.2: "drift"}


def test_where_most_are_odd_it_is_the_plates_sensor() -> None:
    record = made({0.0: 0.1 * PLATE * PULSE})
    assert bad_sensors(record) == ()
    half = dict.fromkeys((0.6, 0.9), 2.0 * PLATE * PULSE)
    assert len(bad_sensors(made(half))) == 2
    most = dict.fromkeys((0.6, 0.9, 1.2), 2.0 * PLATE * PULSE)
    assert bad_sensors(made(most)) == ()


def test_the_centre_is_not_judged_and_without_it_nobody_is() -> None:
    record = made({0.0: drifts(3.0)})
    assert 0.0 not in faults(record)
    loose = made({0.9: drifts(3.0)})
    assert faults(loose) == {0.9: "drift"}
    others = tuple(sensor for sensor in loose.sensors if sensor.offset != 0.0)
    assert bad_sensors(replace(loose, sensors=others)) == ()
    assert CENTRE_RADIUS_M == 1e-3


def test_the_order_of_the_sensors_does_not_matter() -> None:
    record = made({0.9: drifts(1.0), -0.3: drifts(-1.0)})
    turned = replace(record, sensors=record.sensors[::-1])
    assert [bad.offset for bad in bad_sensors(turned)] == [-0.3, 0.9]
    assert bad_sensors(turned) == bad_sensors(record)


def test_a_velocity_is_judged_by_its_displacement() -> None:
    record = made({0.9: drifts(0.7)})
    sensors = tuple(
        Sensor(sensor.offset, "velocity", np.gradient(sensor.values, TIME))
        for sensor in record.sensors
    )
    assert bad_sensors(replace(record, sensors=sensors)) == (BadSensor(0.9, "velocity", "drift"),)
