"""Bad sensors: each rule with its threshold, and sound records."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion.forward.model import Instrument
from inversion.measured.bad_sensors import (
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
    residual = returns * np.clip(TIME / 0.015, 0.0, 1.0)
    moved = {place: part * PLATE * np.maximum(PULSE, residual) for place, part in BOWL.items()}
    moved |= changes or {}
    sensors = tuple(Sensor(place, "displacement", values) for place, values in moved.items())
    return Record(TIME, 8000.0 * PULSE, sensors, Instrument(0.15))


def faults(record: Record) -> dict[float, str]:
    return {sensor.offset: sensor.fault for sensor in bad_sensors(record)}


def pulse(part: float) -> Array:
    """A displacement with a peak over the plate's."""
    return part * PLATE * PULSE


SPIKE = BOWL[0.9] * PLATE * PULSE
SPIKE[-5:] = PLATE


@pytest.mark.parametrize(
    ("changes", "returns", "expected"),
    [
        ({}, 0.0, {}),
        ({}, 0.15, {}),
        ({}, 0.6, {}),
        # Drift ends at more than 0.6 of the plate's peak, as a mean over the end, in a record
        # whose median sensor returns to 0.2 of its peak.
        *(({-0.3: drifts(sign * 0.62)}, 0.0, {-0.3: "drift"}) for sign in (1.0, -1.0)),
        *(({-0.3: drifts(sign * 0.58)}, 0.0, {}) for sign in (1.0, -1.0)),
        ({0.9: SPIKE}, 0.0, {}),
        ({0.9: drifts(0.9)}, 0.19, {0.9: "drift"}),
        ({0.9: drifts(0.9)}, 0.21, {}),
        # A sensor moves at most 1.25 times as much as an inner one; a bad one is no measure.
        ({0.6: pulse(1.24)}, 0.0, {}),
        ({0.6: pulse(1.26)}, 0.0, {0.6: "against the others"}),
        ({0.6: pulse(-1.26)}, 0.0, {0.6: "against the others"}),
        (
            {0.6: pulse(3.0), 1.2: pulse(2.0)},
            0.0,
            {0.6: "against the others", 1.2: "against the others"},
        ),
        # Two sides at equal distance do not judge each other.
        ({-0.3: pulse(0.9), 0.3: pulse(0.3)}, 0.0, {}),
        # Without contact: a tenth of the lesser neighbour, 0.1 of the plate's peak at 1.2 m. The
        # farthest has a single neighbour: the ground may be still there.
        ({0.9: pulse(0.0099)}, 0.0, {0.9: "no contact"}),
        ({0.9: pulse(0.0101)}, 0.0, {}),
        ({1.2: pulse(0.0)}, 0.0, {}),
        ({0.9: pulse(0.02), 1.2: drifts(2.0)}, 0.0, {1.2: "drift"}),
        # A majority of odd sensors means a bad centre sensor, which is not judged.
        ({0.0: pulse(0.1)}, 0.0, {}),
        (dict.fromkeys((0.6, 0.9, 1.2), pulse(2.0)), 0.0, {}),
        (
            dict.fromkeys((0.6, 0.9), pulse(2.0)),
            0.0,
            dict.fromkeys((0.6, 0.9), "against the others"),
        ),
    ],
)
def test_bad_sensors_have_a_fault(
    changes: dict[float, Array], returns: float, expected: dict[float, str]
) -> None:
    assert faults(made(changes, returns)) == expected


def test_the_centre_is_not_judged_and_is_required() -> None:
    assert 0.0 not in faults(made({0.0: drifts(3.0)}))
    loose = made({0.9: drifts(3.0)})
    assert faults(loose) == {0.9: "drift"}
    outer = tuple(sensor for sensor in loose.sensors if sensor.offset != 0.0)
    assert bad_sensors(replace(loose, sensors=outer)) == ()


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
