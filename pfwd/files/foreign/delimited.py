"""Reader of a delimited text that a column map (:mod:`.column_map`) describes."""

import csv
from array import array
from collections.abc import Iterator, Sequence
from typing import TextIO

import numpy as np

from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.column_map import Column, ColumnMap, read_map
from pfwd.files.foreign.common import Request, Values, even_time, make_drop, point_of
from pfwd.files.foreign.laboratory import (
    FORMAT_BYTES,
    LaboratoryFormat,
    laboratory_format,
    read_laboratory,
)
from pfwd.files.plausible_units import refuse_wrong_units
from pfwd.files.traces import TracePoint, numbered_lines, refuse_long, split_drops
from pfwd_device import Drop

MAX_TEXT_COLUMNS = 1024
"""Number of columns of a line that are read; further ones are ignored."""


def read(file: str, request: Request) -> list[TracePoint]:
    """Read the test point of a delimited text.

    Parameters
    ----------
    file : str
        Path of the text.
    request : Request
        With a column map. Its declarations override those of the map.

    Raises
    ------
    TraceError
        If the map or the text is refused.
    """
    if request.column_map is None:
        raise TraceError(refusal(file, "a column map", "none", "give --map FILE.toml"))
    columns = read_map(request.column_map)
    with open(file, "rb") as stream_of_bytes:
        form = laboratory_format(stream_of_bytes.read(FORMAT_BYTES))
    if form is not None:
        table, lines = _channels(file, form, columns)
        return [_point(table, lines, file, columns, request)]
    try:
        with open(file, encoding=columns.encoding, newline=None) as stream:
            table, lines = _numbers(stream, file, columns)
    except UnicodeError as err:
        hint = f"declare text.encoding in {columns.file}"
        raise TraceError(refusal(file, f"text in {columns.encoding}", str(err), hint)) from err
    return [_point(table, lines, file, columns, request)]


def _point(
    table: Values, lines: Sequence[int], file: str, columns: ColumnMap, request: Request
) -> TracePoint:
    drops = _drops(table, lines, file, columns)
    merged = Request(
        columns.declarations | request.declarations, request.channels, request.column_map
    )
    point = point_of(file, {}, drops, merged)
    hint = f"are the units of time, load and sensors in {columns.file} those of the columns?"
    refuse_wrong_units(drops, point.setup, file, hint)
    return point


def _channels(
    file: str, form: LaboratoryFormat, columns: ColumnMap
) -> tuple[Values, Sequence[int]]:
    """Return the columns of the map from a laboratory file; as `_numbers`."""
    channels = read_laboratory(file, form)
    parts = _parts(columns)
    positions = [_place(part, [channel.name for channel in channels], file) for part in parts]
    if max(positions) >= len(channels):
        expected = f"at least {max(positions) + 1} channels"
        raise TraceError(refusal(file, expected, str(len(channels))))
    table = np.stack([channels[position].values for position in positions], axis=1)
    return _in_si_units(table, parts), range(1, len(table) + 1)


def _in_si_units(table: Values, parts: Sequence[Column]) -> Values:
    """Return the columns times their factors; numbers that become infinite are refused later."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(table * np.array([part.factor for part in parts]))


def _parts(columns: ColumnMap) -> list[Column]:
    """Return the columns that a map uses, in the order time, load, sensors, drop number."""
    parts = [part for part in (columns.time, columns.load) if part is not None]
    parts += [sensor.where for sensor in columns.sensors]
    if columns.drop is not None:
        parts.append(Column(columns.drop, 1.0))
    return parts


def _numbers(stream: TextIO, file: str, columns: ColumnMap) -> tuple[Values, Sequence[int]]:
    """Read the columns of the map.

    Returns
    -------
    values : (rows, columns) ndarray of float, SI
        In the order time, load, sensors, drop number; time and drop number may be missing.
    lines : sequence of int
        Line of each row in the file, from 1.
    """
    lines = _cells(stream, file, columns)
    names: list[str] = []
    for _ in range(columns.skip_lines):
        next(lines, None)
    if columns.names:
        number, names = next(lines, (0, []))
        if columns.units_line:
            next(lines, None)
        if not number:
            raise TraceError(refusal(file, "a line with names", "the end of the file"))
    parts = _parts(columns)
    positions = [_place(part, names, file) for part in parts]
    refuse_long(file, len(positions))
    table, line_numbers = array("d"), array("q")  # lists would take six times the memory
    for number, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{file}, line {number}"
        if len(cells) <= max(positions):
            expected = f"at least {max(positions) + 1} columns"
            raise TraceError(refusal(where, expected, f"{len(cells)}: {quote(' '.join(cells))}"))
        table.extend([_number(cells[position], columns, where) for position in positions])
        line_numbers.append(number)
    if not table:
        raise TraceError(refusal(file, "rows of numbers", "the end of the file"))
    return _in_si_units(np.frombuffer(table).reshape(-1, len(positions)), parts), line_numbers


def _cells(stream: TextIO, file: str, columns: ColumnMap) -> Iterator[tuple[int, list[str]]]:
    for number, text in numbered_lines(stream, file):
        if columns.delimiter is None:
            cells = text.split()
        else:
            try:
                cells = next(csv.reader([text.rstrip("\n")], delimiter=columns.delimiter), [])
            except csv.Error as err:
                raise TraceError(refusal(f"{file}, line {number}", "cells", str(err))) from err
        yield number, cells[:MAX_TEXT_COLUMNS]


def _place(column: Column, names: list[str], file: str) -> int:
    if isinstance(column.column, int):
        return column.column - 1
    positions = [index for index, name in enumerate(names) if name.strip() == column.column]
    if len(positions) != 1:
        expected = f"one column named {quote(column.column)}"
        actual = f"columns {', '.join(quote(name.strip()) for name in names[:20])}"
        hint = "is text.delimiter right?" if len(names) < 2 else ""
        actual = f"{len(positions)}" if positions else actual
        raise TraceError(refusal(file, expected, actual, hint))
    return positions[0]


def _number(cell: str, columns: ColumnMap, where: str) -> float:
    text = cell.strip()
    if columns.decimal == ",":
        text = text.replace(",", ".")
    try:
        if "_" in text:  # Python reads 1_000 as a number, other programs do not
            raise ValueError
        return float(text)
    except ValueError:
        hint = "is text.decimal right?" if "," in cell or "." in cell else ""
        raise TraceError(refusal(where, "a number", quote(cell.strip()), hint)) from None


def _drops(table: Values, lines: Sequence[int], file: str, columns: ColumnMap) -> list[Drop]:
    numbers = table[:, -1] if columns.drop is not None else np.ones(len(table))
    drops = []
    for number, start, end in split_drops(numbers, file, lambda row: f"{file}, line {lines[row]}"):
        where = f"{file}, line {lines[start]}, drop {number}"
        rows = table[start:end]
        if columns.time is not None:
            time = even_time(rows[:, 0] - columns.trigger, where)
            rows = rows[:, 1:]
        else:
            assert columns.rate is not None
            time = np.arange(len(rows)) / columns.rate - columns.trigger
        sensors = [
            (sensor.offset, sensor.quantity, rows[:, 1 + index])
            for index, sensor in enumerate(columns.sensors)
        ]
        drops.append(make_drop(number, time, rows[:, 0], sensors, where))
    return drops
