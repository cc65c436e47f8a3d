"""Where and when a drop fell, as far as anybody said so."""

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.survey_content import SurveyDrop, SurveyPoint


@dataclass(frozen=True, slots=True)
class Place:
    """A position on the earth, WGS 84."""

    latitude: float
    """Degrees, north positive."""
    longitude: float
    """Degrees, east positive."""
    altitude: float | None = None
    """m; None: not said."""


def place_of(point: SurveyPoint, drop: SurveyDrop, record: DropFacts | None) -> Place | None:
    """The position of a drop: what was said later wins over what was recorded.

    Returns
    -------
    Place or None
        None when nobody said, or what was said is not on the earth.
    """
    recorded = (record.metadata.get("position"), record.declared) if record else ()
    for said in (drop.position, point.position, *recorded, point.declared):
        place = _place(said)
        if place is not None:
            return place
    return None


def time_of(record: DropFacts | None) -> str | None:
    """When a drop fell, ISO 8601; None when nobody said."""
    if record is None:
        return None
    for said in (record.metadata.get("time_utc"), record.declared.get("time_utc")):
        if isinstance(said, str) and said:
            return said
    return None


def local_time_of(record: DropFacts | None) -> str | None:
    """When a drop fell by the clock of the place, ISO 8601; None when nobody said."""
    if record is None:
        return None
    imported = record.declared.get("imported")
    noted = imported.get("time_local") if isinstance(imported, Mapping) else None
    for said in (record.metadata.get("time_local"), record.declared.get("time_local"), noted):
        if isinstance(said, str) and said:
            return said
    return None


def utc_of(record: DropFacts | None, zone: str | None) -> str | None:
    """When a drop fell in UTC: as it was recorded, else from its local time.

    Parameters
    ----------
    record : DropFacts or None
    zone : str or None
        Offset of the local time, ``+02:00``, where the time does not say its own; None: nobody
        said, and the local time is not taken for UTC.

    Returns
    -------
    str or None
        ISO 8601.
    """
    said = time_of(record)
    local = None if said is not None else local_time_of(record)
    if local is None:
        return said
    try:
        moment = datetime.datetime.fromisoformat(local)
        if moment.tzinfo is None:
            if zone is None:
                return None
            moment = moment.replace(tzinfo=_zone(zone))
        return moment.astimezone(datetime.UTC).isoformat()
    except (ValueError, OverflowError):  # what another program wrote, or the first of all days
        return None


def local_of(record: DropFacts | None, zone: str | None) -> str | None:
    """When a drop fell by the clock of the place: as it was recorded, else from UTC.

    Parameters
    ----------
    record : DropFacts or None
    zone : str or None
        Offset of the local time; None: nobody said.
    """
    said = local_time_of(record)
    utc = None if said is not None or zone is None else time_of(record)
    if utc is None or zone is None:
        return said
    try:
        moment = datetime.datetime.fromisoformat(utc)
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=datetime.UTC)
        return moment.astimezone(_zone(zone)).isoformat()
    except (ValueError, OverflowError):
        return None


def _zone(offset: str) -> datetime.tzinfo | None:
    return datetime.datetime.strptime(offset, "%z").tzinfo


def _place(said: Any) -> Place | None:
    if not isinstance(said, Mapping):
        return None
    latitude, longitude = number(said.get("latitude")), number(said.get("longitude"))
    if latitude is None or longitude is None or abs(latitude) > 90 or abs(longitude) > 180:
        return None
    return Place(latitude, longitude, number(said.get("altitude_m")))


def number(value: object) -> float | None:
    """A finite number; None when it is none."""
    if type(value) is float:  # nearly always
        return value if math.isfinite(value) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        found = float(value)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None
