"""Where drops go that a survey's folder does not take."""

import os
from pathlib import Path

from pfwd_device.recording import SpareFolder

VARIABLE = "PFWD_SPARE"
"""Names another spare folder for all commands; ``--spare`` comes first."""


def spare_folder(named: str | os.PathLike[str] | None = None) -> SpareFolder:
    """As named, else as the environment says, else in the platform's place for data."""
    chosen = named or os.environ.get(VARIABLE)
    if chosen:
        return SpareFolder(Path(chosen).absolute())
    from platformdirs import user_data_path

    return SpareFolder(user_data_path("pfwd", appauthor=False) / "spare")
