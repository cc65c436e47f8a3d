"""Folders of surveys, looked at without what reads surveys."""

import os
from pathlib import Path

from pfwd.errors import SurveyError, refusal
from pfwd_device.recording.layout import Layout


def is_survey(path: str | os.PathLike[str]) -> bool:
    """Return whether this is the folder of a survey."""
    return os.path.isdir(path) and Layout(Path(path)).exists()


def has_ledger_of(path: str | os.PathLike[str], size: int) -> bool:
    """Return whether the survey in a folder has a ledger of this size, bytes, or a larger one.

    Its size tells the number of drops. An exported survey has no ledger.
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
        came = "another folder" if os.path.isdir(path) else "no such folder"
        hint = "pfwd log and pfwd import make surveys"
        raise SurveyError(refusal(os.fspath(path), "the folder of a survey", came, hint))
