"""Recovery and check of a survey, as ``pfwd recover`` and ``pfwd check`` print them."""

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
    folder: str | os.PathLike[str], spare: str | os.PathLike[str] | None = None
) -> tuple[dict[str, Any], list[str]]:
    """Compare every byte of a survey, an exported survey or a drop file with its digests.

    Parameters
    ----------
    folder : path of a survey, an exported survey or a drop file
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
        If the path is none of the three.
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
