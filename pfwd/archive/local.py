"""Worker processes on this computer.

The pool of `concurrent.futures` is not used: one killed process ends the whole pool, and it does
not report which task that process had.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING

from pfwd.archive.work import THREAD_VARIABLES, Batch, SourceOutcome, invert_batch, limit_threads
from pfwd.errors import SurveyError, refusal
from pfwd.spawning import ensure_tracker, spawn_context
from pfwd_device.child_python import ignore_interrupts

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection

if TYPE_CHECKING:
    from pfwd.analysis.options import AnalysisOptions

_MAX_CONSECUTIVE_DEATHS = 20
"""Processes that may die without a completed batch in between; more have a cause in the computer
and not in a source."""

_END_TIMEOUT_S = 5.0
"""Time for a terminated process to end before it is killed."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: Connection
    batch: Batch | None = None


class LocalWorkers:
    """Worker processes on this computer; one that dies is replaced and its batch repeated.

    Parameters
    ----------
    options : AnalysisOptions
    count : int, >= 1
        Number of processes. They are spawned on every platform: a forked copy of a process with
        several threads may hang.
    """

    def __init__(self, options: AnalysisOptions, count: int = 1) -> None:
        self._options = options
        self._count = count
        self._workers: list[_Worker] = []
        self._consecutive_deaths = 0

    @property
    def processes(self) -> list[int]:
        """Process ids of the running workers."""
        return [worker.process.pid for worker in self._workers if worker.process.pid is not None]

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Yield the outcomes of each batch when it is complete, in any order.

        Parameters
        ----------
        batches : iterator of Batch

        Raises
        ------
        SurveyError
            If 20 processes die without a completed batch in between.
        """
        waiting: deque[Batch] = deque()
        exhausted = False
        while True:
            # Prepare one batch for each worker while the workers are busy.
            while not exhausted and len(waiting) < self._count:
                batch = next(batches, None)
                if batch is None:
                    exhausted = True
                else:
                    waiting.append(batch)
                    self._hand_out(waiting)
            self._hand_out(waiting)
            busy = [worker for worker in self._workers if worker.batch is not None]
            if not busy:
                return
            for pipe in wait([worker.pipe for worker in busy]):
                worker = next(each for each in busy if each.pipe is pipe)
                yield from self._receive(worker, waiting)

    def close(self) -> None:
        """End the processes; outcomes that they have not returned are lost."""
        for worker in self._workers:
            worker.pipe.close()
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(_END_TIMEOUT_S)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join(_END_TIMEOUT_S)
        self._workers.clear()

    def _hand_out(self, waiting: deque[Batch]) -> None:
        while waiting:
            worker = next((each for each in self._workers if each.batch is None), None)
            if worker is None:
                if len(self._workers) >= self._count:
                    return
                worker = self._start()
            batch = waiting.popleft()
            worker.batch = batch
            try:
                worker.pipe.send(list(batch.sources))
            except OSError:  # it died while it was idle: no source is the cause
                self._discard(worker)
                waiting.appendleft(batch)

    def _receive(self, worker: _Worker, waiting: deque[Batch]) -> Iterator[list[SourceOutcome]]:
        assert worker.batch is not None
        batch = worker.batch
        try:
            outcomes: list[SourceOutcome] = worker.pipe.recv()
        except (EOFError, OSError):
            self._discard(worker)
            retries = batch.retries_after_death()
            waiting.extendleft(reversed(retries))
            if not retries:
                yield batch.worker_failures()
            return
        worker.batch = None
        self._consecutive_deaths = 0
        # The next batch is sent first, so that the worker continues while the outcomes are written.
        self._hand_out(waiting)
        yield outcomes

    def _start(self) -> _Worker:
        with interrupts_deferred():
            context = spawn_context()
            ours, theirs = context.Pipe()
            process = context.Process(
                target=_serve, args=(theirs, self._options), daemon=True, name="pfwd-invert"
            )
            # Set before the start: the process may load numpy before it runs code of this program.
            before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
            limit_threads()
            try:
                process.start()
            finally:
                for name, value in before.items():
                    if value is None:
                        del os.environ[name]
                    else:
                        os.environ[name] = value
            theirs.close()
            worker = _Worker(process, ours)
            self._workers.append(worker)
            return worker

    def _discard(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.pipe.close()
        worker.process.join(_END_TIMEOUT_S)
        code = worker.process.exitcode
        self._consecutive_deaths += 1
        if self._consecutive_deaths >= _MAX_CONSECUTIVE_DEATHS:
            actual = f"{self._consecutive_deaths} that ended, the last with status {code}"
            raise SurveyError(refusal("worker processes", "processes that stay alive", actual))


def _serve(pipe: Connection, options: AnalysisOptions) -> None:
    """Invert the batches received through the pipe until it is closed."""
    ignore_interrupts()
    with contextlib.suppress(EOFError, OSError):  # the parent process has ended
        while True:
            pipe.send(invert_batch(pipe.recv(), options))


@contextlib.contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Hold back SIGINT and SIGTERM within the block, and raise them at its end.

    A process that is being started reads its task from this process, so that an interrupt in
    between would end it with a traceback. On platforms with signal masks the new process inherits a
    blocked SIGINT: Ctrl-C reaches the worker too, but its parent decides when it ends.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # no interrupt is raised here
        return
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        with _interrupts_blocked():
            yield
    finally:
        for number, handler in before.items():
            # None: the handler was not installed by Python, which cannot restore it.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if received:
            signal.raise_signal(received[0])


if sys.platform == "win32":

    @contextlib.contextmanager
    def _interrupts_blocked() -> Iterator[None]:
        """Do nothing: Windows has no signal masks."""
        yield

else:

    @contextlib.contextmanager
    def _interrupts_blocked() -> Iterator[None]:
        ensure_tracker()  # the resource tracker of multiprocessing would lift the mask at its start
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
