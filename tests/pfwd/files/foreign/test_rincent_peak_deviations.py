"""How far the peaks of traces are from those that a project's database stores."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from pfwd.files.foreign.rincent import compare_peaks
from pfwd.files.foreign.rincent_facts import StoredPeaks
from pfwd_device import Channel, Drop
from pfwd_device.signals import trace_peaks


def peak_deviations(drops: list[Drop], stored: list[StoredPeaks]) -> dict[str, float]:
    return compare_peaks(drops, stored, "a.prjz", "stored_traces")[1]


def peaks_of(drop: Drop, load: float = 1.0, deflection: float = 1.0) -> StoredPeaks:
    peaks = trace_peaks(drop)
    assert peaks.centre is not None
    return StoredPeaks(load * peaks.load, (deflection * peaks.centre,))


def moved(drop: Drop, factor: float) -> Drop:
    centre = replace(drop.channels[0], values=factor * drop.channels[0].values)
    return replace(drop, channels=(Channel(0.0, centre.quantity, centre.values),))


def test_each_drop_is_compared_with_its_own_peaks(make_drop: Callable[..., Drop]) -> None:
    one = moved(make_drop(), 1.0)
    other = replace(moved(make_drop(), 2.0), number=2)
    assert peak_deviations([one, other], [peaks_of(one), peaks_of(other)]) == {}
    low = peaks_of(other, deflection=4.0)
    assert peak_deviations([one, other], [peaks_of(one), low]) == {"2": pytest.approx(0.75)}
    heavy = peaks_of(one, load=0.5)
    assert peak_deviations([one, other], [heavy, peaks_of(other)]) == {"1": pytest.approx(1.0)}


def test_copies_have_the_deviation_of_the_first(make_drop: Callable[..., Drop]) -> None:
    one = moved(make_drop(), 1.0)
    copy = replace(one, number=2)
    stored = [peaks_of(one), peaks_of(one, deflection=4.0)]
    assert peak_deviations([one, copy], stored) == {}
    turned = peak_deviations([one, copy], stored[::-1])
    assert turned == {"1": pytest.approx(0.75), "2": pytest.approx(0.75)}


def test_peaks_of_other_drops_are_not_compared(make_drop: Callable[..., Drop]) -> None:
    assert peak_deviations([make_drop()], []) == {}
