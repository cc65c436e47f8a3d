"""Points of several devices share the processes, and who counts them."""

import contextlib
import math
import operator
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from threading import Event

import numpy as np
import pytest

from inversion.diagnosis.flat_tops import flat_load_level
from inversion.diagnosis.model import PointRecords
from pfwd.analysis.diagnosis import shared_device
from pfwd.analysis.diagnosis.diagnose import diagnose_entries
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, entry_of, with_unique_names
from pfwd.analysis.diagnosis.shared_device import DiagnosisFailure, _with_device_largest
from pfwd.analysis.diagnosis.workers import ProgressCounter, Workers
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from tests.records import known

GROUPS = [[1.0, 4.0], [9.0], [], [16.0, 25.0, 36.0], [49.0], [64.0], [81.0]]


@pytest.mark.parametrize("count", [1, 2])
def test_groups_that_wait_for_the_processes_come_in_order(count: int) -> None:
    with Workers(count) as workers:

        def roots(values: list[float]) -> list[float]:
            # Each waits twice, as a device waits for its points with what they say together.
            once = list(workers.map(math.sqrt, values))
            return list(workers.map(operator.mul, once, [10.0] * len(once)))

        results = list(workers.at_once(roots, GROUPS))
    assert results == [[10.0 * math.sqrt(value) for value in values] for values in GROUPS]


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_of_a_group_is_raised(count: int) -> None:
    with pytest.raises(ValueError, match="math domain error"), Workers(count) as workers:
        list(workers.at_once(lambda value: list(workers.map(math.sqrt, [value])), [1.0, -1.0]))


def test_a_stop_does_not_wait_for_work_that_has_not_started() -> None:
    ended: list[type[BaseException]] = []
    started = Event()

    def naps(seconds: float) -> None:
        try:
            list(workers.map(time.sleep, [0.0]))
            started.set()
            list(workers.map(time.sleep, [seconds] * 40))
        except BaseException as err:
            ended.append(type(err))
            raise

    with contextlib.suppress(KeyboardInterrupt), Workers(2) as workers:
        workers.at_once(naps, [0.5, 0.5])
        assert started.wait(60.0)
        raise KeyboardInterrupt
    assert ended
    assert set(ended) == {CancelledError}


def test_a_shared_counter_reports_each_point_before_its_work() -> None:
    steps: list[object] = []
    counter = ProgressCounter(lambda *report: steps.append(report), "each point", 2)
    for result in counter.counted(["A", "B"], map(str.lower, ["A", "B"])):
        steps.append(result)
    counter.expect(1)
    assert list(counter.counted(["C"], ["c"])) == ["c"]
    assert steps == [
        ("each point", "A", 0, 2), "a", ("each point", "B", 1, 2), "b", ("each point", "", 2, 2),
        ("each point", "C", 2, 3), ("each point", "", 3, 3),
    ]  # fmt: skip


def test_points_of_the_same_name_get_unique_names() -> None:
    """Drops of a point that were declared differently are two points of its name."""
    names = ["A", "A", "A (2)", "A", None]
    entries = [DiagnosisPoint("s", None, None, point=name) for name in names]
    named = with_unique_names([*entries, "refused"])
    assert named[-1] == "refused"
    points = [entry.name for entry in named if isinstance(entry, DiagnosisPoint)]
    expected = [f"s, point {name}" for name in ("A", "A (2)", "A (2) (2)", "A (3)")]
    assert points == [*expected, "s"]


def test_points_of_the_same_name_have_separate_outcomes(monkeypatch: pytest.MonkeyPatch) -> None:
    def diagnose(
        records: PointRecords, _knowledge: object, *, predict_last: bool
    ) -> DiagnosisFailure:
        return DiagnosisFailure(f"drop {records.numbers[0]} has no load")

    monkeypatch.setattr(shared_device, "_diagnose", diagnose)
    entries = [
        DiagnosisPoint("s", None, PointRecords("A", (), (number,)), point="A") for number in (1, 7)
    ]
    assert [diagnosed.error for diagnosed in diagnose_entries(entries)] == [
        "s: drop 1 has no load",
        "s: drop 7 has no load",
    ]


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
