"""Formats for maps: ``geojson`` with a feature for each drop and ``points-geojson`` with one for
each point (RFC 7946), and ``gpx`` (1.1) with a way point for each point that has a position.
"""

import datetime
import os
from collections.abc import Sequence
from itertools import groupby
from typing import Any
from xml.etree import ElementTree

from pfwd.digits import declared
from pfwd.export.json_text import json_text
from pfwd.export.output import new_file, new_text_file
from pfwd.export.rows import Order, PointValues, Row, place_of_row, point_rows
from pfwd.facts import fact_of_value, facts_of_drop
from pfwd.judging.job import target_text
from pfwd.judging.places import Place
from pfwd.units import SI
from pfwd_device.recording.drop_file import software_version
from pfwd_device.text import clean

GPX_NAMESPACE = "http://www.topografix.com/GPX/1/1"
GPX_SCHEMA = f"{GPX_NAMESPACE} {GPX_NAMESPACE}/gpx.xsd"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"


def write_geojson(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a feature for each drop that is not discarded.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        Sentences with the numbers of drops without a position, whose geometry is null, and of
        omitted drops.
    """
    rows = order.rows
    used = [row for row in rows if row.used]
    _write_collection([_feature(row) for row in used], order, path)
    notes = []
    without_place = sum(row.place is None for row in used)
    if without_place:
        text = f"{without_place} of {len(used)} drops have no position: their geometry is null"
        notes.append(text)
    if len(used) < len(rows):
        notes.append(f"{len(rows) - len(used)} discarded or damaged drops are left out")
    return notes


def write_points_geojson(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a feature for each point; discarded points are marked.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        A sentence with the number of points without a position, whose geometry is null.
    """
    rows = point_rows(order)
    features = []
    for (point, _), row in zip(order.points, rows, strict=True):
        place = place_of_row(row)
        values = {k: v for k, v in row.items() if k not in ("latitude", "longitude")}
        features.append(
            {
                "type": "Feature",
                "id": point.name,
                "geometry": place and _geometry(place),
                "properties": values,
            }
        )
    _write_collection(features, order, path)
    return without_position(rows)


def without_position(rows: Sequence[PointValues]) -> list[str]:
    """Return a sentence with the number of points without a position; empty: all have one."""
    without_place = sum(place_of_row(row) is None for row in rows)
    if not without_place:
        return []
    return [f"{without_place} of {len(rows)} points have no position: their geometry is null"]


def _write_collection(
    features: list[dict[str, Any]], order: Order, path: str | os.PathLike[str]
) -> None:
    collection = {
        "type": "FeatureCollection",
        "features": features,
        "pfwd": {"version": software_version(), "survey_id": order.content.survey_id},
    }
    with new_text_file(path, force=order.force) as stream:
        stream.write(json_text(collection) + "\n")


def _feature(row: Row) -> dict[str, Any]:
    properties = {
        name: value
        for name, value in row.json_values.items()
        if name not in ("latitude", "longitude", "discarded")
    }
    return {
        "type": "Feature",
        "id": f"{row.point.name}/{row.drop.number}",
        "geometry": row.place and _geometry(row.place),
        "properties": properties,
    }


def _geometry(place: Place) -> dict[str, Any]:
    # RFC 7946: the longitude comes first, and the datum is always WGS 84.
    coordinates = [place.longitude, place.latitude]
    if place.altitude is not None:
        coordinates.append(place.altitude)
    return {"type": "Point", "coordinates": coordinates}


def write_gpx(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write a way point for each point that has a position and a drop that is not discarded.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        A sentence with the number of omitted points.
    """
    root = ElementTree.Element(
        "gpx",
        {
            "version": "1.1",
            "creator": f"pfwd {software_version()}",
            "xmlns": GPX_NAMESPACE,
            "xmlns:xsi": _XSI,
            "xsi:schemaLocation": GPX_SCHEMA,
        },
    )
    metadata = ElementTree.SubElement(root, "metadata")
    _add(metadata, "name", f"PFWD survey {order.content.survey_id}".strip())
    omitted = 0
    # Grouped by name and not by title, which two points may share.
    for _, group in groupby(order.rows, key=lambda row: row.point.name):
        rows = [row for row in group if row.used]
        place = next((row.place for row in rows if row.place is not None), None)
        if place is None:
            omitted += 1
        else:
            _way_point(root, place, rows)
    with new_file(path, force=order.force) as draft:
        tree = ElementTree.ElementTree(root)
        ElementTree.indent(tree)
        tree.write(draft, encoding="utf-8", xml_declaration=True)
    return [f"{omitted} points without a position or drops are left out"] if omitted else []


def _way_point(root: ElementTree.Element, place: Place, rows: list[Row]) -> None:
    # The schema of GPX allows no exponents.
    latitude, longitude = f"{place.latitude:.9f}", f"{place.longitude:.9f}"
    point = ElementTree.SubElement(root, "wpt", {"lat": latitude, "lon": longitude})
    if place.altitude is not None:
        _add(point, "ele", f"{place.altitude:.3f}")
    moment = next((text for row in rows if (text := _moment(row)) is not None), None)
    if moment is not None:
        _add(point, "time", moment)
    _add(point, "name", rows[0].point.title)
    drops = [f"drop {row.drop.number}: {_result_words(row)}" for row in rows]
    _add(point, "desc", "; ".join([_verdict_words(rows[0]), *drops]))
    _add(point, "type", "PFWD test point")


def _moment(row: Row) -> str | None:
    """Return the time of a drop in UTC in the form that the schema requires; None: not known."""
    try:
        moment = datetime.datetime.fromisoformat(str(row.values["time_utc"]))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    moment = moment.astimezone(datetime.UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _add(parent: ElementTree.Element, name: str, text: str) -> None:
    # XML cannot hold control characters, not even escaped.
    ElementTree.SubElement(parent, name).text = clean(text, limit=100_000)


def _verdict_words(row: Row) -> str:
    """Return value and verdict of the point of a drop as one line of text, with units."""
    progress, values = row.point.progress, row.values
    parts = []
    if progress.value is not None:
        parts.append(f"{values['quantity']} = {SI.show(fact_of_value(progress.value))}")
        if progress.value.quantity.is_fitted and values["modulus_source"] == "diagnosed":
            parts[-1] += " after the diagnosis, which replaces the fits below"
    if progress.target is not None:
        parts.append(f"target {target_text(progress.target)}")
    if values["value_not_supported"] is not None:
        parts.append(f"not supported by the data: {values['value_not_supported']}")
    parts.append(f"procedure {values['procedure']}")
    return f"verdict {values['verdict']} ({', '.join(parts)})"


def _result_words(row: Row) -> str:
    """Return the result of a drop as one line of text, with units."""
    values, result = row.values, row.drop.last_result
    if result is None or values["modulus_pa"] is None:
        reason = values["reason"] or "; ".join(values["warnings"]) or "no modulus"
        return f"{values['status']} ({reason})"
    parts = (
        f"{values['status']}, fit E = {SI.show(facts_of_drop(result)['modulus'])}",
        f"model {values['model']}",
        f"plate radius {declared(values['plate_radius_m'], 'm')}",
        f"Poisson's ratio {declared(values['poisson_ratio'])}",
        f"warnings: {'; '.join(values['warnings']) or 'none'}",
    )
    return ", ".join(parts)
