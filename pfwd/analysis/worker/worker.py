"""Inversion of drops in a process of its own, so that the acquisition never waits for it.

Tasks are done in the order of their requests, except that the quick inversion of a new drop
precedes the full search of an older one. The process has one task at a time. A thread sends the
tasks, so that a request never waits for a pipe. When the process dies, a new one repeats its task.
"""

import contextlib
import itertools
import subprocess
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter

from inversion.result import TimeHistories
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.analysis.screening.drops import Screening
from pfwd.analysis.worker.tasks import (
    Building,
    DiagnosisProgress,
    DiagnosisTask,
    Task,
    TaskOutcome,
    Urgency,
)
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd_device import Drop
from pfwd_device.child_python import start_child

MAX_ATTEMPTS = 2
"""Number of attempts at a task whose process died, after which it counts as failed."""

CLOSING_TIME = 5.0
"""Longest time, s, for which the end of the program waits for an analysis that is no longer
needed."""


@dataclass(frozen=True, eq=False, slots=True)
class TaskResponse:
    """Outcome of a task, together with the task."""

    task: Task | DiagnosisTask
    result: DropResult | None = None
    """As in `TaskOutcome`, like the following fields."""
    curves: TimeHistories | None = None
    fault: str | None = None
    details: str = ""
    diagnoses: tuple[DiagnosisResult, ...] = ()


Listener = Callable[[TaskResponse | Building], None]


class InversionWorker:
    """Queue of inversions and diagnoses, which a separate process carries out.

    Parameters
    ----------
    listener : callable
        Receives every response, in a thread of this object.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()
        self._waiting: dict[int, Task | DiagnosisTask] = {}
        self._under_way: int | None = None
        self._closing = False
        self._process: subprocess.Popen[bytes] | None = None
        with contextlib.suppress(OSError):  # the next task tries again and reports the error
            self._process = start_process()
        self._thread = threading.Thread(target=self._work_off, name="worker", daemon=True)
        self._thread.start()

    def prepare(self, drop: Drop, setup: PointSetup, options: AnalysisOptions) -> int:
        """Request that tables for drops of this setup are loaded; return the number of the task.

        The samples of the drop are not used.
        """
        return self.analyse(Urgency.PREPARE, drop, setup, Screening("measured"), options, "")

    def analyse(
        self,
        urgency: Urgency,
        drop: Drop,
        setup: PointSetup,
        screening: Screening,
        options: AnalysisOptions,
        file: str,
        preceding: DropResult | None = None,
    ) -> int:
        """Request the inversion of a drop; return the number of the task."""
        number = next(self._numbers)
        return self._put(Task(number, urgency, drop, setup, screening, options, file, preceding))

    def diagnose(
        self,
        point: TracePoint,
        options: AnalysisOptions,
        device: Mapping[str, Mapping[str, float]],
    ) -> int:
        """Request the diagnosis of a point; return the number of the task.

        Parameters
        ----------
        point : TracePoint
        options : AnalysisOptions
        device : mapping
            Parameters of device effects estimated at other points, by effect and parameter.
        """
        return self._put(DiagnosisTask(next(self._numbers), point, options, device))

    def forget(self, number: int) -> bool:
        """Withdraw a task; False: it is in work, or complete."""
        with self._changed:
            if number == self._under_way or number not in self._waiting:
                return False
            del self._waiting[number]
            self._changed.notify_all()
            return True

    def _put(self, task: Task | DiagnosisTask) -> int:
        with self._changed:
            self._waiting[task.number] = task
            self._changed.notify_all()
        return task.number

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until all tasks are complete; False: they are not after ``timeout`` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting, timeout)

    def close(self) -> None:
        """End the process; tasks that are not complete are dropped."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(0.2)
        with self._changed:  # no other process is started from now on
            process = self._process
        if process is not None:
            if self._thread.is_alive():
                process.terminate()
            end_process(process)
        self._thread.join(CLOSING_TIME)

    def _work_off(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if self._closing:
                    return
                task = min(self._waiting.values(), key=attrgetter("urgency", "number"))
                self._under_way = task.number
            response = self._respond_to(task)
            if response is None:
                return
            self._listener(response)
            with self._changed:
                del self._waiting[task.number]
                self._under_way = None
                self._changed.notify_all()

    def _respond_to(self, task: Task | DiagnosisTask) -> TaskResponse | None:
        """Carry out a task and return the response; None: the worker was closed."""
        reason = ""
        for _ in range(MAX_ATTEMPTS):
            try:
                process = self._process_or_start()
                if process is None:
                    return None
                outcome = request(process, task, self._report)
            except (EOFError, OSError) as err:
                reason = f"{err}; exit code {self._reap()}"
                if self._closing:
                    return None
            else:
                return TaskResponse(
                    task,
                    outcome.result,
                    outcome.curves,
                    outcome.fault,
                    outcome.details,
                    outcome.diagnoses,
                )
        fault = "the analysis process died twice; the drop is safe, invert it again later"
        return TaskResponse(task, fault=fault, details=reason)

    def _report(self, message: Building | DiagnosisProgress) -> None:
        """Pass on the progress of building tables; that of a diagnosis is of use for files only."""
        if isinstance(message, Building):
            self._listener(message)

    def _process_or_start(self) -> "subprocess.Popen[bytes] | None":
        """Return the process, a new one if it has died; None: the worker was closed."""
        if self._process is not None and self._process.poll() is not None:
            self._reap()
        with self._changed:
            if self._closing:
                return None
            if self._process is None:
                self._process = start_process()
            return self._process

    def _reap(self) -> int | None:
        with self._changed:
            process, self._process = self._process, None
        if process is None:
            return None
        end_process(process)
        return process.returncode


def request(
    process: "subprocess.Popen[bytes]",
    task: Task | DiagnosisTask,
    report: Callable[[Building | DiagnosisProgress], object],
) -> TaskOutcome:
    """Send a task to a process, report its progress and return the outcome.

    Raises
    ------
    EOFError, OSError
        If the process ends before the outcome.
    """
    from pfwd.analysis.worker.process import receive, send

    assert process.stdin is not None
    assert process.stdout is not None
    send(process.stdin, task)
    while isinstance(message := receive(process.stdout), Building | DiagnosisProgress):
        report(message)
    outcome: TaskOutcome = message
    return outcome


def start_process() -> "subprocess.Popen[bytes]":
    """Start a process that carries out tasks until its input is closed.

    Raises
    ------
    OSError
        If the system cannot start a process.
    """
    return start_child("-m", "pfwd.analysis.worker.process")


def end_process(process: "subprocess.Popen[bytes]") -> None:
    """Close the input of a process and wait for its end.

    A busy process is terminated, then killed.
    """
    with contextlib.suppress(OSError):  # buffered data are no longer needed
        if process.stdin is not None:
            process.stdin.close()
    for step in (None, process.terminate, process.kill):
        if step is not None:
            step()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.3 if step is None else CLOSING_TIME)
            break
    if process.stdout is not None:
        process.stdout.close()
