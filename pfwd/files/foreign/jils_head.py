"""What JILS ``.THY`` and ``.DAT`` have in common: the head, names of stations, sensors."""

import re
from collections.abc import Mapping
from math import isinf, isnan, nan
from typing import Any

from inversion.notices import Notice
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.foreign.common import one_a_place, short_text, temperature_of
from pfwd.files.foreign.units import celsius
from pfwd.files.header import LONGEST_REMARK

OFFSETS = "sensor_offsets_m"
"""Key of ``--header``: distances of the sensors, m, in the order of the columns; nan leaves one
out."""


def sensor_offsets(
    file: str, declared: object, count: int, headings: Mapping[str, str]
) -> tuple[list[float], list[Notice]]:
    """Distance of each sensor, m, NaN for those that are left out; and what to say of it."""
    if declared is None:
        sensors = short_text(headings.get("Sensors")) or "nothing"
        remark = Notice("positions-not-declared", {"sensors": sensors})
        return [0.0] + [nan] * (count - 1), [remark] if count > 1 else []
    values = declared if isinstance(declared, list) else [None]
    numbers = [
        float(one) if isinstance(one, int | float) and not isinstance(one, bool) else None
        for one in values
    ]
    if len(numbers) != count or any(n is None or isinf(n) for n in numbers):
        expected = f"{OFFSETS}: {count} distances in m, one a column, nan to leave one out"
        raise TraceError(refusal(file, expected, quote(declared)))
    places = [float("nan") if number is None else number for number in numbers]
    wanted = [index for index, place in enumerate(places) if not isnan(place)]
    taken, remarks = one_a_place([places[index] for index in wanted])
    left = set(wanted) - {wanted[index] for index in taken}
    return [float("nan") if index in left else p for index, p in enumerate(places)], remarks


def station_name(station: tuple[str, str, str]) -> str:
    place = f"station {station[0] or '?'}"
    return f"{place} lane {station[1]}" if station[1] else place


def first_temperature(text: str) -> float | None:
    """Degrees Celsius; the first number of several (air, surface) is taken."""
    found = re.match(r"\s*(-?\d{1,4}(?:\.\d{1,4})?)", text)
    return None if found is None else temperature_of(round(celsius(float(found[1])), 2))


def head_facts(headings: Mapping[str, str], source: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the head of a file says of all its points: header keys, and what else is kept."""
    common = {
        "site": short_text(headings.get("Location")),
        "operator": short_text(headings.get("Operator")),
        "source": source,
        "temperature_c": first_temperature(headings.get("Temp", "")),
    }
    noted = {
        # The file says neither its time zone nor, for sure, the order of day and month.
        "date_time": short_text(headings.get("Date-Time")),
        "sensors": short_text(headings.get("Sensors"), LONGEST_REMARK),
        "weight_spring": short_text(headings.get("Weight/spring"), LONGEST_REMARK),
        "comment": short_text(headings.get("Comments"), LONGEST_REMARK),
    }
    return common, noted
