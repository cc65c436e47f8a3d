"""``geojson``: one feature a drop (RFC 7946); without a position its geometry is null."""

import os
from typing import Any

from pfwd_device.recording.drop_file import software_version
from pfwd_survey.exporting.json_text import json_text
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file
from pfwd_survey.exporting.places import Place
from pfwd_survey.exporting.rows import Row


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write all drops that are not discarded.

    Returns
    -------
    list of str
        How many have no position, and how many were left out.
    """
    rows = order.rows
    used = [row for row in rows if row.used]
    collection = {
        "type": "FeatureCollection",
        "features": [_feature(row) for row in used],
        "pfwd": {"version": software_version(), "survey_id": order.content.survey_id},
    }
    with (
        new_file(path, force=order.force) as draft,
        open(draft, "w", encoding="utf-8", newline="\n") as stream,
    ):
        stream.write(json_text(collection) + "\n")
    notes = []
    nowhere = sum(row.place is None for row in used)
    if nowhere:
        notes.append(f"{nowhere} of {len(used)} drops have no position: their geometry is null")
    if len(used) < len(rows):
        notes.append(f"{len(rows) - len(used)} discarded or damaged drops are left out")
    return notes


def _feature(row: Row) -> dict[str, Any]:
    properties = {
        name: value
        for name, value in row.values.items()
        if name not in ("latitude", "longitude", "discarded")
    }
    return {
        "type": "Feature",
        "id": f"{row.point.name}/{row.drop.drop}",
        "geometry": row.place and _geometry(row.place),
        "properties": properties,
    }


def _geometry(place: Place) -> dict[str, Any]:
    # Longitude comes first, and there is no member for the datum: it is WGS 84.
    coordinates = [place.longitude, place.latitude]
    if place.altitude is not None:
        coordinates.append(place.altitude)
    return {"type": "Point", "coordinates": coordinates}
