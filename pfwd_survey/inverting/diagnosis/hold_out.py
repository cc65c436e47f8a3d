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
from inversion.diagnosis.findings import HeldOut
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import (
    DiagnosisByPoint,
    DiagnosisFailure,
    Workers,
    successful,
)


class _Diagnose(Protocol):
    """Diagnoses of points, with the end of the text that reports the progress."""

    def __call__(self, points: Sequence[DiagnosisPoint], without: str = "") -> DiagnosisByPoint: ...


def with_predictions(
    points: Sequence[DiagnosisPoint],
    diagnoses_of_all: DiagnosisByPoint,
    diagnose: _Diagnose,
    mode: LeaveOut,
    allow: Allow | None,
    workers: Workers,
) -> DiagnosisByPoint:
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
    parts: dict[str, list[HeldOutPart]] = {point.name: [] for point in points}
    warnings: dict[str, list[str]] = {point.name: [] for point in points}
    counts = [count_held_out(_records(point), mode) for point in points]
    for place in range(max(counts, default=0)):
        reduced = [
            replace(point, records=without_held_out(_records(point), mode, place))
            if place < count
            else point
            for point, count in zip(points, counts, strict=True)
        ]
        diagnoses = diagnose(reduced, ", something held out")
        tasks: list[tuple[str, PointRecords, FittedPoint]] = []
        for point, other in zip(points, reduced, strict=True):
            if other is point:
                continue
            diagnosis = diagnoses[point.name]
            if isinstance(diagnosis, DiagnosisFailure):
                warnings[point.name].append(
                    f"nothing is predicted without part {place + 1} ({mode}): {diagnosis.reason}"
                )
            elif diagnosis.fitted is not None:
                tasks.append((point.name, _records(point), diagnosis.fitted))
        if tasks:
            names, *columns = zip(*tasks, strict=True)
            predict: Callable[..., HeldOutPart] = partial(
                held_out_error, mode=mode, place=place, allow=allow
            )
            for name, part in zip(names, workers.map(predict, *columns), strict=True):
                parts[name].append(part)
    return diagnoses_of_all | {
        name: _with_parts(diagnosis, mode, parts[name], warnings[name])
        for name, diagnosis in successful(diagnoses_of_all).items()
    }


def _with_parts(
    diagnosis: PointDiagnosis, mode: LeaveOut, parts: Sequence[HeldOutPart], warnings: Sequence[str]
) -> PointDiagnosis:
    return replace(
        diagnosis,
        held_out=HeldOut.of(mode, parts),
        warnings=(*diagnosis.warnings, *warnings),
    )


def _records(point: DiagnosisPoint) -> PointRecords:
    assert point.records is not None
    return point.records
