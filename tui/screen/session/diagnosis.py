"""Diagnoses requested by the operator, and the verdicts on the points.

The diagnosis runs in a process of its own, so that the screen never waits for it.
"""

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, FittedState
from pfwd.analysis.worker.tasks import Building, DiagnosisProgress, DiagnosisTask, TaskOutcome
from pfwd.analysis.worker.worker import end_process, request, start_process
from tui.diagnosis_lines import USES, unexplained_text
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DiagnosisFinished
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.units import Units


@dataclass(frozen=True, slots=True)
class RunningDiagnosis:
    """Progress of a diagnosis under way, by the monotonic clock, s."""

    start: float
    """Start of the diagnosis."""
    step: DiagnosisProgress | None = None
    """Last report; None: the files are being read."""
    kind_start: float = 0.0
    """Start of the kind of work of the last report."""

    def at(self, step: DiagnosisProgress, now: float) -> "RunningDiagnosis":
        """Return the progress with this report as the last one, received at `now`."""
        is_same = self.step is not None and self.step.kind == step.kind
        return RunningDiagnosis(self.start, step, self.kind_start if is_same else now)

    def remaining(self, now: float) -> float | None:
        """Estimate the time for the rest of this kind of work, s; None: no point is complete."""
        step = self.step
        if step is None or step.count < 1:
            return None
        return max(0.0, (now - self.kind_start) / step.count * (step.total - step.count))


class Diagnoser:
    """Runs one diagnosis at a time, each in a new process.

    Parameters
    ----------
    on_result : callable
        Receives `DiagnosisFinished`, in a thread of its own.
    """

    def __init__(self, on_result: Callable[[DiagnosisFinished], None]) -> None:
        self._on_result = on_result
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._is_stopped = False
        self.file = ""
        """Path of the survey or drop file that is being diagnosed; empty: none."""
        self.progress: RunningDiagnosis | None = None
        """Progress of the diagnosis that runs; None: there is none."""

    def start(self, file: str) -> bool:
        """Diagnose a survey or a drop file; False while another diagnosis runs."""
        with self._lock:
            if self.file:
                return False
            self.file = file
            self.progress = RunningDiagnosis(time.monotonic())
            self._is_stopped = False
        threading.Thread(target=self._run, args=(file,), name="diagnosis", daemon=True).start()
        return True

    def stop(self) -> None:
        """Stop the diagnosis that runs."""
        process = self._process
        if process is not None:
            self._is_stopped = True
            with contextlib.suppress(OSError):
                process.kill()

    def _run(self, file: str) -> None:
        outcome = self._outcome(DiagnosisTask(0, file, AnalysisOptions()))
        self._process, self.file, self.progress = None, "", None
        error = ""
        if self._is_stopped:
            error = f"the diagnosis of {Path(file).name} was stopped"
        elif outcome.fault is not None and not outcome.diagnoses:
            error = f"the diagnosis of {file} failed: {outcome.fault}"
        self._on_result(DiagnosisFinished(file, outcome.diagnoses, error))

    def _outcome(self, task: DiagnosisTask) -> TaskOutcome:
        try:
            process = self._process = start_process()
        except OSError as err:
            return TaskOutcome(fault=str(err))
        outcome = None
        with contextlib.suppress(EOFError, OSError):
            outcome = request(process, task, self._on_progress)
        end_process(process)
        return outcome or TaskOutcome(fault=f"status {process.returncode}")

    def _on_progress(self, message: Building | DiagnosisProgress) -> None:
        running = self.progress
        if running is not None and isinstance(message, DiagnosisProgress):
            self.progress = running.at(message, time.monotonic())


class Diagnoses:
    """Diagnoses that the operator starts, and the sentence on each diagnosed point.

    Parameters
    ----------
    source : SessionSource
    runner : SessionRunner
        Receives the result as an event.
    state : SessionState
    show_message : callable
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

    @property
    def progress(self) -> RunningDiagnosis | None:
        """Progress of the diagnosis that runs; None: there is none."""
        return self._diagnoser.progress

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
    """Return the diagnosis of a point in one sentence, or why there is none.

    The sentence has the verdict, the effects, the modulus before and after with its use, and the
    part that is unexplained as ``pfwd diagnose`` prints it.
    """
    if result.after is None and not result.effects:
        reason = next(iter(result.warnings or ()), "no reason was given")
        return f"not made: {reason}"
    before, after = result.before or FittedState(), result.after or FittedState()
    old = units.value_and_ends("modulus", before.modulus_pa, before.modulus_interval_pa)[0]
    new = units.with_interval("modulus", after.modulus_pa, after.modulus_interval_pa)
    change = f"{old} → {new}, {USES[result.use]}"
    unexplained = f"{unexplained_text(result)} of the peak unexplained, allowance included"
    effects = ", ".join(str(effect.name).replace("_", " ") for effect in result.effects or ())
    if result.verdict == "clean":
        return f"CLEAN: {unexplained}"
    if result.verdict == "explained":
        return f"EXPLAINED by {effects}: {change}; {unexplained}"
    if result.use == "with-care":
        return f"PARTLY EXPLAINED by {effects}: {change}; {unexplained}"
    hint = f"; best guess {effects}" if effects else ""
    return f"UNEXPLAINED: {unexplained}{hint}; {result.remedy or 'repeat the drop'}"


def diagnosis_text(file: str, running: RunningDiagnosis | None, now: float) -> str:
    """Return file, point, kind of work and times of a diagnosis under way in one sentence."""
    text = f"diagnosing {Path(file).name}"
    if running is None:
        return text
    step = running.step
    if step is None:
        text += ", reading the drops"
    else:
        name = os.path.basename(step.point.rpartition(", point ")[2])
        point = f"point {name}, " if name else ""
        text += f": {point}{step.count} of {step.total} points done, {step.kind}"
    text += f"; {_duration(now - running.start)} so far"
    remaining = running.remaining(now)
    return text if remaining is None else f"{text}, about {_duration(remaining)} to go"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
