"""matplotlib without the settings that lie in the current folder."""

import contextlib
import logging
import os
import sys
from importlib.util import find_spec
from pathlib import Path

SETTINGS = "matplotlibrc"


def start_matplotlib() -> None:
    """Import matplotlib; to be called before anything of it is imported.

    It looks for its settings in the current folder first, which may be a survey from a stranger:
    they could have other programs run (``text.usetex``), or modules loaded (``backend``). The
    settings that the user keeps for himself, and those that he names by MATPLOTLIBRC, count as
    ever.
    """
    # The drawing code looks for fonts and reports what cannot be drawn; that a family has no bold
    # letters is of no use to the reader of a report.
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    if "matplotlib" in sys.modules or not os.path.exists(SETTINGS):
        return
    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        return  # the import reports it
    # It has no option for this. The folder is left only where there are such settings, because it
    # is left for every thread.
    with contextlib.chdir(Path(spec.origin).parent):
        import matplotlib  # noqa: F401
