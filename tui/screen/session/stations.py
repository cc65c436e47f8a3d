"""Which station of the job comes next, and how far it is."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

from pfwd.judging import Job, Station
from pfwd.judging.stations import chainage_of

EARTH_RADIUS = 6_371_000.0
"""m; a sphere is good to half a percent of a distance."""


class Whereabouts(NamedTuple):
    """What the receiver says, for the head of a page."""

    fix: str
    """How good it is, with the number of satellites."""
    place: str
    """Latitude and longitude; empty: there is no fix."""
    good: bool
    """Whether the position can be taken as it is."""

    @property
    def text(self) -> str:
        """All of it."""
        return f"{self.fix} {self.place}".rstrip()


@dataclass(frozen=True, slots=True)
class NextStation:
    """A station that is to be measured."""

    station: Station
    distance: float | None
    """From here, m; None: not known."""
    ahead: bool | None
    """Along the line; None: not known."""

    @property
    def text(self) -> str:
        """For people."""
        if self.distance is None:
            return f"next: {self.station.name}"
        side = "" if self.ahead is None else " ahead" if self.ahead else " back"
        return f"next: {self.station.name}, {self.distance:.0f} m{side}"


def next_station(
    job: Job,
    done: Collection[str],
    here: tuple[float, float] | None = None,
    current: str = "",
) -> NextStation | None:
    """The first station that is not measured yet: the nearest one where the position is known.

    Parameters
    ----------
    job : Job
    done : collection of str
        Names of points that are there.
    here : latitude and longitude in degrees, optional
    current : str
        Name of the point that is measured, by whose chainage the way is told without a receiver.
    """
    left = [station for station in job.stations if station.name not in done]
    if not left:
        return None
    standing = job.station(current)
    along = standing.chainage_m if standing is not None else chainage_of(current)
    placed = [
        (distance(here, (station.latitude, station.longitude)), station)
        for station in left
        if here is not None and station.latitude is not None and station.longitude is not None
    ]
    if placed:
        found, station = min(placed, key=lambda pair: pair[0])
        return NextStation(station, found, _ahead(along, station))
    station = left[0]
    if along is None or station.chainage_m is None:
        return NextStation(station, None, None)
    return NextStation(station, abs(station.chainage_m - along), _ahead(along, station))


def _ahead(along: float | None, station: Station) -> bool | None:
    if along is None or station.chainage_m is None:
        return None
    return station.chainage_m >= along


def distance(here: tuple[float, float] | None, there: tuple[float | None, float | None]) -> float:
    """Between two places in degrees, m; infinite where one is not known."""
    if here is None or there[0] is None or there[1] is None:
        return math.inf
    first, other = math.radians(here[0]), math.radians(there[0])
    across = math.radians(there[1] - here[1]) * math.cos((first + other) / 2)
    return EARTH_RADIUS * math.hypot(other - first, across)


def lot_progress(job: Job, done: Collection[str]) -> str:
    """How many stations of the lot are measured; empty: there is no list."""
    if not job.stations:
        return ""
    count = sum(station.name in done for station in job.stations)
    return f"{count} of {len(job.stations)} stations"
