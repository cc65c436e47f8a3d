"""Recovery and check of a survey, as the command line shows them."""

import os
from typing import Any

from pfwd_device.recording import CheckReport, RecoveryReport, check, recover
from pfwd_survey.files.reading import refuse_no_survey
from pfwd_survey.files.survey_file import check_survey_file, is_survey_file


def recover_survey(folder: str | os.PathLike[str]) -> tuple[dict[str, Any], list[str]]:
    """Put right whatever a crash left; the record of ``pfwd recover`` and what was done.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
    """
    refuse_no_survey(folder)
    report = recover(folder)
    return _record(folder, report), list(report.actions)


def check_survey(folder: str | os.PathLike[str]) -> tuple[dict[str, Any], list[str]]:
    """Look at every byte of a survey, in its folder or exported; the record of ``pfwd check`` and
    what is unfinished but no damage.

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey.
    """
    if os.path.isfile(folder) and is_survey_file(folder):
        return check_survey_file(folder), []
    refuse_no_survey(folder)
    report = check(folder)
    return _record(folder, report), list(report.notes)


def _record(folder: str | os.PathLike[str], report: CheckReport | RecoveryReport) -> dict[str, Any]:
    return {
        "survey": os.fspath(folder),
        "drops_acknowledged": report.drops_acknowledged,
        "drops_published": report.drops_published,
        "recovered": report.recovered,
        "damaged": list(report.damaged),
        "ok": report.ok,
    }
