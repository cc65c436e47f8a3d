"""From files to diagnoses: points of one device are one survey, its effects can be kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

from inversion import InversionError, SurrogateLibrary
from inversion.diagnosis import (
    DeviceFindings,
    FoundEffect,
    FoundParameter,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    PointRecords,
    UnknownKey,
    diagnose_point,
    fit_device,
    left_out_error,
)
from inversion.effects import BY_NAME
from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint, entries_of
from pfwd_survey.inverting.diagnosis.kept import kept_answers, questions_of, with_question
from pfwd_survey.inverting.diagnosis.record import diagnosis_result
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.spawning import worker_pool

DeviceValues = dict[str, dict[str, float]]
Progress = Callable[[str, int, int], None]
"""Told what is being tried, how many points are done, and of how many."""
# Points from which on their spread is told; of a normal distribution its middle distance from the
# middle, as a deviation; and what contradicts the others: so many deviations, and this part.
_FEWEST_FOR_SPREAD, _OF_NORMAL, _CONTRADICTS, _SAME_DEVICE = 3, 1.4826, 4.0, 0.05
# Part of a survey's points that show an effect, from which on the others are looked at for it.
_COMMON = 0.2


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """What came of one point, or why a file was refused."""

    file: str
    result: DiagnosisResult | None = None
    diagnosis: PointDiagnosis | None = None
    error: str | None = None
    number: int | None = None
    """Of the point's last measured drop within its survey, with which the result is kept."""


def diagnose_files(
    files: Sequence[str],
    options: AnalysisOptions | None = None,
    device: DeviceValues | None = None,
    jobs: int = 1,
    leave_out: LeaveOut | None = None,
    *,
    use_kept: bool = False,
    progress: Progress | None = None,
    spread: DeviceValues | None = None,
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
    leave_out : "drop", "sensor", "point" or None
        What is predicted from the rest, to be told how well. None: points where those of one
        device share something, else drops.
    use_kept : bool
        Whether what a survey keeps of the same question is the answer.
    progress : callable, optional
        Told what is being tried, and how many of how many points are done.
    spread : mapping, optional
        Deviations of what is given of the device: a point may move it so far; else it is held.
    """
    options = options or AnalysisOptions()
    entries: list[DiagnosisPoint | Diagnosed] = []
    for file in files:
        try:
            entries += entries_of(file, options)
        except (SurveyError, InversionError) as err:
            entries.append(Diagnosed(file, error=str(err)))
    yield from diagnose_entries(
        entries, device, jobs, leave_out, use_kept=use_kept, progress=progress, spread=spread
    )


def diagnose_entries(
    entries: Sequence[DiagnosisPoint | Diagnosed],
    device: DeviceValues | None = None,
    jobs: int = 1,
    leave_out: LeaveOut | None = None,
    *,
    use_kept: bool = False,
    progress: Progress | None = None,
    spread: DeviceValues | None = None,
) -> Iterator[Diagnosed]:
    """The diagnosis of every point that was read, in their order; refused files go through.

    Parameters
    ----------
    entries, device, jobs, leave_out, use_kept, progress, spread : as for :func:`diagnose_files`
    """
    every = [
        entry
        for entry in entries
        if isinstance(entry, DiagnosisPoint) and entry.records is not None
    ]
    questions = dict(
        zip(map(id, every), questions_of(every, device, leave_out, spread), strict=True)
    )
    kept: dict[int, DiagnosisResult] = {}
    if use_kept:
        answers = kept_answers(every, list(questions.values()))
        kept = {id(every[place]): answer for place, answer in answers.items()}
    # Points of one device are one question: all of them are answered, or none.
    asked_anew = {entry.device for entry in every if id(entry) not in kept} - {None}
    work = [entry for entry in every if id(entry) not in kept or entry.device in asked_anew]
    within: LeaveOut = leave_out or "drop"
    told = _Told(progress, "each point by itself")
    first = _diagnose_all(work, device, jobs, within, told=told, spread=spread)
    found = dict(zip(map(id, work), first, strict=True))
    found |= _shared_device(work, found, device, jobs, leave_out, progress)
    for entry in entries:
        if isinstance(entry, Diagnosed):
            yield entry
            continue
        if entry.records is not None and id(entry) not in found:
            yield Diagnosed(entry.file, kept[id(entry)], number=_number(entry))
            continue
        diagnosis = found.get(id(entry))
        if device and isinstance(diagnosis, PointDiagnosis):
            diagnosis = with_device(diagnosis, _given(device, spread))
        if isinstance(diagnosis, str):
            yield Diagnosed(entry.file, error=f"{entry.file}: {diagnosis}")
            continue
        result = diagnosis_result(entry, diagnosis)
        if id(entry) in questions:
            result = with_question(result, entry, questions[id(entry)])
        yield Diagnosed(entry.file, result, diagnosis, number=_number(entry))


def _number(entry: DiagnosisPoint) -> int | None:
    return None if entry.last is None else entry.last.number


class _Told:
    """Counts points for who wants to know how far it is."""

    def __init__(self, progress: Progress | None, what: str) -> None:
        self._progress = progress
        self._what = what

    def counted(
        self, results: Iterable[PointDiagnosis | str], total: int
    ) -> list[PointDiagnosis | str]:
        found = []
        for result in results:
            found.append(result)
            if self._progress is not None:
                self._progress(self._what, len(found), total)
        return found


def _diagnose_all(
    work: Sequence[DiagnosisPoint],
    device: DeviceValues | Sequence[DeviceValues] | None,
    jobs: int,
    leave_out: LeaveOut,
    likely: Sequence[Sequence[str]] = (),
    begun: Sequence[Sequence[Mapping[UnknownKey, float]]] = (),
    told: _Told | None = None,
    spread: DeviceValues | None = None,
) -> list[PointDiagnosis | str]:
    """Diagnoses in order; device values are alike for all, or one set a point."""
    records = [point.records for point in work if point.records is not None]
    devices = device if isinstance(device, Sequence) else [device] * len(records)
    told = told or _Told(None, "")
    first = likely or [()] * len(records)
    starts = begun or [()] * len(records)
    if jobs <= 1 or len(records) < 2:
        library = SurrogateLibrary()
        found = (
            _diagnose(record, values, names, there, leave_out, spread, library)
            for record, values, names, there in zip(records, devices, first, starts, strict=True)
        )
        return told.counted(found, len(records))
    with worker_pool(min(jobs, len(records))) as pool:
        alike = ([leave_out] * len(records), [spread] * len(records))
        done = pool.map(_diagnose, records, devices, first, starts, *alike)
        return told.counted(done, len(records))


def _diagnose(
    records: PointRecords,
    device: DeviceValues | None = None,
    likely: Sequence[str] = (),
    begun: Sequence[Mapping[UnknownKey, float]] = (),
    leave_out: LeaveOut = "drop",
    spread: DeviceValues | None = None,
    library: SurrogateLibrary | None = None,
) -> PointDiagnosis | str:
    try:
        return diagnose_point(records, library, device, likely, begun, leave_out, spread)
    except InversionError as err:
        return str(err)


def _shared_device(
    work: Sequence[DiagnosisPoint],
    found: Mapping[int, PointDiagnosis | str],
    given: DeviceValues | None,
    jobs: int,
    leave_out: LeaveOut | None,
    progress: Progress | None = None,
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
        alone = [_device_values(d, findings) for p in points if _is_sound(d := found[id(p)])]
        findings = _with_spread(findings, [values for values in alone if values is not None])
        first = [found[id(point)] for point in points]
        likely, begun = _of_survey(first, findings)
        within: LeaveOut = leave_out or "drop"
        told = _Told(progress, "with what other points show")
        anew = _diagnose_all(points, findings.values, jobs, within, likely, begun, told)
        errors: list[HeldOutPart | None] = [None] * len(points)
        if leave_out in (None, "point"):
            errors = _left_out_errors(points, anew, _of_others(points, sound, findings), jobs)
        for point, found_anew, error in zip(points, anew, errors, strict=True):
            if isinstance(found_anew, str):
                again[id(point)] = found_anew
                continue
            diagnosis = with_device(found_anew, findings)
            contradicting = _contradictions(found[id(point)], findings)
            diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, *contradicting))
            if error is not None:
                diagnosis = replace(
                    diagnosis,
                    held_out_before=error.before,
                    held_out_after=error.after,
                    held_out_mode="point",
                    held_out_by=(error,),
                )
            again[id(point)] = diagnosis
    return again


def _is_sound(found: PointDiagnosis | str) -> TypeGuard[PointDiagnosis]:
    return isinstance(found, PointDiagnosis)


def _with_spread(findings: DeviceFindings, alone: Sequence[DeviceValues]) -> DeviceFindings:
    """By how much points differ of which each was asked by itself, and what that leaves unknown.

    The middle of several points is known by the root of their number better than one of them.
    """
    spread: DeviceValues = {}
    deviations: DeviceValues = {}
    for name, values in findings.values.items():
        for key in values:
            shown = [own[name][key] for own in alone]
            if len(shown) < _FEWEST_FOR_SPREAD:
                continue
            middle = _median(shown)
            wide = _OF_NORMAL * _median([abs(value - middle) for value in shown])
            spread.setdefault(name, {})[key] = wide
            own_deviation = findings.deviations[name][key]
            deviations.setdefault(name, {})[key] = math.hypot(
                own_deviation if math.isfinite(own_deviation) else 0.0, wide / math.sqrt(len(shown))
            )
    merged = {
        name: dict(known) | deviations.get(name, {}) for name, known in findings.deviations.items()
    }
    return replace(findings, deviations=merged, spread=spread)


def _contradictions(found: PointDiagnosis | str, findings: DeviceFindings) -> list[str]:
    """Where a point by itself shows another device than the others do."""
    if isinstance(found, str):
        return []
    said = []
    for effect in found.effects:
        for p in effect.parameters:
            wide = findings.spread.get(effect.name, {}).get(p.name)
            if effect.scope != "device" or wide is None:
                continue
            own = p.deviation if math.isfinite(p.deviation) else 0.0
            shared = findings.values[effect.name][p.name]
            away = abs(p.value - shared)
            if away > _CONTRADICTS * math.hypot(wide, own) and away > _SAME_DEVICE * abs(shared):
                unit = "" if p.unit == "-" else f" {p.unit}"
                said.append(
                    f"{effect.name}: {p.name.replace('_', ' ')} {p.value:.3g}{unit} by this point "
                    f"alone, {shared:.3g}{unit} by all points of the device: it contradicts them"
                )
    return said


def _of_survey(
    first: Sequence[PointDiagnosis | str], findings: DeviceFindings
) -> tuple[list[list[str]], list[list[Mapping[UnknownKey, float]]]]:
    """Effects that each point is looked at for again, and where their fit begins.

    Its own effects and those of several points of the survey: from its own values, and from what
    the survey shows in the middle, for a point alone may have ended in the wrong place. What it
    does not have is taken away again by the evidence.
    """
    sound = [d for d in first if isinstance(d, PointDiagnosis)]
    named = [{e.name for e in d.effects if e.name not in findings.values} for d in sound]
    counts = {name: sum(name in own for own in named) for name in set().union(*named)}
    common = {name for name, count in counts.items() if count >= max(2, _COMMON * len(named))}
    shown: dict[UnknownKey, list[float]] = {}
    for diagnosis in sound:
        for key, value in diagnosis.values.items():
            if key[1]:
                shown.setdefault(key, []).append(value)
    middle = {key: _median(values) for key, values in shown.items()}
    likely: list[list[str]] = []
    begun: list[list[Mapping[UnknownKey, float]]] = []
    for shown_first in first:
        if isinstance(shown_first, str):
            likely.append([])
            begun.append([])
            continue
        own = {e.name for e in shown_first.effects if e.name not in findings.values}
        ground = {key: value for key, value in shown_first.values.items() if not key[1]}
        likely.append(sorted(own | common))
        begun.append([shown_first.values, middle | ground])
    return likely, begun


def _of_others(
    points: Sequence[DiagnosisPoint], sound: Sequence[DiagnosisPoint], findings: DeviceFindings
) -> list[DeviceValues | None]:
    """What other points say of the device, of each point that has a part in it."""
    records = [point for point in sound if point.records is not None]
    values = {id(p): v for p, v in zip(records, findings.of_others, strict=True)}
    return [values.get(id(point)) for point in points]


def _left_out_errors(
    points: Sequence[DiagnosisPoint],
    anew: Sequence[PointDiagnosis | str],
    of_others: Sequence[DeviceValues | None],
    jobs: int,
) -> list[HeldOutPart | None]:
    """What each point leaves when its device is what other points say."""
    work: list[tuple[int, PointRecords, PointDiagnosis, DeviceValues]] = []
    for index, (entry, diagnosis, values) in enumerate(zip(points, anew, of_others, strict=True)):
        if entry.records is not None and isinstance(diagnosis, PointDiagnosis) and values:
            work.append((index, entry.records, diagnosis, values))
    errors: list[HeldOutPart | None] = [None] * len(points)
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


def _given(device: DeviceValues, spread: DeviceValues | None) -> DeviceFindings:
    """Known device effects; where nothing is said of them their deviations are not known."""
    known = spread or {}
    deviations = {
        name: {key: known.get(name, {}).get(key, math.nan) for key in values}
        for name, values in device.items()
    }
    return DeviceFindings(device, deviations, 0)


def with_device(diagnosis: PointDiagnosis, findings: DeviceFindings) -> PointDiagnosis:
    """The diagnosis with the effects of the survey's device among its effects."""
    shared = tuple(
        FoundEffect(
            name=name,
            scope="device",
            advice=BY_NAME[name].advice,
            parameters=tuple(
                FoundParameter(
                    p.name,
                    p.unit,
                    # As the point moved it, where it might.
                    diagnosis.values.get((0, name, p.name, None), values[p.name]),
                    findings.deviations[name][p.name],
                    None,
                    False,
                    findings.spread.get(name, {}).get(p.name, math.nan),
                )
                for p in BY_NAME[name].parameters
            ),
            evidence=math.nan,
            alternatives=(),
            probability=math.nan,
        )
        for name, values in findings.values.items()
    )
    return replace(diagnosis, effects=(*shared, *diagnosis.effects))
