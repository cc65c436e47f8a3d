"""``xlsx``: a workbook with the job, the points, the drops and what was noted; numbers are numbers,
dates are dates."""

import datetime
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from openpyxl import Workbook
from openpyxl.cell import WriteOnlyCell
from openpyxl.styles import Font, PatternFill
from openpyxl.utils import get_column_letter

from pfwd.analysis.result_columns import ResultColumn
from pfwd.export.columns import COLUMNS
from pfwd.export.output import new_file
from pfwd.export.point_rows import POINT_COLUMNS, PointValues, point_rows
from pfwd.export.rows import LONGEST_CELL, Order, Row
from pfwd.export.tables import FORMULA
from pfwd_device.recording.drop_file import software_version
from pfwd_device.recording.survey_content import SurveyContent
from pfwd_device.text import clean

_DATE = "yyyy-mm-dd hh:mm:ss"
_FORMATS = {
    **dict.fromkeys(("latitude", "longitude"), "0.0000000"),
    **dict.fromkeys(("chainage_m", "altitude_m"), "0.00"),
}
_BY_UNIT = (
    *(("_pa", "#,##0"), ("_n", "#,##0"), ("_pa_s", "#,##0"), ("_n_per_m", "#,##0")),
    *(("_m", "0.000000"), ("_s", "0.00000"), ("_kg_m3", "#,##0")),
)
_WIDEST, _NARROWEST = 40, 9
"""Letters; of a column."""

_HEAD = PatternFill("solid", fgColor="DDE6EF")
_BOLD = Font(bold=True)


def write_xlsx(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the sheets ``job``, ``points``, ``drops`` and ``notes``; discarded ones are marked."""
    points = point_rows(order)
    book = Workbook(write_only=True)  # a survey of many drops would fill the memory
    _add(book, "job", ("key", "value", "time_utc"), _job(order.content, order.rows, points))
    _add_rows(book, "points", POINT_COLUMNS, (list(row.values()) for row in points))
    cells = ([row.values[column.name] for column in COLUMNS] for row in order.rows)
    _add_rows(book, "drops", COLUMNS, cells)
    _add(book, "notes", ("point", "drop", "what", "text", "time_utc"), _notes(order.content))
    book.properties.creator = f"pfwd {software_version()}"
    book.properties.title = clean(order.content.path, limit=LONGEST_CELL)
    with new_file(path, force=order.force) as draft:
        book.save(draft)
    return []


def _add_rows(
    book: Any, title: str, columns: Sequence[ResultColumn], rows: Iterable[Sequence[Any]]
) -> None:
    """A sheet of rows, each cell as its column's kind."""
    kinds = [column.kind for column in columns]
    formats = [_format(column) for column in columns]
    names = [column.name for column in columns]
    made = (
        [_cell(value, kind, form) for value, kind, form in zip(row, kinds, formats, strict=True)]
        for row in rows
    )
    _fill(book, title, names, made)


def _add(book: Any, title: str, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    kinds = ["time" if name.startswith("time") else "text" for name in names]
    made = ([_cell(v, kind, None) for v, kind in zip(row, kinds, strict=True)] for row in rows)
    _fill(book, title, names, made)


def _fill(book: Any, title: str, names: Sequence[str], rows: Iterable[Sequence["_Value"]]) -> None:
    sheet = book.create_sheet(title)
    sheet.freeze_panes = "B2"
    rows = list(rows)
    for number, name in enumerate(names, 1):
        widths = [len(name), *(row[number - 1].width for row in rows[:200])]
        width = min(_WIDEST, max(_NARROWEST, *widths)) + 2
        sheet.column_dimensions[get_column_letter(number)].width = width
    head = []
    for name in names:
        cell = WriteOnlyCell(sheet, value=name)
        cell.font, cell.fill = _BOLD, _HEAD
        head.append(cell)
    sheet.append(head)
    for row in rows:
        sheet.append([value.in_sheet(sheet) for value in row])
    sheet.auto_filter.ref = f"A1:{get_column_letter(len(names))}{len(rows) + 1}"


class _Value:
    """A value, its kind of cell, and how it is shown."""

    __slots__ = ("_form", "_value", "width")

    def __init__(self, value: Any, form: str | None) -> None:
        self._value, self._form = value, form
        self.width = 12 if isinstance(value, int | float) else len(str(value or ""))

    def in_sheet(self, sheet: Any) -> Any:
        """As the sheet takes it."""
        if self._value is None:
            return None
        cell = WriteOnlyCell(sheet, value=None)
        if isinstance(self._value, str):
            # Never a formula, whatever a note begins with.
            cell.value, cell.data_type = self._value, "s"
            cell.quotePrefix = self._value.lstrip(" ").startswith(FORMULA)
        else:
            cell.value = self._value
        if self._form is not None:
            cell.number_format = self._form
        return cell


def _cell(value: Any, kind: str, form: str | None) -> _Value:
    if isinstance(value, list | tuple):
        value = "; ".join(map(str, value)) or None
    if kind == "time" and isinstance(value, str):
        moment = as_date(value)
        if moment is not None:
            return _Value(moment, _DATE)
    if isinstance(value, str):
        return _Value(clean(value, limit=LONGEST_CELL), None)
    return _Value(value, form if isinstance(value, float) else None)


def as_date(text: str) -> datetime.datetime | None:
    """A moment as a spreadsheet has it: without a zone, to the second; None: it is none.

    Examples
    --------
    >>> as_date("2024-05-06T08:01:00.123+00:00")
    datetime.datetime(2024, 5, 6, 8, 1)
    """
    try:
        found = datetime.datetime.fromisoformat(text)
    except ValueError:
        return None
    return found.replace(tzinfo=None, microsecond=0)


def _format(column: ResultColumn) -> str | None:
    if column.name in _FORMATS:
        return _FORMATS[column.name]
    ends = [(suffix, form) for suffix, form in _BY_UNIT if column.name.endswith(suffix)]
    return max(ends, key=lambda end: len(end[0]))[1] if ends else None


def _job(
    content: SurveyContent, drops: Sequence[Row], points: Sequence[PointValues]
) -> Iterator[tuple[Any, Any, Any]]:
    """What the survey is, how its points stand, and every change of its job with its date."""

    def several(key: str) -> str:
        return ", ".join(dict.fromkeys(str(v) for r in drops if (v := r.values[key]) is not None))

    moments = sorted(str(v) for row in drops if (v := row.values["time_utc"]) is not None)
    verdicts = Counter(str(row["verdict"]) for row in points)
    procedures = dict.fromkeys(str(v) for r in points if (v := r["procedure"]) is not None)
    yield "survey", content.path, None
    yield "survey_id", content.survey_id, None
    yield "made_by", f"pfwd {software_version()}", None
    yield "exported", None, datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    for key in ("site", "operator", "device"):
        yield key, several(key) or None, None
    yield "procedure", ", ".join(procedures) or None, None
    yield "first_drop", None, moments[0] if moments else None
    yield "last_drop", None, moments[-1] if moments else None
    yield "points", len(points), None
    yield "drops", len(drops), None
    for verdict in ("pass", "fail", "undecided", "none"):
        yield f"points_{verdict}", verdicts[verdict], None
    for event in content.events:
        if event.get("event") in ("procedure", "job"):
            details = event.get("details", {})
            said = {key: value for key, value in details.items() if key != "text"}
            text = json.dumps(said, ensure_ascii=False, default=str)
            yield f"change: {event['event']}", text, _moment(event)


def _notes(content: SurveyContent) -> Iterator[tuple[Any, ...]]:
    """Every note and every edit, the latter with its date where it has one."""
    for point in content.points:
        for edit in point.edits:
            yield point.title, None, edit.get("what"), _said(edit.get("value")), _moment(edit)
        for drop in point.drops:
            for edit in drop.edits:
                said = _said(edit.get("value"))
                yield point.title, drop.drop, edit.get("what"), said, _moment(edit)


def _said(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return json.dumps(value, ensure_ascii=False, default=str)


def _moment(said: Any) -> str | None:
    return next((str(said[key]) for key in ("time_utc", "time") if said.get(key)), None)
