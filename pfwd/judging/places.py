"""Place and time of a drop: recorded with it, declared for it, or edited later."""

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pfwd.files.header import is_position
from pfwd.judging.drops import DropView
from pfwd_device.recording.survey_reader import SurveyPoint


@dataclass(frozen=True, slots=True)
class Place:
    """Position on the earth, WGS 84."""

    latitude: float
    """Degrees, north positive."""
    longitude: float
    """Degrees, east positive."""
    altitude: float | None = None
    """Altitude, m; None: not declared."""


def place_of(point: SurveyPoint, drop: DropView) -> Place | None:
    """Return the position of a drop; an edited one replaces a recorded or declared one.

    Returns
    -------
    Place or None
        None: unknown, or the coordinates are outside of their range.
    """
    edited = None if drop.source is None else drop.source.position
    recorded = drop.metadata.get("position"), drop.declared
    places = map(place_in, (edited, point.position, *recorded, point.declared))
    return next((place for place in places if place is not None), None)


def time_of(drop: DropView) -> str | None:
    """Return the recorded time of a drop in UTC, ISO 8601; None: unknown."""
    return _first_text(drop.metadata.get("time_utc"), (drop.declared or {}).get("time_utc"))


def local_time_of(drop: DropView) -> str | None:
    """Return the recorded local time of a drop, ISO 8601; None: unknown."""
    declared = drop.declared or {}
    imported = declared.get("imported")
    noted = imported.get("time_local") if isinstance(imported, Mapping) else None
    return _first_text(drop.metadata.get("time_local"), declared.get("time_local"), noted)


def _first_text(*values: Any) -> str | None:
    return next((value for value in values if isinstance(value, str) and value), None)


def utc_of(drop: DropView, zone: str | None) -> str | None:
    """Return the time of a drop in UTC, as recorded or computed from its local time.

    Parameters
    ----------
    drop : DropView
    zone : str or None
        Offset from UTC for a local time that states none, such as ``+02:00``; None: unknown.

    Returns
    -------
    str or None
        ISO 8601; None: unknown.
    """
    recorded = time_of(drop)
    local = None if recorded is not None else local_time_of(drop)
    if local is None:
        return recorded
    try:
        moment = datetime.datetime.fromisoformat(local)
        if moment.tzinfo is None:
            if zone is None:
                return None
            moment = moment.replace(tzinfo=_zone(zone))
        return moment.astimezone(datetime.UTC).isoformat()
    except (ValueError, OverflowError):  # not ISO 8601, or out of the range of datetime
        return None


def local_of(drop: DropView, zone: str | None) -> str | None:
    """Return the local time of a drop, as recorded or computed from its time in UTC.

    Parameters
    ----------
    drop : DropView
    zone : str or None
        Offset of the local time from UTC, such as ``+02:00``; None: unknown.

    Returns
    -------
    str or None
        ISO 8601; None: unknown.
    """
    recorded = local_time_of(drop)
    utc = None if recorded is not None or zone is None else time_of(drop)
    if utc is None or zone is None:
        return recorded
    try:
        moment = datetime.datetime.fromisoformat(utc)
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=datetime.UTC)
        return moment.astimezone(_zone(zone)).isoformat()
    except (ValueError, OverflowError):
        return None


def place_in(position: Any) -> Place | None:
    """Return the position in a recorded, declared or edited mapping.

    Parameters
    ----------
    position : mapping
        Keys ``latitude`` and ``longitude``, degrees, and optionally ``altitude_m``. Values must be
        numbers: a header may also have texts under these keys, which are only shown.

    Returns
    -------
    Place or None
        None: `position` is no mapping, or has no valid latitude and longitude.
    """
    if not isinstance(position, Mapping):
        return None
    latitude, longitude = number(position.get("latitude")), number(position.get("longitude"))
    if latitude is None or longitude is None or not is_position(latitude, longitude):
        return None
    return Place(latitude, longitude, number(position.get("altitude_m")))


def _zone(offset: str) -> datetime.tzinfo | None:
    return datetime.datetime.strptime(offset, "%z").tzinfo


def number(value: object) -> float | None:
    """Return a value as float if it is a finite number, else None."""
    if type(value) is float:  # fast path: nearly all values
        return value if math.isfinite(value) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        converted = float(value)
    except OverflowError:
        return None
    return converted if math.isfinite(converted) else None
