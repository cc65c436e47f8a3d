"""Inverts drops beside the acquisition, in a process of its own that never makes it wait.

What is asked first is answered first, except that a quick answer to a new drop goes before the full
search of an older one. When the process dies, a new one takes over what had not been answered.
"""

import contextlib
import itertools
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

from pfwd_device import Drop
from pfwd_survey.header import Setup
from pfwd_survey.options import AnalysisOptions
from pfwd_survey.screening import Screening

if TYPE_CHECKING:
    # Only the process of its own loads the inversion.
    from pfwd_survey.analysis import DropAnalysis

MOST_ATTEMPTS = 2
"""A task that has ended its process this often is given up."""

CLOSING_TIME = 5.0
"""s; how long an analysis that nobody waits for any more may hold up the end."""


class Urgency(IntEnum):
    """What goes before what."""

    PREPARE = 0
    """Have the response table ready before the first drop."""
    QUICK = 1
    """The first modulus of a new drop."""
    FULL = 2
    """The full search of a drop."""


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """One analysis."""

    number: int
    """Of the task; comes back with the answer."""
    urgency: Urgency
    drop: Drop
    setup: Setup
    screening: Screening
    options: AnalysisOptions


@dataclass(frozen=True, eq=False, slots=True)
class Answer:
    """What came of a task."""

    task: Task
    analysis: "DropAnalysis | None" = None
    """None when it failed, and for a task that only prepares."""
    fault: str | None = None
    """Why it failed, in one sentence."""
    details: str = ""
    """More on the failure, for the log."""


@dataclass(frozen=True, slots=True)
class Building:
    """A response table is being built."""

    what: str
    fraction: float


Listener = Callable[[Answer | Building], None]


class Analyst:
    """Takes drops, gives moduli.

    Parameters
    ----------
    listener : callable
        Told every answer, in a thread of the analyst's own.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._waiting: dict[int, Task] = {}
        self._attempts: dict[int, int] = {}
        self._closing = False
        self._idle = threading.Event()
        self._idle.set()
        self._process, self._pipe = _start()
        self._thread = threading.Thread(target=self._listen, name="analyst", daemon=True)
        self._thread.start()

    def prepare(self, drop: Drop, setup: Setup, options: AnalysisOptions) -> int:
        """Have ready what drops like this one need; its samples do not matter."""
        return self._ask(Urgency.PREPARE, drop, setup, Screening("measured"), options)

    def analyse(
        self,
        urgency: Urgency,
        drop: Drop,
        setup: Setup,
        screening: Screening,
        options: AnalysisOptions,
    ) -> int:
        """Ask for an analysis; the number comes back in the answer's task."""
        return self._ask(urgency, drop, setup, screening, options)

    def _ask(
        self,
        urgency: Urgency,
        drop: Drop,
        setup: Setup,
        screening: Screening,
        options: AnalysisOptions,
    ) -> int:
        task = Task(next(self._numbers), urgency, drop, setup, screening, options)
        with self._lock:
            self._waiting[task.number] = task
            self._idle.clear()
            self._send(task)
        return task.number

    def _send(self, task: Task) -> None:
        # When the process has ended, the listener starts another and sends all again.
        with contextlib.suppress(OSError):
            self._pipe.send(task)

    def wait(self, timeout: float | None = None) -> bool:
        """Whether everything was answered within so many seconds."""
        return self._idle.wait(timeout)

    def close(self) -> None:
        """End the process; what was not answered stays unanswered."""
        with self._lock:
            self._closing = True
            with contextlib.suppress(OSError):  # it may have ended by itself
                self._pipe.send(None)
        self._process.join(0.2)
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(CLOSING_TIME)
        self._thread.join(CLOSING_TIME)
        self._pipe.close()
        self._process.close()

    def _listen(self) -> None:
        while True:
            try:
                message = self._pipe.recv()
            except (EOFError, OSError):
                if not self._restart():
                    return
                continue
            if isinstance(message, Answer):
                self._settle(message)
            else:
                self._listener(message)

    def _settle(self, answer: Answer) -> None:
        with self._lock:
            self._waiting.pop(answer.task.number, None)
            self._attempts.pop(answer.task.number, None)
        self._listener(answer)
        with self._lock:
            if not self._waiting:
                self._idle.set()

    def _restart(self) -> bool:
        """Another process for the one that died; False when it was meant to end."""
        given_up = []
        with self._lock:
            if self._closing:
                return False
            self._pipe.close()
            self._process.join()
            code = self._process.exitcode
            self._process.close()
            self._process, self._pipe = _start()
            # The first in the order of urgency is what it was working on.
            for task in sorted(self._waiting.values(), key=_order)[:1]:
                attempts = self._attempts[task.number] = self._attempts.get(task.number, 0) + 1
                if attempts >= MOST_ATTEMPTS:
                    given_up.append(task)
            for task in self._waiting.values():
                if task not in given_up:
                    self._send(task)
        for task in given_up:
            fault = "the analysis ended by itself twice; the drop is safe, invert it again later"
            self._settle(Answer(task, fault=fault, details=f"exit code {code}"))
        return True


def _order(task: Task) -> tuple[int, int]:
    return task.urgency, task.number


def _start() -> tuple[BaseProcess, "Connection[Any, Any]"]:
    # Spawned on every platform alike: a forked copy of a threaded process may hang.
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,), name="pfwd analyst", daemon=True)
    process.start()
    # Only the process holds its end now: each side sees when the other has gone.
    theirs.close()
    return process, ours


def _work(pipe: "Connection[Any, Any]") -> None:
    """The process: answers until it is told to end or its parent has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to end
    from inversion import SurrogateLibrary

    def progress(what: str, fraction: float) -> None:
        pipe.send(Building(what, fraction))

    library = SurrogateLibrary(progress=progress)
    tasks: deque[Task] = deque()
    try:
        while True:
            while not tasks or pipe.poll():
                task = pipe.recv()
                if task is None:
                    return
                tasks.append(task)
            task = min(tasks, key=_order)
            tasks.remove(task)
            pipe.send(_answer(task, library))
    except (EOFError, OSError):
        return  # the parent has gone


def _answer(task: Task, library: Any) -> Answer:
    from pfwd_survey.analysis import analyse_drop, load_surrogate

    try:
        if task.urgency is Urgency.PREPARE:
            load_surrogate(task.drop, task.setup, task.options, library)
            return Answer(task)
        args = (task.drop, task.setup, task.screening, task.options, library)
        return Answer(task, analyse_drop(*args))
    except Exception as err:  # the user has to hear of whatever nobody foresaw
        fault = f"the analysis failed: {type(err).__name__}: {err}"
        return Answer(task, fault=fault, details=traceback.format_exc())
