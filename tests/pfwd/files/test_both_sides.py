"""Sensors on both sides of the plate are separate sensors."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.analysis.drop_facts import point_drop, unbroken_peaks
from pfwd.analysis.screening.drops import screen
from pfwd.files.reading import read_points
from pfwd_device import Drop
from pfwd_device.signals import channels_outward
from tests.pfwd.files.trace_lines import HEADER
from tests.records import known

Write = Callable[..., Path]


@pytest.fixture
def trace_file(write: Write, make_drop: Callable[..., Drop]) -> Path:
    """A trace file whose first column is on the other side, and no two columns alike."""
    drop = make_drop(offsets=(0.3, 0.0, 0.6), quantity="velocity")
    behind = 1.1 * drop.channels[0].values
    columns = [behind, *(channel.values for channel in drop.channels)]
    names = ",".join(f"velocity_m_s@{place}" for place in ("-0.3000", "0.3", "-0.0", "0.6"))
    rows = [
        ",".join(repr(float(number)) for number in row)
        for row in np.column_stack([drop.time, drop.load, *columns])
    ]
    return write([*HEADER, f"time_s,load_N,{names}", *rows])


def test_a_negative_distance_is_a_separate_sensor(trace_file: Path) -> None:
    (point,) = read_points(trace_file)
    (drop,) = point.drops
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.3, 0.0, 0.6]
    # -0 is the centre: no sign is left on it.
    assert not np.signbit(drop.channels[2].offset)
    np.testing.assert_allclose(drop.channels[0].values, 1.1 * drop.channels[1].values)
    assert [channel.offset for channel in channels_outward(drop)] == [0.0, 0.3, -0.3, 0.6]


def test_a_sensor_behind_the_plate_is_not_the_centre(trace_file: Path) -> None:
    (point,) = read_points(trace_file)
    (drop,) = point.drops
    screening = screen(drop, point.setup)
    assert screening.status == "measured"
    peaks = known(unbroken_peaks(drop))
    assert peaks.centre == pytest.approx(5e-4, rel=0.01)
    facts = point_drop(drop, point.setup, screening)
    assert facts.peak_deflection == pytest.approx(5e-4, rel=0.01)
    without = Drop(1, drop.time, drop.load, drop.channels[:2])
    assert text_of(screen(without, point.setup).reason) == (
        "no centre channel: none of the sensors stands at offset 0"
    )
