"""Folders of surveys, and the spare folder.

The spare folder takes the drops that cannot be written to their survey, for instance because its
disk is full.
"""

import os
from pathlib import Path

from pfwd.errors import SurveyError, refusal
from pfwd_device.recording import SpareFolder, Survey, SurveyWriter
from pfwd_device.recording.layout import Layout

SPARE_VARIABLE = "PFWD_SPARE"
"""Environment variable with another spare folder for all commands; ``--spare`` overrides it."""


def is_survey(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is the folder of a survey."""
    return os.path.isdir(path) and Layout(Path(path)).exists()


def has_ledger_of(path: str | os.PathLike[str], size: int) -> bool:
    """Return whether a survey's list of acknowledged drops has at least this size.

    The size in bytes grows with the number of drops, which is thereby estimated without reading the
    survey. An exported survey has no such list: the answer is False.
    """
    try:
        return Layout(Path(path)).ledger.stat().st_size >= size
    except OSError:
        return False


def refuse_no_survey(path: str | os.PathLike[str]) -> None:
    """Raise SurveyError if a path is not the folder of a survey."""
    if not is_survey(path):
        actual = "another folder" if os.path.isdir(path) else "no such folder"
        hint = "name a folder that pfwd log or pfwd import has made"
        raise SurveyError(refusal(os.fspath(path), "the folder of a survey", actual, hint))


def spare_folder(named: str | os.PathLike[str] | None = None) -> SpareFolder:
    """Return the spare folder.

    Parameters
    ----------
    named : path, optional
        Folder to use; None: the one in the environment variable `SPARE_VARIABLE`, else the user's
        data folder of the operating system.
    """
    path = named or os.environ.get(SPARE_VARIABLE)
    if path:
        return SpareFolder(Path(path).absolute())
    from platformdirs import user_data_path

    return SpareFolder(user_data_path("pfwd", appauthor=False) / "spare")


def open_for_edits(folder: str | os.PathLike[str], survey: Survey | None = None) -> SurveyWriter:
    """Open a survey that no program measures into, to append edits, events or results.

    Parameters
    ----------
    folder : path of a survey
    survey : Survey, optional
        Content of the survey if it has been read already, which saves reading it again.
    """
    return SurveyWriter.open(
        folder,
        publish=False,
        spare=spare_folder(),
        fall_back=False,
        edits_only=True,
        already_read=survey,
    )
