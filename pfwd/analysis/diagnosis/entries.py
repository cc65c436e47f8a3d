"""Points of files prepared for their diagnosis: choice of the drops, and their records."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from inversion.diagnosis.findings import DeviceValues, LeaveOut
from inversion.diagnosis.model import PointRecords
from inversion.inference.held_out import Allow
from inversion.notices import Notice, codes
from pfwd.analysis.analyse import record_of
from pfwd.analysis.diagnosis.workers import Progress
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_store import basis_of, question_of, read_diagnosis
from pfwd.analysis.results import DiagnosisResult
from pfwd.analysis.screening.bad_sensors import leave_out_bad_sensors
from pfwd.analysis.screening.drops import duplicate_drops, screen_point, unbroken_part
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device.recording import SurveyDrop

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class DiagnosisPoint:
    """Point prepared for its diagnosis."""

    file: str
    device: str | None
    """Name of the device that measured it."""
    records: PointRecords | None
    """Records of the measured drops; None: no drop of it was measured."""
    rejected: tuple[Notice, ...] = ()
    warnings: tuple[Notice, ...] = ()
    rig: TracePoint | None = None
    """The point as read, if it was measured on a spring test rig; None: on ground."""
    point: str | None = None
    """Name of the test point."""
    question: str = ""
    """Identifier of the samples and declarations; empty: no drop was measured."""
    basis: str = ""
    """Identifier of the declarations, see `result_store.basis_of`."""
    left_out: tuple[int, ...] = ()
    """Numbers of the drops that are not fitted."""
    name: str = ""
    """Name that is unique within one request, see :func:`with_unique_names`."""
    last: SurveyDrop | None = None
    """Last measured drop of a point in a survey, with which the diagnosis is stored; None: no
    survey."""


@dataclass(frozen=True, kw_only=True)
class DiagnosisRequest:
    """Known device effects, data to hold out, and the way to compute the diagnoses of points.

    Parameters
    ----------
    device : mapping, optional
        Known parameters of device effects, by effect and parameter, in SI units.
    spread : mapping, optional
        Standard deviations of the values in ``device``. A parameter with one is fitted to each
        point with the value as its prior; others are fixed.
    leave_out : "next", "drop", "sensor", "point" or None
        Data that are held out and predicted. "next": the last drop of each point. "drop", "sensor":
        each drop or sensor in turn. They are predicted from the remaining data of the point and
        from the other points of the instrument. "point": each point is fitted with the device
        effects of the other points. None: the last drop of each point is predicted from its other
        drops.
    allow : "stiffness" or None
        "stiffness": a factor on the stiffness is fitted to a held-out drop.
    use_stored : bool
        True: a diagnosis that the survey stores for the same request is returned in place of a new
        one.
    jobs : int
        Number of processes.
    progress : callable, optional
        Called with the kind of work, the name of the point, and the numbers of points done and in
        all.
    """

    device: DeviceValues | None = None
    spread: DeviceValues | None = None
    leave_out: LeaveOut | None = None
    allow: Allow | None = None
    use_stored: bool = False
    jobs: int = 1
    progress: Progress | None = None

    @property
    def uses_all_points(self) -> bool:
        """Whether held-out data are predicted from all points of the instrument."""
        return self.leave_out in ("next", "drop", "sensor")


def with_unique_names(entries: Iterable[DiagnosisPoint | _T]) -> list[DiagnosisPoint | _T]:
    """Return the points with unique names, by which their diagnoses are identified.

    Drops that were declared differently are two points of the same file with the same name, which
    then get a number. Entries that are not points are returned unchanged.
    """
    names: set[str] = set()
    named: list[DiagnosisPoint | _T] = []
    for entry in entries:
        if isinstance(entry, DiagnosisPoint):
            at_point = "" if entry.point is None else f", point {entry.point}"
            base = name = f"{entry.file}{at_point}"
            number = 1
            while name in names:
                number += 1
                name = f"{base} ({number})"
            names.add(name)
            entry = replace(entry, name=name)
        named.append(entry)
    return named


def entries_of(file: str, options: AnalysisOptions) -> list[DiagnosisPoint]:
    """Read and screen the points of a file."""
    return [
        entry_of(file, p, options) for p in read_points(file, options.header, options.overrides())
    ]


def entry_of(file: str, point: TracePoint, options: AnalysisOptions) -> DiagnosisPoint:
    """Screen a point that was read already, and choose the drops that are fitted."""
    device = None if point.setup.device is None else str(point.setup.device)
    if point.setup.is_stiffness_test:
        return DiagnosisPoint(file, device, None, (), point.warnings, point, point.name)
    screenings = leave_out_bad_sensors(point, screen_point(point))
    reasons = duplicate_drops(point.drops, screenings)
    chosen = [
        (unbroken_part(drop)[0], screening)
        for index, (drop, screening) in enumerate(zip(point.drops, screenings, strict=True))
        if screening.status == "measured" and index not in reasons
    ]
    reasons |= {
        index: screening.reason
        for index, screening in enumerate(screenings)
        if screening.reason is not None
    }
    rejected = tuple(
        Notice("drop-rejected", {"drop": point.drops[index].number, "reason": reason})
        for index, reason in sorted(reasons.items())
    )
    # A bad sensor is excluded from every drop of the point: one warning is enough.
    every = [*point.warnings, *(w for _, screening in chosen for w in screening.warnings)]
    warnings = tuple(dict.fromkeys(every))
    if not chosen:
        return DiagnosisPoint(file, device, None, rejected, warnings, point=point.name)
    excluded = {offset for _, screening in chosen for offset in screening.left_out}
    records = tuple(record_of(drop, point.setup, options, excluded) for drop, _ in chosen)
    numbers = tuple(drop.number for drop, _ in chosen)
    # Only declared values are fixed; the search for effects needs the others to be free.
    made = PointRecords(
        file if point.name is None else point.name,
        records,
        numbers,
        elastic=options.elastic,
        load=options.load or "measured",
    )
    stored = [
        drop
        for drop, screening in zip(
            point.survey_drops, screenings if point.survey_drops else (), strict=True
        )
        if screening.status == "measured"
    ]
    return DiagnosisPoint(
        file,
        device,
        made,
        rejected,
        warnings,
        point=point.name,
        basis=basis_of(point.setup),
        left_out=tuple(
            drop.number
            for index, (drop, screening) in enumerate(zip(point.drops, screenings, strict=True))
            if screening.status != "measured" or index in reasons
        ),
        question=question_of(
            records, (made.elastic, made.load), [codes(rejected), codes(warnings)]
        ),
        last=stored[-1] if stored else None,
    )


def instrument_of(point: DiagnosisPoint) -> tuple[object, ...]:
    """Return the key by which points of the same instrument are grouped.

    It is the declared device, or else plate radius, offsets and quantities of the sensors.
    """
    if point.device is not None or point.records is None:
        return (point.device,)
    record = point.records.records[0]
    sensors = tuple((sensor.offset, sensor.quantity) for sensor in record.sensors)
    return None, record.instrument.plate_radius, sensors


def questions_of(work: Sequence[DiagnosisPoint], request: DiagnosisRequest) -> list[str]:
    """Return, for each point, an identifier of the request for its diagnosis.

    Points of one device have a common request, because effects detected at one are tried at all.

    Parameters
    ----------
    work : sequence of DiagnosisPoint
        Points with records.
    request : DiagnosisRequest
    """
    predicts = request.uses_all_points
    groups: dict[object, list[str]] = {}
    for place, point in enumerate(work):
        groups.setdefault(_group(place, point, predicts), []).append(point.question)
    questions = []
    for place, point in enumerate(work):
        group = sorted(groups[_group(place, point, predicts)])
        parts = (
            *(point.question, group, request.device),
            *(request.leave_out, request.spread, request.allow),
        )
        # "inference" makes predictions of an earlier method invalid.
        text = repr((*parts, "inference") if predicts else parts)
        questions.append(hashlib.sha256(text.encode()).hexdigest()[:32])
    return questions


def _group(place: int, point: DiagnosisPoint, predicts: bool) -> object:
    """Return the key of the group of points that have a common request."""
    if predicts:
        return instrument_of(point)
    return place if point.device is None else point.device


def stored_answers(
    points: Sequence[DiagnosisPoint], questions: Mapping[str, str]
) -> dict[str, DiagnosisResult]:
    """Return the stored diagnoses of the same requests, by `DiagnosisPoint.name`."""
    answers = {}
    for point in points:
        stored = None if point.last is None else read_diagnosis(point.last)
        if stored and stored.question == questions[point.name]:
            answers[point.name] = replace(stored, file=point.file, point=point.point, stored=True)
    return answers
