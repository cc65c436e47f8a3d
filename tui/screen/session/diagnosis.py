"""Diagnoses requested by the operator, and the verdicts on the points.

The diagnosis runs in a process of its own, so that the screen never waits for it.
"""

import contextlib
import subprocess
import threading
from collections.abc import Callable

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, FittedState
from pfwd.analysis.worker.tasks import DiagnosisTask, TaskOutcome
from pfwd.analysis.worker.worker import end_process, request, start_process
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DiagnosisFinished
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.units import Units, percent


class Diagnoser:
    """One diagnosis at a time, each in a new process.

    Parameters
    ----------
    tell : callable
        Receives `DiagnosisFinished`, in a thread of its own.
    """

    def __init__(self, on_result: Callable[[DiagnosisFinished], None]) -> None:
        self._on_result = on_result
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
        self._on_result(DiagnosisFinished(file, outcome.diagnoses, error))

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
        Receives the result as an event.
    state : SessionState
    say : callable
        Shows one line to the operator.
    """

    def __init__(
        self,
        source: SessionSource,
        runner: SessionRunner,
        state: SessionState,
        show_message: Callable[[str], None],
    ) -> None:
        self._source, self._state, self._show_message = source, state, show_message
        self._diagnoser = Diagnoser(runner.put)
        self.verdicts: dict[str, str] = {}
        """Sentence of the diagnosis by point."""

    @property
    def file(self) -> str:
        """Path of the file that is being diagnosed; empty: none."""
        return self._diagnoser.file

    def start(self, file: str) -> None:
        """Diagnose a survey or a drop file; the result comes as an event."""
        if self._diagnoser.start(file):
            self._show_message("the diagnosis runs; measuring goes on")
        else:
            self._show_message("a diagnosis is under way; 4 and k stop it")

    def stop(self) -> None:
        """Stop the diagnosis that runs."""
        self._diagnoser.stop()

    def on_diagnosed(self, event: DiagnosisFinished, units: Units) -> None:
        """Show that the diagnosis has ended, and store the verdicts."""
        if event.error:
            self._show_message(event.error)
            return
        self._show_message("the diagnosis is done: 4 shows it")
        if event.file != str(self._source.survey):
            return
        for result in event.results:
            for point in self._state.points.values():
                if str(result.point) in (point.name, point.shown_name):
                    self.verdicts[point.name] = verdict_text(result, units)

    def on_point(self, name: str, result: DiagnosisResult, units: Units) -> None:
        """Store and show the diagnosis of a point that is being measured."""
        self.verdicts[name] = verdict_text(result, units)
        self._show_message(f"diagnosis: {self.verdicts[name]}")


def verdict_text(result: DiagnosisResult, units: Units) -> str:
    """Return the diagnosis of a point in one sentence, or why there is none."""
    if result.after is None and not result.effects:
        reason = next(iter(result.warnings or ()), "no reason was given")
        return f"not made: {reason}"
    before, after = result.before or FittedState(), result.after or FittedState()
    old, new = (units.text("modulus", state.modulus_pa) for state in (before, after))
    part = percent(after.residual_rms_over_peak)
    effects = ", ".join(str(effect.name).replace("_", " ") for effect in result.effects or ())
    if result.verdict == "unexplained" and result.corrected:
        unit = units.unit("modulus")
        return f"EXPLAINED to {part} of the peak by {effects}: {old} → {new} {unit}"
    match result.verdict:
        case "clean":
            return f"CLEAN: residual {part} of the peak, noise only"
        case "explained":
            unit = units.unit("modulus")
            return f"EXPLAINED by {effects}: {old} → {new} {unit}, residual {part}"
        case _:
            hint = f"; best guess {effects}" if effects else ""
            return f"UNEXPLAINED: residual {part} of the peak{hint}; repeat the drop"
