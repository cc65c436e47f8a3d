"""Commands of the program in a process of their own, for work that would stop the screen."""

import subprocess
from collections.abc import Sequence

from pfwd.processes import start_text_child

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
    code = "from tui.cli import main; raise SystemExit(main())"
    try:
        child = start_text_child("-c", code, *words, stdin=subprocess.DEVNULL)
    except OSError as err:
        return f"the command could not be started: {err}"
    try:
        out, err_text = child.communicate(timeout=COMMAND_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return f"it took longer than {COMMAND_TIMEOUT_S:.0f} s and was ended"
    if child.returncode == 0:
        return ""
    lines = (err_text or out).strip().splitlines() or [f"exit status {child.returncode}"]
    return lines[-1].removeprefix("pfwd: ").removeprefix(f"{words[0]}: ")
