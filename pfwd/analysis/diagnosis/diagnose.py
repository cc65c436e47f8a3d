"""Diagnoses of files: points of one device are diagnosed together as one survey."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from inversion import InversionError
from inversion.diagnosis import Channel, LeaveOut, PointDiagnosis, largest_values
from inversion.inference.held_out import Allow
from inversion.inference.instrument import InstrumentKnowledge
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
    """Outcome of one point, or the reason why a file was refused."""

    file: str
    result: DiagnosisResult | None = None
    diagnosis: PointDiagnosis | None = None
    error: str | None = None
    number: int | None = None
    """Number of the point's last measured drop within its survey; it stores the diagnosis."""


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
    """The diagnosis of every point, in their order.

    Parameters
    ----------
    files : sequence of str
        Surveys, drop files, trace files.
    options : AnalysisOptions, optional
        Header and declared values.
    device : mapping, optional
        Values of device effects that are known, by effect and parameter.
    jobs : int
        Processes.
    leave_out : "next", "drop", "sensor", "point" or None
        What is held out: the last drop of each point, each drop or each sensor is predicted
        without it, by the rest of its point and the other points of the instrument.
        "point": the device of the other points, the ground fitted to the
        point. None: the last drop of each point of several, by its other drops.
    use_stored : bool
        Whether what a survey keeps of the same question is the answer.
    progress : callable, optional
        Receives what is tried, at which point, and how many points of how many are done.
    spread : mapping, optional
        Deviations of what is given of the device: a point may move it so far; else it is held.
    allow : "stiffness" or None
        The one number that is fitted to a held-out drop: its stiffness.
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
    """The diagnosis of every point that was read, in their order; refused files go through.

    Parameters
    ----------
    entries, device, jobs, leave_out, use_stored, progress, spread, allow : as for
        :func:`diagnose_files`
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
    # Points of one device are one question: all of them are answered, or none.
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

    with Workers(min(jobs, len(work))) as workers:
        outcomes = diagnose(work)
        if leave_out in PREDICTED:
            outcomes = with_predictions(
                work,
                outcomes,
                leave_out,
                workers,
                declared_effects=device,
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


def _by_device(work: Sequence[DiagnosisPoint]) -> list[list[DiagnosisPoint]]:
    """Points of one device together, and those of none."""
    devices: dict[str | None, list[DiagnosisPoint]] = {}
    for point in work:
        devices.setdefault(point.device, []).append(point)
    return [devices[key] for key in sorted(devices, key=lambda key: (key is not None, key or ""))]


def _with_device_largest(entries: Sequence[DiagnosisPoint]) -> list[DiagnosisPoint]:
    """Return the points with the largest values of each channel in the others of their device.

    They refute that a channel was cut off at a lower level.
    """
    by_device: dict[str, dict[Channel, list[tuple[float, int]]]] = {}
    for place, entry in enumerate(entries):
        if entry.records and entry.device is not None:
            of_device = by_device.setdefault(entry.device, {})
            for channel, value in largest_values(entry.records.records).items():
                # The second largest counts where the largest is the point's own.
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
    """Return the outcome of a file with the diagnosis of its point in each drop that took part."""
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
