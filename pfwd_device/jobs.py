"""Function calls in worker processes, with priorities, progress, and cancellation.

A worker is ``python -m pfwd_device.jobs``. So a script needs no guard against being imported again,
and no code comes from the current folder, which may be a survey of unknown origin. The worker
receives calls through its standard input and ends with it: it cannot outlive the program that
started it.
"""

import contextlib
import heapq
import itertools
import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from typing import IO, Any, TypeVar

from pfwd_device.child_python import ignore_interrupts, start_child
from pfwd_device.errors import DeviceError, refusal

_R = TypeVar("_R")

MAX_ATTEMPTS = 2
"""Number of attempts at a call whose worker died; the first one may have been killed for another
reason."""

CLOSING_TIME_S = 5.0
"""Longest wait for the end of killed processes, s."""

_LENGTH = struct.Struct("<Q")


class WorkerDied(DeviceError):
    """The worker process ended before the result, at each attempt."""


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """TaskProgress of a call; `report` sends it to the program that requested the call."""

    work: str
    """Kind of work, in words for the user."""
    item: str
    """Part that is in work; empty: this kind of work is complete."""
    count: int
    """Number of finished parts."""
    total: int
    """Number of all parts."""


_answers: IO[bytes] | None = None
"""Output of this worker for progress and results; None: this process is no worker."""


def report(progress: TaskProgress) -> None:
    """Report the progress of the call that this worker carries out."""
    if _answers is not None:
        _send(_answers, pickle.dumps(progress))


class Task(Future[_R]):
    """Requested call, as a future.

    Parameters
    ----------
    on_progress : callable, optional
        Receives each progress.
    """

    def __init__(self, on_progress: Callable[[TaskProgress], object] | None = None) -> None:
        super().__init__()
        self._on_progress = on_progress
        self.is_stopped = False
        """True: the call was withdrawn; it has no result, unless it was finished already."""
        self.process: subprocess.Popen[bytes] | None = None
        """Process that carries out the call; None: it has not started, or is finished."""
        self.start = time.monotonic()
        """Time of the request by the monotonic clock, s."""
        self.progress: TaskProgress | None = None
        """Last progress; None: none was reported."""
        self._work_start = self.start

    def take_progress(self, progress: TaskProgress) -> None:
        """Store a progress and pass it on."""
        if self.progress is None or self.progress.work != progress.work:
            self._work_start = time.monotonic()
        self.progress = progress
        if self._on_progress is not None:
            self._on_progress(progress)

    def remaining_s(self, now: float) -> float | None:
        """Estimate the time for the rest of this kind of work, s; None: no part is finished."""
        progress = self.progress
        if progress is None or progress.count < 1:
            return None
        pace = (now - self._work_start) / progress.count
        return max(0.0, pace * (progress.total - progress.count))


class Jobs:
    """Priority queue of function calls that worker processes carry out.

    Each process has a thread of this one and pipes of its own, so that a request never waits for a
    pipe, and a killed process disturbs no other. When a process dies, a new one repeats its call.
    The processes ignore Ctrl+C; they are killed when the ``with`` block is left.

    Parameters
    ----------
    count : int
        Number of processes; each starts with the first call for which no other is free. 0: this
        process carries out a call when it is submitted.
    attempts : int
        Number of attempts at a call whose process dies.
    timeout_s : float, optional
        Time after which the process of a call is killed, s.
    end_after_error : bool
        True: a process ends after an error of its call, as a library of it may then be unusable.
    """

    def __init__(
        self,
        count: int = 1,
        attempts: int = MAX_ATTEMPTS,
        *,
        timeout_s: float | None = None,
        end_after_error: bool = False,
    ) -> None:
        self.count = count
        self.processes: list[subprocess.Popen[bytes]] = []
        """Processes that were started and have not been found dead."""
        self._attempts = attempts
        self._timeout_s = timeout_s
        self._end_after_error = end_after_error
        self._changed = threading.Condition()
        self._waiting: list[tuple[int, int, Task[Any], tuple[Any, ...]]] = []
        self._numbers = itertools.count()
        self._threads: list[threading.Thread] = []
        self._n_idle = 0
        self._open: set[Task[Any]] = set()
        self._is_closed = False

    @property
    def n_open(self) -> int:
        """Number of calls that wait or run."""
        return len(self._open)

    @classmethod
    def for_calls(cls, count: int, n_calls: int) -> "Jobs":
        """Return `count` processes, at most one for each call; a single one would gain nothing."""
        number = min(count, n_calls)
        return cls(number if number > 1 else 0)

    def submit(
        self,
        function: Callable[..., _R],
        /,
        *args: Any,
        priority: int = 0,
        on_progress: Callable[[TaskProgress], object] | None = None,
        on_finish: Callable[[Task[Any]], object] | None = None,
    ) -> Task[_R]:
        """Request a call and return at once; the smallest priority is carried out first.

        The task raises the error of the function, `WorkerDied`, or `CancelledError` if the call was
        stopped.

        Parameters
        ----------
        function : callable
        *args
            Arguments; they are pickled when the call is carried out.
        priority : int
        on_progress, on_finish : callable, optional
            Receive each progress of the call and the finished task, in a thread of this object.
        """
        task: Task[_R] = Task(on_progress)
        self._open.add(task)
        task.add_done_callback(self._open.discard)
        if on_finish is not None:
            task.add_done_callback(on_finish)  # type: ignore[arg-type]
        if self.count == 0 and not self._is_closed:
            try:
                task.set_result(function(*args))
            except Exception as err:
                task.set_exception(err)
            return task
        with self._changed:
            if self._is_closed:
                task.cancel()
                return task
            call = (function, *args)
            heapq.heappush(self._waiting, (priority, next(self._numbers), task, call))
            if len(self._waiting) > self._n_idle and len(self._threads) < self.count:
                thread = threading.Thread(target=self._work_off, name="jobs", daemon=True)
                self._threads.append(thread)
                thread.start()
            self._changed.notify()
        return task

    def map(self, function: Callable[..., _R], *columns: Sequence[Any]) -> Iterator[_R]:
        """Yield the results of a function for rows of the columns, in order."""
        if self.count == 0:
            return map(function, *columns)
        tasks = deque(self.submit(function, *row) for row in zip(*columns, strict=True))

        def results() -> Iterator[_R]:
            while tasks:
                yield tasks.popleft().result()

        return results()

    def wait(self, timeout_s: float) -> None:
        """Wait until all calls are finished, at most for this time, s."""
        futures.wait([*self._open], timeout_s)

    def stop(self, task: Task[Any]) -> None:
        """Withdraw a call; one that runs is ended with its process."""
        task.is_stopped = True
        if task.cancel():
            return
        with self._changed:
            if task.process is not None:
                task.process.kill()

    def close(self) -> None:
        """End the processes; calls without a result are cancelled."""
        for task in [*self._open]:
            self.stop(task)
        with self._changed:
            self._is_closed = True
            for process in self.processes:
                process.kill()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(CLOSING_TIME_S)

    def __enter__(self) -> "Jobs":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _work_off(self) -> None:
        process = None
        while True:
            with self._changed:
                self._n_idle += 1
                self._changed.wait_for(lambda: self._waiting or self._is_closed)
                self._n_idle -= 1
                if self._is_closed:
                    break
                _, _, task, call = heapq.heappop(self._waiting)
            if task.set_running_or_notify_cancel():
                process = self._carry_out(task, call, process)
        if process is not None:
            self._end(process)

    def _carry_out(
        self, task: Task[Any], call: tuple[Any, ...], process: subprocess.Popen[bytes] | None
    ) -> subprocess.Popen[bytes] | None:
        """Set the result of a task; return the process for the next one."""
        try:
            message = pickle.dumps(call)
        except Exception as err:  # an object that cannot be sent
            task.set_exception(err)
            return process
        reason = ""
        for _ in range(self._attempts):
            try:
                if process is not None and process.poll() is not None:  # it died while idle
                    self._end(process)
                    process = None
                process = process or self._start()
                with self._changed:
                    task.process = process
                    if self._is_closed or task.is_stopped:
                        break
                with _killed_after(self._timeout_s, process):
                    is_result, value = _call(process, message, task)
            except (EOFError, OSError) as err:
                reason = str(err)
                if process is not None:
                    self._end(process)
                    reason = f"its end (status {process.returncode})"
                process = None
            else:
                with self._changed:
                    task.process = None
                if is_result:
                    task.set_result(value)
                else:
                    if self._end_after_error:
                        self._end(process)
                        process = None
                    task.set_exception(value)
                return process
        if self._is_closed or task.is_stopped:
            task.set_exception(CancelledError("the call was stopped"))
        else:
            hint = "it may need more memory than there is"
            actual = f"{reason} (attempts: {self._attempts})"
            text = refusal("worker process", "a result", actual, hint)
            task.set_exception(WorkerDied(text))
        return process

    def _start(self) -> subprocess.Popen[bytes]:
        process = start_child("-m", "pfwd_device.jobs")
        with self._changed:
            self.processes.append(process)
            if self._is_closed:
                process.kill()
        return process

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        with self._changed:
            self.processes.remove(process)
        process.kill()
        with contextlib.suppress(OSError), process:  # data that were not sent are not needed
            pass


@contextlib.contextmanager
def _killed_after(timeout_s: float | None, process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill a process if the block takes longer; a read from a pipe has no timeout everywhere."""
    watch = threading.Timer(timeout_s or 0.0, process.kill)
    watch.daemon = True
    if timeout_s is not None:
        watch.start()
    try:
        yield
    finally:
        watch.cancel()


def _call(process: subprocess.Popen[bytes], message: bytes, task: Task[Any]) -> tuple[bool, Any]:
    """Send a call, pass on its progress; return True and the result, or False and the error."""
    assert process.stdin is not None
    assert process.stdout is not None
    _send(process.stdin, message)
    while True:
        received = _receive(process.stdout)
        try:
            answer = pickle.loads(received)
        except Exception as err:  # an error that cannot be rebuilt from its arguments
            return False, err
        if not isinstance(answer, TaskProgress):
            is_result, value = answer
            return is_result, value
        task.take_progress(answer)


def _send(stream: IO[bytes], message: bytes) -> None:
    stream.write(_LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def _receive(stream: IO[bytes]) -> bytes:
    """Return the next message of a stream; raise EOFError if the stream ends before."""
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    return _exactly(stream, length)


def _exactly(stream: IO[bytes], length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise EOFError("the other side has ended")
    return data


def serve() -> None:
    """Carry out the calls from standard input until it is closed."""
    global _answers
    ignore_interrupts()
    # A read that waits for the next call holds standard input: Windows then blocks every query of
    # its state, such as numpy's while it is imported. So the calls have their own handle.
    source = os.fdopen(os.dup(sys.stdin.fileno()), "rb")
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), sys.stdin.fileno())
    _answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # Text that a library prints must not get between the results: it is sent to standard error.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def receive_calls() -> None:
        try:
            while True:
                calls.put(_receive(source))
        finally:
            os._exit(0)  # the parent has gone; the result is for nobody

    threading.Thread(target=receive_calls, daemon=True).start()
    try:
        while True:
            _send(_answers, _answer(calls.get()))
    finally:
        os._exit(1)


def _answer(message: bytes) -> bytes:
    try:
        function, *args = pickle.loads(message)
        return pickle.dumps((True, function(*args)))
    except Exception as err:
        err.add_note(traceback.format_exc())
        try:
            return pickle.dumps((False, err))
        except Exception:  # an error with an object that cannot be sent
            return pickle.dumps((False, RuntimeError(f"{type(err).__name__}: {err}")))


if __name__ == "__main__":
    # This module is loaded a second time: `report` of that one is what the functions call.
    from pfwd_device import jobs

    jobs.serve()
