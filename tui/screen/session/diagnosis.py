"""Diagnoses that are asked for, and what they say of the points.

The diagnosis runs as a command beside the screen, so that the screen never waits for it.
"""

import contextlib
import json
import subprocess
import threading
from collections.abc import Callable

from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.processes import start_text_child
from tui.screen.session.drop_state import PointState
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_events import DiagnosisDone
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.session.verdicts import verdict_text
from tui.screen.units import Units

_COMMAND = "from tui.cli import main; raise SystemExit(main())"


class Diagnoser:
    """One diagnosis at a time.

    Parameters
    ----------
    tell : callable
        Told `DiagnosisDone`, in a thread of its own.
    """

    def __init__(self, tell: Callable[[DiagnosisDone], None]) -> None:
        self._tell = tell
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()
        self.file = ""
        """What is being diagnosed; empty: nothing."""

    def start(self, file: str) -> bool:
        """Diagnose a survey or a drop file; False while another one is under way."""
        with self._lock:
            if self.file:
                return False
            self.file = file
        threading.Thread(target=self._run, args=(file,), name="diagnosis", daemon=True).start()
        return True

    def stop(self) -> None:
        """End it."""
        process = self._process
        if process is not None:
            with contextlib.suppress(OSError):
                process.kill()

    def _run(self, file: str) -> None:
        command = ("-c", _COMMAND, "diagnose", file, "--json")
        try:
            self._process = start_text_child(*command, stdin=subprocess.DEVNULL)
            out, err = self._process.communicate()
            status = self._process.returncode
        except OSError as error:
            out, err, status = "", str(error), 1
        finally:
            self._process, self.file = None, ""
        results, bad = _results(out)
        fault = ""
        if bad or (status != 0 and not results):
            said = [text for text in err.strip().splitlines() if text]
            fault = f"the diagnosis of {file} failed: {said[-1] if said else f'status {status}'}"
        self._tell(DiagnosisDone(file, tuple(results), fault))


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

    def names_of_results(self, count: int) -> list[str]:
        """Names of the points that a diagnosis of the survey has results of."""
        points = self._points()
        if len(points) == count:
            return [point.shown_name for point in points]
        return [f"no. {place + 1}" for place in range(count)]

    def on_diagnosed(self, event: DiagnosisDone, units: Units) -> None:
        """Say that it is done, and keep the verdicts."""
        if event.error:
            self._say(event.error)
            return
        self._say("the diagnosis is done: 4 shows it")
        if event.file != str(self._source.survey):
            return
        points = self._points()
        if len(points) == len(event.results):
            for point, result in zip(points, event.results, strict=True):
                self.verdicts[point.name] = verdict_text(result, units)

    def on_point(self, name: str, result: DiagnosisResult, units: Units) -> None:
        """Keep what was found of a point while it is measured, and say it."""
        self.verdicts[name] = verdict_text(result, units)
        self._say(f"diagnosis: {self.verdicts[name]}")

    def _points(self) -> list[PointState]:
        return [
            point for point in self._state.points.values() if point.drops and not point.discarded
        ]


def _results(text: str) -> tuple[list[DiagnosisResult], bool]:
    results, bad = [], False
    for printed in text.splitlines():
        try:
            results.append(DiagnosisResult.from_json(json.loads(printed)))
        except (ValueError, SurveyError):
            bad = True
    return results, bad
