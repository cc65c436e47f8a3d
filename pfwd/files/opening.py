"""Reading of a survey, from its folder or from one file."""

import os

from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_hdf5, is_survey, is_survey_file
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, read_drop_file, read_survey


def survey_content(path: str | os.PathLike[str]) -> Survey:
    """Read a survey, from its folder or from one file.

    Raises
    ------
    SurveyError
        If the path is no survey, or cannot be read.
    """
    file = os.fspath(path)
    try:
        if is_survey(file):
            return read_survey(file)
        if is_survey_file(file):
            from pfwd.files.survey_file import read_survey_file  # loads modules for archives

            return read_survey_file(file)
        if is_hdf5(file):
            read_drop_file(file)  # refuses an export for other programs, and a damaged file
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    actual = "another folder" if os.path.isdir(file) else "another file"
    if not os.path.exists(file):
        actual = "no such file or folder"
    hint = "pfwd import makes a survey of other files"
    raise SurveyError(refusal(file, "a survey, its folder or one file (.pfwdz)", actual, hint))
