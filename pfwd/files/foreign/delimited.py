"""Delimited text of any program, read by a column map (:mod:`.column_map`)."""

import csv
import itertools
from array import array
from collections.abc import Iterator, Sequence
from typing import TextIO

import numpy as np

from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.column_map import Column, ColumnMap, read_map
from pfwd.files.foreign.common import Request, Values, even_time, make_drop, point_of
from pfwd.files.traces import (
    MAX_DROP_NUMBER,
    MAX_FILE_DROPS,
    MAX_LINE_CHARACTERS,
    TracePoint,
    refuse_long,
)
from pfwd_device import Drop

MOST_COLUMNS = 1024
Line = tuple[int, list[str]]


def read(file: str, request: Request) -> list[TracePoint]:
    """The test point of a text.

    Parameters
    ----------
    file : str
    request : Request
        With a column map. Its declarations win over those in the map.

    Raises
    ------
    TraceError
        If the map or the text is refused.
    """
    if request.column_map is None:
        raise TraceError(refusal(file, "a column map", "none", "give --map FILE.toml"))
    columns = read_map(request.column_map)
    try:
        with open(file, encoding=columns.encoding, newline=None) as stream:
            table, lines = _numbers(stream, file, columns)
    except UnicodeError as err:
        hint = f"say text.encoding in {columns.file}"
        raise TraceError(refusal(file, f"text in {columns.encoding}", str(err), hint)) from err
    drops = _drops(table, lines, file, columns)
    said = Request(columns.declarations | request.said, request.channels, request.column_map)
    return [point_of(file, {}, drops, said)]


def _numbers(stream: TextIO, file: str, columns: ColumnMap) -> tuple[Values, Sequence[int]]:
    """What the map names, in the order time, load, sensors, drop; and the line of each row."""
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
    wanted = [one for one in (columns.time, columns.load) if one is not None]
    wanted += [sensor.where for sensor in columns.sensors]
    if columns.drop is not None:
        wanted.append(Column(columns.drop, 1.0))
    places = [_place(one, names, file) for one in wanted]
    refuse_long(file, len(places))
    table, at = array("d"), array("q")  # lists of Python's numbers take six times as much
    for number, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{file}, line {number}"
        if len(cells) <= max(places):
            expected = f"at least {max(places) + 1} columns"
            raise TraceError(refusal(where, expected, f"{len(cells)}: {quote(' '.join(cells))}"))
        table.extend([_number(cells[place], columns, where) for place in places])
        at.append(number)
    if not table:
        raise TraceError(refusal(file, "rows of numbers", "the end of the file"))
    factors = np.array([one.factor for one in wanted])
    return np.frombuffer(table).reshape(-1, len(places)) * factors, at


def _cells(stream: TextIO, file: str, columns: ColumnMap) -> Iterator[Line]:
    for number in itertools.count(1):
        text = stream.readline(MAX_LINE_CHARACTERS)
        if len(text) == MAX_LINE_CHARACTERS or "\0" in text:
            came = "binary data, or another encoding"
            raise TraceError(refusal(f"{file}, line {number}", "a line of text", came))
        if not text:
            return
        if columns.delimiter is None:
            cells = text.split()
        else:
            try:
                cells = next(csv.reader([text.rstrip("\n")], delimiter=columns.delimiter), [])
            except csv.Error as err:
                raise TraceError(refusal(f"{file}, line {number}", "cells", str(err))) from err
        yield number, cells[:MOST_COLUMNS]


def _place(column: Column, names: list[str], file: str) -> int:
    if isinstance(column.column, int):
        return column.column - 1
    found = [index for index, name in enumerate(names) if name.strip() == column.column]
    if len(found) != 1:
        expected = f"one column named {quote(column.column)}"
        came = f"columns {', '.join(quote(name.strip()) for name in names[:20])}"
        hint = "is text.delimiter right?" if len(names) < 2 else ""
        raise TraceError(refusal(file, expected, came if not found else f"{len(found)}", hint))
    return found[0]


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
    odd = ~((numbers == np.floor(numbers)) & (numbers >= 1) & (numbers <= MAX_DROP_NUMBER))
    if odd.any():
        row = int(np.argmax(odd))
        where = f"{file}, line {lines[row]}"
        raise TraceError(refusal(where, "a whole drop number from 1", f"{numbers[row]:g}"))
    starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(table)]
    if len(starts) > MAX_FILE_DROPS + 1:
        raise TraceError(refusal(file, f"at most {MAX_FILE_DROPS} drops", str(len(starts) - 1)))
    found: dict[int, Drop] = {}
    for start, end in itertools.pairwise(starts):
        number = int(numbers[start])
        where = f"{file}, line {lines[start]}, drop {number}"
        if number in found:
            raise TraceError(refusal(where, "the rows of a drop together", "the drop again"))
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
        found[number] = make_drop(number, time, rows[:, 0], sensors, where)
    return list(found.values())
