"""Slips of points: one page each, with the verdict and a signature, written by a process."""

from collections.abc import Callable
from pathlib import Path

from pfwd.export.surveys import safe_name
from pfwd.judging import PointView
from pfwd.session.events import SessionNotice
from tui.screen.command_process import run_command
from tui.screen.session.screen_events import ScreenEvent
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
    state : SessionState
    show_message : callable
        Shows one line to the operator.
    in_thread : callable
        Runs slow work in a thread, in a named group; the notice that it returns is shown.
    """

    def __init__(
        self,
        source: SessionSource,
        state: SessionState,
        show_message: Callable[[str], None],
        in_thread: Callable[[Callable[[], ScreenEvent | None], str], None],
    ) -> None:
        self._source, self._state = source, state
        self._show_message, self._in_thread = show_message, in_thread
        self._is_running = False

    def obstacle(self, point: PointView) -> str:
        """Return why the point can have no slip now; empty: it can."""
        drops = self._state.drops_of(point).values()
        if self._source.survey is None:
            return "there is no survey whose points could have a slip"
        if not any(drop.record is not None for drop in drops):
            return f"point {point.shown_name} has no drop on the disk yet; a slip needs one"
        if not all(drop.safe for drop in drops):
            return "some drops are only in memory; the slip is possible once they are on the disk"
        if self._is_running:
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
        self._is_running = True
        self._show_message(f"writing the slip of point {point.shown_name}; measuring goes on")
        self._in_thread(lambda: self._run(survey, point, signature.strip()), "slip")

    def _run(self, survey: Path, point: PointView, signature: str) -> SessionNotice:
        try:
            text, serious = self._outcome(survey, point, signature)
            return SessionNotice(text, serious=serious)
        finally:
            self._is_running = False

    def _outcome(self, survey: Path, point: PointView, signature: str) -> tuple[str, bool]:
        """Return the path of the slip, or the error, as one sentence; True for an error."""
        name = point.shown_name
        place = survey.resolve()  # "." has no name
        folder = place.with_name(place.name + FOLDER_SUFFIX)
        file = free_path(folder, f"slip-{safe_name(name)}", ".pdf")
        try:
            folder.mkdir(exist_ok=True)
        except OSError as err:
            reason = err.strerror or str(err)
            return f"the slip of point {name} was not written: {folder}: {reason}", True
        words = ["report", str(survey), f"--point={point.name}", "--slip", "--no-store"]
        words += [f"--signed={signature}"] if signature else []
        error = run_command([*words, f"--output={file}"])
        if error:
            return f"the slip of point {name} was not written: {error}", True
        return f"slip of point {name}: {file}", False


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
