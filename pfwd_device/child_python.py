"""How a Python process is started: it takes no code from the current folder.

The current folder is usually a survey, and a survey may come from a stranger. ``python -m`` and
``python -c`` put that folder before everything else on the path of imports, so a file ``json.py``
in it would run in place of Python's own. Whoever starts a Python process starts it by what is here.

A path that the user set himself (PYTHONPATH) stays: it is his own decision.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

_SAFE_PATH = "PYTHONSAFEPATH"
"""The option -P of Python 3.11 as a variable, which children of children inherit too."""


def python_command(*arguments: str) -> list[str]:
    """The command that starts this Python without the current folder on its path.

    Examples
    --------
    >>> python_command("-m", "package")[1:]
    ['-P', '-m', 'package']
    """
    if getattr(sys, "frozen", False):
        # The program in one folder (PyInstaller), which is its own Python: its beginning takes
        # -m, and no code comes from the current folder or from PYTHONPATH.
        return [sys.executable, *arguments]
    return [sys.executable, "-P", *arguments]


def python_environment() -> dict[str, str]:
    """The variables for such a process: it finds the packages that this one finds.

    An empty entry of the path stands for the current folder and is left out.
    """
    path = os.pathsep.join(part for part in sys.path if part)
    return {**os.environ, "PYTHONPATH": path, _SAFE_PATH: "1"}


def start_child(
    *arguments: str, stdin: int = subprocess.PIPE, stderr: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """A Python process beside this one that is spoken to through pipes.

    Ctrl+C does not reach it: who started it decides when it ends, by closing its input or by
    ending it. On Windows it has no window of its own.

    Parameters
    ----------
    *arguments : str
        As on the command line of Python: ``"-m", "package.module"``.
    stdin : int
        A pipe, or `subprocess.DEVNULL` for a process that is told nothing.
    stderr : int
        `subprocess.DEVNULL`, so that nothing is written over a screen, or a pipe.

    Raises
    ------
    OSError
        If the system starts no more processes.
    """
    return subprocess.Popen(python_command(*arguments), **_beside(stdin, stderr))


def start_text_child(
    *arguments: str, stdin: int = subprocess.PIPE, stderr: int = subprocess.PIPE
) -> subprocess.Popen[str]:
    """The same for a process that speaks in lines of UTF-8."""
    return subprocess.Popen(
        python_command(*arguments),
        **_beside(stdin, stderr),
        text=True,
        encoding="utf-8",
        errors="replace",
    )


def _beside(stdin: int, stderr: int) -> dict[str, Any]:
    return {
        "stdin": stdin,
        "stdout": subprocess.PIPE,
        "stderr": stderr,
        "env": python_environment(),
        "start_new_session": os.name == "posix",
        # Of Windows alone.
        "creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0)
        | getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    }


def ignore_interrupts() -> None:
    """For a process that works for another one: who started it decides when to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def children_shielded() -> Iterator[None]:
    """The same for what is started within the block, where the command is made by others.

    That is a library which starts processes of its own. The variable is the whole process's: what
    another thread starts meanwhile is shielded as well. Python itself, started with -E, sets the
    variable aside.
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
