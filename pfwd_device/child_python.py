"""Start of Python processes that import no code from the current folder.

The current folder is usually a survey, and a survey may come from a stranger. ``python -m`` and
``python -c`` put that folder first on the import path, so a file ``json.py`` in it would run in
place of Python's own. Every Python process of the program is started by these functions.

A path that the user has set (PYTHONPATH) stays in force.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

_SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable with the effect of Python's option -P; child processes inherit it."""


def python_command(*arguments: str) -> list[str]:
    """Return the command line that starts Python without the current folder on its import path.

    Examples
    --------
    >>> python_command("-m", "package")[1:]
    ['-P', '-m', 'package']
    """
    if getattr(sys, "frozen", False):
        # The program in one folder (PyInstaller) is its own Python: its entry point handles -m,
        # and no code comes from the current folder or from PYTHONPATH.
        return [sys.executable, *arguments]
    return [sys.executable, "-P", *arguments]


def python_environment() -> dict[str, str]:
    """Return the environment variables of a child process, with the import path of this process.

    An empty entry of the import path stands for the current folder and is omitted.
    """
    path = os.pathsep.join(part for part in sys.path if part)
    return {**os.environ, "PYTHONPATH": path, _SAFE_PATH: "1"}


def start_child(*arguments: str) -> subprocess.Popen[bytes]:
    """Start a Python process whose standard input and output are pipes of bytes.

    Its standard error is discarded, so that nothing is written over a screen. Ctrl+C does not reach
    the child: its parent ends it, by closing its input or by a signal. On Windows the child opens
    no window.

    Parameters
    ----------
    *arguments : str
        As on the command line of Python: ``"-m", "package.module"``.

    Raises
    ------
    OSError
        If the system cannot start another process.
    """
    return subprocess.Popen(
        python_command(*arguments), stderr=subprocess.DEVNULL, **_pipe_options()
    )


def start_text_child(*arguments: str) -> subprocess.Popen[str]:
    """Start a Python process as `start_child` does, with pipes that carry UTF-8 text, also of its
    standard error.
    """
    return subprocess.Popen(
        python_command(*arguments),
        stderr=subprocess.PIPE,
        **_pipe_options(),
        text=True,
        encoding="utf-8",
        errors="replace",
    )


def _pipe_options() -> dict[str, Any]:
    return {
        "stdin": subprocess.PIPE,
        "stdout": subprocess.PIPE,
        "env": python_environment(),
        "start_new_session": os.name == "posix",
        # These flags exist on Windows alone.
        "creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0)
        | getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    }


def ignore_interrupts() -> None:
    """Ignore Ctrl+C in a child process: its parent decides when it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def children_shielded() -> Iterator[None]:
    """Keep the current folder off the import path of processes that a library starts.

    Use it where the library builds the command itself. The environment variable holds for all
    threads of this process within the block. A Python that is started with -E ignores it.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before
