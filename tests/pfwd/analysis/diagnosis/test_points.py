"""Points of several devices share the processes, and who counts them."""

import contextlib
import math
import operator
import time
from concurrent.futures import CancelledError
from threading import Event

import pytest

from inversion.diagnosis.model import PointRecords
from pfwd.analysis.diagnosis import shared_device
from pfwd.analysis.diagnosis.diagnose import diagnose_entries
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, with_unique_names
from pfwd.analysis.diagnosis.shared_device import DiagnosisFailure
from pfwd.analysis.diagnosis.workers import ProgressCounter, Workers

GROUPS = [[1.0, 4.0], [9.0], [], [16.0, 25.0, 36.0], [49.0], [64.0], [81.0]]


@pytest.mark.parametrize("count", [1, 2])
def test_groups_that_wait_for_the_processes_come_in_order(count: int) -> None:
    with Workers(count) as workers:

        def roots(values: list[float]) -> list[float]:
            # Each waits twice, as a device waits for its points with what they say together.
            once = list(workers.map(math.sqrt, values))
            return list(workers.map(operator.mul, once, [10.0] * len(once)))

        found = list(workers.at_once(roots, GROUPS))
    assert found == [[10.0 * math.sqrt(value) for value in values] for values in GROUPS]


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_of_a_group_is_told(count: int) -> None:
    with (
        pytest.raises(ValueError, match="math domain error"),
        Workers(count) as workers,
    ):
        list(workers.at_once(lambda value: list(workers.map(math.sqrt, [value])), [1.0, -1.0]))


def test_who_stops_does_not_wait_for_the_work_that_has_not_begun() -> None:
    ended: list[type[BaseException]] = []
    asked = Event()

    def naps(seconds: float) -> None:
        try:
            list(workers.map(time.sleep, [0.0]))
            asked.set()
            list(workers.map(time.sleep, [seconds] * 40))
        except BaseException as err:
            ended.append(type(err))
            raise

    with contextlib.suppress(KeyboardInterrupt), Workers(2) as workers:
        workers.at_once(naps, [0.5, 0.5])
        assert asked.wait(60.0)
        began = time.monotonic()
        raise KeyboardInterrupt
    # All naps together take twenty seconds.
    assert time.monotonic() - began < 10.0
    assert ended
    assert set(ended) == {CancelledError}


def test_one_count_is_shared() -> None:
    reports: list[tuple[str, str, int, int]] = []
    counter = ProgressCounter(lambda *report: reports.append(report), "each point", 2)
    assert list(counter.counted(["A", "B"], iter(["a", "b"]))) == ["a", "b"]
    counter.expect(1)
    assert list(counter.counted(["C"], ["c"])) == ["c"]
    assert reports == [
        ("each point", "A", 0, 2),
        ("each point", "B", 1, 2),
        ("each point", "", 2, 2),
        ("each point", "C", 2, 3),
        ("each point", "", 3, 3),
    ]


def test_a_point_is_reported_before_it_is_worked_on() -> None:
    steps: list[str] = []
    counter = ProgressCounter(lambda what, name, done, total: steps.append(name), "each point", 2)
    for result in counter.counted(["A", "B"], map(str.lower, ["A", "B"])):
        steps.append(result)
    assert steps == ["A", "a", "B", "b", ""]


def test_points_of_one_name_are_told_apart() -> None:
    """Drops of a point that were declared differently are two points of its name."""
    names = ["A", "A", "A (2)", "A", None]
    entries = [DiagnosisPoint("s", None, None, point=name) for name in names]
    named = with_unique_names([*entries, "refused"])
    assert named[-1] == "refused"
    assert [entry.name for entry in named[:-1] if isinstance(entry, DiagnosisPoint)] == [
        "s, point A",
        "s, point A (2)",
        "s, point A (2) (2)",
        "s, point A (3)",
        "s",
    ]


def test_each_of_two_points_of_one_name_has_its_own_outcome(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def diagnose(records: PointRecords, _known: object, *, predict_last: bool) -> DiagnosisFailure:
        return DiagnosisFailure(f"drop {records.numbers[0]} has no load")

    monkeypatch.setattr(shared_device, "_diagnose", diagnose)
    entries = [
        DiagnosisPoint("s", None, PointRecords("A", (), (number,)), point="A") for number in (1, 7)
    ]
    assert [diagnosed.error for diagnosed in diagnose_entries(entries)] == [
        "s: drop 1 has no load",
        "s: drop 7 has no load",
    ]
