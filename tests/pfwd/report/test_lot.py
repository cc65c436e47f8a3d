"""Statistics of a lot against the tables of their sources, and names that do not overlap."""

import math

import pytest
from matplotlib.transforms import Bbox

from pfwd.report.labels import common_beginning, place_labels
from pfwd.report.lot import line_through, lot_of
from tests.records import known


@pytest.mark.parametrize(
    ("n", "factor"), [(3, 3.37), (4, 2.63), (5, 2.33), (6, 2.18), (10, 1.92), (30, 1.73)]
)
def test_the_fractile_has_the_factors_of_en_1990(n: int, factor: float) -> None:
    """Table D1, 5 % characteristic value, V unknown."""
    lot = known(lot_of([float(i) + 50.0 for i in range(n)]))
    assert (lot.mean - lot.characteristic) / lot.deviation == pytest.approx(factor, abs=0.006)


def test_a_deflection_is_judged_from_above() -> None:
    low = known(lot_of([0.5, 0.6, 0.7]))
    high = known(lot_of([0.5, 0.6, 0.7], small_is_good=True))
    assert high.characteristic - high.mean == pytest.approx(low.mean - low.characteristic)


def test_limits_are_those_of_an_individuals_chart() -> None:
    lot = known(lot_of([50.0, 52.0, 49.0, 53.0]))
    assert lot.limits[1] - lot.mean == pytest.approx(3 * 3.0 / 1.128)  # mean of 2, 3, 4
    assert lot.mean_interval[0] < lot.mean < lot.mean_interval[1]
    assert lot.variation == pytest.approx(lot.deviation / 51.0)


def test_outliers_are_detected() -> None:
    lot = known(lot_of([50.0, 51.0, 49.0, 50.5, 50.2, 12.0, 49.6]))
    assert lot.outliers == (5,)
    assert 5 in lot.noticeable
    even = known(lot_of([50.0, 51.0, 49.0, 50.5, 50.2, 51.5, 49.6]))
    assert even.noticeable == ()


def test_a_lot_needs_three_points() -> None:
    assert lot_of([1.0, 2.0]) is None
    same = known(lot_of([5.0, 5.0, 5.0, 5.0, 5.0]))
    assert same.characteristic == 5.0
    assert same.outliers == ()


def test_a_line_through_pairs() -> None:
    line = known(line_through([1.0, 2.0, 3.0, 4.0], [3.0, 5.0, 7.0, 9.0]))
    assert (line.slope, line.intercept) == pytest.approx((2.0, 1.0))
    assert line.r_squared == pytest.approx(1.0)
    assert line_through([1.0, 2.0], [1.0, 2.0]) is None
    assert line_through([2.0, 2.0, 2.0], [1.0, 2.0, 3.0]) is None


@pytest.mark.parametrize("step", [3.0, 7.0, 12.0, 40.0])
def test_labels_do_not_overlap_labels_or_markers(step: float) -> None:
    """The points are 25 m apart on a line of some hundred metres."""
    markers = [(100.0 + step * i, 100.0 + 0.4 * step * i) for i in range(24)]
    sizes = [(42.0, 10.0)] * len(markers)
    placed = place_labels(markers, sizes, Bbox.from_extents(0, 0, 600, 400))
    boxes = []
    for label in placed:
        x, y = markers[label.number]
        x, y = x + label.dx, y + label.dy
        boxes.append(Bbox.from_extents(x - 21, y - 5, x + 21, y + 5))
    dots = [Bbox.from_extents(x - 4.5, y - 4.5, x + 4.5, y + 4.5) for x, y in markers]
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(later) for later in boxes[i + 1 :])
        assert not any(box.overlaps(dot) for dot in dots)
        assert box.x0 >= 0
        assert box.x1 <= 600
    assert len(placed) >= 6
    if step == 40.0:
        assert len(placed) >= 12  # as many as there is room for


def test_a_common_beginning_is_cut() -> None:
    assert common_beginning(["PV01 1", "PV01 2"]) == "PV01 "
    assert common_beginning(["A/1", "A/2"]) == "A/"
    assert common_beginning(["PV01 1"]) == ""
    assert common_beginning(["PV01 1", "B 2"]) == ""
    assert math.isfinite(len(common_beginning(["", "a b"])))
