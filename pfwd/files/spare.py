"""Folder for drops that the folder of a survey does not take, and writers without one."""

import os
from pathlib import Path

from pfwd_device.recording import SpareFolder, Survey, SurveyWriter

VARIABLE = "PFWD_SPARE"
"""Names another spare folder for all commands; ``--spare`` comes first."""


def spare_folder(named: str | os.PathLike[str] | None = None) -> SpareFolder:
    """As named, else as the environment says, else in the platform's place for data."""
    chosen = named or os.environ.get(VARIABLE)
    if chosen:
        return SpareFolder(Path(chosen).absolute())
    from platformdirs import user_data_path

    return SpareFolder(user_data_path("pfwd", appauthor=False) / "spare")


def open_for_edits(folder: str | os.PathLike[str], known: Survey | None = None) -> SurveyWriter:
    """Open a survey that nobody measures into, to add edits, events or results.

    Parameters
    ----------
    folder : path of a survey
    known : Survey, optional
        The survey as it was read before; saves reading it again.
    """
    return SurveyWriter.open(
        folder,
        publish=False,
        spare=spare_folder(),
        fall_back=False,
        edits_only=True,
        known=known,
    )
