"""Columns of tables of results, generated from the fields of a result, and the values for them."""

from collections.abc import Iterator, Mapping
from dataclasses import Field
from functools import cache
from typing import Any, Literal, NamedTuple, get_type_hints

from inversion.notices import Notice
from inversion.records import (
    DepthRange,
    Interval,
    JsonRecord,
    TableColumn,
    stored_fields,
    without_none,
)
from inversion.result import HalfSinePulse, InversionResult, LayerResult, PlateContact
from pfwd.analysis.options import MOST_LAYERS

Kind = Literal["text", "whole", "number", "flag", "texts", "time"]

N_LAYERS = "layers"
"""Name of the column with the number of layers; each layer has columns of its own."""


class ResultColumn(NamedTuple):
    """Column of a table of results."""

    name: str
    """Name of the column, with the SI unit at its end."""
    kind: Kind
    """Type of the values. texts: several texts, joined by ``"; "`` where a cell holds only one;
    time: ISO 8601."""
    meaning: str


_KINDS: Mapping[Any, Kind] = {
    float: "number",
    int: "whole",
    str: "text",
    PlateContact: "text",
    bool: "flag",
    tuple[str, ...]: "texts",
    tuple[Notice, ...]: "texts",
}
_ENDS: Mapping[Any, tuple[str, str]] = {
    Interval: ("low", "high"),
    DepthRange: ("from", "to"),
}


@cache
def result_columns(place: TableColumn) -> tuple[ResultColumn, ...]:
    """Return the columns of one part of a table of results, in their order.

    Parameters
    ----------
    place : TableColumn
        Name of the part, as in the metadata of the fields of `InversionResult`.
    """
    return tuple(columns_of(InversionResult, place))


def columns_of(
    record: type[JsonRecord], place: TableColumn = "last", prefix: str = "", which: str = ""
) -> Iterator[ResultColumn]:
    """Yield the columns for the fields of a record, in the order of a table.

    Parameters
    ----------
    record : type of JsonRecord
    place : TableColumn
        Part of the table, as in the metadata of the fields.
    prefix, which : str
        Beginning of the names and of the meanings.
    """
    hints = get_type_hints(record)
    for field in _in_table_order(record):
        if field.metadata["column"] != place:
            continue
        name, hint = prefix + field.name, without_none(hints[field.name])
        parts = (which + field.metadata["meaning"], field.metadata["unit"])
        meaning = ", ".join(part for part in parts if part)
        if hint in _KINDS:
            yield ResultColumn(name, _KINDS[hint], meaning)
        elif hint in _ENDS:
            for column in _ends_of(name, hint):
                yield ResultColumn(column, "number", meaning)
        elif hint is HalfSinePulse:
            yield from columns_of(HalfSinePulse, "established", f"{name}_")
        else:
            yield ResultColumn(N_LAYERS, "whole", "Media with a modulus; modulus_pa: the lowest")
            for number in range(1, MOST_LAYERS + 1):
                medium = f"Medium {number} from the top: "
                yield from columns_of(LayerResult, "layers", f"layer_{number}_", medium)


def _in_table_order(record: type[JsonRecord]) -> list[Field[Any]]:
    """Return the fields of a record, each interval after the standard deviation of its quantity."""
    fields = {field.name: field for field in stored_fields(record)}
    ordered: dict[str, Field[Any]] = {}
    for name, field in fields.items():
        ordered.setdefault(name, field)
        interval = name.replace("_sd_", "_interval_")
        if interval in fields:
            ordered.setdefault(interval, fields[interval])
    return list(ordered.values())


def _ends_of(name: str, hint: Any) -> tuple[str, str]:
    """Return the names of the columns for the ends of an interval or a range of depths.

    The unit stays at the end of the name, also one of two parts.
    """
    quantity, separator, unit = name.rpartition("_interval_")
    if not separator:
        quantity, separator, unit = name.rpartition("_")
    first, last = (f"{quantity}{separator}{end}_{unit}" for end in _ENDS[hint])
    return first, last


@cache
def _interval_columns(record: Any, prefix: str = "") -> tuple[tuple[str, ...], ...]:
    """Return field, column of the lower and of the upper end for each interval."""
    hints = get_type_hints(record)
    ends = {f.name: without_none(hints[f.name]) for f in stored_fields(record)}
    return tuple(
        (name, *_ends_of(prefix + name, hint)) for name, hint in ends.items() if hint in _ENDS
    )


@cache
def _scalar_columns(record: Any) -> tuple[str, ...]:
    hints = get_type_hints(record)
    named = (f.name for f in stored_fields(record) if f.metadata["column"])
    return tuple(name for name in named if without_none(hints[name]) is float)


@cache
def _empty_layers() -> Mapping[str, None]:
    names = [column.name for column in result_columns("layers")]
    return dict.fromkeys(name for name in names if name.startswith("layer_"))


def nested_cells(result: InversionResult) -> dict[str, Any]:
    """Return the cells for the nested values of a result: intervals, half-sine and layers."""
    cells: dict[str, Any] = dict(_empty_layers())
    _add_intervals(cells, result, "")
    for name in _scalar_columns(HalfSinePulse):
        cells[f"half_sine_{name}"] = (
            None if result.half_sine is None else getattr(result.half_sine, name)
        )
    cells[N_LAYERS] = None if result.layers is None else len(result.layers)
    for number, layer in enumerate((result.layers or ())[:MOST_LAYERS], 1):
        prefix = f"layer_{number}_"
        for name in _scalar_columns(LayerResult):
            cells[prefix + name] = getattr(layer, name)
        if not layer.modulus_known:
            cells[f"{prefix}modulus_pa"] = None
        _add_intervals(cells, layer, prefix)
    return cells


def cells_of(record: JsonRecord | None, prefix: str = "") -> dict[str, Any]:
    """Return the cells of a record by the names of `columns_of`; None: there are none."""
    if record is None:
        return {}
    cells = {prefix + name: value for name, value in record.to_json().items()}
    _add_intervals(cells, record, prefix)
    return cells


def _add_intervals(cells: dict[str, Any], record: Any, prefix: str) -> None:
    kind: Any = type(record)
    for name, low, high in _interval_columns(kind, prefix):
        cells[low], cells[high] = getattr(record, name) or (None, None)
