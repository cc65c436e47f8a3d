"""Points of several devices share the processes, and who counts them."""

import contextlib
import math
import operator
import time
from concurrent.futures import CancelledError
from threading import Event

import pytest

from pfwd_survey.inverting.diagnosis.points import Told, Workers

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
    assert set(ended) <= {CancelledError, RuntimeError}


def test_one_count_is_shared() -> None:
    said: list[tuple[str, int, int]] = []
    told = Told(lambda *one: said.append(one), "each point", 2)
    assert told.counted(iter(["a", "b"])) == ["a", "b"]
    told.expect(1)
    told.counted(["c"])
    assert said == [("each point", 1, 2), ("each point", 2, 2), ("each point", 3, 3)]
