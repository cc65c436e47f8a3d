"""Draft of a column map for a delimited text, inferred from its delimiters, column names and units.

The draft may be wrong: the user checks it and adds what is missing, such as the distance of a
sensor that no column name states.
"""

import csv
import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pfwd.errors import TraceError, refusal
from pfwd.files.foreign.column_map import COLUMN_UNITS, TextLayout
from pfwd.files.foreign.common import decoded
from pfwd.files.foreign.laboratory import NamedColumn, laboratory_format, read_laboratory
from pfwd.files.toml import toml_line
from pfwd_plugins.quantities import MOTIONS, Measurand

Role = Literal["time", "load", "sensor", "drop", "none"]

DRAFT_BYTES = 200_000
"""Number of bytes at the beginning of the text from which the draft is inferred."""

_TRIED_DELIMITERS = (";", "\t", ",", "|", None)
"""Delimiters in the order in which they are tried; None: one or more blanks."""

_NUMBER_CELL = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")

_ROLE_PATTERNS: tuple[tuple[Role, str], ...] = (
    ("drop", r"\b(drop|blow|shot|stoss|stoß|schlag|chute|coup|锤|次)"),
    ("load", r"(force|load|kraft|last|charge|\bf\b|荷载|力)"),
    ("time", r"(time|zeit|temps|\bt\b|时间)"),
    (
        "sensor",
        r"(geophon|sensor|defl|displ|weg|setzung|verschieb|velocity|geschwind|tassement|"
        r"\b[sdvw]\d*\b|\bg\d+\b|沉降|位移|速度)",
    ),
)
"""Patterns of column names for each role of a column, the least ambiguous first."""

_UNIT = re.compile(r"[\[(/,]\s*([A-Za-zµμ]+(?:/s)?)\s*[\])]?\s*$|\b([A-Za-zµμ]+(?:/s)?)\s*$")
_DISTANCE = re.compile(r"@?\s*([+-]?\d+(?:[.,]\d+)?)\s*(mm|cm|m)\b")
_CENTRE_NAME = re.compile(r"(cent(er|re)|mitte|\b[sdvw]0\b|中心)", re.IGNORECASE)

_UNIT_SPELLINGS = {
    "µm": "um",
    "μm": "um",
    "µs": "us",
    "μs": "us",
    "sec": "s",
    "msec": "ms",
    "kn": "kN",
    "n": "N",
    "lb": "lbf",
    "kips": "kip",
    "mils": "mil",
    "inch": "in",
}


@dataclass(frozen=True, slots=True)
class DraftColumn:
    """Column with its presumed role."""

    position: int
    """Position from 1."""
    name: str
    """Name in the file; empty: the file has no names."""
    role: Role = "none"
    unit: str | None = None
    """Unit of the numbers; None: not recognised."""
    quantity: Measurand = Measurand.DISPLACEMENT
    """Quantity, if the column is a sensor."""
    offset: float | None = None
    """Distance of a sensor from the plate centre, m; None: the name does not state it."""


@dataclass(frozen=True, slots=True)
class MapDraft(TextLayout):
    """Presumed layout of a text and presumed roles of its columns."""

    columns: tuple[DraftColumn, ...]
    plate_radius: float | None = None
    """Plate radius, m, entered by the user; None: not entered. The texts do not state it."""
    trigger: float = 0.0
    """Time of the trigger by the clock of the file, s."""
    form: str = ""
    """Name of the format of a laboratory program; empty: the file is a text."""

    def with_column(self, column: DraftColumn) -> "MapDraft":
        """Return the draft with the description of one column replaced."""
        columns = tuple(column if c.position == column.position else c for c in self.columns)
        return replace(self, columns=columns)

    @property
    def missing(self) -> list[str]:
        """Entries that the map still needs, as phrases such as "the unit of F"."""
        roles = [column.role for column in self.columns]
        gaps = [f"which column is the {role}" for role in ("time", "load") if role not in roles]
        if "sensor" not in roles:
            gaps.append("which column is a sensor")
        for column in self.columns:
            if column.role in ("time", "load", "sensor") and column.unit is None:
                gaps.append(f"the unit of {column.name or column.position}")
            if column.role == "sensor" and column.offset is None:
                gaps.append(f"the distance of {column.name or column.position} from the centre")
        return gaps


def draft_map(file: str | os.PathLike[str]) -> MapDraft:
    """Infer the layout of a text and the roles of its columns.

    Parameters
    ----------
    file : path of the text

    Raises
    ------
    TraceError
        If the text cannot be read, or has no rows of numbers.
    """
    path = os.fspath(file)
    try:
        if not stat.S_ISREG(os.stat(path).st_mode) and not os.path.isdir(path):
            hint = "save the text as a file first: pfwd import reads it again"
            raise TraceError(refusal(path, "a file", "a pipe or a device", hint))
        with open(path, "rb") as stream:
            data = stream.read(DRAFT_BYTES)
            if len(data) == DRAFT_BYTES:
                data = data[: data.rfind(b"\n") + 1]  # the limit cuts the last line off
    except OSError as err:
        raise TraceError(refusal(path, "a readable text", err.strerror or str(err))) from err
    form = laboratory_format(data)
    if form is not None:
        channels = read_laboratory(path, form)
        columns: list[DraftColumn] = []
        for position, channel in enumerate(channels, start=1):
            columns.append(_column(position, channel.name, channel.unit, columns))
        trigger = _trigger(channels, columns)
        layout = path, ",", ".", "utf-8", 0, True, False
        return MapDraft(*layout, tuple(columns), trigger=trigger, form=form.name)
    text, encoding = _decoded(data, path)
    lines = text.splitlines()
    best: tuple[int, int, MapDraft] | None = None
    for delimiter in _TRIED_DELIMITERS:
        for decimal in (".", ","):
            if delimiter == decimal:
                continue
            reading = _as_table(path, lines, delimiter, decimal, encoding)
            # The trial with the most numbers is right: a wrong delimiter gives fewer columns.
            if reading is not None and (best is None or reading[:2] > best[:2]):
                best = reading
    if best is None:
        hint = "save a workbook as CSV first" if data[:2] == b"PK" else ""
        raise TraceError(refusal(path, "rows of two or more numbers", "none", hint))
    return best[2]


def _trigger(channels: Sequence[NamedColumn], columns: Sequence[DraftColumn]) -> float:
    """Return the time at which the load first exceeds a tenth of its peak; 0 without a load."""
    places = {column.role: column.position - 1 for column in columns}
    if "load" not in places or "time" not in places:
        return 0.0
    load = channels[places["load"]].values
    load = load - np.median(load)
    first = int(np.argmax(np.abs(load) > 0.1 * np.abs(load).max()))
    unit = COLUMN_UNITS["time"][columns[places["time"]].unit or "s"]
    return float(channels[places["time"]].values[first]) * unit


def _decoded(data: bytes, path: str) -> tuple[str, str]:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace"), "utf-16"
    if b"\0" in data:
        hint = "save a workbook as CSV first" if data[:2] == b"PK" else ""
        raise TraceError(refusal(path, "a text", "binary data", hint))
    return decoded(data)


def _as_table(
    path: str, lines: Sequence[str], delimiter: str | None, decimal: str, encoding: str
) -> tuple[int, int, MapDraft] | None:
    """Read the lines with one delimiter and one decimal sign.

    Returns
    -------
    tuple of int, int and MapDraft, or None
        Count of numbers, count of columns, and draft; None: the lines have no rows of numbers.
    """
    rows = [_cells(line, delimiter) for line in lines]
    numeric = [_is_numeric(row, decimal) for row in rows]
    first = next((i for i, is_number_row in enumerate(numeric) if is_number_row), None)
    if first is None:
        return None
    width = len(rows[first])
    body = [
        row
        for row, is_number_row in zip(rows, numeric, strict=True)
        if is_number_row and len(row) == width
    ]
    above = [i for i in range(first) if any(cell.strip() for cell in rows[i])]
    fitting = [i for i in above if len(rows[i]) == width]
    last = rows[fitting[-1]] if fitting else ()
    n_units = sum(_unit_of(cell.strip("[]() "), None) is not None for cell in last if cell)
    units_line = len(fitting) > 1 and n_units >= 2
    head = fitting[-2] if units_line else fitting[-1] if fitting else None
    names = rows[head] if head is not None else [""] * width
    units = rows[fitting[-1]] if units_line else [""] * width
    columns: list[DraftColumn] = []
    for position, (name, unit) in enumerate(zip(names, units, strict=True), start=1):
        columns.append(_column(position, name.strip(), unit.strip("[]() "), columns))
    draft = MapDraft(
        file=path,
        delimiter=delimiter,
        decimal=decimal,
        encoding=encoding,
        skip_lines=first if head is None else head,
        names=head is not None,
        units_line=units_line,
        columns=tuple(columns),
    )
    return len(body) * width, width, draft


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _is_numeric(row: Sequence[str], decimal: str) -> bool:
    grouping_sign = "," if decimal == "." else "."
    cells = [cell for cell in row if cell]
    return len(cells) > 1 and all(
        _NUMBER_CELL.fullmatch(cell) is not None and grouping_sign not in cell for cell in cells
    )


def _column(position: int, name: str, unit: str, before: Sequence[DraftColumn]) -> DraftColumn:
    unit_text = unit
    if not unit_text:
        match = _UNIT.search(name)
        unit_text = next((part for part in match.groups() if part), "") if match else ""
    assigned = {column.role for column in before}
    roles = [role for role, words in _ROLE_PATTERNS if re.search(words, name, re.IGNORECASE)]
    role: Role = next((r for r in roles if r == "sensor" or r not in assigned), "none")
    if role == "none":
        # The name matches no pattern, so the unit decides.
        by_unit = [
            "sensor" if kind in MOTIONS else kind
            for kind in COLUMN_UNITS
            if _unit_of(unit_text, kind) is not None
        ]
        free: list[Role] = [r for r in ("time", "load") if r in by_unit and r not in assigned]
        role = free[0] if free else "sensor" if "sensor" in by_unit else "none"
    if role not in ("time", "load", "sensor"):
        return DraftColumn(position, name, role)
    if role != "sensor":
        return DraftColumn(position, name, role, _unit_of(unit_text, role))
    named = (quantity for quantity in MOTIONS if _unit_of(unit_text, quantity) is not None)
    quantity = next(named, Measurand.DISPLACEMENT)
    first = not any(column.role == "sensor" for column in before)
    return DraftColumn(
        position, name, role, _unit_of(unit_text, quantity), quantity, _offset(name, first=first)
    )


def _unit_of(text: str, kind: str | None) -> str | None:
    """Return the unit that a text names; None: it names none of this kind of quantity."""
    spelling = _UNIT_SPELLINGS.get(text, _UNIT_SPELLINGS.get(text.lower(), text))
    tables = COLUMN_UNITS.values() if kind is None else (COLUMN_UNITS[kind],)
    return spelling if any(spelling in table for table in tables) else None


def _offset(name: str, *, first: bool) -> float | None:
    """Return the distance of a sensor from the plate centre that its column name states, m.

    Without one, it is 0 for the first sensor and None (not known) for the others.
    """
    if _CENTRE_NAME.search(name):
        return 0.0
    match = _DISTANCE.search(name)
    if match is not None:
        scale = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[match[2]]
        return round(float(match[1].replace(",", ".")) * scale, 6)
    return 0.0 if first else None


def map_text(draft: MapDraft) -> str:
    """Return a draft as the text of a column map; unknown values are written as comments."""
    delimiter = {None: "blank", "\t": "tab"}.get(draft.delimiter, draft.delimiter)
    name = os.path.basename(draft.file)
    lines = [f"# Draft of a column map for {_plain(name)}. Check every entry."]
    lines += ["# Every key is explained in examples/column-map.toml.", ""]
    if draft.plate_radius is not None:
        lines.append(toml_line("plate_radius_m", draft.plate_radius))
    else:
        lines.append("# plate_radius_m = 0.15   # not in the file: declare it here or in --header")
    if not draft.form:
        lines += ["", "[text]", toml_line("delimiter", delimiter)]
        lines += [toml_line("decimal", draft.decimal), toml_line("encoding", draft.encoding)]
        lines += [toml_line("skip_lines", draft.skip_lines), toml_line("names", draft.names)]
        lines.append(toml_line("units_line", draft.units_line))
    for column in draft.columns:
        if column.role == "none":
            title = column.name or "no name"
            lines += ["", f"# column {column.position} ({_plain(title)}) is not used"]
        else:
            lines += ["", *_column_lines(column)]
        if column.role == "time" and draft.trigger:
            lines.append(toml_line("trigger_s", round(draft.trigger, 9)))
    return "\n".join(lines) + "\n"


def _column_lines(column: DraftColumn) -> list[str]:
    lines = ["[[sensor]]" if column.role == "sensor" else f"[{column.role}]"]
    lines.append(toml_line("column", column.name or column.position))
    if column.role == "drop":
        return lines
    if column.role == "sensor":
        lines.append(toml_line("quantity", column.quantity))
    kind = column.quantity if column.role == "sensor" else column.role
    if column.unit is None:
        units = ", ".join(COLUMN_UNITS[kind])
        lines.append(f"# unit = ?   # one of {units}; or factor = SI units per number")
    else:
        lines.append(toml_line("unit", column.unit))
    if column.role == "sensor":
        if column.offset is None:
            lines.append("# offset_m = ?   # distance from the centre of the plate, m")
        else:
            lines.append(toml_line("offset_m", column.offset))
    if column.role != "time":
        lines.append('positive = "down"   # "up" if the numbers decrease when the plate moves down')
    return lines


def _plain(text: str) -> str:
    """Return a text that fits into a comment of one line."""
    return "".join(letter if letter.isprintable() else " " for letter in text)[:80]
