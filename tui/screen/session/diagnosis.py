"""Diagnoses requested by the operator, and the verdicts on the points.

The diagnosis runs in a process of its own, so that the screen never waits for it.
"""

import contextlib
import subprocess
import threading
from collections.abc import Callable

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.analysis.worker.tasks import DiagnosisTask, TaskOutcome
from pfwd.analysis.worker.worker import end_process, request, start_process
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DiagnosisDone
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.session.verdicts import verdict_text
from tui.screen.units import Units


class Diagnoser:
    """One diagnosis at a time, each in a new process.

    Parameters
    ----------
    tell : callable
        Receives `DiagnosisDone`, in a thread of its own.
    """

    def __init__(self, tell: Callable[[DiagnosisDone], None]) -> None:
        self._tell = tell
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self.file = ""
        """Path of the survey or drop file that is being diagnosed; empty: none."""

    def start(self, file: str) -> bool:
        """Diagnose a survey or a drop file; False while another diagnosis runs."""
        with self._lock:
            if self.file:
                return False
            self.file = file
        threading.Thread(target=self._run, args=(file,), name="diagnosis", daemon=True).start()
        return True

    def stop(self) -> None:
        """Stop the diagnosis that runs."""
        process = self._process
        if process is not None:
            with contextlib.suppress(OSError):
                process.kill()

    def _run(self, file: str) -> None:
        outcome = self._outcome(DiagnosisTask(0, file, AnalysisOptions()))
        self._process, self.file = None, ""
        error = ""
        if outcome.fault is not None and not outcome.diagnoses:
            error = f"the diagnosis of {file} failed: {outcome.fault}"
        self._tell(DiagnosisDone(file, outcome.diagnoses, error))

    def _outcome(self, task: DiagnosisTask) -> TaskOutcome:
        try:
            process = self._process = start_process()
        except OSError as err:
            return TaskOutcome(fault=str(err))
        outcome = None
        with contextlib.suppress(EOFError, OSError):
            outcome = request(process, task, lambda _building: None)
        end_process(process)
        return outcome or TaskOutcome(fault=f"status {process.returncode}")


class Diagnoses:
    """One diagnosis at a time; the verdicts of the last one of the survey.

    Parameters
    ----------
    source : SessionSource
    runner : SessionRunner
        Told what was found.
    state : SessionState
    say : callable
        Takes one line for the operator.
    """

    def __init__(
        self,
        source: SessionSource,
        runner: SessionRunner,
        state: SessionState,
        say: Callable[[str], None],
    ) -> None:
        self._source, self._state, self._say = source, state, say
        self._diagnoser = Diagnoser(runner.put)
        self.verdicts: dict[str, str] = {}
        """By point."""

    @property
    def file(self) -> str:
        """What is being diagnosed; empty: nothing."""
        return self._diagnoser.file

    def start(self, file: str) -> None:
        """Ask what is behind the residuals of a survey or a drop; the answer comes as an event."""
        if self._diagnoser.start(file):
            self._say("the diagnosis runs; measuring goes on")
        else:
            self._say("a diagnosis is under way; 4 and k stop it")

    def stop(self) -> None:
        """End it."""
        self._diagnoser.stop()

    def on_diagnosed(self, event: DiagnosisDone, units: Units) -> None:
        """Say that it is done, and keep the verdicts."""
        if event.error:
            self._say(event.error)
            return
        self._say("the diagnosis is done: 4 shows it")
        if event.file != str(self._source.survey):
            return
        for result in event.results:
            for point in self._state.points.values():
                if str(result.point) in (point.name, point.shown_name):
                    self.verdicts[point.name] = verdict_text(result, units)

    def on_point(self, name: str, result: DiagnosisResult, units: Units) -> None:
        """Keep what was found of a point while it is measured, and say it."""
        self.verdicts[name] = verdict_text(result, units)
        self._say(f"diagnosis: {self.verdicts[name]}")
