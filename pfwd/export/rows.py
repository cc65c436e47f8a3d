"""Export request, row of each drop (position, time, peaks, result with uncertainty and warnings),
and row of each point (position, time, procedure, value and verdict).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from inversion import notices
from inversion.notices import WARNING_CODES, WARNINGS, Notice, Value, text_of
from inversion.records import stored_fields, without_nan
from pfwd.analysis.drop_facts import corrected_deflection
from pfwd.analysis.result_columns import N_LAYERS, nested_cells
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.errors import SurveyError
from pfwd.export.columns import DROP_COLUMNS, POINT_COLUMNS
from pfwd.files.header import Declaration, setup_from
from pfwd.files.importing import on_rig
from pfwd.files.photos import photos_of
from pfwd.judging import DropView, Job, PointView, job_of, point_view
from pfwd.judging.places import Place, local_of, number, place_of, utc_of
from pfwd.judging.stations import chainage_of_point
from pfwd.peaks.basin import ASSUMED_POISSON_RATIO, RIGID_PLATE_FACTOR, basin_of
from pfwd.peaks.stiffness import stiffness_of
from pfwd.procedures import Kind as DropKind
from pfwd.procedures import PointModulus, PointProgress
from pfwd_device.drop import Peaks
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyPoint
from pfwd_device.recording.index import no_collections
from pfwd_device.text import clean

NO_RESULT_STATUS = "no result"
MAX_CELL_CHARACTERS = 4096
"""Longest text of a cell; a note may be as long."""

SURVEY_COLUMNS = (
    *("drop", "record", "point", "site", "operator", "device", "time_utc", "notes"),
    *("peak_load_n", "deflection_recorded_m", "deflection_corrected_m"),
    *("procedure", "quantity", "value", "interval_low", "interval_high", "unit", "target"),
    *("verdict", "value_not_supported", "modulus_source", "modulus_not_supported"),
)
"""Columns whose values are those of the survey now. The others are those at the time of the
inversion."""

_RESULT_KINDS = {c.name: c.kind for c in DROP_COLUMNS if c.name not in SURVEY_COLUMNS}
_RESULT_FIELDS = [
    f.name for f in stored_fields(DropResult) if f.name in _RESULT_KINDS and f.name != N_LAYERS
]
_EMPTY_ROW: Mapping[str, Any] = dict.fromkeys(column.name for column in DROP_COLUMNS)

MAX_RELATIVE_DIFFERENCE = 1e-9
"""Relative difference up to which two declared values are equal."""


Results = Mapping[tuple[str, int], DropResult]
"""Results by the title of the point and the number of the drop within it."""


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """A drop with its values for all columns."""

    point: PointView
    drop: DropView
    place: Place | None
    values: Mapping[str, Any]
    """Values by the names of `DROP_COLUMNS`; None: unknown."""
    time_local: str | None = None
    """Local time, ISO 8601; None: unknown."""
    warnings: tuple[Notice, ...] = ()
    """Warnings of the result as objects; in `values` they are sentences."""

    @property
    def json_values(self) -> dict[str, Any]:
        """Values for JSON, with the codes of the warnings after their sentences."""
        written: dict[str, Any] = {}
        for name, value in self.values.items():
            written[name] = value
            if name == WARNINGS:
                written[WARNING_CODES] = None if value is None else notices.codes(self.warnings)
        return written

    @property
    def peaks(self) -> Peaks | None:
        """Recorded peaks; None: samples around the trigger are missing."""
        return self.drop.peaks

    @property
    def has_result(self) -> bool:
        """True if the drop has a result."""
        return bool(self.values["status"] != NO_RESULT_STATUS)

    @property
    def used(self) -> bool:
        """True if the drop can be read, and neither it nor its point is discarded."""
        discarded = self.point.discarded or self.drop.discarded is not None
        return not discarded and self.drop.declared is not None


@dataclass(frozen=True)  # no slots: `cached_property` needs a dictionary
class Order:
    """Export request: a survey, and options of the format."""

    content: Survey
    inverted: Results | None = None
    """Results of an inversion for this export; None: the stored ones are used."""
    force: bool = False
    """True: an existing file may be replaced."""
    delimiter: str = ","
    """Character between the columns of a text."""
    decimal: str = "."
    """Decimal sign of a text."""

    @cached_property
    def job(self) -> Job:
        """Procedure, targets and stations of the survey.

        Raises
        ------
        SurveyError
            If the recorded procedure cannot be read.
        """
        return job_of(self.content)

    @cached_property
    def points(self) -> list[tuple[PointView, tuple[Row, ...]]]:
        """All points with the rows of their drops, computed once."""
        with no_collections():
            views = map(self._point, self.content.points)
            return [(view, tuple(self._rows_of(view))) for view in views]

    def _point(self, point: SurveyPoint) -> PointView:
        """Return a point with the results to export."""
        view = point_view(point, self.job)
        if self.inverted is None:
            return view
        drops = tuple(
            drop.with_result(self.inverted.get((point.title, drop.number))) for drop in view.drops
        )
        # The stored diagnosis belongs to the stored results.
        return replace(view, drops=drops, diagnosis=None)

    @cached_property
    def rows(self) -> list[Row]:
        """Rows of all drops, point by point, computed once."""
        return [row for _, rows in self.points for row in rows]

    def _rows_of(self, point: PointView) -> Iterator[Row]:
        point = point.shown
        progress = point.progress
        verdict = _point_columns(point)
        kinds = dict(progress.kinds)
        reasons = {drop.number: drop.reason for drop in progress.excluded}
        survey_id, inverted = self.content.survey_id, self.inverted is not None
        for drop in point.drops:
            reason = reasons.get(drop.number)
            yield _row(survey_id, point, drop, verdict, kinds.get(drop.number), reason, inverted)

    @cached_property
    def results(self) -> int:
        """Number of drops with a result."""
        return sum(row.has_result for row in self.rows)


def _point_columns(point: PointView) -> dict[str, Any]:
    """Return value and verdict of a point by the names of `DROP_COLUMNS`."""
    progress = point.progress
    return {
        **{name: value for name, value in judged_values(point).items() if name in SURVEY_COLUMNS},
        "procedure": point.job.procedure_in_force.name,
        "verdict": progress.verdict.value,
        "modulus_not_supported": progress.withheld,
    }


def _corrected_deflection(drop: DropView) -> float | None:
    """Return the centre deflection without the presently declared geophone response, m; None: no
    peak.
    """
    if drop.own.peak_deflection is not None or drop.declared is None or drop.source is None:
        return drop.own.peak_deflection
    try:
        # A drop that was rejected by comparison with its point has a peak that was not computed.
        return corrected_deflection(drop.source.read_traces().drop, drop.setup)
    except (RecordingError, SurveyError):
        return None


def _row(
    survey_id: str,
    point: PointView,
    drop: DropView,
    verdict: Mapping[str, Any],
    kind: DropKind | None,
    reason: Notice | None,
    inverted: bool,
) -> Row:
    """Return the row of a drop.

    Parameters
    ----------
    survey_id : str
    point : PointView
    drop : DropView
    verdict : mapping
        Value and verdict of the point by column name.
    kind : DropKind or None
        Seating, measured or rejected by the procedure of the point.
    reason : Notice or None
        Reason why the drop is not averaged.
    inverted : bool
        True: the results are of an inversion for this export.
    """
    stored_point = point.source
    assert stored_point is not None  # an export reads a stored survey
    zone = point.job.time_zone
    place = place_of(stored_point, drop)
    values: dict[str, Any] = dict(_EMPTY_ROW)
    values |= _facts(survey_id, point, drop)
    values |= {
        "latitude": place and place.latitude,
        "longitude": place and place.longitude,
        "altitude_m": place and place.altitude,
        "peak_load_n": drop.peaks and drop.peaks.load,
        "deflection_recorded_m": drop.peaks and drop.peaks.centre,
        "deflection_corrected_m": _corrected_deflection(drop),
    }
    values |= verdict
    declared = {**(drop.declared or {}), **stored_point.declared}
    if drop.declared is not None and (on_rig(declared) or not drop.has_traces):
        obstacle = Notice("stiffness-test" if on_rig(declared) else "peaks-only")
        values |= {"status": "rejected", "reason": obstacle, "warnings": []}
    elif drop.last_result is None:
        discarded = inverted and (point.discarded or drop.discarded is not None)
        why = Notice("discarded-not-inverted" if discarded else "not-inverted")
        if drop.fault is not None:
            why = Notice("damaged", {"fault": drop.fault})
        values |= {"status": NO_RESULT_STATUS, "reason": why, "warnings": []}
    else:
        values |= _result(drop.last_result, stored_point, drop)
        values["modulus_not_supported"] = point.progress.withheld or drop.last_result.not_supported
    if drop.declared is not None:
        values |= _peak_values(drop, declared, values)
    if values["status"] in ("seating", "measured"):
        # The present procedure decides, not the one at the time of the inversion.
        if kind in (DropKind.SEATING, DropKind.MEASURED):
            values["status"] = kind.value
        elif kind is DropKind.REJECTED and drop.discarded is None:
            values |= {"status": kind.value, "reason": reason}
    warnings = tuple(values[WARNINGS])
    values[WARNINGS] = _texts(list(map(text_of, warnings)))
    return Row(point, drop, place, _in_words(values), _text(local_of(drop, zone)), warnings)


def _in_words(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with English sentences in place of messages."""
    return {key: _cell(text_of(v)) if isinstance(v, Notice) else v for key, v in values.items()}


def _peak_values(
    drop: DropView, declared: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the columns of a drop on a rig (stiffness) or without traces (basin indices)."""
    if on_rig(declared):
        assert drop.source is not None
        try:
            traces = drop.source.read_traces().drop
            setup = setup_from(
                {key: Declaration(value, "") for key, value in declared.items()}, drop.source.point
            )
        except (RecordingError, SurveyError):
            return {"kind": "stiffness"}
        stiffness = stiffness_of(traces, setup)
        return {
            "kind": "stiffness",
            "secant_stiffness_n_per_m": stiffness and stiffness.secant_n_per_m,
            "dynamic_stiffness_n_per_m": stiffness and stiffness.dynamic_n_per_m,
        }
    radius = number(declared.get("plate_radius_m"))
    if drop.has_traces or drop.peaks is None or radius is None:
        return {"kind": "traces" if drop.has_traces else "peaks"}
    declared_ratio = number(declared.get("poisson_ratio"))
    ratio = ASSUMED_POISSON_RATIO if declared_ratio is None else declared_ratio
    basin = basin_of(drop.peaks, radius, ratio)
    warnings = list(values[WARNINGS])
    if basin.rejected_offsets_m:
        places = tuple(f"{offset:g} m" for offset in basin.rejected_offsets_m)
        warnings.append(Notice("sensors-without-index", {"places": places}))
    return {
        "kind": "peaks",
        "poisson_ratio": ratio,
        "plate_radius_m": radius,
        "peak_modulus_pa": basin.peak_modulus_pa,
        "peak_factor": RIGID_PLATE_FACTOR,
        "sci_m": basin.sci_m,
        "bdi_m": basin.bdi_m,
        "bci_m": basin.bci_m,
        "area_m": basin.area_m,
        "surface_moduli_pa": [f"{r:g}: {e:.4g}" for r, e in basin.surface_moduli_pa.items()],
        WARNINGS: warnings,
    }


def _facts(survey_id: str, point: PointView, drop: DropView) -> dict[str, Any]:
    """Return the columns of a drop other than peaks, result and verdict."""
    stored_point, stored_drop = point.source, drop.source
    assert stored_point is not None
    assert stored_drop is not None
    declared = {**(drop.declared or {}), **stored_point.declared}
    # An edit of the point overrides what was recorded with the drop.
    edits = stored_point.edits
    operators = [edit.get("value") for edit in edits if edit.get("what") == "operator"]
    identity = drop.metadata.get("identity")
    serial = identity.get("serial_number") if isinstance(identity, Mapping) else None
    target = stored_drop.target if stored_drop.target is not None else stored_point.target
    return {
        "survey_id": survey_id or None,
        "point": point.title,
        "drop": drop.number,
        "record": drop.record,
        "discarded": point.discarded or drop.discarded is not None,
        "time_utc": _text(utc_of(drop, point.job.time_zone)),
        "site": _text(declared.get("site")),
        "operator": _text([*operators, drop.metadata.get("operator"), declared.get("operator")]),
        "device": _text([declared.get("device"), serial]),
        "target_pa": number(target),
        "notes": [*drop.notes, *point.notes],
    }


def _result(result: DropResult, point: SurveyPoint, drop: DropView) -> dict[str, Any]:
    """Return the columns of a result."""
    values = result.values(_RESULT_FIELDS)
    cells = {
        name: _texts(value) if _RESULT_KINDS[name] == "texts" else _cell(value)
        for name, value in values.items()
    }
    cells |= without_nan(nested_cells(result))
    cells["reason"] = result.reason
    cells[WARNINGS] = [*result.warnings, *_stale(result, point, drop)]
    return cells


def _cell(value: Any) -> Any:
    """Return a value of a result as a cell: clean text, or None in place of NaN."""
    return _text(value) if isinstance(value, str) else without_nan(value)


def _stale(result: DropResult, point: SurveyPoint, drop: DropView) -> list[Notice]:
    """Return a warning for each declaration that has changed since the inversion."""
    now = {**(drop.declared or {})}
    for edit in point.edits:
        value = edit.get("value")
        if edit.get("what") == "declared" and isinstance(value, Mapping):
            now |= value
    notes = []
    used = {"plate_radius_m": result.plate_radius_m, "poisson_ratio": result.poisson_ratio}
    for key, value_then in used.items():
        then, declared = number(value_then), number(now.get(key))
        if then is None or declared is None:
            continue
        if abs(then - declared) > MAX_RELATIVE_DIFFERENCE * abs(declared):
            values: dict[str, Value] = {"key": key, "then": then, "now": declared}
            notes.append(Notice("declaration-changed", values))
    return notes


def _text(value: object) -> str | None:
    """Return a value, or the first usable one of a list, as one line of text; None: there is no
    text.
    """
    if isinstance(value, list):
        return next((text for item in value if (text := _text(item)) is not None), None)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    return clean(str(value), limit=MAX_CELL_CHARACTERS) or None


def _texts(values: Iterable[Any] | None) -> list[str]:
    return [clean(str(item), limit=MAX_CELL_CHARACTERS) for item in values or ()]


_EMPTY_POINT: Mapping[str, Any] = dict.fromkeys(column.name for column in POINT_COLUMNS)


PointValues = Mapping[str, Any]
"""Values of a point by the names of `POINT_COLUMNS`, in their order; None: unknown. Times are ISO
8601 texts."""


def point_rows(order: Order) -> list[PointValues]:
    """Return the values of all points of a survey, in the survey's order."""
    folder = order.content.folder
    values: list[PointValues] = []
    for point, rows in order.points:
        photos = (photo.relative_to(folder).as_posix() for photo in photos_of(folder, point.name))
        values.append({**_point_row(point, rows), "photos": "; ".join(photos) or None})
    return values


def place_of_row(row: PointValues) -> Place | None:
    """Return the position of a point; None: unknown."""
    latitude, longitude = row["latitude"], row["longitude"]
    return None if latitude is None else Place(latitude, longitude, row["altitude_m"])


def _point_row(point: PointView, drops: Sequence[Row]) -> PointValues:
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
    values = {
        "procedure": None if job.procedure is None else job.procedure.name,
        "quantity": str(job.quantity),
        "value": None if value is None else number(value.value),
        "interval_low": number(low),
        "interval_high": number(high),
        "unit": job.quantity.unit,
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
        **_equivalent_values(in_force),
        "modulus_source": None if in_force is None else in_force.source,
        "modulus_not_supported": progress.withheld if fitted is None else fitted.not_supported,
    }
    return _in_words(values)


def _use_values(progress: PointProgress, diagnosis: DiagnosisResult | None) -> dict[str, Any]:
    """Return what the diagnosed modulus may be used for, and the reason.

    If the records of the point do not support it, that is "do-not-use".
    """
    if diagnosis is None:
        return {"use": None, "use_reason": None, "equivalent_use": None}
    modulus = progress.modulus
    fault = None if modulus is None else modulus.not_supported
    if diagnosis.use != "do-not-use" and fault is not None:
        return {"use": "do-not-use", "use_reason": fault, "equivalent_use": None}
    return {key: getattr(diagnosis, key) for key in ("use", "use_reason", "equivalent_use")}


def _equivalent_values(modulus: PointModulus | None) -> dict[str, float | None]:
    interval, depth = (
        (None, None) if modulus is None else (modulus.equivalent_interval, modulus.depth)
    )
    (low, high), (top, bottom) = interval or (None, None), depth or (None, None)
    return {
        "equivalent_modulus_pa": None if modulus is None else number(modulus.equivalent),
        "equivalent_modulus_interval_low_pa": number(low),
        "equivalent_modulus_interval_high_pa": number(high),
        "modulus_depth_from_m": number(top),
        "modulus_depth_to_m": number(bottom),
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
