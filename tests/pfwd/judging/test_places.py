"""Positions in what was recorded, declared or edited."""

import math
from typing import Any

import pytest

from pfwd.judging.places import Place, place_in


def test_a_position_has_latitude_longitude_and_perhaps_an_altitude() -> None:
    position = {"latitude": 48.2, "longitude": 11, "source": "nmea"}
    assert place_in(position) == Place(48.2, 11.0)
    assert place_in({**position, "altitude_m": 512.5}) == Place(48.2, 11.0, 512.5)
    assert place_in({**position, "altitude_m": "512.5"}) == Place(48.2, 11.0)


@pytest.mark.parametrize(
    "position",
    [
        None,
        "48.2, 11.6",
        {"latitude": 48.2},
        {"latitude": 48.2, "longitude": None},
        {"latitude": "48.2", "longitude": "11.6"},
        {"latitude": 48.2, "longitude": True},
        {"latitude": 90.1, "longitude": 11.6},
        {"latitude": 48.2, "longitude": math.nan},
        {"latitude": 48.2, "longitude": 10**400},
    ],
)
def test_anything_else_is_no_position(position: Any) -> None:
    assert place_in(position) is None
