"""Calls in worker processes: order, errors, death, withdrawal, end."""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

import pytest

from pfwd_device import jobs as module
from pfwd_device.jobs import Jobs, Task, TaskProgress, WorkerDied, report

TOP = Path(__file__).resolve().parents[2]
PATIENCE = 60.0

SCRIPT = """
import os, signal, time
from pfwd_device.jobs import Jobs
jobs = Jobs(2)  # no guard: a script may begin at its first line
print(jobs.submit(os.getpid).result(), flush=True)
jobs.submit(time.sleep, 600)
jobs.submit(os.getpid).result()
os.kill(os.getpid(), signal.SIGKILL)
"""


def wait_until(holds: Callable[[], Any]) -> None:
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.005)


@pytest.mark.posix  # signals
def test_workers_end_with_a_process_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, script], env={**os.environ, "PYTHONPATH": str(TOP)}, stdout=subprocess.PIPE
    ) as process:
        pid = int(process.stdout.readline())
        process.wait(PATIENCE)
    assert process.returncode == -signal.SIGKILL
    wait_until(lambda: not is_running(pid))


def is_running(pid: int) -> bool:
    with contextlib.suppress(OSError):
        os.kill(pid, 0)
        stat = Path(f"/proc/{pid}/stat")  # a zombie has ended
        return not stat.exists() or stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


def _report_and_wait(stop: str) -> None:
    report(TaskProgress("each point", "A", 0, 4))
    report(TaskProgress("each point", "B", 1, 4))
    while not os.path.exists(stop):
        time.sleep(0.005)


def test_the_smallest_priority_is_first_and_a_withdrawn_call_never_runs(tmp_path: Path) -> None:
    order: list[int] = []

    def note(task: Task[int]) -> None:
        order.append(task.result())

    with Jobs() as jobs:
        running = jobs.submit(_report_and_wait, str(tmp_path / "stop"))
        wait_until(lambda: running.progress)
        late = jobs.submit(abs, 3, priority=3, on_finish=note)
        withdrawn = jobs.submit(os._exit, 2, priority=2)
        early = jobs.submit(abs, 1, priority=1, on_finish=note)
        jobs.stop(withdrawn)
        assert jobs.n_open == 3
        (tmp_path / "stop").touch()
        assert (late.result(PATIENCE), early.result(PATIENCE)) == (3, 1)
        assert order == [1, 3]
        assert withdrawn.cancelled()
        assert jobs.n_open == 0


def test_progress_arrives_with_the_remaining_time(tmp_path: Path) -> None:
    progress: queue.SimpleQueue[TaskProgress] = queue.SimpleQueue()
    with Jobs() as jobs:
        task = jobs.submit(_report_and_wait, str(tmp_path / "stop"), on_progress=progress.put)
        assert task.remaining_s(task.start) is None
        assert progress.get(timeout=PATIENCE) == TaskProgress("each point", "A", 0, 4)
        assert progress.get(timeout=PATIENCE) == TaskProgress("each point", "B", 1, 4)
        assert task.progress == TaskProgress("each point", "B", 1, 4)
        start = task._work_start
        assert task.remaining_s(start + 10.0) == pytest.approx(30.0)
        task.take_progress(TaskProgress("all points", "A", 0, 4))
        assert task.remaining_s(start + 10.0) is None, "a new kind of work has its own pace"
        jobs.stop(task)
        assert isinstance(task.exception(PATIENCE), CancelledError)
        assert task.is_stopped
        # Its process is replaced.
        assert jobs.submit(os.getpid).result(PATIENCE) == jobs.processes[-1].pid


def _fail(kind: type[Exception]) -> None:
    print("text of a library does not get between the results")
    raise kind("wrong")


class _Unpicklable(Exception):
    """Error that cannot be rebuilt from its message."""

    def __init__(self, first: str, two: str) -> None:
        super().__init__(first)


def _fail_unusually() -> None:
    raise _Unpicklable("a", "b")


def _fail_with_an_object() -> None:
    raise ValueError(threading.Lock())


def test_errors_of_a_call_are_raised_and_the_worker_continues() -> None:
    with Jobs() as jobs:
        with pytest.raises(ValueError, match="wrong") as error:
            jobs.submit(_fail, ValueError).result(PATIENCE)
        assert "in _fail" in error.value.__notes__[0]
        with pytest.raises(TypeError, match="argument"):
            jobs.submit(_fail, ValueError, 3).result(PATIENCE)
        with pytest.raises(AttributeError, match="local object"):
            jobs.submit(lambda: 3).result(PATIENCE)
        with pytest.raises(TypeError, match="two"):
            jobs.submit(_fail_unusually).result(PATIENCE)
        with pytest.raises(RuntimeError, match="ValueError: <unlocked"):
            jobs.submit(_fail_with_an_object).result(PATIENCE)
        assert list(jobs.map(pow, (2, 3), (3, 2))) == [8, 9]
        assert len(jobs.processes) == 1


def test_a_call_does_not_share_the_input_of_its_worker() -> None:
    """On Windows a call that only asked for its state, as an import of numpy does, never ended."""
    with Jobs() as jobs:
        assert jobs.submit(os.read, 0, 1).result(PATIENCE) == b""


def test_a_single_call_is_made_in_this_process() -> None:
    for count, n_calls in ((1, 5), (5, 1), (0, 0)):
        with Jobs.for_calls(count, n_calls) as jobs:
            assert list(jobs.map(lambda n: (n, os.getpid()), [3])) == [(3, os.getpid())]
    assert Jobs.for_calls(7, 2).count == 2


def _die_once(mark: str) -> int:
    try:
        os.mkdir(mark)
    except FileExistsError:
        return os.getpid()
    os._exit(9)


def test_a_call_whose_process_dies_is_repeated_by_another(tmp_path: Path) -> None:
    with Jobs() as jobs:
        first = jobs.submit(os.getpid).result(PATIENCE)
        assert jobs.submit(_die_once, str(tmp_path / "mark")).result(PATIENCE) != first
        with pytest.raises(WorkerDied, match=r"its end \(status 7\) \(attempts: 2\)") as error:
            jobs.submit(os._exit, 7).result(PATIENCE)
        assert "\n" not in str(error.value)
        assert jobs.submit(abs, -2).result(PATIENCE) == 2


def test_a_process_that_died_while_idle_costs_no_attempt() -> None:
    with Jobs(attempts=1) as jobs:
        jobs.submit(abs, 1).result(PATIENCE)
        jobs.processes[0].kill()
        jobs.processes[0].wait(PATIENCE)
        assert jobs.submit(abs, -2).result(PATIENCE) == 2


def test_a_process_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: str) -> Any:
        raise OSError(12, "no memory")

    with Jobs() as jobs:
        jobs.submit(abs, 1).result(PATIENCE)
        jobs.processes[0].kill()
        jobs.processes[0].wait(PATIENCE)
        monkeypatch.setattr(module, "start_child", refuse)
        with pytest.raises(WorkerDied, match="no memory"):
            jobs.submit(abs, 1).result(PATIENCE)
        monkeypatch.undo()
        assert jobs.submit(abs, -2).result(PATIENCE) == 2


def _die_while_sending(_large: bytes) -> None:
    """Send the beginning of a long result, and be killed."""
    os.write(module._answers.fileno(), module._LENGTH.pack(10_000_000) + bytes(1000))
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.posix
def test_a_worker_that_is_killed_while_it_sends_does_not_block() -> None:
    with Jobs(attempts=1) as jobs:
        # The second call fills the pipe of a new process.
        for task in [jobs.submit(_die_while_sending, bytes(10_000_000)) for _ in range(2)]:
            assert isinstance(task.exception(PATIENCE), WorkerDied)


def test_a_request_never_waits_for_a_busy_process() -> None:
    with Jobs() as jobs:
        running = jobs.submit(time.sleep, PATIENCE)
        wait_until(lambda: running.process)
        begin = time.monotonic()
        for _ in range(20):
            jobs.submit(len, bytes(1_000_000))
        assert time.monotonic() - begin < PATIENCE / 2


def _interrupted(jobs: Jobs, requested: list[Task[None]]) -> None:
    with jobs:
        requested += [jobs.submit(time.sleep, 600.0) for _ in range(4)]
        wait_until(lambda: len(jobs.processes) == 2)
        raise KeyboardInterrupt


def test_an_interrupt_ends_workers_that_are_busy() -> None:
    begin = time.monotonic()
    jobs, requested = Jobs(2), list[Task[None]]()
    with pytest.raises(KeyboardInterrupt):
        _interrupted(jobs, requested)
    assert time.monotonic() - begin < PATIENCE
    assert jobs.processes == []
    assert all(task.done() and task.is_stopped for task in requested)
    jobs.close()  # twice is once
    assert jobs.submit(abs, 1).cancelled()
