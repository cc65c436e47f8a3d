"""Reader of the stations of a job, from a CSV file or from the waypoints of a GPX file."""

import csv
import difflib
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pfwd.errors import OptionError, quote, refusal
from pfwd.files.header import is_position
from pfwd.judging.job import MAX_STATIONS, Station, target_si
from pfwd.judging.places import number as finite_number
from pfwd.procedures import Procedure

MAX_STATION_FILE_CHARACTERS = 50_000_000
"""Largest number of characters of a file; 100,000 stations need a tenth of it."""

MAX_STATION_NAME_CHARACTERS = 64
"""Largest number of characters of a station's name."""

STATION_HEADINGS: Mapping[str, tuple[str, ...]] = {
    "name": ("name", "station", "point", "id"),
    "chainage_m": ("chainage_m", "chainage"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "target": ("target",),
}
"""Accepted headings of each column; upper and lower case are equal."""

_PARTS_OF_HEADINGS: Mapping[str, tuple[str, ...]] = {
    "chainage_m": ("chainage", "stationier", "kilomet"),
    "latitude": ("latitud",),
    "longitude": ("longitud",),
    "target": ("target", "ziel", "soll", "evd", "elwd"),
}
"""Parts of words that show what a misspelt or translated heading probably means; compared without
spaces and underlines."""

_CLOSE_MATCH = 0.8
"""Similarity above which a heading counts as misspelt: about one letter in four may differ."""

_CHAINAGE = re.compile(r"(\d+)\+(\d{3}(?:[.,]\d+)?)(?!\d)")
"""Kilometres and metres in a name, such as 12+320."""


def read_stations(
    path: str | os.PathLike[str],
    procedure: Procedure,
    on_remark: Callable[[str], None] = lambda _: None,
) -> tuple[Station, ...]:
    """Return the stations of a file, in its order.

    Parameters
    ----------
    path : path of a .csv or .gpx file
        The first line of a CSV file names the columns (see `STATION_HEADINGS`), separated by comma,
        semicolon or tabulator. Targets are in MPa, or in mm if the procedure judges a deflection.
    procedure : Procedure
    on_remark : callable, optional
        Receives one line that names the columns of a CSV file that are not used.

    Raises
    ------
    OptionError
        If the file cannot be read, has no station or one station twice; the message names the line.
        Also if a heading is similar to a known one: the values of its column would be ignored.
    """
    file = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as err:
        raise OptionError(refusal(file, "a readable file", err.strerror or str(err))) from err
    except UnicodeDecodeError as err:
        hint = "save the file as UTF-8"
        raise OptionError(refusal(file, "UTF-8 text", "another encoding", hint)) from err
    if len(text) > MAX_STATION_FILE_CHARACTERS:
        expected = f"at most {MAX_STATION_FILE_CHARACTERS} characters"
        raise OptionError(refusal(file, expected, "more"))
    is_gpx = file.lower().endswith(".gpx")
    stations = _gpx(text, file) if is_gpx else _csv(text, file, procedure, on_remark)
    if not stations:
        raise OptionError(refusal(file, "stations", "none"))
    if len(stations) > MAX_STATIONS:
        raise OptionError(refusal(file, f"at most {MAX_STATIONS} stations", str(len(stations))))
    names: set[str] = set()
    for station in stations:
        if station.name in names:
            raise OptionError(refusal(file, "every station once", f"{quote(station.name)} twice"))
        names.add(station.name)
    return tuple(stations)


def chainage_of(name: str) -> float | None:
    """Return the chainage in the name of a station, m; None: the name has no chainage.

    Examples
    --------
    >>> chainage_of("km 12+320"), chainage_of("12+320.5 left"), chainage_of("7")
    (12320.0, 12320.5, None)
    """
    match = _CHAINAGE.search(name)
    if match is None:
        return None
    return 1e3 * int(match[1]) + float(match[2].replace(",", "."))


def chainage_of_point(
    name: str, station: Station | None, declarations: Iterable[Mapping[str, Any]] = ()
) -> float | None:
    """Return the chainage of a point, m; None: unknown.

    Parameters
    ----------
    name : str
        Name of the point, which may contain its chainage.
    station : Station or None
        Station of the job with this name; its chainage is used before all others.
    declarations : iterable of mapping
        Headers of the drops, with a chainage that was declared or imported.
    """
    if station is not None and station.chainage_m is not None:
        return station.chainage_m
    for declared in declarations:
        imported = declared.get("imported")
        noted = imported.get("chainage_m") if isinstance(imported, Mapping) else None
        for value in (declared.get("chainage_m"), noted):
            if (chainage := finite_number(value)) is not None:
                return chainage
    return chainage_of(name)


def next_along(name: str, step_m: float) -> str | None:
    """Return the name of the station one step further; None: the name has no chainage.

    Parameters
    ----------
    name : str
    step_m : float, m
        Distance of neighbouring stations.

    Examples
    --------
    >>> next_along("12+320", 20), next_along("km 12+990 left", 20), next_along("7", 20)
    ('12+340', 'km 13+010 left', None)
    """
    match, at = _CHAINAGE.search(name), chainage_of(name)
    if match is None or at is None:
        return None
    further = round(at + step_m, 3)
    kilometres, metres = divmod(further, 1000)
    metres_text = f"{metres:07.3f}".rstrip("0").rstrip(".") if metres % 1 else f"{metres:03.0f}"
    return f"{name[: match.start()]}{kilometres:.0f}+{metres_text}{name[match.end() :]}"


def next_name(name: str, taken_names: Collection[str] = (), step_m: float | None = None) -> str:
    """Return a name for the next point: the last number in the name is increased until it is new.

    Parameters
    ----------
    name : str
        Name of the present point.
    taken_names : collection of str
        Names that are in use.
    step_m : float, m, optional
        Distance of neighbouring stations, by which a chainage is increased.

    Examples
    --------
    >>> next_name("7"), next_name("lane 2, point 09"), next_name("start"), next_name("7", {"8"})
    ('8', 'lane 2, point 10', 'start 2', '9')
    >>> next_name("12+320", {"12+340"}, 20.0)
    '12+360'
    """
    further = None if step_m is None else next_along(name, step_m)
    if further is not None:
        return next_name(further, taken_names, step_m) if further in taken_names else further
    match = re.search(r"(\d+)(\D*)$", name)
    if match is None:
        proposal = f"{name} 2".strip()
    else:
        digits = match[1]
        number = str(int(digits) + 1).zfill(len(digits))
        proposal = name[: match.start()] + number + match[2]
    return next_name(proposal, taken_names) if proposal in taken_names else proposal


def similar_name(name: str, existing: Collection[str]) -> str | None:
    """Return the existing name that was probably meant by a new one; None: there is none.

    The new name is suspect if one of the two begins with the other, as after a missed digit. A name
    that follows an existing one (10 after 9, although 1 exists) is accepted. So is a chainage that
    begins with the name of a numbered point (12+360, although 1 exists).

    Parameters
    ----------
    name : str
        Name as typed.
    existing : collection of str
        Names of points and stations.

    Examples
    --------
    >>> similar_name("12+36", {"12+340", "12+360"}), similar_name("12+3600", {"12+360"})
    ('12+360', '12+360')
    >>> similar_name("10", {"1", "9"}), similar_name("12+380", {"12+360"})
    (None, None)
    """
    name = name.strip()
    if not name or name in existing:
        return None
    longer = [each for each in existing if each.startswith(name)]
    shorter = [
        each
        for each in existing
        if each and name.startswith(each) and (name.isdecimal() or not each.isdecimal())
    ]
    if shorter and not longer and any(next_name(each) == name for each in existing):
        return None
    return min(
        (*longer, *shorter), key=lambda each: (abs(len(each) - len(name)), each), default=None
    )


def _csv(
    text: str, file: str, procedure: Procedure, on_remark: Callable[[str], None]
) -> list[Station]:
    lines = text.splitlines()
    first = lines[0] if lines else ""
    delimiter = max(",;\t", key=first.count)
    rows = csv.reader(lines, delimiter=delimiter)
    heading = [cell.strip() for cell in next(rows, [])]
    places = _places(heading, file)
    _refuse_misnamed(heading, places, file, procedure)
    unused = {at: _quoted_heading(name) for at, name in enumerate(heading) if name}
    stations = []
    for number, row in enumerate(rows, start=2):
        if not any(cell.strip() for cell in row):
            continue
        where = f"{file}, line {number}"
        for at in range(len(row)):
            if at not in unused and row[at].strip():
                unused[at] = f"number {at + 1} (no heading)"
        cells = {key: row[at].strip() for key, at in places.items() if at < len(row)}
        stations.append(_station(cells, where, procedure, decimal_comma=delimiter != ","))
    names = [unused[at] for at in sorted(unused.keys() - set(places.values()))]
    if names:
        columns = ", ".join(STATION_HEADINGS)
        on_remark(f"{file}: columns not used: {', '.join(names)}. Known columns are {columns}")
    return stations


def _refuse_misnamed(
    heading: Sequence[str], places: Mapping[str, int], file: str, procedure: Procedure
) -> None:
    """Raise an error for a heading that probably means a known column which the file lacks."""
    for at, name in enumerate(heading):
        key = None if at in places.values() else _column_of_heading(name)
        if key is None or key in places:
            continue
        units = {"target": procedure.quantity.display_unit.name, "chainage_m": "m"}
        expected = f"a column {key}, in {units[key]}" if key in units else f"a column {key}"
        hint = f"rename the column to {key} if that is meant; otherwise rename or remove it"
        raise OptionError(refusal(f"{file}, line 1", expected, _quoted_heading(name), hint))


def _quoted_heading(heading: str) -> str:
    return f"'{heading}'" if heading.isprintable() and len(heading) <= 40 else quote(heading)


def _column_of_heading(heading: str) -> str | None:
    """Return the column that a heading probably means; None: it resembles no known heading."""
    letters = re.sub(r"[\W_]", "", heading.lower())
    for key, parts in _PARTS_OF_HEADINGS.items():
        if any(part in letters for part in parts):
            return key
    for key, headings in STATION_HEADINGS.items():
        if difflib.get_close_matches(heading.lower(), headings, n=1, cutoff=_CLOSE_MATCH):
            return key
    return None


def _places(heading: Sequence[str], file: str) -> dict[str, int]:
    names = [cell.strip().lower() for cell in heading]
    places = {
        key: names.index(name)
        for key, headings in STATION_HEADINGS.items()
        for name in reversed(headings)
        if name in names
    }
    if "name" not in places:
        expected = f"a first line with a column {' or '.join(STATION_HEADINGS['name'])}"
        hint = f"further columns are {', '.join(key for key in STATION_HEADINGS if key != 'name')}"
        raise OptionError(refusal(file, expected, quote(", ".join(heading)), hint))
    return places


def _station(
    cells: Mapping[str, str], where: str, procedure: Procedure, *, decimal_comma: bool
) -> Station:
    def number(key: str, limit: float = math.inf) -> float | None:
        text = cells.get(key, "")
        if not text:
            return None
        if decimal_comma:
            text = text.replace(",", ".")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= limit or math.isinf(value):
            raise OptionError(refusal(f"{where}, {key}", "a number", quote(text)))
        return value

    name = _name(cells.get("name", ""), where)
    chainage = cells.get("chainage_m", "")
    along = chainage_of(chainage) if "+" in chainage else number("chainage_m")
    target = number("target")
    return Station(
        name,
        chainage_of(name) if along is None else along,
        number("latitude", 90.0),
        number("longitude", 180.0),
        None if target is None else target_si(target, procedure, f"{where}, target"),
    )


def _name(text: str, where: str) -> str:
    if not 0 < len(text) <= MAX_STATION_NAME_CHARACTERS or not text.isprintable():
        expected = f"a name of 1 to {MAX_STATION_NAME_CHARACTERS} letters"
        raise OptionError(refusal(where, expected, quote(text)))
    return text


def _gpx(text: str, file: str) -> list[Station]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # entities could read files or expand endlessly
        raise OptionError(refusal(file, "GPX without DOCTYPE and ENTITY", "a file with them"))
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as err:
        raise OptionError(refusal(file, "GPX", f"invalid XML: {err}")) from err
    points: list[Any] = [item for item in root.iter() if _tag(item) in ("wpt", "rtept")]
    stations = []
    for number, item in enumerate(points, start=1):
        where = f"{file}, waypoint {number}"
        named = [child.text for child in item if _tag(child) == "name"]
        name = _name((named[0] or "").strip() if named else str(number), where)
        try:
            latitude, longitude = float(item.get("lat", "")), float(item.get("lon", ""))
        except ValueError as err:
            expected, actual = "numbers as lat and lon", "missing ones or other text"
            raise OptionError(refusal(where, expected, actual)) from err
        if not is_position(latitude, longitude):
            raise OptionError(refusal(where, "lat and lon in degrees", f"{latitude}, {longitude}"))
        stations.append(Station(name, chainage_of(name), latitude, longitude))
    return stations


def _tag(item: Any) -> str:
    return str(item.tag).rsplit("}", 1)[-1]
