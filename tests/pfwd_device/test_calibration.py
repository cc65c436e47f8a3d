"""Counts to SI by numbers worked out by hand, and what is said of dates."""

import dataclasses
import datetime

import numpy as np
import pytest

from pfwd_device.calibration import (
    calibrate,
    calibration_warnings,
    counts_per_unit,
    load_channel,
    sensor_channels,
    to_si,
)
from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_plugins.quantities import Measurand

# 12 bits over 2.048 V: one count is 1 mV.
LOAD = ChannelIdentity("load", Measurand.LOAD, sensitivity=0.0005, zero=0.1)
FAR = ChannelIdentity("far", Measurand.VELOCITY, offset=0.3, sensitivity=20.0)
CENTRE = ChannelIdentity("centre", Measurand.VELOCITY, sensitivity=-25.0)
LASER = ChannelIdentity("laser", Measurand.DISPLACEMENT, offset=0.6, sensitivity=1000.0, zero=1.0)
SPARE = ChannelIdentity("spare", Measurand.VOLTAGE)


def identity(*channels: ChannelIdentity) -> Identity:
    return Identity("S", "M", "1", 1000.0, 12, 2.048, channels)


ALL = identity(SPARE, FAR, LOAD, LASER, CENTRE)


def test_counts_become_si_values() -> None:
    counts = np.array([0, 100, 1100, -2048], np.int32)
    # (1 mV n - 100 mV) / 0.5 mV/N
    np.testing.assert_allclose(to_si(counts, LOAD, 0.001), [-200.0, 0.0, 2000.0, -4296.0])
    # 1 mV n / -25 V/(m/s): upside down
    np.testing.assert_allclose(to_si(counts, CENTRE, 0.001), [0.0, -0.004, -0.044, 0.08192])
    # (1 mV n - 1 V) / 1 V/mm
    np.testing.assert_allclose(to_si(counts, LASER, 0.001), [-1e-3, -0.9e-3, 0.1e-3, -3.048e-3])
    assert counts_per_unit(LOAD, ALL) == pytest.approx(0.5)
    assert counts_per_unit(CENTRE, ALL) == pytest.approx(-25_000)


def test_a_drop_has_its_sensors_by_offset_and_nan_where_samples_are_missing() -> None:
    counts = np.zeros((6, 5), np.int32)
    counts[:, 2] = [100, 100, 1100, 2100, 0, 100]
    counts[:, 4] = [0, 0, -25, -50, 0, 0]
    drop = calibrate(3, counts, [(4, 1)], 2, ALL)
    assert drop.number == 3
    np.testing.assert_allclose(drop.time, [-0.002, -0.001, 0.0, 0.001, 0.002, 0.003])
    np.testing.assert_allclose(drop.load, [0.0, 0.0, 2000.0, 4000.0, np.nan, 0.0])
    assert [(c.offset, c.quantity) for c in drop.channels] == [
        (0.0, "velocity"),
        (0.3, "velocity"),
        (0.6, "displacement"),
    ]
    left = dataclasses.replace(FAR, name="left", offset=-0.3)
    both = identity(left, FAR, LOAD, CENTRE)
    # The plate first, whatever side the others are on.
    assert [c.offset for c in calibrate(1, counts, [], 2, both).channels] == [0.0, 0.3, -0.3]
    np.testing.assert_allclose(drop.channels[0].values, [0, 0, 0.001, 0.002, np.nan, 0], atol=1e-12)
    assert np.isnan(drop.channels[2].values[4])


@pytest.mark.parametrize("channels", [(CENTRE,), (LOAD, LOAD, CENTRE)])
def test_one_load_cell_is_needed(channels: tuple[ChannelIdentity, ...]) -> None:
    with pytest.raises(SetupError, match="expected one with the role load"):
        load_channel(identity(*channels))


def test_a_sensor_of_motion_is_needed() -> None:
    with pytest.raises(SetupError, match="at least one with the role geophone or displacement"):
        sensor_channels(identity(LOAD, SPARE))


@pytest.mark.parametrize(
    ("dates", "said"),
    [
        ({}, ["calibration of load: no date is declared"]),
        ({"calibrated": datetime.date(2020, 1, 1)}, []),
        ({"due": datetime.date(2026, 5, 3)}, ["calibration of load EXPIRED on 2026-05-03"]),
        ({"due": datetime.date(2026, 5, 4)}, ["calibration of load expires on 2026-05-04"]),
        ({"due": datetime.date(2026, 6, 3)}, ["calibration of load expires on 2026-06-03"]),
        ({"due": datetime.date(2026, 6, 4)}, []),
    ],
)
def test_the_end_of_a_calibration_is_announced(
    dates: dict[str, datetime.date], said: list[str]
) -> None:
    channel = ChannelIdentity("load", Measurand.LOAD, **dates)  # type: ignore[arg-type]
    today = datetime.date(2026, 5, 4)
    assert calibration_warnings(identity(channel, SPARE), today) == said
