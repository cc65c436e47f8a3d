"""Row of each point: position, time, procedure, value and verdict."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pfwd.analysis.results import DiagnosisResult
from pfwd.export.columns import POINT_COLUMNS
from pfwd.export.rows import MAX_CELL_CHARACTERS, Order, Row
from pfwd.files.photos import photos_of
from pfwd.judging import PointView
from pfwd.judging.places import Place, number
from pfwd.judging.stations import chainage_of_point
from pfwd.procedures import PointModulus, PointProgress, unit_of
from pfwd_device.text import clean

_EMPTY_POINT: Mapping[str, Any] = dict.fromkeys(column.name for column in POINT_COLUMNS)


PointValues = Mapping[str, Any]
"""Values of a point by the names of `POINT_COLUMNS`, in their order; None: unknown. Times are ISO
8601 texts."""


def point_rows(order: Order) -> list[PointValues]:
    """Return the values of all points of a survey, in the survey's order."""
    folder = order.content.folder
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
    return dict(_EMPTY_POINT) | {
        "point": point.title,
        "chainage_m": chainage_of_point(point.title, station, declarations),
        "latitude": place and place.latitude,
        "longitude": place and place.longitude,
        "altitude_m": place and place.altitude,
        "time_utc": _first(row.values["time_utc"] for row in counted),
        "time_local": _first(row.time_local for row in counted),
        "discarded": point.discarded,
        "note": clean("; ".join(point.notes), limit=MAX_CELL_CHARACTERS) or None,
        **judged_values(point),
    }


def judged_values(point: PointView) -> dict[str, Any]:
    """Return value, target, verdict and moduli of a point, by the names of `POINT_COLUMNS`."""
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
        "value_not_supported": progress.withheld if value is None else value.not_supported,
        "drops_measured": len(progress.used),
        "diagnosis": None if diagnosis is None else diagnosis.verdict,
        **_use_values(progress, diagnosis),
        **_modulus_values("modulus", fitted),
        **_modulus_values("modulus_in_force", in_force),
        "modulus_source": None if in_force is None else in_force.source,
        "modulus_not_supported": progress.withheld if fitted is None else fitted.not_supported,
    }


def _use_values(progress: PointProgress, diagnosis: DiagnosisResult | None) -> dict[str, Any]:
    """Return what the diagnosed modulus may be used for, and the reason.

    If the records of the point do not support it, that is "do-not-use".
    """
    if diagnosis is None:
        return {"use": None, "use_reason": None}
    modulus = progress.modulus
    fault = None if modulus is None else modulus.not_supported
    if diagnosis.use != "do-not-use" and fault is not None:
        return {"use": "do-not-use", "use_reason": fault}
    return {"use": diagnosis.use, "use_reason": diagnosis.use_reason}


def _modulus_values(name: str, modulus: PointModulus | None) -> dict[str, float | None]:
    low, high = (None, None) if modulus is None else modulus.interval or (None, None)
    return {
        f"{name}_pa": None if modulus is None else number(modulus.value),
        f"{name}_interval_low_pa": number(low),
        f"{name}_interval_high_pa": number(high),
    }


def _first(values: Iterable[Any]) -> Any:
    return next((value for value in values if value is not None), None)
