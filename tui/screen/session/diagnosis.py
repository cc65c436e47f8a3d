"""Diagnoses requested by the operator, and the verdicts on the points.

The diagnosis runs in a process of its own, so that the screen never waits for it.
"""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pfwd.analysis import tasks
from pfwd.analysis.response_tables import BUILDING
from pfwd.analysis.results import DiagnosisResult
from pfwd.jobs import Jobs, Task
from pfwd.session.session import Session
from pfwd.units import Units
from tui.diagnosis_lines import diagnosis_sentence
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DiagnosisFinished
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState


class RequestedDiagnoses:
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
        self._runner = runner
        self._jobs = Jobs()
        self.task: Task[Any] | None = None
        """Diagnosis that runs; None: there is none."""
        self.file = ""
        """Path of the file that is being diagnosed, or was the last one."""
        self.verdicts: dict[str, str] = {}
        """Sentence of the diagnosis by point."""

    def start(self, file: str) -> None:
        """Diagnose a survey or a drop file; the result comes as an event."""
        if self.task is not None:
            self._show_message("a diagnosis is under way; 4 and k stop it")
            return
        self.file = file
        self.task = self._jobs.submit(
            tasks.diagnose_file, file, on_finish=partial(self._finish, file)
        )
        self._show_message("the diagnosis runs; measuring goes on")

    def stop(self) -> None:
        """Stop the diagnosis that runs."""
        if self.task is not None:
            self._jobs.stop(self.task)

    def close(self) -> None:
        """Stop the process that diagnoses."""
        self._jobs.close()

    def _finish(self, file: str, task: Task[Any]) -> None:
        results, text, not_stored = (), "", ""
        if task.is_stopped:
            text = f"the diagnosis of {Path(file).name} was stopped"
        elif (error := task.exception()) is not None:
            text = f"the diagnosis of {file} failed: {tasks.failure_text(error)}"
        else:
            diagnoses, fault = task.result()
            results = tuple(result for _, result in diagnoses)
            if fault and not self._is_stored_by_session(file, diagnoses):
                not_stored = fault
        self._runner.put(DiagnosisFinished(file, results, text, not_stored))

    def _is_stored_by_session(
        self, file: str, diagnoses: list[tuple[int, DiagnosisResult]]
    ) -> bool:
        """Have the session that writes the survey store its diagnoses; False without one."""
        if not self._source.writes or file != str(self._source.survey):
            return False

        def store(session: Session) -> None:
            for number, result in diagnoses:
                if not result.stored:
                    session.keep_diagnosis(number, result)

        return self._runner.request(store)

    def on_diagnosed(self, event: DiagnosisFinished, units: Units) -> None:
        """Show that the diagnosis has ended, and store the verdicts."""
        self.task = None
        if event.error:
            self._show_message(event.error)
            return
        text = "the diagnosis is done: 4 shows it"
        self._show_message(f"{text}; {event.not_stored}" if event.not_stored else text)
        if event.file != str(self._source.survey):
            return
        for result in event.results:
            for point in self._state.points.values():
                if str(result.point) in (point.name, point.shown_name):
                    self.verdicts[point.name] = diagnosis_sentence(result, units)

    def on_point(self, name: str, result: DiagnosisResult, units: Units) -> None:
        """Store and show the diagnosis of a point that is being measured."""
        self.verdicts[name] = diagnosis_sentence(result, units)
        self._show_message(f"diagnosis: {self.verdicts[name]}")


def diagnosis_text(file: str, task: Task[Any], now: float) -> str:
    """Return file, point, kind of work and times of a diagnosis under way in one sentence."""
    text = f"diagnosing {Path(file).name}"
    step = task.progress
    if step is None:
        text += ", reading the drops"
    elif step.work == BUILDING:
        text += f", {step.work} of {step.item}"
    else:
        name = os.path.basename(step.item.rpartition(", point ")[2])
        point = f"point {name}, " if name else ""
        text += f": {point}{step.count} of {step.total} points done, {step.work}"
    text += f"; {_duration(now - task.start)} so far"
    remaining = task.remaining_s(now)
    return text if remaining is None else f"{text}, about {_duration(remaining)} to go"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
