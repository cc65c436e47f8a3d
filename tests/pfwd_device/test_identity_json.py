"""The identity as a recording keeps it."""

import dataclasses
import datetime
import json
from typing import Any

import pytest

from pfwd_device.errors import SetupError
from pfwd_device.identity import identity_as_dict, identity_from_dict
from tests.pfwd.scripted_feed import GEOPHONE, IDENTITY, LOAD


def test_an_identity_survives_json() -> None:
    dates = {"due": datetime.date(2027, 1, 1)}
    dated = dataclasses.replace(LOAD, shunt=5000.0, adc_range=5.0, delay=5e-5, **dates)
    identity = dataclasses.replace(IDENTITY, channels=(dated, GEOPHONE), centre_sensor="ground")
    table: Any = json.loads(json.dumps(identity_as_dict(identity)))
    assert identity_from_dict(table) == identity
    broken: Any
    for broken in ({}, {**table, "channels": [1]}, {**table, "adc_bits": 99}, {**table, "x": 1}):
        with pytest.raises(SetupError):
            identity_from_dict(broken)
