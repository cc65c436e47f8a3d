"""Worker processes on this machine.

A pool of our own in place of `concurrent.futures`, whose pool is broken as a whole when one of its
processes is killed, without saying which task that one had.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING

from pfwd.archive.interrupts import interrupts_wait
from pfwd.archive.work import ONE_THREAD, SourceOutcome, invert_batch, limit_threads
from pfwd.archive.workers import Batch
from pfwd.errors import SurveyError, refusal
from pfwd.spawning import spawn_context
from pfwd_device.child_python import ignore_interrupts

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection

if TYPE_CHECKING:
    from pfwd.analysis.options import AnalysisOptions

_MOST_DEATHS_IN_A_ROW = 20
"""Deaths without a batch done in between: then it is the machine, not a source."""

_PATIENCE = 5.0
"""s, for a process to end when it is told to."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    line: Connection
    batch: Batch | None = None


class LocalWorkers:
    """Processes that invert batches; a killed one is replaced and its batch done again.

    Parameters
    ----------
    options : AnalysisOptions
    count : int, >= 1
        Processes. Spawned on every platform alike: a forked copy of a threaded process may hang.
    """

    def __init__(self, options: AnalysisOptions, count: int = 1) -> None:
        self._options = options
        self._count = count
        self._workers: list[_Worker] = []
        self._deaths_in_a_row = 0

    @property
    def processes(self) -> list[int]:
        """Their process numbers."""
        return [worker.process.pid for worker in self._workers if worker.process.pid is not None]

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """See :class:`~pfwd.archive.workers.Workers`.

        Raises
        ------
        SurveyError
            If the processes die whatever they are given.
        """
        waiting: deque[Batch] = deque()
        more = True
        while True:
            # One batch a worker lies ready, found while the workers were busy.
            while more and len(waiting) < self._count:
                batch = next(batches, None)
                if batch is None:
                    more = False
                else:
                    waiting.append(batch)
                    self._hand_out(waiting)
            self._hand_out(waiting)
            busy = [worker for worker in self._workers if worker.batch is not None]
            if not busy:
                return
            for line in wait([worker.line for worker in busy]):
                worker = next(each for each in busy if each.line is line)
                yield from self._answer(worker, waiting)

    def close(self) -> None:
        """End the processes; what they have not handed back is lost."""
        for worker in self._workers:
            worker.line.close()
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(_PATIENCE)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join(_PATIENCE)
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
                worker.line.send(list(batch.sources))
            except OSError:  # it died while it had nothing to do: nobody's fault
                self._discard(worker)
                waiting.appendleft(batch)

    def _answer(self, worker: _Worker, waiting: deque[Batch]) -> Iterator[list[SourceOutcome]]:
        assert worker.batch is not None
        batch = worker.batch
        try:
            outcomes: list[SourceOutcome] = worker.line.recv()
        except (EOFError, OSError):
            self._discard(worker)
            again = batch.after_a_death()
            waiting.extendleft(reversed(again))
            if not again:
                yield batch.given_up()
            return
        worker.batch = None
        self._deaths_in_a_row = 0
        # Before the outcomes are handed back: it works on while they are written.
        self._hand_out(waiting)
        yield outcomes

    def _start(self) -> _Worker:
        with interrupts_wait():
            return self._start_now()

    def _start_now(self) -> _Worker:
        context = spawn_context()
        ours, theirs = context.Pipe()
        process = context.Process(
            target=_serve, args=(theirs, self._options), daemon=True, name="pfwd-invert"
        )
        # Set for the moment of starting: the process may load numpy before it runs our first line.
        before = {name: os.environ.get(name) for name in ONE_THREAD}
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
        worker.line.close()
        worker.process.join(_PATIENCE)
        code = worker.process.exitcode
        self._deaths_in_a_row += 1
        if self._deaths_in_a_row >= _MOST_DEATHS_IN_A_ROW:
            came = f"{self._deaths_in_a_row} that ended, the last with status {code}"
            raise SurveyError(refusal("worker processes", "processes that stay alive", came))


def _serve(line: Connection, options: AnalysisOptions) -> None:
    """Invert batches until nobody sends any more."""
    ignore_interrupts()
    with contextlib.suppress(EOFError, OSError):  # who started it has gone
        while True:
            line.send(invert_batch(line.recv(), options))
