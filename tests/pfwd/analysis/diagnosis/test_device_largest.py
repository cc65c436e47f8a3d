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

Make = Callable[..., Drop]


def entry(drop: Drop, device: str | None) -> DiagnosisPoint:
    setup = PointSetup(plate_radius=0.15, device=device)
    return entry_of("f", TracePoint("f", setup, (drop,)), AnalysisOptions())


def cut_off(drop: Drop) -> Drop:
    return Drop(drop.number, drop.time, np.minimum(drop.load, 7000.0), drop.channels)


def levels(entries: list[DiagnosisPoint]) -> list[float | None]:
    """Level of a flat top in the load of each point's drop."""
    found = []
    for completed in _with_device_largest(entries):
        assert completed.records is not None
        (record,) = completed.records.records
        found.append(flat_load_level(record, 0.0, completed.records.largest_values))
    return found


def test_the_device_is_what_the_points_share(make_drop: Make) -> None:
    cut, whole = cut_off(make_drop()), make_drop()
    assert levels([entry(cut, "a"), entry(cut, "a")]) == [7000.0, 7000.0]
    assert levels([entry(cut, "a"), entry(whole, "a")]) == [None, None]
    assert levels([entry(cut, "a"), entry(whole, "b")]) == [7000.0, None]
    # Files without a device are surveys of their own.
    assert levels([entry(cut, None), entry(whole, None)]) == [7000.0, None]


def test_a_point_has_the_largest_of_the_others_and_not_its_own(make_drop: Make) -> None:
    peaks = (8000.0, 9000.0, 8500.0)
    entries = [entry(make_drop(peak=peak), "a") for peak in peaks]
    others = [
        completed.records.device_largest[None]
        for completed in _with_device_largest(entries)
        if completed.records is not None
    ]
    assert others == pytest.approx([9000.0, 8500.0, 9000.0])
