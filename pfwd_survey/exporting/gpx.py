"""``gpx``: one way point a test point, GPX 1.1; points without a position cannot be in it."""

import datetime
import os
from itertools import groupby
from xml.etree import ElementTree

from pfwd_device.recording.drop_file import software_version
from pfwd_device.text import clean
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file
from pfwd_survey.exporting.places import Place
from pfwd_survey.exporting.rows import Row
from pfwd_survey.exporting.words import result_words

NAMESPACE = "http://www.topografix.com/GPX/1/1"
SCHEMA = f"{NAMESPACE} {NAMESPACE}/gpx.xsd"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write all points that have a position and a drop that is not discarded.

    Returns
    -------
    list of str
        How many points were left out.
    """
    root = ElementTree.Element(
        "gpx",
        {
            "version": "1.1",
            "creator": f"pfwd {software_version()}",
            "xmlns": NAMESPACE,
            "xmlns:xsi": _XSI,
            "xsi:schemaLocation": SCHEMA,
        },
    )
    metadata = ElementTree.SubElement(root, "metadata")
    _add(metadata, "name", f"PFWD survey {order.content.survey_id}".strip())
    left_out = 0
    # By the name that drops carry: titles of two points may be alike.
    for _, group in groupby(order.rows, key=lambda row: row.point.name):
        rows = [row for row in group if row.used]
        place = next((row.place for row in rows if row.place is not None), None)
        if place is None:
            left_out += 1
        else:
            _way_point(root, place, rows)
    with new_file(path, force=order.force) as draft:
        tree = ElementTree.ElementTree(root)
        ElementTree.indent(tree)
        tree.write(draft, encoding="utf-8", xml_declaration=True)
    return [f"{left_out} points without a position or drops are left out"] if left_out else []


def _way_point(root: ElementTree.Element, place: Place, rows: list[Row]) -> None:
    # As decimals: the schema has no exponents.
    latitude, longitude = f"{place.latitude:.9f}", f"{place.longitude:.9f}"
    point = ElementTree.SubElement(root, "wpt", {"lat": latitude, "lon": longitude})
    if place.altitude is not None:
        _add(point, "ele", f"{place.altitude:.3f}")
    moment = next((text for row in rows if (text := _moment(row)) is not None), None)
    if moment is not None:
        _add(point, "time", moment)
    _add(point, "name", rows[0].point.title)
    _add(point, "desc", "; ".join(f"drop {row.drop.drop}: {result_words(row)}" for row in rows))
    _add(point, "type", "PFWD test point")


def _moment(row: Row) -> str | None:
    """When, with its time zone, as the schema wants it."""
    try:
        moment = datetime.datetime.fromisoformat(str(row.values["time_utc"]))
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    moment = moment.astimezone(datetime.UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _add(parent: ElementTree.Element, name: str, text: str) -> None:
    # XML has no letter for a control character, not even escaped.
    ElementTree.SubElement(parent, name).text = clean(text, limit=100_000)
