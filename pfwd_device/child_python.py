"""How a Python process is started: it takes no code from the current folder.

The current folder is usually a survey, and a survey may come from a stranger. ``python -m`` and
``python -c`` put that folder before everything else on the path of imports, so a file ``json.py``
in it would run in place of Python's own. Whoever starts a Python process starts it by what is here.

A path that the user set himself (PYTHONPATH) stays: it is his own decision.
"""

import contextlib
import os
import sys
from collections.abc import Iterator

_SAFE_PATH = "PYTHONSAFEPATH"
"""The option -P of Python 3.11 as a variable, which children of children inherit too."""


def python_command(*arguments: str) -> list[str]:
    """The command that starts this Python without the current folder on its path.

    Examples
    --------
    >>> python_command("-m", "package")[1:]
    ['-P', '-m', 'package']
    """
    return [sys.executable, "-P", *arguments]


def python_environment() -> dict[str, str]:
    """The variables for such a process: it finds the packages that this one finds.

    An empty entry of the path stands for the current folder and is left out.
    """
    path = os.pathsep.join(part for part in sys.path if part)
    return {**os.environ, "PYTHONPATH": path, _SAFE_PATH: "1"}


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
