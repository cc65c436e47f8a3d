"""Diagnosis of the points of files. Points of the same device are diagnosed together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from inversion import InversionError
from inversion.diagnosis.findings import LeaveOut, PointDiagnosis
from inversion.diagnosis.flat_tops import Channel, largest_values
from inversion.inference.held_out import Allow
from inversion.inference.instrument import InstrumentKnowledge
from inversion.inference.population import without_error_budget
from pfwd.analysis.diagnosis.entries import (
    DiagnosisPoint,
    entries_of,
    questions_of,
    stored_answers,
    with_question,
    with_unique_names,
)
from pfwd.analysis.diagnosis.hold_out import with_predictions
from pfwd.analysis.diagnosis.points import (
    DeviceValues,
    DiagnosisByPoint,
    DiagnosisFailure,
    Progress,
    ProgressCounter,
    Workers,
    diagnose_all,
)
from pfwd.analysis.diagnosis.record import diagnosis_result
from pfwd.analysis.diagnosis.shared_device import (
    PREDICTED,
    Phases,
    declared_device,
    diagnose_device,
    with_device,
)
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, DropDiagnosis, FileOutcome
from pfwd.errors import SurveyError


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """Outcome for one point, or the reason why a file is not valid."""

    file: str
    result: DiagnosisResult | None = None
    diagnosis: PointDiagnosis | None = None
    error: str | None = None
    number: int | None = None
    """Number, within its survey, of the point's last measured drop, with which the diagnosis is
    stored."""


def diagnose_files(
    files: Sequence[str],
    options: AnalysisOptions | None = None,
    device: DeviceValues | None = None,
    jobs: int = 1,
    leave_out: LeaveOut | None = None,
    *,
    use_stored: bool = False,
    progress: Progress | None = None,
    spread: DeviceValues | None = None,
    allow: Allow | None = None,
) -> Iterator[Diagnosed]:
    """Yield the diagnosis of every point of files, in their order.

    Parameters
    ----------
    files : sequence of str
        Surveys, drop files, trace files.
    options : AnalysisOptions, optional
        Header and declared values.
    device : mapping, optional
        Known parameters of device effects, by effect and parameter, in SI units.
    jobs : int
        Number of processes.
    leave_out : "next", "drop", "sensor", "point" or None
        Data that are held out and predicted. "next": the last drop of each point. "drop", "sensor":
        each drop or sensor in turn. They are predicted from the remaining data of the point and
        from the other points of the instrument. "point": each point is fitted with the device
        effects of the other points. None: the last drop of each point is predicted from its other
        drops.
    use_stored : bool
        True: a diagnosis that the survey stores for the same request is returned in place of a new
        one.
    progress : callable, optional
        Called with the kind of work, the name of the point, and the numbers of points done and in
        all.
    spread : mapping, optional
        Standard deviations of the values in ``device``. A parameter with one is fitted to each
        point with the value as its prior; others are fixed.
    allow : "stiffness" or None
        "stiffness": a factor on the stiffness is fitted to a held-out drop.
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
    yield from diagnose_entries(
        entries,
        device,
        jobs,
        leave_out,
        use_stored=use_stored,
        progress=progress,
        spread=spread,
        allow=allow,
    )


def diagnose_entries(
    entries: Sequence[DiagnosisPoint | Diagnosed],
    device: DeviceValues | None = None,
    jobs: int = 1,
    leave_out: LeaveOut | None = None,
    *,
    use_stored: bool = False,
    progress: Progress | None = None,
    spread: DeviceValues | None = None,
    allow: Allow | None = None,
) -> Iterator[Diagnosed]:
    """Yield the diagnosis of points that were read already, in their order.

    Entries for invalid files are passed on.

    Parameters
    ----------
    entries : sequence of DiagnosisPoint or Diagnosed
    device, jobs, leave_out, use_stored, progress, spread, allow
        As for :func:`diagnose_files`.
    """
    entries = with_unique_names(entries)
    points = [
        entry
        for entry in entries
        if isinstance(entry, DiagnosisPoint) and entry.records is not None
    ]
    texts = questions_of(points, device, leave_out, spread, allow)
    questions = {point.name: text for point, text in zip(points, texts, strict=True)}
    stored = stored_answers(points, questions) if use_stored else {}
    # Points of one device are one request: all of their diagnoses are stored ones, or none.
    open_devices = {point.device for point in points if point.name not in stored} - {None}
    work = [p for p in points if p.name not in stored or p.device in open_devices]

    def diagnose(points: Sequence[DiagnosisPoint]) -> DiagnosisByPoint:
        points = _with_device_largest(points)
        if device:
            instrument = InstrumentKnowledge.from_values(device, spread)
            counter = ProgressCounter(progress, "each point with what is known", len(points))
            return diagnose_all(
                points, [instrument] * len(points), workers, counter, predict_last=leave_out is None
            )
        phases = Phases.of(progress, len(points))

        def of_device(points: Sequence[DiagnosisPoint]) -> DiagnosisByPoint:
            return diagnose_device(points, workers, leave_out, phases)

        outcomes: DiagnosisByPoint = {}
        for outcomes_of_device in workers.at_once(of_device, _by_device(points)):
            outcomes |= outcomes_of_device
        return outcomes

    with Workers(min(jobs, len(work)), questions) as workers:
        outcomes = diagnose(work)
        if leave_out in PREDICTED:
            outcomes = with_predictions(
                work,
                outcomes,
                leave_out,
                workers,
                declared_effects=device and without_error_budget(device),
                allow=allow,
                progress=partial(ProgressCounter, progress),
            )
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
        if device and outcome is not None:
            outcome = with_device(outcome, declared_device(device, spread))
        result = diagnosis_result(entry, outcome)
        if entry.name in questions:
            result = with_question(result, entry, questions[entry.name])
        yield Diagnosed(entry.file, result, outcome, number=number)
    workers.forget()


def _by_device(work: Sequence[DiagnosisPoint]) -> list[list[DiagnosisPoint]]:
    """Return the points in groups of one device; the first group has those without a device."""
    devices: dict[str | None, list[DiagnosisPoint]] = {}
    for point in work:
        devices.setdefault(point.device, []).append(point)
    return [devices[key] for key in sorted(devices, key=lambda key: (key is not None, key or ""))]


def _with_device_largest(entries: Sequence[DiagnosisPoint]) -> list[DiagnosisPoint]:
    """Return points with the largest values of each channel at others of the device.

    They disprove that a channel of the point was cut off at a lower level.
    """
    by_device: dict[str, dict[Channel, list[tuple[float, int]]]] = {}
    for place, entry in enumerate(entries):
        if entry.records and entry.device is not None:
            of_device = by_device.setdefault(entry.device, {})
            for channel, value in largest_values(entry.records.records).items():
                # Keep two: where the largest value is of the point itself, the second one is used.
                pairs = [*of_device.get(channel, []), (value, place)]
                of_device[channel] = sorted(pairs, reverse=True)[:2]
    completed: list[DiagnosisPoint] = []
    for place, entry in enumerate(entries):
        if entry.records and entry.device is not None:
            largest = {
                channel: next((value for value, owner in pairs if owner != place), 0.0)
                for channel, pairs in by_device[entry.device].items()
            }
            records = replace(entry.records, device_largest=largest)
            entry = replace(entry, records=records)
        completed.append(entry)
    return completed


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
        by_drop |= {(result.point, drop): diagnosis for drop in result.drops or ()}
    results = []
    for drop in outcome.results:
        point = None if drop.point is None else str(drop.point)
        results.append(replace(drop, diagnosis=by_drop.get((point, drop.drop or 0))))
    return replace(outcome, results=results)
