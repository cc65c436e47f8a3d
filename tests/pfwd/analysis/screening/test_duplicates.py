"""Copies of a drop count once where drops are evaluated together."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from inversion import InversionError, Record, Settings, SurrogateLibrary
from inversion.notices import Notice
from pfwd.analysis import analyse
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.diagnosis.entries import entry_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.drops import duplicate_drops, screen_point
from pfwd.files.header import PointSetup
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Drop

SAME = Notice("samples-copied", {"drop": 1})
QUICK = AnalysisOptions(method="posterior", bedrock_depth="none")


@pytest.fixture
def point(make_drop: Callable[..., Drop]) -> TracePoint:
    """Four drops: one, its copy, another one, and a second copy."""
    first = make_drop(number=1)
    drops = (
        first,
        replace(first, number=2),
        make_drop(number=3, peak=7000.0),
        replace(first, number=4),
    )
    return TracePoint("f", PointSetup(plate_radius=0.15), drops)


def test_every_copy_of_a_measured_drop_is_detected(point: TracePoint) -> None:
    assert duplicate_drops(point.drops, screen_point(point)) == {1: SAME, 3: SAME}


def test_a_drop_that_is_not_measured_is_no_original(point: TracePoint) -> None:
    seating = replace(point, setup=replace(point.setup, seating_drops=1))
    copy = Notice("samples-copied", {"drop": 2})
    assert duplicate_drops(seating.drops, screen_point(seating)) == {3: copy}


def test_copies_count_once_in_a_joint_inversion(
    point: TracePoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups: list[int] = []

    def counted(records: list[Record], *_: Settings | SurrogateLibrary) -> None:
        groups.append(len(records))
        raise InversionError("enough")

    monkeypatch.setattr(analyse, "invert_joint", counted)
    analyse_point(point, replace(QUICK, joint=True), SurrogateLibrary())
    # The two that differ share a ground; each copy is inverted by itself.
    assert groups == [2, 1, 1]


def test_copies_count_once_in_a_diagnosis(point: TracePoint) -> None:
    entry = entry_of("f", point, QUICK)
    assert entry.records.numbers == (1, 3)
    assert entry.left_out == (2, 4)
    assert [notice.values for notice in entry.rejected] == [
        {"drop": number, "reason": SAME} for number in (2, 4)
    ]


def test_the_copies_of_an_original(shared: Path) -> None:
    (first, *_) = read_points(shared / "originals/mapview/minidyn-two-points.dynz")
    reasons = duplicate_drops(first.drops, screen_point(first))
    measured = [screening.status for screening in screen_point(first)].count("measured")
    assert len(reasons) == measured - 1
