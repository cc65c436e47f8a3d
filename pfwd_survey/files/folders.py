"""Which folders are surveys; of use to who has no need of anything that reads them."""

import os
from pathlib import Path

from pfwd_device.recording.layout import Layout
from pfwd_survey.errors import SurveyError, refusal


def is_survey(path: str | os.PathLike[str]) -> bool:
    """Whether there is a folder of a survey."""
    return os.path.isdir(path) and Layout(Path(path)).exists()


def refuse_no_survey(path: str | os.PathLike[str]) -> None:
    """Refuse what is no survey.

    Raises
    ------
    SurveyError
    """
    if not is_survey(path):
        came = "another folder" if os.path.isdir(path) else "no such folder"
        hint = "pfwd log and pfwd import make surveys"
        raise SurveyError(refusal(os.fspath(path), "the folder of a survey", came, hint))
