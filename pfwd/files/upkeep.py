"""Recovery and check of a survey, as ``pfwd recover`` and ``pfwd check`` print them."""

import os
from pathlib import Path
from typing import Any

from pfwd.files.folders import is_hdf5, is_survey_file, refuse_no_survey, spare_folder
from pfwd.files.survey_file import survey_folder
from pfwd_device.errors import RecordingError
from pfwd_device.recording import CheckReport, RecoveryReport, check, read_drop_file, recover
from pfwd_device.recording.drop_file import ExportedSurveyError
from pfwd_device.recording.layout import Layout, refuse_links


def refuse_links_in(folder: str | os.PathLike[str]) -> None:
    """Raise RecordingError if the folder of a survey contains a link that leads out of it.

    Parameters
    ----------
    folder : path of a survey, or of a new folder
    """
    refuse_links(Layout(Path(folder).absolute()))


def recover_survey(
    folder: str | os.PathLike[str], spare: str | os.PathLike[str] | None = None
) -> tuple[dict[str, Any], list[str]]:
    """Repair a survey after a crash.

    Drops of the survey in the spare folder are moved back into it. If nothing else remains of a
    survey, it is restored from the spare folder.

    Parameters
    ----------
    folder : path of a survey
    spare : path, optional
        Spare folder; None: as `spare_folder` chooses it.

    Returns
    -------
    record : dict
        Keys as in ``pfwd recover --json``.
    actions : list of str
        Sentences about what was repaired.

    Raises
    ------
    SurveyError, RecordingError
        If the folder is no survey, or another program is writing to it.
    """
    second = spare_folder(spare)
    if not second.parts(home=Path(folder).absolute()):
        refuse_no_survey(folder)
    report = recover(folder, spare=second)
    return _record(folder, report), list(report.actions)


def check_survey(
    path: str | os.PathLike[str], spare: str | os.PathLike[str] | None = None
) -> tuple[dict[str, Any], list[str]]:
    """Compare every byte of a survey or of a drop file with its digests.

    Parameters
    ----------
    path : path of the folder of a survey, of a survey in one file, or of a drop file
    spare : path, optional
        Spare folder; None: as `spare_folder` chooses it.

    Returns
    -------
    record : dict
        Keys as in ``pfwd check --json``.
    notes : list of str
        Sentences about unfinished work that is no damage.

    Raises
    ------
    SurveyError, RecordingError
        If the path is none of the three, or the survey in one file is damaged.
    """
    if is_hdf5(path):
        return _record(path, _check_drop_file(os.fspath(path))), []
    with survey_folder(path) as folder:
        # A survey in one file has its drops in it, even if a spare folder has further ones.
        report = check(folder, spare=None if is_survey_file(path) else spare_folder(spare))
    return _record(path, report), list(report.notes)


def _check_drop_file(path: str) -> CheckReport:
    damaged: tuple[str, ...] = ()
    try:
        read_drop_file(path)
    except ExportedSurveyError:
        raise
    except RecordingError as err:
        damaged = (str(err),)
    return CheckReport(path, 1, 1 - len(damaged), 0, damaged, notes=(), closed=True)


def _record(folder: str | os.PathLike[str], report: CheckReport | RecoveryReport) -> dict[str, Any]:
    return {
        "survey": os.fspath(folder),
        "drops_acknowledged": report.drops_acknowledged,
        "drops_published": report.drops_published,
        "recovered": report.recovered,
        "damaged": list(report.damaged),
        "ok": report.ok,
    }
