"""Reads the test points of whatever a command is given: a survey, one of its drop files, traces,
files of other programs."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from typing import Any

from inversion.notices import Notice
from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_survey
from pfwd.files.foreign.common import Channels, Request
from pfwd.files.foreign.registry import TEXT, find_format, read_foreign
from pfwd.files.header import (
    Declaration,
    Declarations,
    read_header_file,
    setup_from,
    setup_warnings,
)
from pfwd.files.survey_file import is_survey_file, read_survey_file
from pfwd.files.traces import TracePoint, is_trace_file, read_traces
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, SurveyPoint, read_drop_file, read_survey
from pfwd_device.recording.survey_content import SurveyContent

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_points(
    path: str | os.PathLike[str],
    header: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, object] | None = None,
    *,
    column_map: str | os.PathLike[str] | None = None,
    channels: Channels | None = None,
) -> list[TracePoint]:
    """The test points of a survey, exported or not, a drop file, a trace file or a foreign one.

    Discarded drops and points are left out. Drops of a point that were declared differently (the
    plate was changed) come as two points.

    Parameters
    ----------
    path : path of a survey folder, an exported survey or a drop file (.h5), a trace file, or a file
        of another program
    header : path of a TOML file, optional
        Its keys win over what is declared.
    overrides : mapping of header key to value, optional
        Win over both.
    column_map : path of a TOML file, optional
        Says what the columns of a text hold that is no trace file.
    channels : "raw" or "stored", optional
        Which channels are taken of a file that has both; not said: the raw ones.

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
            return _survey_points(read_survey(file), _said(header, overrides))
        if is_hdf5(file) and is_survey_file(file):
            return _survey_points(read_survey_file(file), _said(header, overrides))
        if is_hdf5(file):
            record = read_drop_file(file)
            return [_point(file, record.point, [record], _said(header, overrides))]
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    form = find_format(file)
    if form is None and column_map is not None and not is_trace_file(file):
        form = TEXT
    if form is None:
        return [read_traces(path, header, overrides)]
    wanted = Request(
        _said(header, overrides), channels, None if column_map is None else os.fspath(column_map)
    )
    return read_foreign(form, file, wanted)


def survey_content(path: str | os.PathLike[str]) -> SurveyContent:
    """What a survey holds, in its folder or exported.

    Raises
    ------
    SurveyError
        If it is no survey, or cannot be read.
    """
    file = os.fspath(path)
    try:
        if is_survey(file):
            return read_survey(file)
        if is_hdf5(file) and is_survey_file(file):
            return read_survey_file(file)
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    came = "another folder" if os.path.isdir(file) else "another file"
    came = came if os.path.exists(file) else "no such file or folder"
    hint = "pfwd import makes a survey of other files"
    raise SurveyError(refusal(file, "a survey, or one that was exported as h5", came, hint))


def _survey_points(survey: SurveyContent, said: Declarations) -> list[TracePoint]:
    file = survey.path
    points = [trace for point in survey.points for trace in points_of(file, point, said)]
    if not points:
        what = "all are discarded" if survey.drops else "none"
        hint = f"; damage: {'; '.join(survey.damage)}" if survey.damage else ""
        raise SurveyError(refusal(file, "a survey with drops", what) + hint)
    # Nothing is lost in silence.
    lost = tuple(Notice("survey-damaged", {"damage": text}) for text in survey.damage)
    points[0] = replace(points[0], warnings=(*points[0].warnings, *lost))
    return points


def is_hdf5(file: str | os.PathLike[str]) -> bool:
    """Whether a file begins like HDF5."""
    if not os.path.isfile(file):
        return False  # a pipe may wait for ever
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


def points_of(
    file: str, point: SurveyPoint, said: Declarations | None = None
) -> Iterator[TracePoint]:
    """The drops of a point that are not discarded; declared differently, as points of their own."""
    if point.discarded:
        return
    edits = _edited(point)
    records = [(drop.read(), drop) for drop in point.drops if not drop.discarded]
    for declared, group in groupby(records, key=lambda read: dict(read[0].declared)):
        found = list(group)
        same = [replace(record, declared=declared | edits) for record, _ in found]
        kept = tuple(drop for _, drop in found)
        yield replace(_point(file, point.title, same, said or {}), kept=kept)


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
    return TracePoint(file, setup, drops, setup_warnings(setup, drops))
