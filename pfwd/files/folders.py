"""Folders of surveys, and the spare folder for drops that such a folder does not accept."""

import os
from pathlib import Path

from pfwd.errors import SurveyError, refusal
from pfwd_device.recording import SpareFolder, Survey, SurveyWriter
from pfwd_device.recording.layout import Layout

SPARE_VARIABLE = "PFWD_SPARE"
"""Environment variable with another spare folder for all commands; ``--spare`` overrides it."""


def is_survey(path: str | os.PathLike[str]) -> bool:
    """Return whether this is the folder of a survey."""
    return os.path.isdir(path) and Layout(Path(path)).exists()


def has_ledger_of(path: str | os.PathLike[str], size: int) -> bool:
    """Return whether the survey in a folder has a ledger of at least this size, bytes.

    The size depends on the number of drops. An exported survey has no ledger.
    """
    try:
        return Layout(Path(path)).ledger.stat().st_size >= size
    except OSError:
        return False


def refuse_no_survey(path: str | os.PathLike[str]) -> None:
    """Refuse a path that is not the folder of a survey.

    Raises
    ------
    SurveyError
    """
    if not is_survey(path):
        actual = "another folder" if os.path.isdir(path) else "no such folder"
        hint = "pfwd log and pfwd import make surveys"
        raise SurveyError(refusal(os.fspath(path), "the folder of a survey", actual, hint))


def spare_folder(named: str | os.PathLike[str] | None = None) -> SpareFolder:
    """Return the named spare folder, else that of the environment, else the platform's."""
    path = named or os.environ.get(SPARE_VARIABLE)
    if path:
        return SpareFolder(Path(path).absolute())
    from platformdirs import user_data_path

    return SpareFolder(user_data_path("pfwd", appauthor=False) / "spare")


def open_for_edits(folder: str | os.PathLike[str], survey: Survey | None = None) -> SurveyWriter:
    """Open a survey that no program measures into, to add edits, events or results.

    Parameters
    ----------
    folder : path of a survey
    survey : Survey, optional
        The survey, if it has been read already; saves reading it again.
    """
    return SurveyWriter.open(
        folder,
        publish=False,
        spare=spare_folder(),
        fall_back=False,
        edits_only=True,
        already_read=survey,
    )
