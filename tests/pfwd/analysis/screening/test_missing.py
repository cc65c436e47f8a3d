"""What is left of a drop with missing samples, and that the inversion never sees a NaN."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.analysis.screening.drops import screen, unbroken_part
from pfwd.files.header import PointSetup
from pfwd_device import Drop


def without(drop: Drop, start_s: float, end_s: float) -> Drop:
    """The drop without the samples from `start_s` to before `end_s`."""
    gone = (drop.time > start_s - 1e-9) & (drop.time < end_s - 1e-9)
    load = drop.load.copy()
    load[gone] = np.nan
    channels = []
    for channel in drop.channels:
        values = channel.values.copy()
        values[gone] = np.nan
        channels.append(dataclasses.replace(channel, values=values))
    return Drop(drop.number, drop.time, load, tuple(channels))


@pytest.fixture
def drop(make_drop: Callable[..., Drop]) -> Drop:
    return make_drop(pre_trigger=0.02, window=0.1)


def test_a_whole_drop_stays_as_it_is(drop: Drop) -> None:
    assert unbroken_part(drop) == (drop, None, None)


@pytest.mark.parametrize(
    ("start", "end", "left"),
    [
        (-0.020, -0.010, (-0.010, 0.0999)),
        (-0.015, -0.003, (-0.003, 0.0999)),
        (0.0501, 0.06, (-0.020, 0.0500)),
        (0.099, 0.2, (-0.020, 0.0989)),
    ],
)
def test_gaps_outside_of_the_needed_part(
    drop: Drop, start: float, end: float, left: tuple[float, float]
) -> None:
    whole, reason, warning = unbroken_part(without(drop, start, end))
    assert reason is None
    assert warning is not None
    assert f"the first at {start * 1e3:.1f} ms" in text_of(warning)
    assert (whole.time[0], whole.time[-1]) == pytest.approx(left)
    for values in (whole.load, *(channel.values for channel in whole.channels)):
        assert np.isfinite(values).all()
    found = screen(without(drop, start, end), PointSetup(plate_radius=0.15))
    assert found.status == "measured"
    assert warning in found.warnings


@pytest.mark.parametrize(
    ("start", "end"),
    [(-0.0029, -0.0028), (0.0, 0.0001), (0.005, 0.006), (0.0498, 0.0499), (-1.0, 1.0)],
)
def test_gaps_in_the_needed_part(drop: Drop, start: float, end: float) -> None:
    damaged = without(drop, start, end)
    whole, reason, warning = unbroken_part(damaged)
    assert whole is damaged
    assert reason is not None
    assert text_of(reason).startswith("damaged record")
    assert warning is None
    assert screen(damaged, PointSetup(plate_radius=0.15)).status == "rejected"


def test_a_record_that_is_short_by_its_settings_is_not_damaged_for_that(
    make_drop: Callable[..., Drop],
) -> None:
    short = make_drop(pre_trigger=0.02, window=0.04)
    whole, reason, _ = unbroken_part(without(short, -0.02, -0.015))
    assert reason is None
    assert whole.time[-1] == short.time[-1]


@pytest.mark.parametrize("gap", [(-0.02, -0.01), (0.06, 0.07), (0.01, 0.02)])
def test_no_nan_reaches_the_inversion(
    drop: Drop, gap: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfwd.analysis import analyse
    from pfwd.analysis.options import AnalysisOptions
    from pfwd.files.traces import TracePoint

    seen: list[Any] = []

    def spy(records: list[Any], *_: object) -> list[None]:
        seen.extend(records)
        return [None] * len(records)

    monkeypatch.setattr(analyse, "invert_joint", spy)
    setup, damaged = PointSetup(plate_radius=0.15), without(drop, *gap)
    library: Any = None
    options = AnalysisOptions()
    analyse.analyse_drop(damaged, setup, screen(damaged, setup), options, library)
    analyse.analyse_point(TracePoint("x", setup, (damaged,), ()), options, library)
    assert len(seen) == (0 if gap == (0.01, 0.02) else 2)
    for record in seen:
        assert np.isfinite(record.load).all()
        assert all(np.isfinite(sensor.values).all() for sensor in record.sensors)
