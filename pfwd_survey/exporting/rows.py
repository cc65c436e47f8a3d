"""One row per drop: where, when, what was measured, and the result with all that belongs to it."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple, Protocol

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.index import no_collections
from pfwd_device.recording.survey_content import SurveyContent, SurveyDrop, SurveyPoint
from pfwd_device.text import clean
from pfwd_survey.errors import SurveyError
from pfwd_survey.exporting.columns import COLUMNS
from pfwd_survey.exporting.peaks import Peaks, peaks_of
from pfwd_survey.exporting.places import Place, local_of, number, place_of, utc_of
from pfwd_survey.files.header import STIFFNESS_TEST, Declaration, setup_from
from pfwd_survey.files.imported import on_rig
from pfwd_survey.inverting.drop_facts import corrected_deflection, stored_facts
from pfwd_survey.inverting.result_columns import N_LAYERS, Kind, nested_cells, result_columns
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.inverting.screening.missing import ONLY_PEAKS
from pfwd_survey.judging import Job, MeasuredPoint, job_of, judge_point, measured_point
from pfwd_survey.judging.contents import KeptDrop, kept_drops
from pfwd_survey.peaks.basin import ASSUMED_POISSON_RATIO, RIGID, basin_of
from pfwd_survey.peaks.stiffness import stiffness_of
from pfwd_survey.procedures import PointProgress, unit_of

NO_RESULT = "no result"
NOT_INVERTED = "not inverted yet: pfwd export --invert does it"
LONGEST_CELL = 4096
"""Characters; a note may be as long."""

OF_THE_SURVEY = (
    *("drop", "record", "point", "site", "operator", "device", "time_utc", "notes"),
    *("peak_load_n", "deflection_recorded_m", "deflection_corrected_m"),
    *("procedure", "quantity", "value", "interval_low", "interval_high", "unit", "target"),
    "verdict",
)
"""Columns that say what the survey says now, not what was known when the result was found."""

_OF_A_RESULT = {c.name: c.kind for c in COLUMNS if c.name not in OF_THE_SURVEY}
_KEYS = frozenset(_OF_A_RESULT)
_EMPTY: Mapping[str, Any] = dict.fromkeys(column.name for column in COLUMNS)

SAME = 1e-9
"""Relative difference up to which two declared values are one."""


Results = Mapping[tuple[str, int], DropResult]
"""By title of the point and number of the drop within it."""


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """A drop, ready for an export."""

    point: SurveyPoint
    drop: SurveyDrop
    declared: Mapping[str, Any] | None
    """What was declared with the drop; None: the drop is damaged. The traces are not kept here: a
    survey of many drops would fill the memory."""
    place: Place | None
    peaks: Peaks | None
    result: DropResult | None
    """None: there is none."""
    values: Mapping[str, Any]
    """By the names of ``COLUMNS``; None: not known."""
    counts_as: str = ""
    """What it counts as beside the other drops of its point: seating, measured, rejected or
    discarded."""
    time_local: str | None = None
    """When, by the clock of the place, ISO 8601; None: nobody said."""

    @property
    def has_result(self) -> bool:
        """Whether there is a result."""
        return bool(self.values["status"] != NO_RESULT)

    @property
    def used(self) -> bool:
        """Whether neither the drop nor its point is discarded, and it can be read."""
        gone = self.point.discarded or self.drop.discarded
        return not gone and self.declared is not None


class RowMaker(Protocol):
    """Another process that makes parts of the rows as text; one is `exporting.parts`'s."""

    def make(
        self,
        survey_id: str,
        job: Job,
        texts: Callable[[Iterable[Row]], Iterator[str]],
        parts: Sequence[Sequence[SurveyPoint]],
        /,
    ) -> Sequence[Any]:
        """Ask for parts of the points; None stands for one that nobody makes."""
        ...


@dataclass(frozen=True)  # without slots, which leave no room for what is computed once
class Order:
    """A survey on its way into a format."""

    content: SurveyContent
    inverted: Results | None = None
    """Results in place of the stored ones."""
    force: bool = False
    """Whether a file that is there may be replaced."""
    jobs: int = 1
    """Processes that may work on it."""
    second: RowMaker | None = None
    """Makes rows too, for who wants them as text."""
    delimiter: str = ","
    """Between the columns of a text."""
    decimal: str = "."
    """Decimal sign of a text."""

    @cached_property
    def job(self) -> Job:
        """What the survey is measured by.

        Raises
        ------
        SurveyError
            If the procedure that the survey keeps cannot be read.
        """
        return job_of(self.content)

    @cached_property
    def points(self) -> list["PointRows"]:
        """All points with their rows; read and judged once."""
        with no_collections():
            return [self.point(point) for point in self.content.points]

    def point(self, point: SurveyPoint) -> "PointRows":
        """One point with its rows; read anew with every call."""
        return point_rows_of(self.content.survey_id, self.job, point, self.inverted)

    @cached_property
    def rows(self) -> list[Row]:
        """All drops, point by point; read once."""
        return [row for point in self.points for row in point.rows]

    @cached_property
    def results(self) -> int:
        """How many drops have a result; who has not kept the rows may have counted them."""
        return sum(row.has_result for row in self.rows)


@dataclass(frozen=True, eq=False, slots=True)
class PointRows:
    """A point with how it stands and the rows of its drops."""

    point: SurveyPoint
    measured: MeasuredPoint
    progress: PointProgress
    rows: tuple[Row, ...]


class _Counted(NamedTuple):
    """What a drop counts as beside the others of its point."""

    kind: str
    reason: str | None
    """Why it takes no part; None: it does, or nobody said."""


def point_rows_of(
    survey_id: str, job: Job, point: SurveyPoint, inverted: Results | None = None
) -> PointRows:
    """A point of a survey, every drop of it read once: for the verdict and for its row.

    Parameters
    ----------
    survey_id : str
    job : Job
        What the survey is measured by.
    point : SurveyPoint
    inverted : mapping, optional
        Results in place of the stored ones.
    """
    found = tuple(kept_drops(point))
    measured = measured_point(point, found)
    if inverted is not None:
        drops = tuple(
            drop.with_result(inverted.get((point.title, drop.facts.number)))
            for drop in measured.drops
        )
        # What was diagnosed was the fit of another result.
        measured = replace(measured, drops=drops, diagnosis=None)
    progress = judge_point(job, measured)
    stands = _point_columns(job, progress)
    kinds = {number_: kind.value for number_, kind in progress.kinds}
    reasons = {fact.number: fact.reason for fact in progress.excluded}
    counted = [_Counted(kinds.get(d.drop.drop, ""), reasons.get(d.drop.drop)) for d in found]
    rows = tuple(
        _row(survey_id, job, point, kept, inverted, stands, counts)
        for kept, counts in zip(found, counted, strict=True)
    )
    return PointRows(point, measured, progress, rows)


def _point_columns(job: Job, progress: PointProgress) -> dict[str, Any]:
    """How a point stands, as columns of the rows of its drops."""
    value = progress.value
    low, high = (None, None) if value is None or value.interval is None else value.interval
    return {
        "procedure": job.procedure_in_force.name,
        "quantity": job.quantity.value,
        "value": value and value.value,
        "interval_low": low,
        "interval_high": high,
        "unit": unit_of(job.quantity),
        "target": progress.target,
        "verdict": progress.verdict.value,
    }


def _corrected(kept: KeptDrop, result: DropResult | None) -> float | None:
    """The peak of the centre with the response taken out that is declared now, m."""
    record, setup = kept.record, kept.setup
    if record is None or setup is None:
        return None
    found = kept.measured.facts.peak_deflection
    if found is not None:
        return found
    try:
        # One that is rejected for its point has a peak all the same.
        facts = stored_facts(kept.drop.drop, setup, record.metadata, result)
        if facts is not None:
            return facts[0].peak_deflection
        traces = record.drop if record.drop is not None else kept.drop.read_traces().drop
        return corrected_deflection(traces, setup)
    except (RecordingError, SurveyError):
        return None


def _row(
    survey_id: str,
    job: Job,
    point: SurveyPoint,
    kept: KeptDrop,
    inverted: Results | None,
    stands: Mapping[str, Any],
    counted: _Counted,
) -> Row:
    """The row of a drop.

    Parameters
    ----------
    survey_id : str
    job : Job
    point : SurveyPoint
    kept : KeptDrop
    inverted : mapping, optional
        Results in place of the stored ones.
    stands : mapping
        How the point stands, as columns.
    counted : _Counted
    """
    drop, record = kept.drop, kept.record
    fault = None if kept.fault is None else f"damaged: {kept.fault}"
    result = kept.last if inverted is None else inverted.get((point.title, drop.drop))
    place = place_of(point, drop, record)
    peaks = None
    if record is not None:
        peaks = record.peaks if record.drop is None else peaks_of(record.drop)
    values: dict[str, Any] = dict(_EMPTY)
    values |= _facts(survey_id, point, drop, record, job.time_zone)
    values |= {
        "latitude": place and place.latitude,
        "longitude": place and place.longitude,
        "altitude_m": place and place.altitude,
        "peak_load_n": peaks and peaks.load,
        "deflection_recorded_m": peaks and peaks.centre,
        "deflection_corrected_m": _corrected(kept, result),
    }
    values |= stands
    if record is not None and (reason := _never(point, record)) is not None:
        values |= {"status": "rejected", "reason": reason, "warnings": []}
    elif result is None:
        discarded = inverted is not None and (point.discarded or drop.discarded)
        why = "discarded drops are not inverted" if discarded else NOT_INVERTED
        values |= {"status": NO_RESULT, "reason": fault or why, "warnings": []}
    else:
        values |= _result(result, point, record)
    if record is not None:
        values |= _peak_values(point, drop, record, values)
    declared = None if record is None else record.declared
    if values["status"] in ("seating", "measured"):
        # As the procedure counts now, whatever it was when it was inverted.
        if counted.kind in ("seating", "measured"):
            values["status"] = counted.kind
        elif counted.kind == "rejected" and not drop.discarded:
            values |= {"status": counted.kind, "reason": counted.reason}
    local = _text(local_of(record, job.time_zone))
    return Row(point, drop, declared, place, peaks, result, values, counted.kind, local)


def _never(point: SurveyPoint, record: DropFacts) -> str | None:
    """Why a drop is never inverted; None: it can be."""
    if on_rig({**record.declared, **point.declared}):
        return STIFFNESS_TEST
    only = record.drop is not None and record.drop.only_peaks is not None
    return ONLY_PEAKS if only else None


def _peak_values(
    point: SurveyPoint, drop: SurveyDrop, record: DropFacts, values: Mapping[str, Any]
) -> dict[str, Any]:
    """What peaks alone say, and the stiffness of a rig."""
    declared = {**record.declared, **point.declared}
    only = None if record.drop is None else record.drop.only_peaks
    if on_rig(declared):
        try:
            traces = record.drop if record.drop is not None else drop.read_traces().drop
            setup = setup_from({k: Declaration(v, "") for k, v in declared.items()}, point.title)
        except (RecordingError, SurveyError):
            return {"kind": "stiffness"}
        found = stiffness_of(traces, setup)
        return {
            "kind": "stiffness",
            "secant_stiffness_n_per_m": found and found.secant_n_per_m,
            "dynamic_stiffness_n_per_m": found and found.dynamic_n_per_m,
        }
    radius = number(declared.get("plate_radius_m"))
    if only is None or radius is None:
        return {"kind": "traces" if only is None else "peaks"}
    said = number(declared.get("poisson_ratio"))
    ratio = ASSUMED_POISSON_RATIO if said is None else said
    basin = basin_of(only, radius, ratio)
    warnings = list(values["warnings"] or [])
    if basin.left_out:
        places = ", ".join(f"{offset:g} m" for offset in basin.left_out)
        warnings.append(f"bad sensors, left out of the indices: {places}")
    return {
        "kind": "peaks",
        "poisson_ratio": ratio,
        "plate_radius_m": radius,
        "peak_modulus_pa": basin.peak_modulus_pa,
        "peak_factor": RIGID,
        "sci_m": basin.sci_m,
        "bdi_m": basin.bdi_m,
        "bci_m": basin.bci_m,
        "area_m": basin.area_m,
        "surface_moduli_pa": [f"{r:g}: {e:.4g}" for r, e in basin.surface_moduli_pa.items()],
        "warnings": warnings,
    }


def _facts(
    survey_id: str,
    point: SurveyPoint,
    drop: SurveyDrop,
    record: DropFacts | None,
    zone: str | None,
) -> dict[str, Any]:
    declared = {**(record.declared if record else {}), **point.declared}
    # Said of the point later, wins over what was recorded with the drop.
    operators = [edit.get("value") for edit in point.edits if edit.get("what") == "operator"]
    metadata = record.metadata if record else {}
    identity = metadata.get("identity")
    serial = identity.get("serial_number") if isinstance(identity, Mapping) else None
    target = drop.target if drop.target is not None else point.target
    return {
        "survey_id": survey_id or None,
        "point": point.title,
        "drop": drop.drop,
        "record": drop.number,
        "discarded": point.discarded or drop.discarded,
        "time_utc": _text(utc_of(record, zone)),
        "site": _text(declared.get("site")),
        "operator": _text([*operators, metadata.get("operator"), declared.get("operator")]),
        "device": _text([declared.get("device"), serial]),
        "target_pa": number(target),
        "notes": [*drop.notes, *point.notes],
    }


def _result(result: DropResult, point: SurveyPoint, record: DropFacts | None) -> dict[str, Any]:
    """The result as columns; a modulus is left out when what belongs to it is missing."""
    found = _cells(result)
    nested = {
        name: value if value is None or name == N_LAYERS else number(value)
        for name, value in nested_cells(result).items()
    }
    warnings = found.get("warnings") or []
    warnings += _stale(result, point, record)
    missing = missing_parts(result)
    if found.get("modulus_pa") is not None and missing:
        found["modulus_pa"] = found["peak_modulus_pa"] = None
        warnings.append(f"modulus withheld: the result lacks {', '.join(missing)}; invert again")
    found["warnings"] = warnings
    if missing:
        nested |= dict.fromkeys(_WITHHELD)
    return found | nested


def _cells(result: DropResult) -> dict[str, Any]:
    """What a result has under the names of columns, each as its column's kind."""
    if result.more.keys().isdisjoint(_KEYS):
        return _known_cells(result)
    # Another version may have such a key, or a value of another type for one.
    values = result.values(_OF_A_RESULT)
    return {name: _OF_KIND[_OF_A_RESULT[name]](value) for name, value in values.items()}


def _known_cells(result: DropResult) -> dict[str, Any]:
    """As :func:`_cells`, of a result whose keys are all known here.

    A survey has many drops and a result many values: what they are is looked up once, above.
    """
    found: dict[str, Any] = {}
    for name, value in zip(_NUMBER_NAMES, _NUMBER_VALUES(result), strict=True):
        # Nearly always a float; this is `number` without the call.
        sound = type(value) is float and math.isfinite(value)
        found[name] = value if sound or value is None else number(value)
    for name, as_kind, value in zip(_OTHER_NAMES, _OTHER_KINDS, _OTHER_VALUES(result), strict=True):
        found[name] = as_kind(value)
    return found


def missing_parts(result: DropResult) -> list[str]:
    """What a modulus must not be shown without, and this result does not have."""
    interval = result.modulus_interval_pa
    uncertain = number(result.modulus_sd_pa) is not None or (
        interval is not None and number(interval[0]) is not None
    )
    parts = {
        "an uncertainty": uncertain,
        "its model": result.model is not None,
        "the plate radius": number(result.plate_radius_m) is not None,
        "Poisson's ratio": number(result.poisson_ratio) is not None,
        "its warnings": result.warnings is not None,
    }
    return [name for name, there in parts.items() if not there]


def _stale(result: DropResult, point: SurveyPoint, record: DropFacts | None) -> list[str]:
    """What has been declared otherwise since the result was made."""
    now = {**(record.declared if record else {})}
    for edit in point.edits:
        value = edit.get("value")
        if edit.get("what") == "declared" and isinstance(value, Mapping):
            now |= value
    found = []
    used = {"plate_radius_m": result.plate_radius_m, "poisson_ratio": result.poisson_ratio}
    for key, value_then in used.items():
        then, declared = number(value_then), number(now.get(key))
        if then is None or declared is None:
            continue
        if abs(then - declared) > SAME * abs(declared):
            found.append(f"{key} was {then:g} for this result, {declared:g} is declared by now")
    return found


def _text(value: object) -> str | None:
    """A text on one line, or the first of several that is one."""
    if isinstance(value, list):
        return next((text for item in value if (text := _text(item)) is not None), None)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    return clean(str(value), limit=LONGEST_CELL) or None


def _texts(value: object) -> list[str]:
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple):
        return []
    return [clean(str(item), limit=LONGEST_CELL) for item in value]


def _whole(value: object) -> int | None:
    return value if type(value) is int else None


def _flag(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


_OF_KIND: Mapping[Kind, Callable[[Any], Any]] = {
    "number": number,
    "whole": _whole,
    "flag": _flag,
    "text": _text,
    "texts": _texts,
}
"""How the value of a result becomes that of a column."""

# Nested records have columns of their own, see `nested_cells`.
_FIELDS = [f.name for f in fields(DropResult) if f.name in _KEYS and f.name != N_LAYERS]
_WITHHELD = [column.name for column in result_columns("layers")]
_NUMBER_NAMES = tuple(name for name in _FIELDS if _OF_A_RESULT[name] == "number")
_NUMBER_VALUES = attrgetter(*_NUMBER_NAMES)
_OTHER_NAMES = tuple(name for name in _FIELDS if _OF_A_RESULT[name] != "number")
_OTHER_KINDS = tuple(_OF_KIND[_OF_A_RESULT[name]] for name in _OTHER_NAMES)
_OTHER_VALUES = attrgetter(*_OTHER_NAMES)
