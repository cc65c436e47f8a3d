"""Slips of points: one page each, with the verdict and a signature, written by a process."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from pfwd.export.surveys import safe_name
from pfwd.jobs import Jobs, Task
from pfwd.judging import PointView
from pfwd.session.events import SessionNotice
from tui.screen.command_process import error_of_command
from tui.screen.session.runner import SessionRunner
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState

FOLDER_SUFFIX = "-reports"
"""End of the name of the folder for slips beside that of the survey, which holds drops alone."""

MAX_SIGNATURE_LETTERS = 64
"""Letters of a typed signature: more do not fit beside the QR code."""


class SlipWriter:
    """Writes the slip of a point into a folder beside the survey, one slip at a time.

    ``pfwd report --slip`` makes the file in a process of its own, so that neither the screen nor
    the session waits.

    Parameters
    ----------
    source : SessionSource
        Its survey has the drops and gives the folder its name.
    runner : SessionRunner
        Receives the notice that a slip is written, or why not.
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
        self._source, self._runner, self._state = source, runner, state
        self._show_message = show_message
        self._jobs = Jobs()

    def close(self) -> None:
        """Stop the process that writes."""
        self._jobs.close()

    def obstacle(self, point: PointView) -> str:
        """Return why the point can have no slip now; empty: it can."""
        if self._source.survey is None:
            return "there is no survey whose points could have a slip"
        if not any(drop.record is not None for drop in point.drops):
            return f"point {point.shown_name} has no drop on the disk yet; a slip needs one"
        if not all(drop.safe for drop in self._state.drops_of(point).values()):
            return "some drops are only in memory; the slip is possible once they are on the disk"
        if self._jobs.n_open:
            return "another slip is being written; try again in a moment"
        return ""

    def write(self, point: PointView, signature: str) -> None:
        """Write the slip of a point.

        Parameters
        ----------
        point : PointView
        signature : str
            Typed signature; empty: the slip gets a line to sign on.
        """
        problem = self.obstacle(point)
        survey = self._source.survey
        if problem or survey is None:
            self._show_message(problem)
            return
        name = point.shown_name
        place = survey.resolve()  # "." has no name
        folder = place.with_name(place.name + FOLDER_SUFFIX)
        file = free_path(folder, f"slip-{safe_name(name)}", ".pdf")
        try:
            folder.mkdir(exist_ok=True)
        except OSError as err:
            self._report(name, file, f"{folder}: {err.strerror or err}")
            return
        words = ["report", str(survey), f"--point={point.name}", "--slip", "--no-store"]
        words += [f"--signed={signature.strip()}"] if signature.strip() else []
        words.append(f"--output={file}")
        self._show_message(f"writing the slip of point {name}; measuring goes on")
        finish = partial(self._finish, name, file)
        self._jobs.submit(error_of_command, words, on_finish=finish)

    def _finish(self, name: str, file: Path, task: Task[str]) -> None:
        if not task.is_stopped:
            error = task.exception()
            self._report(name, file, task.result() if error is None else str(error))

    def _report(self, name: str, file: Path, error: str) -> None:
        text = f"slip of point {name}: {file}"
        if error:
            text = f"the slip of point {name} was not written: {error}"
        self._runner.put(SessionNotice(text, serious=bool(error)))


def free_path(folder: Path, stem: str, suffix: str) -> Path:
    """Return a path in a folder that no file has yet: a slip that was signed is not overwritten."""
    path, number = folder / f"{stem}{suffix}", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path


def signature_error(text: str) -> str:
    """Return the error of a typed signature; empty: it can be used, or there is none."""
    if len(text) > MAX_SIGNATURE_LETTERS or not text.isprintable():
        return f"up to {MAX_SIGNATURE_LETTERS} letters on one line"
    return ""
