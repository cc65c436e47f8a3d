"""Prediction of held-out drops and sensors from the other data of the instrument."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from inversion import InversionError
from inversion.diagnosis.findings import (
    HeldOut,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    PointSummary,
)
from inversion.diagnosis.model import PointRecords
from inversion.effects.base import Values
from inversion.inference.held_out import (
    Allow,
    count_held_out,
    held_out_error,
    with_peak_interval,
    with_side_difference,
)
from inversion.inference.instrument import InstrumentPoints
from inversion.inference.population import without_error_budget
from inversion.inference.structures import Structure
from inversion.notices import Notice
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, DiagnosisRequest, instrument_of
from pfwd.analysis.diagnosis.shared_device import DiagnosisByPoint, successful
from pfwd.analysis.diagnosis.workers import ProgressCounter, Workers
from pfwd.analysis.response_tables import library_of_process

# Errors that concern one point and must not stop the diagnosis of the others.
_FAILURES = (InversionError, np.linalg.LinAlgError)
_PartOutcome = HeldOutPart | Notice
_R = TypeVar("_R")


def with_predictions(
    points: Sequence[DiagnosisPoint],
    diagnoses: DiagnosisByPoint,
    request: DiagnosisRequest,
    workers: Workers,
) -> DiagnosisByPoint:
    """Return the diagnoses with the errors of the predictions of held-out data.

    Held-out data of a point are not used in their prediction; the other points of the instrument
    are used completely.

    Parameters
    ----------
    points : sequence of DiagnosisPoint
        Points with records.
    diagnoses : dict
        Diagnoses of the points with all their records.
    request : DiagnosisRequest
        It holds out the next drop, drops or sensors.
    workers : Workers
    """
    by_name = successful(diagnoses)
    groups: dict[tuple[object, ...], list[DiagnosisPoint]] = {}
    for point in points:
        if point.name in by_name:
            groups.setdefault(instrument_of(point), []).append(point)
    predicted = dict(diagnoses)
    for group in groups.values():
        predicted |= _of_instrument(group, by_name, request, workers)
    return predicted


def _of_instrument(
    group: Sequence[DiagnosisPoint],
    diagnoses: Mapping[str, PointDiagnosis],
    request: DiagnosisRequest,
    workers: Workers,
) -> DiagnosisByPoint:
    """Return the diagnoses, with predictions, of those points of an instrument that have them."""
    mode = request.leave_out
    assert mode is not None  # without it nothing is predicted here
    names = [point.name for point in group]
    records = [point.records for point in group if point.records is not None]
    tasks = [
        (place, part)
        for place, of_point in enumerate(records)
        for part in range(count_held_out(of_point, mode))
    ]
    if not tasks:
        return {}

    def compute(kind: str, function: Callable[..., _R], count: int) -> list[_R]:
        counter = ProgressCounter(request.progress, kind, count)
        work = workers.map(partial(_in_worker, function), records[:count])
        return list(counter.counted(names[:count], work))

    declared_effects = without_error_budget(request.device or {})
    instrument = InstrumentPoints(records, declared_effects, library_of_process(), compute)
    peers = {place: instrument.neighbour_summaries(place) for place, _ in tasks}
    columns: list[Sequence[Any]] = [
        [records[place] for place, _ in tasks],
        [instrument.structure_without(place) for place, _ in tasks],
        [[*peers[place].values()] for place, _ in tasks],
        [part for _, part in tasks],
    ]
    predict = partial(
        _held_out_error, mode=mode, declared_effects=declared_effects, allow=request.allow
    )
    counter = ProgressCounter(request.progress, "held-out parts", len(tasks))
    parts: dict[int, list[_PartOutcome]] = {}
    outcomes = counter.counted([names[place] for place, _ in tasks], workers.map(predict, *columns))
    for (place, _), outcome in zip(tasks, outcomes, strict=True):
        parts.setdefault(place, []).append(outcome)
    next_drops = {
        place: outcome
        for place, (outcome, *_) in parts.items()
        if mode == "next" and request.allow is None and isinstance(outcome, HeldOutPart)
    }
    predicted: DiagnosisByPoint = {}
    for place, of_point in parts.items():
        diagnosis = diagnoses[names[place]]
        held_out = HeldOut.of(mode, [part for part in of_point if isinstance(part, HeldOutPart)])
        warnings = [part for part in of_point if isinstance(part, Notice)]
        if held_out is not None and mode == "sensor":
            held_out = with_side_difference(held_out, records[place])
        elif held_out is not None and place in next_drops:
            held_out = with_peak_interval(held_out, [next_drops.get(peer) for peer in peers[place]])
        predicted[names[place]] = replace(
            diagnosis, held_out=held_out, warnings=(*diagnosis.warnings, *warnings)
        )
    return predicted


def _in_worker(function: Callable[..., _R], records: PointRecords) -> _R:
    return function(records, library=library_of_process())


def _held_out_error(
    records: PointRecords,
    structure: Structure | None,
    neighbours: Sequence[PointSummary],
    place: int,
    *,
    mode: LeaveOut,
    declared_effects: Mapping[str, Values] | None,
    allow: Allow | None,
) -> _PartOutcome:
    """Return the prediction errors of one held-out drop or sensor, or a warning with the reason."""
    try:
        return held_out_error(
            records,
            structure,
            neighbours,
            mode,
            place,
            declared_effects,
            allow,
            library_of_process(),
        )
    except _FAILURES as err:
        values = {"part": place + 1, "mode": mode, "reason": str(err)}
        return Notice("held-out-failed", values)
