"""Worker process that inverts drops, one after the other, during the acquisition.

It is started as ``python -m pfwd.analysis.worker.process``, so that a script that measures needs no
guard against being imported again. It reads pickled tasks from its standard input and writes the
outcomes to its standard output. It ends when the input is closed, and so cannot outlive the program
that started it.
"""

import dataclasses
import os
import pickle
import struct
import sys
import traceback
from collections.abc import Callable
from typing import IO, TYPE_CHECKING, Any

from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.worker.tasks import (
    Building,
    DiagnosisProgress,
    DiagnosisTask,
    Task,
    TaskOutcome,
    Urgency,
)
from pfwd.files.header import setup_warnings
from pfwd_device.child_python import ignore_interrupts

if TYPE_CHECKING:
    from inversion import SurrogateLibrary

_LENGTH = struct.Struct("<Q")


def send(stream: IO[bytes], message: object) -> None:
    """Write one message to a stream.

    Raises
    ------
    OSError
        If the reading process has ended.
    """
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    stream.write(_LENGTH.pack(len(data)) + data)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Return the next message of a stream.

    Raises
    ------
    EOFError
        If the stream ends before the end of a message.
    """
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    return pickle.loads(_exactly(stream, length))


def _exactly(stream: IO[bytes], length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise EOFError("the other side has ended")
    return data


def main() -> None:
    """Carry out the tasks from standard input until it is closed."""
    ignore_interrupts()
    source = sys.stdin.buffer
    # Text that a library prints must not get between the outcomes: it is sent to standard error.
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as target:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        try:
            _work(source, target)
        except (EOFError, OSError):
            return  # the parent process has gone


def _work(source: IO[bytes], target: IO[bytes]) -> None:
    from inversion import SurrogateLibrary

    def progress(table: str, fraction: float) -> None:
        send(target, Building(table, fraction))

    library = SurrogateLibrary(progress=progress)
    while True:
        outcome = outcome_of(receive(source), library, lambda message: send(target, message))
        send(target, outcome)


def outcome_of(
    task: Task | DiagnosisTask,
    library: "SurrogateLibrary",
    report: Callable[[DiagnosisProgress], object] = lambda _: None,
) -> TaskOutcome:
    """Return the outcome of a task; an error in the analysis becomes part of the outcome.

    Parameters
    ----------
    task : Task or DiagnosisTask
    library : SurrogateLibrary
    report : callable, optional
        Receives the progress of the diagnosis of a file.
    """
    from pfwd.analysis.analyse import analyse_drop, rehearse

    try:
        if isinstance(task, DiagnosisTask):
            return _diagnose(task, report)
        if task.urgency is Urgency.PREPARE:
            rehearse(task.drop, task.setup, task.options, library)
            return TaskOutcome()
        analysis = analyse_drop(
            task.drop, task.setup, task.screening, task.options, library, task.preceding
        )
        result = drop_result(task.file, analysis, setup_warnings(task.setup, [task.drop]))
        # The caller keeps the results of all drops in memory, hence without the fitted traces.
        return TaskOutcome(dataclasses.replace(result, history=None), result.history)
    except Exception as err:  # every unexpected error is reported to the user
        fault = f"the analysis failed: {type(err).__name__}: {err}"
        return TaskOutcome(fault=fault, details=traceback.format_exc())


def _diagnose(task: DiagnosisTask, report: Callable[[DiagnosisProgress], object]) -> TaskOutcome:
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries, diagnose_files
    from pfwd.analysis.diagnosis.entries import entry_of
    from pfwd.analysis.result_store import store_diagnoses

    def progress(kind: str, point: str, count: int, total: int) -> None:
        report(DiagnosisProgress(kind, point, count, total))

    not_stored = None
    if isinstance(task.source, str):
        points = list(
            diagnose_files([task.source], task.options, use_stored=True, progress=progress)
        )
        if os.path.isdir(task.source):
            new = [(p.number, p.result) for p in points if p.number is not None and p.result]
            not_stored = store_diagnoses(task.source, new)
    else:
        device = {name: dict(values) for name, values in task.device.items()}
        entry = entry_of(task.source.file, task.source, task.options)
        points = list(diagnose_entries([entry], device or None))
    return TaskOutcome(
        fault=next((point.error for point in points if point.error is not None), None),
        details=not_stored or "",
        diagnoses=tuple(point.result for point in points if point.result is not None),
    )


if __name__ == "__main__":
    main()
