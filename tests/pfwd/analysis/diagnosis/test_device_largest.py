"""Other points of a device refute that a channel was cut off below what they recorded."""

from collections.abc import Callable

import numpy as np
import pytest

from inversion.diagnosis.flat_tops import flat_load_level
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, entry_of
from pfwd.analysis.diagnosis.shared_device import _with_device_largest
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from tests.records import known

Make = Callable[..., Drop]


def entry(drop: Drop, device: str | None) -> DiagnosisPoint:
    setup = PointSetup(plate_radius=0.15, device=device)
    return entry_of("f", TracePoint("f", setup, (drop,)), AnalysisOptions())


def cut_off(drop: Drop) -> Drop:
    return Drop(drop.number, drop.time, np.minimum(drop.load, 7000.0), drop.channels)


def levels(entries: list[DiagnosisPoint]) -> list[float | None]:
    """Level of a flat top in the load of each point's drop."""
    points = [known(completed.records) for completed in _with_device_largest(entries)]
    return [flat_load_level(point.records[0], 0.0, point.largest_values) for point in points]


def test_points_of_a_device_share_their_largest_values(make_drop: Make) -> None:
    cut, intact = cut_off(make_drop()), make_drop()
    assert levels([entry(cut, "a"), entry(cut, "a")]) == [7000.0, 7000.0]
    assert levels([entry(cut, "a"), entry(intact, "a")]) == [None, None]
    assert levels([entry(cut, "a"), entry(intact, "b")]) == [7000.0, None]
    # Files without a device are surveys of their own.
    assert levels([entry(cut, None), entry(intact, None)]) == [7000.0, None]


def test_a_point_has_the_largest_value_of_its_peers(make_drop: Make) -> None:
    entries = [entry(make_drop(peak=peak), "a") for peak in (8000.0, 9000.0, 8500.0)]
    completed = [known(each.records) for each in _with_device_largest(entries)]
    assert [each.device_largest[None] for each in completed] == pytest.approx(
        [9000.0, 8500.0, 9000.0]
    )
