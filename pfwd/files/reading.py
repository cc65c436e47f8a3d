"""Reading of test points from any supported file, and of surveys.

Supported are surveys, their drop files, trace files and the files of other programs.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from inversion.notices import Notice
from pfwd.errors import SurveyError, refusal
from pfwd.files.editing import later_declarations
from pfwd.files.folders import is_hdf5, is_survey_file
from pfwd.files.foreign.common import Channels, Request
from pfwd.files.foreign.registry import DELIMITED_TEXT, find_format, read_foreign
from pfwd.files.header import (
    Declaration,
    Declarations,
    declarations_of,
    setup_from,
    setup_warnings,
)
from pfwd.files.opening import survey_content
from pfwd.files.traces import TracePoint, is_trace_file, read_traces
from pfwd_device.errors import RecordingError
from pfwd_device.recording import (
    DropRecord,
    Survey,
    SurveyPoint,
    read_drop_file,
)


def read_points(
    path: str | os.PathLike[str],
    header: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, object] | None = None,
    *,
    column_map: str | os.PathLike[str] | None = None,
    channels: Channels | None = None,
) -> list[TracePoint]:
    """Read the test points of a survey, a drop file, a trace file or another program's file.

    Discarded drops and points are omitted. If consecutive drops of a point have different
    declarations, for instance because the plate was changed, the point is returned in parts, one
    for each set of declarations.

    Parameters
    ----------
    path : path of a survey folder, a survey in one file, a drop file (.h5), a trace file, or a file
        of another program
    header : path of a TOML file, optional
        Its keys override the declarations of the file.
    overrides : mapping of header key to value, optional
        Override those of the file and of the header.
    column_map : path of a TOML file, optional
        Describes the columns of a text that is no trace file.
    channels : "raw" or "stored", optional
        Channels to read from a file with two versions of each trace: as measured, or as the other
        program corrected them. None: as measured.

    Returns
    -------
    list of TracePoint

    Raises
    ------
    SurveyError
        If the file is refused.
    """
    file = os.fspath(path)
    declared = declarations_of(header, overrides)
    try:
        if os.path.isdir(file) or is_survey_file(file):
            return _survey_points(survey_content(file), declared)
        if is_hdf5(file):
            record = read_drop_file(file)
            return [_point(file, record.point, [record], declared)]
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    form = find_format(file)
    if form is None and column_map is not None and not is_trace_file(file):
        form = DELIMITED_TEXT
    if form is None:
        return [read_traces(path, declared, foreign=header is not None)]
    columns = None if column_map is None else os.fspath(column_map)
    return read_foreign(form, file, Request(declared, channels, columns))


def _survey_points(survey: Survey, declared: Declarations) -> list[TracePoint]:
    file = survey.path
    points = [trace for point in survey.points for trace in points_of(file, point, declared)]
    if not points:
        actual = "all are discarded" if survey.drops else "none"
        hint = f"; damage: {'; '.join(survey.damage)}" if survey.damage else ""
        raise SurveyError(refusal(file, "a survey with drops", actual) + hint)
    lost = tuple(Notice("survey-damaged", {"damage": text}) for text in survey.damage)
    points[0] = replace(points[0], warnings=(*points[0].warnings, *lost))
    return points


def points_of(
    file: str, point: SurveyPoint, declared: Declarations | None = None
) -> Iterator[TracePoint]:
    """Yield a point of a survey without its discarded drops, in parts of equal declarations.

    Parameters
    ----------
    file : str
        Path of the survey, for messages.
    point : SurveyPoint
        A discarded point yields nothing.
    declared : dict of header key to Declaration, optional
        Override the declarations of the survey.
    """
    if point.discarded:
        return
    edits = later_declarations(point, position=True)
    records = [(drop.read(), drop) for drop in point.drops if not drop.discarded]
    for recorded, group in groupby(records, key=lambda pair: dict(pair[0].declared)):
        edited, drops = zip(
            *((replace(record, declared=recorded | edits), drop) for record, drop in group),
            strict=True,
        )
        yield replace(_point(file, point.title, edited, declared or {}), survey_drops=drops)


def _point(
    file: str, title: str, records: Sequence[DropRecord], overrides: Declarations
) -> TracePoint:
    where = f"{file}, point {title}"
    values = {"point": title, **records[0].declared}
    values["point"] = title
    declared = {key: Declaration(value, where) for key, value in values.items()}
    setup = setup_from(declared | overrides, where)
    drops = tuple(record.drop for record in records)
    return TracePoint(file, setup, drops, setup_warnings(setup, drops))
