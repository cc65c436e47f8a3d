"""Recovery and check of a survey, with the results that the command line prints."""

import os
from pathlib import Path
from typing import Any

from pfwd.files.folders import refuse_no_survey, spare_folder
from pfwd.files.reading import is_hdf5
from pfwd.files.survey_file import check_survey_file, is_survey_file
from pfwd_device.errors import RecordingError
from pfwd_device.recording import CheckReport, RecoveryReport, check, recover
from pfwd_device.recording.drop_file import stored_drop
from pfwd_device.recording.layout import Layout, refuse_links


def refuse_links_in(folder: str | os.PathLike[str]) -> None:
    """Refuse the folder of a survey, existing or new, with a link that leads out of it.

    Raises
    ------
    RecordingError
        The message names the link.
    """
    refuse_links(Layout(Path(folder).absolute()))


def recover_survey(
    folder: str | os.PathLike[str], spare: str | os.PathLike[str] | None = None
) -> tuple[dict[str, Any], list[str]]:
    """Repair a survey after a crash; return the record of ``pfwd recover`` and the actions.

    Drops of the survey in the spare folder (by default the platform's) are moved back; a survey of
    which nothing else remains is restored from it.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
    """
    second = spare_folder(spare)
    if not second.parts(home=Path(folder).absolute()):
        refuse_no_survey(folder)
    report = recover(folder, spare=second)
    return _record(folder, report), list(report.actions)


def check_survey(
    folder: str | os.PathLike[str], spare: str | os.PathLike[str] | None = None
) -> tuple[dict[str, Any], list[str]]:
    """Check every byte of a survey, in its folder or exported, or of the file of a drop.

    Returns the record of ``pfwd check`` and notes on unfinished work that is no damage.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey.
    """
    if is_hdf5(folder):
        return check_survey_file(folder) if is_survey_file(folder) else _check_drop_file(folder)
    refuse_no_survey(folder)
    report = check(folder, spare=spare_folder(spare))
    return _record(folder, report), list(report.notes)


def _check_drop_file(path: str | os.PathLike[str]) -> tuple[dict[str, Any], list[str]]:
    damaged, notes = [], []
    try:
        if stored_drop(Path(path)).version == 1:
            notes = [f"{path}: attributes are not covered by the digest of format version 1"]
    except RecordingError as err:
        damaged = [str(err)]
    record = {
        "survey": os.fspath(path),
        "drops_acknowledged": 1,
        "drops_published": 1 - len(damaged),
        "recovered": 0,
        "damaged": damaged,
        "ok": not damaged,
    }
    return record, notes


def _record(folder: str | os.PathLike[str], report: CheckReport | RecoveryReport) -> dict[str, Any]:
    return {
        "survey": os.fspath(folder),
        "drops_acknowledged": report.drops_acknowledged,
        "drops_published": report.drops_published,
        "recovered": report.recovered,
        "damaged": list(report.damaged),
        "ok": report.ok,
    }
