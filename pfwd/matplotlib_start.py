"""Import of matplotlib without settings from the current folder."""

import contextlib
import logging
import os
import sys
from importlib.util import find_spec
from pathlib import Path

SETTINGS = "matplotlibrc"


def start_matplotlib() -> None:
    """Import matplotlib without the settings file in the current folder; call it before other
    imports.

    matplotlib reads ``matplotlibrc`` in the current folder first. That folder may be a survey of
    unknown origin, and the file could make matplotlib run programs (``text.usetex``) or import
    modules (``backend``). Settings in the user's configuration folder and in MATPLOTLIBRC are used
    as usual.
    """
    # Messages about fonts without bold letters do not help the reader of a report.
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    if "matplotlib" in sys.modules or not os.path.exists(SETTINGS):
        return
    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        return  # the import of matplotlib reports the error
    # matplotlib has no option for this. The current folder is changed only if it has such settings,
    # because the change concerns all threads.
    with contextlib.chdir(Path(spec.origin).parent):
        import matplotlib  # noqa: F401
