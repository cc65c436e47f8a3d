"""Runs the diagnosis as a command beside the screen, so that the screen never waits for it."""

import contextlib
import json
import subprocess
import threading
from collections.abc import Callable

from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.processes import start_text_child
from tui.screen.session.screen_events import Diagnosed

_COMMAND = "from tui.cli import main; raise SystemExit(main())"


class Diagnoser:
    """One diagnosis at a time.

    Parameters
    ----------
    tell : callable
        Told `Diagnosed`, in a thread of its own.
    """

    def __init__(self, tell: Callable[[Diagnosed], None]) -> None:
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
        self._tell(Diagnosed(file, tuple(results), fault))


def _results(text: str) -> tuple[list[DiagnosisResult], bool]:
    results, bad = [], False
    for printed in text.splitlines():
        try:
            results.append(DiagnosisResult.from_json(json.loads(printed)))
        except (ValueError, SurveyError):
            bad = True
    return results, bad
