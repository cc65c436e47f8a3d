"""Next station of the job, its distance, and the names of points typed on the screen."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from pfwd.errors import OptionError
from pfwd.judging import Job, Station
from pfwd.judging.stations import chainage_of, similar_name
from pfwd.session.plan import SessionPlan

EARTH_RADIUS_M = 6_371_000.0
"""A sphere gives distances to half a percent."""


class ReceiverStatus(NamedTuple):
    """Fix and position of the satellite receiver as text, for the head of a page."""

    fix: str
    """Quality of the position, with the number of satellites."""
    place: str
    """Latitude and longitude; empty: there is no position."""
    is_good: bool
    """True if the position is precise enough to be stored without a warning."""

    @property
    def text(self) -> str:
        """Quality and place in one text."""
        return f"{self.fix} {self.place}".rstrip()


@dataclass(frozen=True, slots=True)
class NextStation:
    """Station to be measured next, with distance and direction where they are known."""

    station: Station
    distance: float | None
    """Distance from the present position, m; None: not known."""
    ahead: bool | None
    """True if the station lies ahead along the line; None: not known."""

    @property
    def text(self) -> str:
        """Name, distance and direction of the station."""
        if self.distance is None:
            return f"next: {self.station.name}"
        side = "" if self.ahead is None else " ahead" if self.ahead else " back"
        return f"next: {self.station.name}, {self.distance:.0f} m{side}"


def next_station(
    job: Job,
    measured: Collection[str],
    coordinates: tuple[float, float] | None = None,
    current: str = "",
) -> NextStation | None:
    """Return the first station without a point, or the nearest one if the position is known.

    Parameters
    ----------
    job : Job
    measured : collection of str
        Names of existing points.
    coordinates : latitude and longitude in degrees, optional
    current : str
        Name of the present point; without a receiver its chainage gives the distance.
    """
    open_stations = [station for station in job.stations if station.name not in measured]
    if not open_stations:
        return None
    current_station = job.station(current)
    along = current_station.chainage_m if current_station is not None else chainage_of(current)
    placed = [
        (distance(coordinates, (station.latitude, station.longitude)), station)
        for station in open_stations
        if coordinates is not None
        and station.latitude is not None
        and station.longitude is not None
    ]
    if placed:
        metres, station = min(placed, key=lambda pair: pair[0])
        return NextStation(station, metres, _ahead(along, station))
    station = open_stations[0]
    if along is None or station.chainage_m is None:
        return NextStation(station, None, None)
    return NextStation(station, abs(station.chainage_m - along), _ahead(along, station))


def _ahead(along: float | None, station: Station) -> bool | None:
    if along is None or station.chainage_m is None:
        return None
    return station.chainage_m >= along


def distance(start: tuple[float, float] | None, end: tuple[float | None, float | None]) -> float:
    """Return the distance of two places in degrees, m; infinite if one is not known."""
    if start is None or end[0] is None or end[1] is None:
        return math.inf
    latitude, end_latitude = math.radians(start[0]), math.radians(end[0])
    east = math.radians(end[1] - start[1]) * math.cos((latitude + end_latitude) / 2)
    return EARTH_RADIUS_M * math.hypot(end_latitude - latitude, east)


def lot_progress(job: Job, measured: Collection[str]) -> str:
    """Return the number of measured stations in words; empty without a list of stations."""
    if not job.stations:
        return ""
    count = sum(station.name in measured for station in job.stations)
    return f"{count} of {len(job.stations)} stations"


def point_name_error(name: str) -> str:
    """Return the error of a typed name of a point; empty: the name can be used."""
    try:
        SessionPlan(point=name)
    except OptionError:
        return "1 to 64 characters"
    return ""


def point_name_question(name: str, names: Collection[str]) -> str:
    """Return the question to confirm before a point of this name begins; empty: none.

    Parameters
    ----------
    name : str
        Name as typed.
    names : collection of str
        Names of points and stations.
    """
    similar = similar_name(name, names)
    return "" if similar is None else f"{name.strip()} is new, but {similar} exists. Begin it?"
