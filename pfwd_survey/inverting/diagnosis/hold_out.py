"""Held-out drops and sensors: the survey is diagnosed without them, and they are predicted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

from inversion.diagnosis import (
    Allow,
    FittedPoint,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    PointRecords,
    count_held_out,
    held_out_error,
    without_held_out,
)
from inversion.diagnosis.prediction import mean_error
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import Found, Workers


class _Diagnose(Protocol):
    """Diagnoses of points, by their identity, with the words for the progress."""

    def __call__(self, points: Sequence[DiagnosisPoint], without: str = "") -> Found: ...


def with_predictions(
    points: Sequence[DiagnosisPoint],
    diagnoses_of_all: Found,
    diagnose: _Diagnose,
    mode: LeaveOut,
    allow: Allow | None,
    workers: Workers,
) -> Found:
    """Return the diagnoses with how well held-out parts are predicted.

    In each round every point is diagnosed without one part, so that nothing of a held-out part
    enters by the device either.

    Parameters
    ----------
    points : sequence of DiagnosisPoint, with records
    diagnoses_of_all : diagnoses of the points with all their records
    diagnose : makes the diagnoses of other points
    mode : "next", "drop" or "sensor"
    allow : what may be fitted to a held-out drop
    workers : Workers
    """
    parts: dict[int, list[HeldOutPart]] = {id(point): [] for point in points}
    warnings: dict[int, list[str]] = {id(point): [] for point in points}
    counts = [count_held_out(_records(point), mode) for point in points]
    for place in range(max(counts, default=0)):
        reduced = [
            replace(point, records=without_held_out(_records(point), mode, place))
            if place < count
            else point
            for point, count in zip(points, counts, strict=True)
        ]
        diagnoses = diagnose(reduced, ", something held out")
        tasks: list[tuple[int, PointRecords, FittedPoint]] = []
        for point, other in zip(points, reduced, strict=True):
            diagnosis = diagnoses[id(other)]
            if other is point:
                continue
            if isinstance(diagnosis, PointDiagnosis) and diagnosis.fitted is not None:
                tasks.append((id(point), _records(point), diagnosis.fitted))
            else:
                warnings[id(point)].append(
                    f"nothing is predicted without part {place + 1} ({mode}): {diagnosis}"
                )
        if tasks:
            keys, *columns = zip(*tasks, strict=True)
            predict: Callable[..., HeldOutPart] = partial(
                held_out_error, mode=mode, place=place, allow=allow
            )
            for key, part in zip(keys, workers.map(predict, *columns), strict=True):
                parts[key].append(part)
    return {
        key: _with_parts(diagnosis, mode, parts[key], warnings[key])
        if isinstance(diagnosis, PointDiagnosis)
        else diagnosis
        for key, diagnosis in diagnoses_of_all.items()
    }


def _with_parts(
    diagnosis: PointDiagnosis, mode: LeaveOut, parts: Sequence[HeldOutPart], warnings: Sequence[str]
) -> PointDiagnosis:
    before, after = mean_error(parts)
    return replace(
        diagnosis,
        held_out_before=before,
        held_out_after=after,
        held_out_mode=mode,
        held_out_by=tuple(parts),
        warnings=(*diagnosis.warnings, *warnings),
    )


def _records(point: DiagnosisPoint) -> PointRecords:
    assert point.records is not None
    return point.records
