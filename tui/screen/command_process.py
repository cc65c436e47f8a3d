"""Commands of the program in a process of their own, for work that would stop the screen."""

import contextlib
import io
from collections.abc import Sequence

from pfwd.jobs import Jobs, WorkerDied

COMMAND_TIMEOUT_S = 600.0
"""Time after which a command is ended, s: a report of hundreds of points takes minutes."""


def run_command(words: Sequence[str]) -> str:
    """Run a command of the program and wait for its end; call it in a thread.

    Parameters
    ----------
    words : sequence of str
        Name of the command and its arguments, as ``("report", "road", "-o", "road.pdf")``.

    Returns
    -------
    str
        Error in one line; empty: the command succeeded.
    """
    with Jobs() as jobs:
        try:
            return jobs.submit(error_of_command, words).result(COMMAND_TIMEOUT_S)
        except TimeoutError:
            return f"it took longer than {COMMAND_TIMEOUT_S:.0f} s and was ended"
        except WorkerDied as err:
            return str(err)


def error_of_command(words: Sequence[str]) -> str:
    """Run a command in this process and return its error in one line."""
    from tui.cli import main

    with contextlib.redirect_stderr(io.StringIO()) as errors:
        try:
            status: object = main(words)
        except SystemExit as err:  # wrong arguments
            status = err.code
    if not status:
        return ""
    line = (errors.getvalue().strip().splitlines() or [f"exit status {status}"])[-1]
    return line.removeprefix("pfwd: ").removeprefix(f"{words[0]}: ")
