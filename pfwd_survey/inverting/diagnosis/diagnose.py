"""From files to diagnoses: points of one device are one survey, its effects can be kept."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from inversion import InversionError, SurrogateLibrary
from inversion.diagnosis import (
    DeviceFindings,
    FoundEffect,
    FoundParameter,
    PointDiagnosis,
    PointRecords,
    diagnose_point,
    fit_device,
    left_out_error,
)
from inversion.effects import BY_NAME
from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint, entries_of
from pfwd_survey.inverting.diagnosis.record import diagnosis_result
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.spawning import worker_pool

DeviceValues = dict[str, dict[str, float]]


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """What came of one point, or why a file was refused."""

    file: str
    result: DiagnosisResult | None = None
    diagnosis: PointDiagnosis | None = None
    error: str | None = None


def diagnose_files(
    files: Sequence[str],
    options: AnalysisOptions | None = None,
    device: DeviceValues | None = None,
    jobs: int = 1,
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
    """
    options = options or AnalysisOptions()
    entries: list[DiagnosisPoint | Diagnosed] = []
    for file in files:
        try:
            entries += entries_of(file, options)
        except (SurveyError, InversionError) as err:
            entries.append(Diagnosed(file, error=str(err)))
    yield from diagnose_entries(entries, device, jobs)


def diagnose_entries(
    entries: Sequence[DiagnosisPoint | Diagnosed], device: DeviceValues | None = None, jobs: int = 1
) -> Iterator[Diagnosed]:
    """The diagnosis of every point that was read, in their order; refused files go through.

    Parameters
    ----------
    entries, device, jobs : as for :func:`diagnose_files`
    """
    work = [
        entry
        for entry in entries
        if isinstance(entry, DiagnosisPoint) and entry.records is not None
    ]
    found = dict(zip(map(id, work), _diagnose_all(work, device, jobs), strict=True))
    found |= _shared_device(work, found, device, jobs)
    for entry in entries:
        if isinstance(entry, Diagnosed):
            yield entry
            continue
        diagnosis = found.get(id(entry))
        if device and isinstance(diagnosis, PointDiagnosis):
            diagnosis = with_device(diagnosis, _given(device))
        if isinstance(diagnosis, str):
            yield Diagnosed(entry.file, error=f"{entry.file}: {diagnosis}")
            continue
        yield Diagnosed(entry.file, diagnosis_result(entry, diagnosis), diagnosis)


def _diagnose_all(
    work: Sequence[DiagnosisPoint],
    device: DeviceValues | Sequence[DeviceValues] | None,
    jobs: int,
    likely: Sequence[Sequence[str]] = (),
) -> list[PointDiagnosis | str]:
    """Diagnoses in order; device values are alike for all, or one set a point."""
    records = [point.records for point in work if point.records is not None]
    devices = device if isinstance(device, Sequence) else [device] * len(records)
    first = likely or [()] * len(records)
    if jobs <= 1 or len(records) < 2:
        library = SurrogateLibrary()
        return [
            _diagnose(record, values, names, library)
            for record, values, names in zip(records, devices, first, strict=True)
        ]
    with worker_pool(min(jobs, len(records))) as pool:
        return list(pool.map(_diagnose, records, devices, first))


def _diagnose(
    records: PointRecords,
    device: DeviceValues | None = None,
    likely: Sequence[str] = (),
    library: SurrogateLibrary | None = None,
) -> PointDiagnosis | str:
    try:
        return diagnose_point(records, library, device, likely)
    except InversionError as err:
        return str(err)


def _shared_device(
    work: Sequence[DiagnosisPoint],
    found: Mapping[int, PointDiagnosis | str],
    given: DeviceValues | None,
    jobs: int,
) -> dict[int, PointDiagnosis | str]:
    """Diagnoses anew of the points whose device has effects that most of its points show."""
    if given:
        return {}
    again: dict[int, PointDiagnosis | str] = {}
    names = {point.device for point in work if point.device is not None}
    for name in sorted(names):
        points = [point for point in work if point.device == name]
        sound = [point for point in points if isinstance(found[id(point)], PointDiagnosis)]
        if len(sound) < 2:
            continue
        findings = _device_findings(sound, found)
        if findings is None:
            continue
        first = [found[id(point)] for point in points]
        likely = [
            [e.name for e in d.effects if e.name not in findings.values]
            if isinstance(d, PointDiagnosis)
            else []
            for d in first
        ]
        anew = _diagnose_all(points, findings.values, jobs, likely)
        errors = _left_out_errors(points, first, anew, findings, jobs)
        for point, diagnosis, error in zip(points, anew, errors, strict=True):
            if isinstance(diagnosis, PointDiagnosis):
                diagnosis = with_device(diagnosis, findings)
                if error is not None:
                    before = diagnosis.before.residual_rms_over_peak
                    diagnosis = replace(diagnosis, held_out_before=before, held_out_after=error)
            again[id(point)] = diagnosis
    return again


def _left_out_errors(
    points: Sequence[DiagnosisPoint],
    first: Sequence[PointDiagnosis | str],
    anew: Sequence[PointDiagnosis | str],
    findings: DeviceFindings,
    jobs: int,
) -> list[float | None]:
    """What each point leaves when its device is what the other points show in the middle."""
    shown = [
        _device_values(diagnosis, findings) if isinstance(diagnosis, PointDiagnosis) else None
        for diagnosis in first
    ]
    work: list[tuple[int, PointRecords, PointDiagnosis, DeviceValues]] = []
    for index, (entry, diagnosis) in enumerate(zip(points, anew, strict=True)):
        others = [v for i, v in enumerate(shown) if i != index and v is not None]
        if entry.records is not None and isinstance(diagnosis, PointDiagnosis) and others:
            values = {
                name: {key: _median([other[name][key] for other in others]) for key in parameters}
                for name, parameters in findings.values.items()
            }
            work.append((index, entry.records, diagnosis, values))
    errors: list[float | None] = [None] * len(points)
    indices, *columns = zip(*work, strict=True) if work else ((), (), (), ())
    if jobs <= 1 or len(work) < 2:
        found = list(map(left_out_error, *columns))
    else:
        with worker_pool(min(jobs, len(work))) as pool:
            found = list(pool.map(left_out_error, *columns))
    for index, error in zip(indices, found, strict=True):
        errors[index] = error
    return errors


def _device_values(diagnosis: PointDiagnosis, findings: DeviceFindings) -> DeviceValues | None:
    """What one point alone says of the survey's device effects; None: not of all of them."""
    own = {effect.name: effect for effect in diagnosis.effects}
    if not set(findings.values) <= set(own):
        return None
    return {
        name: {p.name: p.value for p in own[name].parameters if p.name in parameters}
        for name, parameters in findings.values.items()
    }


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])


def _device_findings(
    points: Sequence[DiagnosisPoint], found: Mapping[int, PointDiagnosis | str]
) -> DeviceFindings | None:
    diagnoses = [d for point in points if isinstance(d := found[id(point)], PointDiagnosis)]
    counts: dict[str, int] = {}
    for diagnosis in diagnoses:
        for effect in diagnosis.effects:
            if effect.scope == "device":
                counts[effect.name] = counts.get(effect.name, 0) + 1
    # What belongs to the device shows at most of its points.
    names = [name for name, count in counts.items() if 2 * count >= len(diagnoses)]
    if not names:
        return None
    ordered = [name for name in BY_NAME if name in names]
    records = [point.records for point in points if point.records is not None]
    return fit_device(records, diagnoses, ordered, SurrogateLibrary())


def _given(device: DeviceValues) -> DeviceFindings:
    """Known device effects, whose deviations are not known here."""
    nothing = {name: dict.fromkeys(values, math.nan) for name, values in device.items()}
    return DeviceFindings(device, nothing, 0)


def with_device(diagnosis: PointDiagnosis, findings: DeviceFindings) -> PointDiagnosis:
    """The diagnosis with the effects of the survey's device among its effects."""
    shared = tuple(
        FoundEffect(
            name=name,
            scope="device",
            advice=BY_NAME[name].advice,
            parameters=tuple(
                FoundParameter(
                    p.name, p.unit, values[p.name], findings.deviations[name][p.name], None, False
                )
                for p in BY_NAME[name].parameters
            ),
            evidence=math.nan,
            alternatives=(),
        )
        for name, values in findings.values.items()
    )
    return replace(diagnosis, effects=(*shared, *diagnosis.effects))
