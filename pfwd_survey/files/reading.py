"""Reads the test points of whatever a command is given: a survey, one of its drop files, traces."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, Survey, SurveyPoint, read_drop_file, read_survey
from pfwd_device.recording.layout import Layout
from pfwd_survey.errors import SurveyError, refusal
from pfwd_survey.files.header import (
    Declaration,
    Declarations,
    read_header_file,
    setup_from,
    setup_warnings,
)
from pfwd_survey.files.traces import TracePoint, read_traces

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_points(
    path: str | os.PathLike[str],
    header: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, object] | None = None,
) -> list[TracePoint]:
    """The test points of a survey folder, a drop file or a trace file.

    Discarded drops and points are left out. Drops of a point that were declared differently (the
    plate was changed) come as two points.

    Parameters
    ----------
    path : path of a survey folder, a drop file (.h5) or a trace file
    header : path of a TOML file, optional
        Its keys win over what is declared.
    overrides : mapping of header key to value, optional
        Win over both.

    Returns
    -------
    list of TracePoint

    Raises
    ------
    SurveyError
        If it is refused.
    """
    file = os.fspath(path)
    try:
        if os.path.isdir(file):
            return _survey_points(file, _said(header, overrides))
        if _is_hdf5(file):
            record = read_drop_file(file)
            return [_point(file, record.point, [record], _said(header, overrides))]
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    return [read_traces(path, header, overrides)]


def _survey_points(file: str, said: Declarations) -> list[TracePoint]:
    survey = read_survey(file)
    points = [one for point in survey.points for one in _points(survey, point, said)]
    if not points:
        what = "all are discarded" if survey.drops else "none"
        hint = f"; damage: {'; '.join(survey.damage)}" if survey.damage else ""
        raise SurveyError(refusal(file, "a survey with drops", what) + hint)
    # Nothing is lost in silence.
    lost = tuple(f"damaged survey: {text}" for text in survey.damage)
    points[0] = replace(points[0], warnings=(*points[0].warnings, *lost))
    return points


def _is_hdf5(file: str) -> bool:
    try:
        with open(file, "rb") as stream:
            return stream.read(len(HDF5_SIGNATURE)) == HDF5_SIGNATURE
    except OSError:
        return False  # the reader of trace files says what is wrong


def _said(
    header: str | os.PathLike[str] | None, overrides: Mapping[str, object] | None
) -> Declarations:
    said: Declarations = read_header_file(header) if header is not None else {}
    return said | {key: Declaration(v, "command line") for key, v in (overrides or {}).items()}


def _points(survey: Survey, point: SurveyPoint, said: Declarations) -> Iterator[TracePoint]:
    if point.discarded:
        return
    edits = _edited(point)
    records = [drop.read() for drop in point.drops if not drop.discarded]
    for declared, group in groupby(records, key=lambda record: dict(record.declared)):
        same = [replace(record, declared=declared | edits) for record in group]
        yield _point(os.fspath(survey.folder), point.title, same, said)


def _edited(point: SurveyPoint) -> dict[str, Any]:
    """What was said of a point later, as keys of a header; the last counts."""
    edits: dict[str, Any] = {}
    for edit in point.edits:
        what, value = edit["what"], edit.get("value")
        if what in ("declared", "position") and isinstance(value, dict):
            edits |= value
        elif what == "operator" and value is not None:
            edits["operator"] = value
    return edits


def _point(file: str, title: str, records: list[DropRecord], said: Declarations) -> TracePoint:
    where = f"{file}, point {title}"
    declared = {"point": title, **records[0].declared}
    declared["point"] = title
    known = {key: Declaration(value, where) for key, value in declared.items()}
    setup = setup_from(known | said, where)
    drops = tuple(record.drop for record in records)
    return TracePoint(file, setup, drops, setup_warnings(setup))


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
