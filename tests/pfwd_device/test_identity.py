"""Limits of the values of an identity."""

import dataclasses
import datetime
import json
import math
from dataclasses import replace
from typing import Any

import pytest

from pfwd_device.errors import DeviceError, SetupError
from pfwd_device.identity import ChannelIdentity, Identity, identity_as_dict, identity_from_dict
from pfwd_plugins.quantities import Measurand
from tests.pfwd.scripted_feed import IDENTITY

LOAD = ChannelIdentity("load", Measurand.LOAD)


def identity(**changes: Any) -> Identity:
    about: dict[str, Any] = {
        "serial_number": "A-17",
        "model": "m",
        "firmware": "1",
        "sampling_rate": 10_000.0,
        "adc_bits": 24,
        "adc_range": 2.5,
        "channels": (LOAD,),
    }
    return Identity(**{**about, **changes})


def test_the_title_lacks_what_is_not_declared() -> None:
    assert identity().title == "m A-17, firmware 1"
    assert identity(model="", firmware="").title == "A-17"


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"serial_number": "x" * 33}, "serial_number up to 32 letters, got 33"),
        ({"model": "x" * 40}, "identity of 'A-17': expected model up to 32 letters, got 40"),
        ({"sampling_rate": 0.0}, "sampling_rate > 0 and <= 50000 Hz, got 0.0"),
        ({"sampling_rate": 50_000.1}, "sampling_rate .* got 50000.1"),
        ({"adc_bits": 7}, "adc_bits from 8 to 24, got 7"),
        ({"adc_bits": 25}, "adc_bits from 8 to 24, got 25"),
        ({"adc_range": 0.0}, "adc_range > 0 V, got 0.0"),
        ({"adc_range": math.inf}, "adc_range > 0 V, got inf"),
        ({"channels": ()}, "1 to 8 channels, got 0"),
        ({"channels": (LOAD,) * 9}, "1 to 8 channels, got 9"),
        ({"channels": (replace(LOAD, delay=1.1e-4),)}, "a delay within one scan, got 0.00011"),
        ({"plate_radius": 0.0}, "plate_radius > 0 m, got 0.0"),
        ({"plate_mass": -1.0}, "plate_mass >= 0 kg, got -1.0"),
        ({"plate_mass": math.inf}, "plate_mass >= 0 kg, got inf"),
        ({"centre_sensor": "air"}, 'centre_sensor "plate" or "ground", got air'),
    ],
)
def test_an_impossible_instrument_is_refused(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(SetupError, match=match) as caught:
        identity(**changes)
    assert isinstance(caught.value, DeviceError)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"name": "x" * 33}, "a name up to 32 letters, got 33"),
        ({"offset": math.nan}, "channel 'c': expected a finite offset, m, got nan"),
        ({"sensitivity": 0.0}, "finite sensitivity other than 0, got 0.0"),
        ({"zero": math.inf}, "a finite zero, V, got inf"),
        ({"natural_frequency": 0.0, "damping": 0.5}, "natural_frequency > 0, got 0.0"),
        ({"natural_frequency": 4.5, "damping": math.nan}, "damping > 0, got nan"),
        ({"natural_frequency": 4.5}, "natural_frequency and damping together, got one of them"),
        ({"damping": 0.5}, "natural_frequency and damping together"),
        ({"shunt": -5.0}, "shunt > 0, got -5.0"),
    ],
)
def test_an_impossible_channel_is_refused(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(SetupError, match=match):
        ChannelIdentity(**{"name": "c", "quantity": Measurand.VELOCITY, **changes})


def test_the_extremes_are_allowed() -> None:
    identity(
        serial_number="",
        model="x" * 32,
        sampling_rate=50_000,
        adc_bits=8,
        channels=(ChannelIdentity("é" * 32, Measurand.VELOCITY, sensitivity=-1e-300),) * 8,
        plate_mass=0.0,
    )


def test_volts_per_count() -> None:
    for bits, volts, expected in ((24, 2.5, 2.5 / 8_388_608), (8, 1.28, 0.01)):
        converter = identity(adc_bits=bits, adc_range=volts)
        assert converter.volts_per_count(converter.channels[0]) == expected


def test_an_identity_survives_json() -> None:
    dates = {"due": datetime.date(2027, 1, 1)}
    dated = dataclasses.replace(
        IDENTITY.channels[0], shunt=5000.0, adc_range=5.0, delay=5e-5, **dates
    )
    identity = dataclasses.replace(
        IDENTITY, channels=(dated, IDENTITY.channels[1]), centre_sensor="ground"
    )
    table: Any = json.loads(json.dumps(identity_as_dict(identity)))
    assert identity_from_dict(table) == identity
    broken: Any
    for broken in ({}, {**table, "channels": [1]}, {**table, "adc_bits": 99}, {**table, "x": 1}):
        with pytest.raises(SetupError):
            identity_from_dict(broken)
