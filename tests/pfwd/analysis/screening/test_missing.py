"""Drops with missing samples: the part that is inverted never has a NaN."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pfwd.analysis import analyse
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.drops import screen, unbroken_part
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from tests.records import known


def without(drop: Drop, start_s: float, end_s: float) -> Drop:
    """The drop without the samples from `start_s` to before `end_s`."""
    missing = (drop.time > start_s - 1e-9) & (drop.time < end_s - 1e-9)
    load = drop.load.copy()
    load[missing] = np.nan
    channels = []
    for channel in drop.channels:
        values = channel.values.copy()
        values[missing] = np.nan
        channels.append(dataclasses.replace(channel, values=values))
    return Drop(drop.number, drop.time, load, tuple(channels))


@pytest.fixture
def drop(make_drop: Callable[..., Drop]) -> Drop:
    return make_drop(pre_trigger=0.02, window=0.1)


def test_a_complete_drop_is_unchanged(drop: Drop) -> None:
    assert unbroken_part(drop) == (drop, None, None)


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (-0.020, -0.010, (-0.010, 0.0999)),
        (-0.015, -0.003, (-0.003, 0.0999)),
        (0.0501, 0.06, (-0.020, 0.0500)),
        (0.099, 0.2, (-0.020, 0.0989)),
    ],
)
def test_gaps_outside_of_the_needed_part(
    drop: Drop, start: float, end: float, expected: tuple[float, float]
) -> None:
    part, reason, warning = unbroken_part(without(drop, start, end))
    assert reason is None
    assert known(warning).values["first_missing_s"] == pytest.approx(start)
    assert (part.time[0], part.time[-1]) == pytest.approx(expected)
    for values in (part.load, *(channel.values for channel in part.channels)):
        assert np.isfinite(values).all()
    screening = screen(without(drop, start, end), PointSetup(plate_radius=0.15))
    assert screening.status == "measured"
    assert warning in screening.warnings


@pytest.mark.parametrize(
    ("start", "end"),
    [(-0.0029, -0.0028), (0.0, 0.0001), (0.005, 0.006), (0.0498, 0.0499), (-1.0, 1.0)],
)
def test_gaps_in_the_needed_part(drop: Drop, start: float, end: float) -> None:
    damaged = without(drop, start, end)
    part, reason, warning = unbroken_part(damaged)
    assert part is damaged
    assert (known(reason).code, warning) == ("record-damaged", None)
    assert screen(damaged, PointSetup(plate_radius=0.15)).status == "rejected"


def test_a_record_that_is_short_by_its_settings_is_not_damaged_for_that(
    make_drop: Callable[..., Drop],
) -> None:
    short = make_drop(pre_trigger=0.02, window=0.04)
    part, reason, _ = unbroken_part(without(short, -0.02, -0.015))
    assert reason is None
    assert part.time[-1] == short.time[-1]


@pytest.mark.parametrize("gap", [(-0.02, -0.01), (0.06, 0.07), (0.01, 0.02)])
def test_no_nan_reaches_the_inversion(
    drop: Drop, gap: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    inverted: list[Any] = []

    def spy(records: list[Any], *_: object) -> list[None]:
        inverted.extend(records)
        return [None] * len(records)

    monkeypatch.setattr(analyse, "invert_joint", spy)
    setup, damaged = PointSetup(plate_radius=0.15), without(drop, *gap)
    library: Any = None
    options = AnalysisOptions()
    analyse.analyse_drop(damaged, setup, screen(damaged, setup), options, library)
    analyse.analyse_point(TracePoint("x", setup, (damaged,), ()), options, library)
    assert len(inverted) == (0 if gap == (0.01, 0.02) else 2)
    for record in inverted:
        assert np.isfinite(record.load).all()
        assert all(np.isfinite(sensor.values).all() for sensor in record.sensors)
