"""From files to diagnoses: points of one device are one survey, its effects can be kept."""

from __future__ import annotations

import datetime
import importlib.metadata
import math
import os
import signal
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

from inversion import InversionError, SurrogateLibrary
from inversion.diagnosis import (
    DeviceFindings,
    FoundEffect,
    FoundParameter,
    PointDiagnosis,
    PointRecords,
    State,
    diagnose_point,
    fit_device,
    left_out_error,
)
from inversion.effects import BY_NAME
from pfwd_survey.errors import OptionError, SurveyError, refusal
from pfwd_survey.files.reading import read_points
from pfwd_survey.files.toml import toml_line
from pfwd_survey.files.traces import TracePoint
from pfwd_survey.inverting.analysis import record_of
from pfwd_survey.inverting.missing import whole_part
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.screening import screen_point

DeviceValues = dict[str, dict[str, float]]


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """What came of one point, or why a file was refused."""

    file: str
    record: Mapping[str, Any] | None = None
    """With the keys of ``pfwd diagnose --json``."""
    diagnosis: PointDiagnosis | None = None
    error: str | None = None


@dataclass(frozen=True, eq=False)
class _Entry:
    """A point on its way through the diagnosis."""

    file: str
    device: str | None
    records: PointRecords | None
    rejected: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


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
    entries: list[_Entry | Diagnosed] = []
    for file in files:
        try:
            entries += _entries(file, options)
        except (SurveyError, InversionError) as err:
            entries.append(Diagnosed(file, error=str(err)))
    work = [one for one in entries if isinstance(one, _Entry) and one.records is not None]
    found = dict(zip(map(id, work), _diagnose_all(work, device, jobs), strict=True))
    found |= _shared_device(work, found, device, jobs)
    for one in entries:
        if isinstance(one, Diagnosed):
            yield one
            continue
        diagnosis = found.get(id(one))
        if device and isinstance(diagnosis, PointDiagnosis):
            diagnosis = with_device(diagnosis, _given(device))
        if isinstance(diagnosis, str):
            yield Diagnosed(one.file, error=f"{one.file}: {diagnosis}")
            continue
        yield Diagnosed(one.file, diagnosis_record(one, diagnosis), diagnosis)


def _entries(file: str, options: AnalysisOptions) -> list[_Entry]:
    return [
        _entry(file, p, options) for p in read_points(file, options.header, options.overrides())
    ]


def _entry(file: str, point: TracePoint, options: AnalysisOptions) -> _Entry:
    screenings = screen_point(point)
    chosen = [
        (whole_part(drop)[0], found)
        for drop, found in zip(point.drops, screenings, strict=True)
        if found.status == "measured"
    ]
    rejected = tuple(
        f"drop {drop.number}: {found.reason}"
        for drop, found in zip(point.drops, screenings, strict=True)
        if found.status == "rejected"
    )
    warnings = (*point.warnings, *(w for _, found in chosen for w in found.warnings))
    device = point.setup.device
    name = None if device is None else str(device)
    if not chosen:
        return _Entry(file, name, None, rejected, warnings)
    dead = {offset for _, found in chosen for offset in found.dead}
    records = tuple(record_of(drop, point.setup, options, dead) for drop, _ in chosen)
    numbers = tuple(drop.number for drop, _ in chosen)
    # Only what was declared is held; the search for effects needs the rest free.
    made = PointRecords(
        file,
        records,
        numbers,
        elastic=options.elastic,
        half_sine=options.load == "half-sine",
    )
    return _Entry(file, name, made, rejected, warnings)


def _diagnose_all(
    work: Sequence[_Entry],
    device: DeviceValues | Sequence[DeviceValues] | None,
    jobs: int,
    likely: Sequence[Sequence[str]] = (),
) -> list[PointDiagnosis | str]:
    """Diagnoses in order; device values are alike for all, or one set a point."""
    records = [one.records for one in work if one.records is not None]
    devices = device if isinstance(device, Sequence) else [device] * len(records)
    first = likely or [()] * len(records)
    if jobs <= 1 or len(records) < 2:
        library = SurrogateLibrary()
        return [
            _diagnose(one, values, names, library)
            for one, values, names in zip(records, devices, first, strict=True)
        ]
    with ProcessPoolExecutor(
        min(jobs, len(records)), get_context("spawn"), initializer=_leave_interrupts
    ) as pool:
        return list(pool.map(_diagnose, records, devices, first))


def _leave_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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
    work: Sequence[_Entry],
    found: Mapping[int, PointDiagnosis | str],
    given: DeviceValues | None,
    jobs: int,
) -> dict[int, PointDiagnosis | str]:
    """Diagnoses anew of the points whose device has effects that most of its points show."""
    if given:
        return {}
    again: dict[int, PointDiagnosis | str] = {}
    names = {one.device for one in work if one.device is not None}
    for name in sorted(names):
        points = [one for one in work if one.device == name]
        sound = [one for one in points if isinstance(found[id(one)], PointDiagnosis)]
        if len(sound) < 2:
            continue
        findings = _device_findings(sound, found)
        if findings is None:
            continue
        first = [found[id(one)] for one in points]
        likely = [
            [e.name for e in d.effects if e.name not in findings.values]
            if isinstance(d, PointDiagnosis)
            else []
            for d in first
        ]
        anew = _diagnose_all(points, findings.values, jobs, likely)
        errors = _left_out_errors(points, first, anew, findings, jobs)
        for one, diagnosis, error in zip(points, anew, errors, strict=True):
            if isinstance(diagnosis, PointDiagnosis):
                diagnosis = with_device(diagnosis, findings)
                if error is not None:
                    before = diagnosis.before.residual_rms_over_peak
                    diagnosis = replace(diagnosis, held_out_before=before, held_out_after=error)
            again[id(one)] = diagnosis
    return again


def _left_out_errors(
    points: Sequence[_Entry],
    first: Sequence[PointDiagnosis | str],
    anew: Sequence[PointDiagnosis | str],
    findings: DeviceFindings,
    jobs: int,
) -> list[float | None]:
    """What each point leaves when its device is what the other points show in the middle."""
    shown = [
        _device_values(one, findings) if isinstance(one, PointDiagnosis) else None for one in first
    ]
    work: list[tuple[int, PointRecords, PointDiagnosis, DeviceValues]] = []
    for index, (entry, diagnosis) in enumerate(zip(points, anew, strict=True)):
        others = [v for i, v in enumerate(shown) if i != index and v is not None]
        if entry.records is not None and isinstance(diagnosis, PointDiagnosis) and others:
            values = {
                name: {key: _median([one[name][key] for one in others]) for key in parameters}
                for name, parameters in findings.values.items()
            }
            work.append((index, entry.records, diagnosis, values))
    errors: list[float | None] = [None] * len(points)
    indices, *columns = zip(*work, strict=True) if work else ((), (), (), ())
    if jobs <= 1 or len(work) < 2:
        found = list(map(left_out_error, *columns))
    else:
        with ProcessPoolExecutor(
            min(jobs, len(work)), get_context("spawn"), initializer=_leave_interrupts
        ) as pool:
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
    points: Sequence[_Entry], found: Mapping[int, PointDiagnosis | str]
) -> DeviceFindings | None:
    diagnoses = [d for one in points if isinstance(d := found[id(one)], PointDiagnosis)]
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
    records = [one.records for one in points if one.records is not None]
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


def diagnosis_record(entry: _Entry, found: PointDiagnosis | None) -> dict[str, Any]:
    """One point as the machine-readable record of ``pfwd diagnose --json``."""
    record: dict[str, Any] = {
        "file": entry.file,
        "device": entry.device,
        "drops": [] if found is None else list(found.numbers),
        "rejected": list(entry.rejected),
    }
    if entry.records is not None:
        first = entry.records.records[0]
        record |= {
            "plate": "rigid-rough",
            "plate_radius_m": first.instrument.plate_radius,
            "poisson_ratio": first.poisson_ratio,
        }
    if found is None:
        nothing = {"verdict": "unexplained", "corrected": False, "noise_rms_m": None}
        effects = [_false_trigger()] if entry.rejected else []
        return (
            record
            | nothing
            | {
                "before": None,
                "effects": effects,
                "after": None,
                "held_out": None,
                "warnings": [*entry.warnings, *entry.rejected, "no measured drop to diagnose"],
            }
        )
    held = None
    if found.held_out_before is not None:
        held = {"before": found.held_out_before, "after": found.held_out_after}
    return record | {
        "verdict": found.verdict,
        "corrected": found.corrected,
        "noise_rms_m": found.noise_rms,
        "before": _state_record(found.before),
        "effects": [_effect_record(effect) for effect in found.effects],
        "after": _state_record(found.after),
        "held_out": held,
        "warnings": [*entry.warnings, *found.warnings],
    }


def _false_trigger() -> dict[str, Any]:
    return {
        "name": "false_trigger",
        "value": None,
        "sd": None,
        "unit": "-",
        "parameters": [],
        "evidence": None,
        "alternatives": [],
    }


def _state_record(state: State) -> dict[str, Any]:
    return {
        "model": state.model,
        "modulus_pa": state.modulus,
        "modulus_sd_pa": state.modulus_deviation,
        "modulus_interval_pa": list(state.modulus_interval),
        "residual_rms_m": state.residual_rms,
        "residual_over_noise": state.residual_over_noise,
        "residual_rms_over_peak": state.residual_rms_over_peak,
        "contact_residual_rms_over_peak": state.contact_residual_rms_over_peak,
    }


def _effect_record(effect: FoundEffect) -> dict[str, Any]:
    first = effect.parameters[0]
    alike = [p.value for p in effect.parameters if p.name == first.name]
    middle = sorted(alike)[len(alike) // 2]
    return {
        "name": effect.name,
        "scope": effect.scope,
        "value": middle,
        "sd": first.deviation,
        "unit": first.unit,
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "sd": p.deviation,
                "unit": p.unit,
                **({} if p.drop is None else {"drop": p.drop}),
            }
            for p in effect.parameters
        ],
        "evidence": effect.evidence,
        "alternatives": list(effect.alternatives),
        "advice": effect.advice,
    }


def device_of(diagnosed: Sequence[Diagnosed]) -> str | None:
    """The one device of diagnoses.

    Raises
    ------
    OptionError
        If they are of several.
    """
    names = {str(one.record["device"]) for one in diagnosed if one.record and one.record["device"]}
    if len(names) > 1:
        raise OptionError(
            refusal("--write-device", "files of one device", f"of {', '.join(sorted(names))}")
        )
    return names.pop() if names else None


def write_device_file(
    path: str | os.PathLike[str], diagnosed: Sequence[Diagnosed], device: str | None
) -> None:
    """Keep the device effects that were found, for ``--device``.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    effects: dict[str, list[FoundEffect]] = {}
    drops: dict[str, int] = {}
    for one in diagnosed:
        for effect in one.diagnosis.effects if one.diagnosis else ():
            if effect.scope == "device" and one.diagnosis is not None:
                effects.setdefault(effect.name, []).append(effect)
                drops[effect.name] = drops.get(effect.name, 0) + len(one.diagnosis.numbers)
    lines = [
        toml_line("device", device or ""),
        toml_line("date", datetime.date.today().isoformat()),
        toml_line("software_version", importlib.metadata.version("pfwd")),
    ]
    for name, found in effects.items():
        best = min(found, key=lambda effect: effect.parameters[0].deviation)
        lines += ["", f"[{name}]", toml_line("drops", drops[name])]
        for p in best.parameters:
            key = p.name + _SUFFIX.get(p.unit, "")
            lines.append(toml_line(key, p.value))
            if math.isfinite(p.deviation):
                lines.append(toml_line(f"{p.name}_sd{_SUFFIX.get(p.unit, '')}", p.deviation))
    text = "\n".join(lines) + "\n"
    draft = f"{os.fspath(path)}.{os.getpid()}.tmp"
    with open(draft, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(text)
    os.replace(draft, path)


_SUFFIX = {"kg": "_kg", "s": "_s", "Hz": "_hz", "m/s": "_m_s", "m": "_m", "N/m": "_n_m"}


def read_device_file(path: str | os.PathLike[str]) -> DeviceValues:
    """Device effects of a file that ``--write-device`` made.

    Raises
    ------
    OptionError
        If it cannot be read, or names an effect or a parameter that is not known.
    """
    where = f"--device {os.fspath(path)}"
    try:
        with open(path, "rb") as stream:
            table = tomllib.load(stream)
    except OSError as err:
        raise OptionError(refusal(where, "a TOML file", err.strerror or str(err))) from err
    except (ValueError, RecursionError) as err:
        raise OptionError(refusal(where, "TOML", str(err))) from err
    values: DeviceValues = {}
    for name, entries in table.items():
        if not isinstance(entries, dict):
            continue
        effect = BY_NAME.get(name)
        if effect is None or effect.scope != "device":
            raise OptionError(refusal(where, "device effects of the catalogue", repr(name)))
        for p in effect.parameters:
            key = p.name + _SUFFIX.get(p.unit, "")
            value = entries.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise OptionError(refusal(where, f"[{name}] {key} as a number", repr(value)))
            if not p.lower <= value <= p.upper:
                expected = f"[{name}] {key} from {p.lower:g} to {p.upper:g}"
                raise OptionError(refusal(where, expected, f"{value:g}"))
            values.setdefault(name, {})[p.name] = float(value)
    return values
