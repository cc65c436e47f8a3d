"""Diagnosis of the points of files. Points of the same device are diagnosed together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from inversion import InversionError
from pfwd.analysis.diagnosis.entries import (
    DiagnosisPoint,
    DiagnosisRequest,
    entries_of,
    questions_of,
    stored_answers,
    with_unique_names,
)
from pfwd.analysis.diagnosis.hold_out import with_predictions
from pfwd.analysis.diagnosis.record import diagnosis_result
from pfwd.analysis.diagnosis.shared_device import DiagnosisFailure, diagnose_points
from pfwd.analysis.diagnosis.workers import Workers
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropDiagnosis, FileOutcome
from pfwd.errors import SurveyError


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """Outcome for one point, or the reason why a file is not valid."""

    file: str
    result: DiagnosisResult | None = None
    error: str | None = None
    number: int | None = None
    """Number, within its survey, of the point's last measured drop, with which the diagnosis is
    stored."""


def diagnose_files(
    files: Sequence[str],
    options: AnalysisOptions | None = None,
    request: DiagnosisRequest | None = None,
) -> Iterator[Diagnosed]:
    """Yield the diagnosis of every point of files, in their order.

    Parameters
    ----------
    files : sequence of str
        Surveys, drop files, trace files.
    options : AnalysisOptions, optional
        Header and declared values.
    request : DiagnosisRequest, optional
    """
    options = options or AnalysisOptions()
    entries: list[DiagnosisPoint | Diagnosed] = []
    for file in files:
        try:
            entries += entries_of(file, options)
        except SurveyError as err:
            entries.append(Diagnosed(file, error=str(err)))
        except InversionError as err:
            entries.append(Diagnosed(file, error=f"{file}: {err}"))
    yield from diagnose_entries(entries, request)


def diagnose_entries(
    entries: Sequence[DiagnosisPoint | Diagnosed], request: DiagnosisRequest | None = None
) -> Iterator[Diagnosed]:
    """Yield the diagnosis of points that were read already, in their order.

    Entries for invalid files are passed on.
    """
    request = request or DiagnosisRequest()
    entries = with_unique_names(entries)
    points = [
        entry
        for entry in entries
        if isinstance(entry, DiagnosisPoint) and entry.records is not None
    ]
    texts = questions_of(points, request)
    questions = {point.name: text for point, text in zip(points, texts, strict=True)}
    stored = stored_answers(points, questions) if request.use_stored else {}
    # Points of one device are one request: all of their diagnoses are stored ones, or none.
    open_devices = {point.device for point in points if point.name not in stored} - {None}
    work = [p for p in points if p.name not in stored or p.device in open_devices]
    with Workers(min(request.jobs, len(work)), questions) as workers:
        outcomes = diagnose_points(work, request, workers)
        if request.uses_all_points:
            outcomes = with_predictions(work, outcomes, request, workers)
    for entry in entries:
        if isinstance(entry, Diagnosed):
            yield entry
            continue
        number = None if entry.last is None else entry.last.number
        if entry.records is not None and entry.name not in outcomes:
            yield Diagnosed(entry.file, stored[entry.name], number=number)
            continue
        outcome = outcomes.get(entry.name)
        if isinstance(outcome, DiagnosisFailure):
            yield Diagnosed(entry.file, error=f"{entry.file}: {outcome.reason}")
            continue
        result = diagnosis_result(entry, outcome, questions.get(entry.name))
        yield Diagnosed(entry.file, result, number=number)
    workers.forget()


def with_diagnoses(outcome: FileOutcome, diagnosed: Sequence[Diagnosed]) -> FileOutcome:
    """Return the results of a file, with the diagnosis of the point in each fitted drop."""
    by_drop: dict[tuple[str | None, int], DropDiagnosis] = {}
    for point_outcome in diagnosed:
        result = point_outcome.result
        if result is None:
            continue
        diagnosis = DropDiagnosis(
            verdict=result.verdict,
            corrected=result.corrected,
            effects=result.effects,
            after=result.after,
        )
        by_drop |= {(result.point, drop): diagnosis for drop in result.drops}
    results = []
    for drop in outcome.results:
        point = None if drop.point is None else str(drop.point)
        results.append(replace(drop, diagnosis=by_drop.get((point, drop.drop))))
    return replace(outcome, results=results)
