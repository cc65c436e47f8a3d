"""Counts to SI by numbers worked out by hand, and what is said of dates."""

import dataclasses
import datetime

import numpy as np
import pytest

from pfwd_device.calibration import (
    at_scan,
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
OUTER = ChannelIdentity("far", Measurand.VELOCITY, offset=0.3, sensitivity=20.0)
CENTRE = ChannelIdentity("centre", Measurand.VELOCITY, sensitivity=-25.0)
LASER = ChannelIdentity("laser", Measurand.DISPLACEMENT, offset=0.6, sensitivity=1000.0, zero=1.0)
SPARE = ChannelIdentity("spare", Measurand.VOLTAGE)


def identity(*channels: ChannelIdentity) -> Identity:
    return Identity("S", "M", "1", 1000.0, 12, 2.048, channels)


ALL = identity(SPARE, OUTER, LOAD, LASER, CENTRE)


def test_counts_become_si_values() -> None:
    counts = np.array([0, 100, 1100, -2048], np.int32)
    # (1 mV n - 100 mV) / 0.5 mV/N
    np.testing.assert_allclose(to_si(counts, LOAD, ALL), [-200.0, 0.0, 2000.0, -4296.0])
    # 1 mV n / -25 V/(m/s): upside down
    np.testing.assert_allclose(to_si(counts, CENTRE, ALL), [0.0, -0.004, -0.044, 0.08192])
    # (1 mV n - 1 V) / 1 V/mm
    np.testing.assert_allclose(to_si(counts, LASER, ALL), [-1e-3, -0.9e-3, 0.1e-3, -3.048e-3])
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
    sensors = [(channel.offset, channel.quantity) for channel in drop.channels]
    assert sensors == [(0.0, "velocity"), (0.3, "velocity"), (0.6, "displacement")]
    opposite = dataclasses.replace(OUTER, name="left", offset=-0.3)
    both = identity(opposite, OUTER, LOAD, CENTRE)
    # The plate first, whatever side the others are on.
    assert [c.offset for c in calibrate(1, counts, [], 2, both).channels] == [0.0, 0.3, -0.3]
    np.testing.assert_allclose(drop.channels[0].values, [0, 0, 0.001, 0.002, np.nan, 0], atol=1e-12)
    assert np.isnan(drop.channels[2].values[4])


@pytest.mark.parametrize("channels", [(CENTRE,), (LOAD, LOAD, CENTRE)])
def test_a_single_load_cell_is_required(channels: tuple[ChannelIdentity, ...]) -> None:
    with pytest.raises(SetupError, match="expected one with the role load"):
        load_channel(identity(*channels))


def test_a_sensor_of_motion_is_needed() -> None:
    with pytest.raises(SetupError, match="at least one with the role geophone or displacement"):
        sensor_channels(identity(LOAD, SPARE))


@pytest.mark.parametrize(
    ("dates", "warnings"),
    [
        ({}, ["calibration of load: no date is declared"]),
        ({"calibrated": datetime.date(2020, 1, 1)}, []),
        ({"due": datetime.date(2026, 5, 3)}, ["calibration of load EXPIRED on 2026-05-03"]),
        ({"due": datetime.date(2026, 5, 4)}, ["calibration of load expires on 2026-05-04"]),
        ({"due": datetime.date(2026, 6, 3)}, ["calibration of load expires on 2026-06-03"]),
        ({"due": datetime.date(2026, 6, 4)}, []),
    ],
)
def test_an_old_calibration_is_named(dates: dict[str, datetime.date], warnings: list[str]) -> None:
    channel = ChannelIdentity("load", Measurand.LOAD, **dates)  # type: ignore[arg-type]
    today = datetime.date(2026, 5, 4)
    assert calibration_warnings(identity(channel, SPARE), today) == warnings


@pytest.mark.parametrize(("frequency", "largest"), [(50, 1e-10), (500, 1e-5), (1000, 5e-4)])
def test_channels_sampled_later_are_shifted_to_the_scan(frequency: float, largest: float) -> None:
    step = np.arange(400)
    late = np.sin(2 * np.pi * frequency * (step + 0.5) / 10_000)
    expected = np.sin(2 * np.pi * frequency * step / 10_000)
    np.testing.assert_allclose(at_scan(late, 0.5)[5:-5], expected[5:-5], atol=largest)
    late[200] = np.nan
    missing = np.flatnonzero(np.isnan(at_scan(late, 0.5)))
    assert missing.tolist() == list(range(198, 204))


def test_a_declared_delay_moves_the_values_of_a_drop() -> None:
    late = dataclasses.replace(CENTRE, delay=5e-4)
    counts = np.round(1000 * np.sin(np.arange(300) / 20.0)).astype(np.int32)
    both = np.stack([counts, counts], axis=1)
    drop = calibrate(1, both, (), 0, identity(LOAD, late))
    plain = calibrate(1, both, (), 0, identity(LOAD, CENTRE))
    np.testing.assert_array_equal(drop.load, plain.load)
    np.testing.assert_allclose(drop.channels[0].values, at_scan(plain.channels[0].values, 0.5))


def test_each_channel_may_have_a_separate_range() -> None:
    wide = dataclasses.replace(CENTRE, adc_range=20.48)
    counts = np.array([0, 25], np.int32)
    np.testing.assert_allclose(to_si(counts, wide, ALL), [0.0, -0.01])
