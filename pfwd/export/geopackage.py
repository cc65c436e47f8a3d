"""``gpkg``: one feature a point in an OGC GeoPackage, written by GDAL through pyogrio."""

import os
import struct
from typing import Any

import numpy as np

from pfwd.errors import OptionError, refusal
from pfwd.export.maps import without_position
from pfwd.export.output import new_file
from pfwd.export.point_rows import POINT_COLUMNS, place_of_row, point_rows
from pfwd.export.rows import Order
from pfwd.judging.places import Place

LAYER = "points"

_CRS = "EPSG:4326"
"""WGS 84, which receivers give."""

_POINT, _POINT_Z = 1, 1001
"""Kinds of geometry in well-known binary (ISO 13249-3)."""


def write_gpkg(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a feature for each point; discarded ones are marked.

    Returns
    -------
    list of str
        How many have no position: their geometry is null.

    Raises
    ------
    OptionError
        If pyogrio is not installed.
    """
    try:
        from pyogrio.raw import write
    except ImportError as err:
        hint = "python -m pip install pyogrio, or --format points-geojson"
        expected = "the package pyogrio"
        raise OptionError(refusal("--format gpkg", expected, "none", hint)) from err
    rows = point_rows(order)
    places = [place_of_row(row) for row in rows]
    heights = all(place is None or place.altitude is not None for place in places)
    geometry = np.array(
        [None if place is None else _binary(place, heights=heights) for place in places], object
    )
    data, masks = [], []
    for column in POINT_COLUMNS:
        values = [row[column.name] for row in rows]
        filled, missing = _field(values, column.kind)
        data.append(filled)
        masks.append(missing)
    with new_file(path, force=order.force) as draft:
        # GDAL looks at the end of the name, too.
        whole = draft.with_name(draft.name + ".gpkg")
        try:
            write(
                whole,
                geometry,
                data,
                [column.name for column in POINT_COLUMNS],
                field_mask=masks,
                layer=LAYER,
                driver="GPKG",
                geometry_type="Point Z" if heights else "Point",
                crs=_CRS,
            )
            os.replace(whole, draft)
        finally:
            whole.unlink(missing_ok=True)
    return without_position(rows)


def _field(values: list[Any], kind: str) -> tuple[Any, Any]:
    """A column and which of its values are missing."""
    missing = np.array([value is None for value in values], bool)
    empty: Any = {"number": 0.0, "whole": 0, "flag": False}.get(kind)
    types: dict[str, Any] = {"number": np.float64, "whole": np.int64, "flag": np.bool_}
    filled = [empty if value is None else value for value in values]
    return np.array(filled, types.get(kind, object)), missing


def _binary(place: Place, *, heights: bool) -> bytes:
    """A point as well-known binary, little-endian; longitude comes first."""
    if heights and place.altitude is not None:
        return struct.pack("<BIddd", 1, _POINT_Z, place.longitude, place.latitude, place.altitude)
    return struct.pack("<BIdd", 1, _POINT, place.longitude, place.latitude)
