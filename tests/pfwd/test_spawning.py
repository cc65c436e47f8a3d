"""Worker processes end with the one that started them, which never waits for a killed one."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from threading import Thread

import pytest

from pfwd.spawning import WorkerPool

TOP = Path(__file__).resolve().parents[2]

SCRIPT = """
import os, signal
from pfwd.spawning import WorkerPool
if __name__ == "__main__":
    pool = WorkerPool(1)
    print(pool.submit(os.getpid).result(), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.posix  # signals
def test_a_worker_ends_with_a_process_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": str(TOP)},
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        # The output is at its end when the last process that may write to it has ended.
        out, _ = process.communicate(timeout=30)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == -signal.SIGKILL
    assert out.strip().isdigit()


def _die_while_sending(_large: bytes) -> None:
    """Send the beginning of a long result, and be killed."""
    frame = sys._getframe()
    while "pipe" not in frame.f_locals:
        assert frame.f_back is not None
        frame = frame.f_back
    os.write(frame.f_locals["pipe"].fileno(), (10_000_000).to_bytes(4, "big") + bytes(1000))
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.posix
def test_nothing_waits_for_a_worker_that_is_killed_while_it_sends() -> None:
    with WorkerPool(1) as pool:
        # The second request fills the pipe, which nobody reads any more.
        first, second = (pool.submit(_die_while_sending, bytes(10_000_000)) for _ in range(2))
        for future in (first, second):
            assert isinstance(future.exception(60), BrokenProcessPool)


def _interrupted(pool: WorkerPool) -> None:
    with pool:
        for _ in range(4):
            pool.submit(time.sleep, 600.0)
        assert pool.submit(os.getpid).cancel(), "a request that waits"
        while len(pool.processes) < 2:
            time.sleep(0.01)
        raise KeyboardInterrupt


def test_an_interrupt_ends_workers_that_are_busy() -> None:
    started = time.monotonic()
    pool = WorkerPool(2)
    with pytest.raises(KeyboardInterrupt):
        _interrupted(pool)
    assert time.monotonic() - started < 60
    assert not any(process.is_alive() for process in pool.processes)


def test_an_interrupt_of_the_wait_for_the_last_results_ends_the_workers_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pool = WorkerPool(1)
    running = pool.submit(time.sleep, 600.0)
    while not pool.processes:
        time.sleep(0.01)

    def interrupted(_thread: Thread, _timeout: float | None = None) -> None:
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(Thread, "join", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pool.shutdown()
    assert wait([running], 60).done


def _fail(kind: type[Exception]) -> None:
    raise kind("wrong")


def test_errors_of_a_call_are_those_of_its_result_and_the_worker_goes_on() -> None:
    with WorkerPool(1) as pool:
        with pytest.raises(ValueError, match="wrong") as error:
            pool.submit(_fail, ValueError).result()
        assert "in _fail" in error.value.__notes__[0]
        with pytest.raises(TypeError, match="argument"):
            pool.submit(_fail, ValueError, 3).result()
        with pytest.raises(AttributeError, match="local object"):
            pool.submit(lambda: 3).result()
        assert list(pool.map(pow, (2, 3), (3, 2))) == [8, 9]
        assert len(pool.processes) == 1


def test_a_worker_that_ended_is_replaced() -> None:
    with WorkerPool(1) as pool:
        with pytest.raises(BrokenProcessPool):
            pool.submit(os._exit, 1).result(60)
        assert pool.submit(os.getpid).result(60) == pool.processes[-1].pid


@pytest.mark.posix
def test_an_interrupt_while_a_worker_starts_does_not_end_it() -> None:
    with WorkerPool(1) as pool:
        request = pool.submit(os.getpid)
        while not pool.processes:
            time.sleep(0.001)
        pid = pool.processes[0].pid
        assert pid is not None
        os.kill(pid, signal.SIGINT)
        assert request.result(60) == pid
