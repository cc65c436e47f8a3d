"""Folders of surveys, and the spare folder.

The spare folder takes the drops that cannot be written to their survey, for instance because its
disk is full.
"""

import os
from pathlib import Path

from pfwd.errors import SurveyError, refusal
from pfwd_device.recording import (
    SpareFolder,
    Survey,
    SurveyWriter,
    read_drop_file,
)
from pfwd_device.recording.layout import Layout

MANIFEST = "pfwd-survey.json"
"""Name of the first member of a survey in one file."""

SURVEY_FILE_SUFFIX = ".pfwdz"

_ZIP_SIGNATURE, _ZIP_HEADER_BYTES = b"PK\x03\x04", 30

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"

SPARE_VARIABLE = "PFWD_SPARE"
"""Environment variable with another spare folder for all commands; ``--spare`` overrides it."""


def is_survey(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is the folder of a survey."""
    return os.path.isdir(path) and Layout(Path(path)).exists()


def is_survey_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a survey in one file, by its content or its ending ``.pfwdz``."""
    if not os.path.isfile(path):
        return False  # a pipe may wait for ever
    if os.fspath(path).lower().endswith(SURVEY_FILE_SUFFIX):
        return True  # a damaged one as well, so that its reader reports the damage
    try:
        with open(path, "rb") as stream:
            start = stream.read(_ZIP_HEADER_BYTES + len(MANIFEST))
    except OSError:
        return False
    return start.startswith(_ZIP_SIGNATURE) and start.endswith(MANIFEST.encode())


def is_hdf5(file: str | os.PathLike[str]) -> bool:
    """Return whether a file begins with the signature of the HDF5 format."""
    if not os.path.isfile(file):
        return False  # a pipe may wait for ever
    try:
        with open(file, "rb") as stream:
            return stream.read(len(HDF5_SIGNATURE)) == HDF5_SIGNATURE
    except OSError:
        return False  # the reader of the file reports the reason


def refuse_no_survey(path: str | os.PathLike[str]) -> None:
    """Raise SurveyError if a path is not the folder of a survey."""
    if is_survey_file(path):
        actual, hint = (
            "a survey in one file, which is not changed",
            "pfwd import makes a folder of it",
        )
        raise SurveyError(refusal(os.fspath(path), "the folder of a survey", actual, hint))
    if is_hdf5(path):
        read_drop_file(path)  # refuses an export for other programs, and a damaged file
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
