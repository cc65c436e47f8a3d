"""One row per point: where, when, what it is judged by, its value and its verdict."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pfwd.analysis.result_columns import ResultColumn
from pfwd.export.rows import LONGEST_CELL, Order, Row
from pfwd.files.photos import photos_of
from pfwd.judging import PointView
from pfwd.judging.places import Place, number
from pfwd.judging.stations import chainage_of_point
from pfwd.procedures import PointModulus, unit_of
from pfwd_device.text import clean

POINT_COLUMNS = (
    ResultColumn("point", "text", "test point, as it was named last"),
    ResultColumn("chainage_m", "number", "along the line, m"),
    ResultColumn("latitude", "number", "degrees, north positive"),
    ResultColumn("longitude", "number", "degrees, east positive"),
    ResultColumn("altitude_m", "number", "m"),
    ResultColumn("time_utc", "time", "of the first drop that counts, UTC"),
    ResultColumn("time_local", "time", "the same, by the clock of the place"),
    ResultColumn("procedure", "text", "that the point is judged by"),
    ResultColumn("quantity", "text", "that the procedure judges"),
    ResultColumn("value", "number", "of the quantity, in the unit"),
    ResultColumn("interval_low", "number", "95 %, in the unit"),
    ResultColumn("interval_high", "number", "95 %, in the unit"),
    ResultColumn("unit", "text", "of value, interval and target: Pa, or m for a deflection"),
    ResultColumn("target", "number", "in the unit"),
    ResultColumn("verdict", "text", "pass, fail, undecided, or none"),
    ResultColumn("drops_measured", "whole", "drops that the value is the mean of"),
    ResultColumn("modulus_pa", "number", "of the fits of these drops together, Pa"),
    ResultColumn("modulus_interval_low_pa", "number", "95 %, Pa"),
    ResultColumn("modulus_interval_high_pa", "number", "95 %, Pa"),
    ResultColumn("diagnosis", "text", "clean, explained or unexplained; empty: not asked for"),
    ResultColumn("discarded", "flag", "whether the point was discarded"),
    ResultColumn("note", "text", "of the point"),
    ResultColumn("verdict_reason", "text", "one sentence"),
    ResultColumn("verdict_reason_code", "text", "kind of the reason; empty: no target"),
    ResultColumn("value_not_supported", "text", "why nothing can be decided by the value"),
    ResultColumn("modulus_in_force_pa", "number", "that may be used, Pa; empty: none"),
    ResultColumn("modulus_in_force_interval_low_pa", "number", "95 %, Pa"),
    ResultColumn("modulus_in_force_interval_high_pa", "number", "95 %, Pa"),
    ResultColumn("modulus_source", "text", "of the modulus in force: diagnosed or fitted"),
    ResultColumn("modulus_not_supported", "text", "why the data do not support modulus_pa"),
    ResultColumn("photos", "text", "files within the survey; empty: none"),
)
"""What a point has in every export."""

_NOTHING: Mapping[str, Any] = dict.fromkeys(column.name for column in POINT_COLUMNS)


PointValues = Mapping[str, Any]
"""Values of a point by the names of ``POINT_COLUMNS``, in their order; None: not known. Times are
texts, ISO 8601."""


def point_rows(order: Order) -> list[PointValues]:
    """Return the values of all points of a survey, in their order."""
    folder = Path(order.content.path)
    return [
        {**_row(point, rows), "photos": _photo_files(folder, point.name)}
        for point, rows in order.points
    ]


def _photo_files(folder: Path, point: str) -> str | None:
    files = [photo.relative_to(folder).as_posix() for photo in photos_of(folder, point)]
    return "; ".join(files) or None


def place_of_row(row: PointValues) -> Place | None:
    """Return the position of a point; None: unknown."""
    latitude, longitude = row["latitude"], row["longitude"]
    return None if latitude is None else Place(latitude, longitude, row["altitude_m"])


def _row(point: PointView, drops: Sequence[Row]) -> PointValues:
    used = set(point.progress.used)
    counted = [row for row in drops if row.drop.number in used] or list(drops)
    station = point.job.station(point.shown_name)
    declarations = (drop.declared or {} for drop in point.drops)
    place = next((row.place for row in (*counted, *drops) if row.place is not None), None)
    return dict(_NOTHING) | {
        "point": point.title,
        "chainage_m": chainage_of_point(point.title, station, declarations),
        "latitude": place and place.latitude,
        "longitude": place and place.longitude,
        "altitude_m": place and place.altitude,
        "time_utc": _first(row.values["time_utc"] for row in counted),
        "time_local": _first(row.time_local for row in counted),
        "discarded": point.discarded,
        "note": clean("; ".join(point.notes), limit=LONGEST_CELL) or None,
        **judged_values(point),
    }


def judged_values(point: PointView) -> dict[str, Any]:
    """Return value, target, verdict and moduli of a point under the names of exports."""
    job, progress, diagnosis = point.job, point.progress, point.diagnosis_in_force
    value, fitted, in_force = progress.value, progress.fitted_modulus, progress.modulus_in_force
    low, high = (None, None) if value is None or value.interval is None else value.interval
    return {
        "procedure": None if job.procedure is None else job.procedure.name,
        "quantity": str(job.quantity),
        "value": None if value is None else number(value.value),
        "interval_low": number(low),
        "interval_high": number(high),
        "unit": unit_of(job.quantity),
        "target": number(progress.target),
        "verdict": "none" if point.discarded else str(progress.verdict),
        "verdict_reason": progress.verdict_reason,
        "verdict_reason_code": progress.verdict_reason_code and str(progress.verdict_reason_code),
        "value_not_supported": None if value is None else value.not_supported,
        "drops_measured": len(progress.used),
        "diagnosis": None if diagnosis is None else diagnosis.verdict,
        **_modulus_values("modulus", fitted),
        **_modulus_values("modulus_in_force", in_force),
        "modulus_source": None if in_force is None else in_force.source,
        "modulus_not_supported": None if fitted is None else fitted.not_supported,
    }


def _modulus_values(name: str, modulus: PointModulus | None) -> dict[str, float | None]:
    low, high = (None, None) if modulus is None else modulus.interval or (None, None)
    return {
        f"{name}_pa": None if modulus is None else number(modulus.value),
        f"{name}_interval_low_pa": number(low),
        f"{name}_interval_high_pa": number(high),
    }


def _first(values: Iterable[Any]) -> Any:
    return next((value for value in values if value is not None), None)
