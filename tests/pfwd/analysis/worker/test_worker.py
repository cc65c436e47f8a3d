"""The worker with its real process: order, death, errors, end."""

import os
import queue
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.screening.drops import Screening
from pfwd.analysis.worker.tasks import Urgency
from pfwd.analysis.worker.worker import InversionWorker, TaskResponse
from pfwd.files.header import PointSetup
from pfwd.judging import drop_from_traces
from pfwd.session.analyses import Analyses
from pfwd.session.events import DropAnalysed, Notice, SavedDrop
from pfwd_device import Drop
from tests.pfwd.scripted_feed import IDENTITY

PATIENCE = 60.0  # s; far more than anything here takes
SETUP = PointSetup(plate_radius=0.15, plate_mass=10.0, bedrock_depth=float("inf"))
OPTIONS = AnalysisOptions(seed=3)
QUICK = AnalysisOptions(method="posterior", seed=3)
FINE = Screening("measured")


@pytest.fixture
def drop(make_drop: Callable[..., Drop]) -> Drop:
    return make_drop(pre_trigger=0.02, window=0.1)


@pytest.fixture
def answers() -> "queue.SimpleQueue[Any]":
    return queue.SimpleQueue()


@pytest.fixture
def worker(answers: "queue.SimpleQueue[Any]") -> Iterator[InversionWorker]:
    one = InversionWorker(answers.put)
    yield one
    one.close()


def next_answer(answers: "queue.SimpleQueue[Any]") -> TaskResponse:
    while True:
        message = answers.get(timeout=PATIENCE)
        if isinstance(message, TaskResponse):
            return message


def pid_of(worker: InversionWorker) -> int:
    assert worker._process is not None
    return worker._process.pid


def wait_until(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.01)


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    if os.path.exists(f"/proc/{pid}/stat"):  # a zombie has ended
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    return True


def test_a_quick_answer_then_the_full_one(
    worker: InversionWorker, answers: "queue.SimpleQueue[Any]", drop: Drop
) -> None:
    worker.analyse(Urgency.FULL, drop, SETUP, FINE, OPTIONS, "f")
    wait_until(lambda: pid_of(worker) > 0)
    second = worker.analyse(Urgency.FULL, drop, SETUP, FINE, OPTIONS, "f")
    third = worker.analyse(Urgency.QUICK, drop, SETUP, FINE, QUICK, "q")
    found = [next_answer(answers) for _ in range(3)]
    # Whichever was begun first, the quick one went before the full one of an older drop.
    order = [one.task.number for one in found]
    assert order.index(third) < order.index(second)
    by_number = {one.task.number: one for one in found}
    quick, full = by_number[third].result, by_number[second].result
    assert quick is not None
    assert full is not None
    assert (quick.method, full.method) == ("posterior", "mpga")
    assert quick.modulus_pa == pytest.approx(full.modulus_pa, rel=1e-3)
    curves = by_number[third].curves
    assert curves is not None
    assert np.isfinite(curves.predicted).all()
    assert worker.wait(PATIENCE)


@pytest.mark.posix
def test_a_killed_process_is_replaced_and_the_answer_comes(
    worker: InversionWorker, answers: "queue.SimpleQueue[Any]", drop: Drop
) -> None:
    first = pid_of(worker)
    worker.analyse(Urgency.QUICK, drop, SETUP, FINE, QUICK, "q")
    os.kill(first, signal.SIGKILL)
    answer = next_answer(answers)
    assert answer.fault is None
    assert answer.result is not None
    assert pid_of(worker) != first
    assert not is_running(first)


def test_one_that_died_while_it_had_nothing_to_do_costs_no_attempt(
    worker: InversionWorker, answers: "queue.SimpleQueue[Any]", drop: Drop
) -> None:
    os.kill(pid_of(worker), signal.SIGTERM)
    assert worker._process is not None
    worker._process.wait(PATIENCE)
    worker.prepare(drop, SETUP, QUICK)
    assert next_answer(answers).fault is None


def test_after_two_deaths_a_task_is_given_up_and_the_next_is_answered(
    answers: "queue.SimpleQueue[Any]", drop: Drop, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfwd.analysis.worker import worker as module

    starts = []
    start = module.start_process

    def dying() -> Any:
        process = start()
        starts.append(process.pid)
        if len(starts) <= 2:
            process.kill()
            process.wait()
            process.poll = lambda: None  # type: ignore[method-assign]
        return process

    monkeypatch.setattr(module, "start_process", dying)
    worker = InversionWorker(answers.put)
    try:
        worker.analyse(Urgency.QUICK, drop, SETUP, FINE, QUICK, "q")
        answer = next_answer(answers)
        assert answer.result is None
        assert answer.fault is not None
        assert "died twice" in answer.fault
        assert len(starts) == 2
        worker.analyse(Urgency.QUICK, drop, SETUP, FINE, QUICK, "q")
        assert next_answer(answers).result is not None
    finally:
        worker.close()


def test_a_process_that_cannot_be_started_is_a_fault_and_no_hang(
    answers: "queue.SimpleQueue[Any]", drop: Drop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> Any:
        raise OSError(12, "no memory")

    monkeypatch.setattr("pfwd.analysis.worker.worker.start_process", refuse)
    worker = InversionWorker(answers.put)
    try:
        worker.analyse(Urgency.QUICK, drop, SETUP, FINE, QUICK, "q")
        answer = next_answer(answers)
        assert answer.fault is not None
        assert "no memory" in answer.details
    finally:
        worker.close()


def test_an_error_inside_an_analysis_is_an_answer(
    worker: InversionWorker, answers: "queue.SimpleQueue[Any]", drop: Drop
) -> None:
    broken: Any = "no screening"
    worker.analyse(Urgency.QUICK, drop, SETUP, broken, QUICK, "q")
    answer = next_answer(answers)
    assert answer.fault is not None
    assert answer.fault.startswith("the analysis failed: AttributeError")
    assert "Traceback" in answer.details
    worker.prepare(drop, SETUP, QUICK)
    assert next_answer(answers).fault is None


@pytest.mark.posix
def test_close_with_work_under_way_leaves_no_process(
    answers: "queue.SimpleQueue[Any]", drop: Drop
) -> None:
    worker = InversionWorker(answers.put)
    pid = pid_of(worker)
    for _ in range(20):
        worker.analyse(Urgency.FULL, drop, SETUP, FINE, OPTIONS, "f")
    next_answer(answers)
    worker.close()
    assert not is_running(pid)
    assert not worker._thread.is_alive()
    worker.close()  # twice is once


def test_asking_never_waits_for_the_process(
    answers: "queue.SimpleQueue[Any]", make_drop: Callable[..., Drop]
) -> None:
    """Eight channels at 50 kHz are 0.5 MB a drop: more than a pipe takes from a busy reader."""
    large = make_drop(rate=50_000, window=0.1, offsets=tuple(0.1 * i for i in range(8)))
    worker = InversionWorker(answers.put)
    try:
        begin = time.monotonic()
        for _ in range(20):
            worker.analyse(Urgency.FULL, large, SETUP, FINE, QUICK, "f")
        asked = time.monotonic() - begin
        next_answer(answers)
        # The first answer takes the start of a process; asking must not have waited for it.
        assert asked < 0.5 * (time.monotonic() - begin)
    finally:
        worker.close()


@pytest.mark.posix
def test_it_ends_when_its_parent_is_killed() -> None:
    script = """
        import time
        from pfwd.analysis.worker.worker import InversionWorker

        worker = InversionWorker(print)  # no guard: a script may begin at its first line
        print(worker._process.pid, flush=True)
        time.sleep(600)
    """
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    with parent:
        pid = int(parent.stdout.readline())
        assert is_running(pid)
        parent.kill()
        parent.wait(PATIENCE)
        wait_until(lambda: not is_running(pid))


def saved_drop(drop: Drop, **more: Any) -> SavedDrop:
    return SavedDrop("1", drop_from_traces(drop, SETUP), drop, "f", **more)


def test_what_is_not_answered_in_time_is_said_and_has_its_keys(drop: Drop) -> None:
    told: list[Any] = []
    analyses = Analyses(OPTIONS, told.append, lambda *_: None)
    try:
        analyses.prepare(IDENTITY, SETUP)
        analyses.request(saved_drop(drop))
        assert analyses.n_pending == 2
        analyses.wait_for_responses(0.0)
        assert analyses.n_pending == 0
    finally:
        analyses.close()
    (one,) = [event for event in told if isinstance(event, DropAnalysed)]
    assert one.final
    assert one.result.reason.startswith("the analysis did not end in time")
    assert one.result.modulus_pa is None
    assert [event.serious for event in told if isinstance(event, Notice)] == [True]


def test_a_computer_that_is_too_slow_holds_only_so_much(
    drop: Drop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.session.analyses.MAX_PENDING_FOR_FULL_SEARCH", 4)
    told: list[Any] = []
    analyses = Analyses(OPTIONS, told.append, lambda *_: None)
    try:
        for _ in range(4):
            analyses.request(saved_drop(drop))
        assert analyses.n_pending == 2 + 2 + 1 + 1
        analyses.wait_for_responses(PATIENCE)
    finally:
        analyses.close()
    answers = [event for event in told if isinstance(event, DropAnalysed)]
    assert [event.final for event in answers if not event.full].count(True) == 2
    assert [event.final for event in answers if event.full] == [True, True]
    assert [type(event) for event in told].count(Notice) == 1


def test_a_rejected_drop_is_not_analysed(drop: Drop) -> None:
    flat = Drop(1, drop.time, np.zeros_like(drop.load), drop.channels)
    analyses = Analyses(OPTIONS, lambda _: None, lambda *_: None)
    try:
        analyses.request(saved_drop(flat))
        assert analyses.n_pending == 0
    finally:
        analyses.close()
