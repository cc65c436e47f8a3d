"""Format ``xlsx``: a workbook with the job, the points, the drops, the notes and a chart.

Numbers are in engineering units (MPa, kN, µm, mm, ms), and dates are dates of the spreadsheet.
"""

import datetime
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from openpyxl import Workbook
from openpyxl.cell import WriteOnlyCell
from openpyxl.chart import LineChart, Reference
from openpyxl.chart.axis import ChartLines
from openpyxl.styles import Font, PatternFill
from openpyxl.utils import get_column_letter

from pfwd.analysis.result_columns import ResultColumn
from pfwd.export.columns import DROP_COLUMNS, POINT_COLUMNS
from pfwd.export.output import new_file
from pfwd.export.rows import MAX_CELL_CHARACTERS, Order, PointValues, point_rows
from pfwd.export.tables import FORMULA_STARTS
from pfwd.judging.job import JobChange, target_text
from pfwd_device.recording import Survey
from pfwd_device.recording.drop_file import software_version
from pfwd_device.text import clean

_DATE_FORMAT = "yyyy-mm-dd hh:mm:ss"


class _Unit(NamedTuple):
    """Engineering unit of a column."""

    name: str
    """Symbol of the unit in the title of a column."""
    factor: float
    """Number of these units in one SI unit."""
    number_format: str


_MEGAPASCAL = _Unit("MPa", 1e-6, "#,##0.0")
_METRE, _MILLIMETRE = _Unit("m", 1.0, "0.00"), _Unit("mm", 1e3, "0.00")
_MICROMETRE = _Unit("µm", 1e6, "#,##0.0")
_DEGREE = _Unit("°", 1.0, "0.0000000")
_NUMBER_FORMAT = "0.000"
"""Format of numbers without a unit."""

_UNIT_OF_NAME = {
    **dict.fromkeys(("latitude", "longitude"), _DEGREE),
    **dict.fromkeys(("chainage_m", "altitude_m"), _METRE),
    **dict.fromkeys(("modulus_depth_from_m", "modulus_depth_to_m"), _METRE),
    **dict.fromkeys(("sci_m", "bdi_m", "bci_m", "noise_rms_m"), _MICROMETRE),
}
_UNIT_OF_END = (
    ("_pa_s", _Unit("kPa·s", 1e-3, "#,##0.00")),
    ("_n_per_m", _Unit("kN/mm", 1e-6, "#,##0.00")),
    ("_kg_m3", _Unit("kg/m³", 1.0, "#,##0")),
    ("_pa", _MEGAPASCAL),
    ("_n", _Unit("kN", 1e-3, "0.00")),
    ("_s", _Unit("ms", 1e3, "0.00")),
    ("_m", _MILLIMETRE),
)
"""Units by the SI unit at the end of a column's name; the first end that matches is used."""

_JUDGED = ("value", "interval_low", "interval_high", "target")
"""Columns whose SI unit is in the column ``unit`` of the same row."""
_JUDGED_UNITS = {"Pa": _MEGAPASCAL, "m": _MILLIMETRE}

_TITLE_WORDS = {
    "sd": "standard deviation",
    "rms": "RMS",
    "utc": "UTC",
    "id": "ID",
    "r squared": "R²",
}
_TITLE_WORDS |= {name: name.upper() for name in ("sci", "bdi", "bci")}

_FIT_TITLES = {
    f"modulus_{name}": f"fitted_modulus_{name}"
    for name in ("pa", "sd_pa", "interval_low_pa", "interval_high_pa", "not_supported")
}
_POINT_TITLES = {
    **_FIT_TITLES,
    "use": "use_of_diagnosed_modulus",
    "use_reason": "reason_of_use",
    "equivalent_use": "use_of_equivalent_modulus",
}
_DROP_TITLES = {
    **_FIT_TITLES,
    **{name: f"point_{name}" for name in ("value", "interval_low", "interval_high", "unit")},
    **{name: f"point_{name}" for name in ("verdict", "value_not_supported", "modulus_source")},
    "target": "point_target",
    "target_pa": "declared_target_pa",
}
"""Names for the titles of columns, which distinguish the fit of a drop from the value of its point.
"""

_LAYER_COLUMNS = ("layers", "layer_", "effective_")
"""Beginnings of the names of columns that are left out if no drop has a value in them."""

_MAX_WIDTH_LETTERS, _MIN_WIDTH_LETTERS = 40, 9

_TITLE_FILL = PatternFill("solid", fgColor="DDE6EF")
_TITLE_FONT = Font(bold=True)


def write_xlsx(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the sheets ``job``, ``points``, ``drops``, ``notes`` and ``chart``.

    Discarded points and drops are marked.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        Empty, because nothing is omitted.
    """
    points = point_rows(order)
    book = Workbook(write_only=True)  # otherwise many drops would fill the memory
    _add(book, "job", ("key", "value", "time_utc"), _job(order, points))
    sheet = _add_rows(book, "points", POINT_COLUMNS, points, _POINT_TITLES)
    drops = [row.values for row in order.rows]
    columns = [
        column
        for column in DROP_COLUMNS
        if not column.name.startswith(_LAYER_COLUMNS)
        or any(drop[column.name] is not None for drop in drops)
    ]
    _add_rows(book, "drops", columns, drops, _DROP_TITLES)
    _add(book, "notes", ("point", "drop", "what", "text", "time_utc"), _notes(order.content))
    if points:
        _add_chart(book, sheet, len(points))
    book.properties.creator = f"pfwd {software_version()}"
    book.properties.title = clean(order.content.path, limit=MAX_CELL_CHARACTERS)
    with new_file(path, force=order.force) as draft:
        book.save(draft)
    return []


def _add_rows(
    book: Any,
    title: str,
    columns: Sequence[ResultColumn],
    rows: Iterable[Mapping[str, Any]],
    titles_by_name: Mapping[str, str] = MappingProxyType({}),
) -> Any:
    """Add a sheet of rows, each value with the type and the engineering unit of its column; return
    it.
    """
    units = {column.name: _unit(column) for column in columns}
    titles = [
        _title(titles_by_name.get(column.name, column.name), units[column.name])
        for column in columns
    ]
    cells = [
        [
            _cell(value, column.kind, unit.number_format if unit else _NUMBER_FORMAT)
            for column in columns
            for value, unit in [_in_unit(row, column.name, units[column.name])]
        ]
        for row in rows
    ]
    return _fill(book, title, titles, cells)


def _unit(column: ResultColumn) -> _Unit | None:
    """Return the engineering unit of a column of numbers; None: the column has none."""
    name = column.name
    if name in _UNIT_OF_NAME:
        return _UNIT_OF_NAME[name]
    if column.kind in ("whole", "text", "time", "flag"):
        return None
    if name.startswith("deflection_"):
        return _MICROMETRE
    if name.endswith("_m") and ("depth" in name or "altitude" in name):
        return _METRE
    return next((unit for end, unit in _UNIT_OF_END if name.endswith(end)), None)


def _title(name: str, unit: _Unit | None) -> str:
    """Return the title of a column: its name in words, and its unit."""
    if unit is not None:
        ends = (end for end, _ in _UNIT_OF_END if name.endswith(end))
        name = name.removesuffix(next(ends, ""))
    words = " ".join(_TITLE_WORDS.get(word, word) for word in name.split("_"))
    words = _TITLE_WORDS.get(words, words)
    text = words[:1].upper() + words[1:]
    return text if unit is None else f"{text} ({unit.name})"


def _in_unit(row: Mapping[str, Any], name: str, unit: _Unit | None) -> tuple[Any, _Unit | None]:
    """Return the value of a cell in its engineering unit, and that unit (None: no unit)."""
    value = row[name]
    if name == "unit" and value in _JUDGED_UNITS:
        return _JUDGED_UNITS[value].name, None
    if name in _JUDGED:
        unit = _JUDGED_UNITS.get(row["unit"])
    if name == "surface_moduli_pa" and value is not None:
        pairs = (text.split(": ") for text in value)
        return [f"{distance}: {float(modulus) * 1e-6:.4g}" for distance, modulus in pairs], unit
    if unit is not None and isinstance(value, int | float):
        value *= unit.factor
    return value, unit


def _add_chart(book: Any, points: Any, n_points: int) -> None:
    """Add a sheet with a chart of the modulus in force of each point and its interval."""
    names = [column.name for column in POINT_COLUMNS]
    chart = LineChart()
    chart.title = "Modulus in force and its 95 % interval"
    chart.width, chart.height = 30, 15  # cm
    chart.x_axis.title, chart.y_axis.title = "Point", "MPa"
    chart.x_axis.delete = chart.y_axis.delete = False  # otherwise some programs show no axes
    chart.y_axis.scaling.min = 0
    chart.hiLowLines = ChartLines()  # from the lower to the upper end of the interval
    marks = {"": "circle", "_interval_low": "dash", "_interval_high": "dash"}
    for part, mark in marks.items():
        column = names.index(f"modulus_in_force{part}_pa") + 1
        data = Reference(points, min_col=column, min_row=1, max_row=n_points + 1)
        chart.add_data(data, titles_from_data=True)
        series = chart.series[-1]
        series.marker.symbol = mark
        series.graphicalProperties.line.noFill = True
    chart.set_categories(Reference(points, min_col=1, min_row=2, max_row=n_points + 1))
    book.create_sheet("chart").add_chart(chart, "A1")


def _add(book: Any, title: str, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    kinds = ["time" if name.startswith("time") else "text" for name in names]
    made = ([_cell(v, kind, None) for v, kind in zip(row, kinds, strict=True)] for row in rows)
    _fill(book, title, [_title(name, None) for name in names], made)


def _fill(
    book: Any, title: str, names: Sequence[str], rows: Iterable[Sequence[tuple[Any, str | None]]]
) -> Any:
    """Add a sheet with a title row, which is frozen and has filters, and rows; return it."""
    sheet = book.create_sheet(title)
    sheet.freeze_panes = "B2"
    rows = list(rows)
    for number, name in enumerate(names, 1):
        values = [row[number - 1][0] for row in rows[:200]]
        widths = [len(name), *map(_width, values)]
        width = min(_MAX_WIDTH_LETTERS, max(_MIN_WIDTH_LETTERS, *widths)) + 2
        sheet.column_dimensions[get_column_letter(number)].width = width
    head = []
    for name in names:
        cell = WriteOnlyCell(sheet, value=name)
        cell.font, cell.fill = _TITLE_FONT, _TITLE_FILL
        head.append(cell)
    sheet.append(head)
    for row in rows:
        sheet.append([_in_sheet(sheet, *cell) for cell in row])
    sheet.auto_filter.ref = f"A1:{get_column_letter(len(names))}{len(rows) + 1}"
    return sheet


_Cell = tuple[Any, str | None]
"""Value of a cell and its number format."""


def _width(value: Any) -> int:
    """Return the width of a value, characters."""
    return 12 if isinstance(value, int | float) else len(str(value or ""))


def _in_sheet(sheet: Any, value: Any, form: str | None) -> Any:
    """Return a value as a cell of a sheet; None: the cell is empty."""
    if value is None:
        return None
    cell = WriteOnlyCell(sheet, value=None if isinstance(value, str) else value)
    if isinstance(value, str):
        # A text that begins like a formula is not evaluated.
        cell.value, cell.data_type = value, "s"
        cell.quotePrefix = value.lstrip(" ").startswith(FORMULA_STARTS)
    if form is not None:
        cell.number_format = form
    return cell


def _cell(value: Any, kind: str, form: str | None) -> _Cell:
    """Return the value of a cell and its number format."""
    if isinstance(value, list | tuple):
        value = "; ".join(map(str, value)) or None
    if kind == "time" and isinstance(value, str) and (moment := as_date(value)) is not None:
        return moment, _DATE_FORMAT
    if isinstance(value, str):
        return clean(value, limit=MAX_CELL_CHARACTERS), None
    return value, form if isinstance(value, float) else None


def as_date(text: str) -> datetime.datetime | None:
    """Return a time as a spreadsheet holds it: without time zone, in whole seconds; None: no time.

    Examples
    --------
    >>> as_date("2024-05-06T08:01:00.123+00:00")
    datetime.datetime(2024, 5, 6, 8, 1)
    """
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment.replace(tzinfo=None, microsecond=0)


_VERDICT_TITLES = {
    "pass": "Points that pass",
    "fail": "Points that fail",
    "undecided": "Points without a decision",
    "none": "Points without a verdict",
}

_CHANGE_TITLES = {
    "stations": "list of stations",
    "step_m": "step between stations",
    "units": "units on the screen",
    "time_zone": "time zone",
}
"""Names of the settings of a job whose key says less."""


def _job(order: Order, points: Sequence[PointValues]) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the rows of the sheet ``job``: facts of the survey, number of points with each verdict,
    dated changes of the job.
    """
    content, job, drops = order.content, order.job, order.rows

    def several(key: str) -> str:
        return ", ".join(dict.fromkeys(str(v) for r in drops if (v := r.values[key]) is not None))

    moments = sorted(str(v) for row in drops if (v := row.values["time_utc"]) is not None)
    verdicts = Counter(str(row["verdict"]) for row in points)
    procedure = None if job.procedure is None else job.procedure.name
    if job.procedure is not None and job.procedure.enforce_unverified:
        procedure = f"{procedure}; numbers that are not verified are enforced, too"
    yield "Survey", content.path, None
    yield "Survey ID", content.survey_id, None
    yield "Made by", f"pfwd {software_version()}", None
    yield "Exported", None, datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    for key in ("site", "operator", "device"):
        yield key.capitalize(), several(key) or None, None
    yield "Procedure", procedure, None
    yield "First drop", None, moments[0] if moments else None
    yield "Last drop", None, moments[-1] if moments else None
    yield "Points", len(points), None
    yield "Drops", len(drops), None
    for verdict, title in _VERDICT_TITLES.items():
        yield title, verdicts[verdict], None
    for change in job.changes:
        title = _CHANGE_TITLES.get(change.key, change.key)
        yield f"Change of the {title}", _change_text(change), change.time_utc or None


def _change_text(change: JobChange) -> str:
    """Return the new value of a setting of a job as text."""
    value = change.value
    if value is None:
        return "withdrawn"
    match change.key:
        case "target":
            return target_text(value)
        case "stations":
            return f"{len(value)} station{'s' if len(value) != 1 else ''}"
        case "calibration":
            return f"{len(value)} channel{'s' if len(value) != 1 else ''}"
        case "step_m":
            return f"{value:g} m"
        case "units":
            return {"si": "metric", "us": "US customary"}[value]
    return str(value)


def _notes(content: Survey) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the sheet ``notes``: all notes and edits with their dates."""
    for point in content.points:
        for edit in point.edits:
            yield point.title, None, edit.get("what"), _edit_text(edit.get("value")), _moment(edit)
        for drop in point.drops:
            for edit in drop.edits:
                text = _edit_text(edit.get("value"))
                yield point.title, drop.drop, edit.get("what"), text, _moment(edit)


def _edit_text(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return json.dumps(value, ensure_ascii=False, default=str)


def _moment(edit: Mapping[str, Any]) -> str | None:
    return next((str(edit[key]) for key in ("time_utc", "time") if edit.get(key)), None)
