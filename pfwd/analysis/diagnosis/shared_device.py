"""Diagnosis of points, those of one device together: first the effects of the device, then each.

All points, or a sample of many, are first diagnosed individually. An effect of the device is shared
if the joint evidence of these points supports it. Then every point is diagnosed with the shared
effects, whose values at the other points are its prior. A point with a much larger discrepancy than
the others is also diagnosed individually.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from inversion import InversionError
from inversion.diagnosis.findings import (
    DeviceFindings,
    DeviceValues,
    EffectParameter,
    HeldOut,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    effect_result,
)
from inversion.diagnosis.flat_tops import Channel, largest_values
from inversion.diagnosis.model import PointRecords
from inversion.effects import BY_NAME
from inversion.inference.diagnose import diagnose_point
from inversion.inference.instrument import InstrumentKnowledge, shared_effects
from inversion.inference.population import without_error_budget
from inversion.inference.selection import EXPLAINED_TO
from inversion.notices import Notice, Value
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, DiagnosisRequest
from pfwd.analysis.diagnosis.workers import Progress, ProgressCounter, Workers
from pfwd.analysis.response_tables import library_of_process
from pfwd.files.output_path import replaced_at_once

# With this number of points or more, only a sample of this size is diagnosed individually first.
_MIN_POINTS_FOR_SAMPLE, _SAMPLE_SIZE = 8, 4
# A point is odd if its discrepancy exceeds this number of times the median. Its individual
# diagnosis is reported if it lowers the discrepancy to this fraction of that with the shared
# device.
_ODD_RATIO, _IMPROVED_RATIO = 2.0, 2.0 / 3.0


@dataclass(frozen=True, slots=True)
class DiagnosisFailure:
    """Reason why a point could not be diagnosed."""

    reason: str


DiagnosisByPoint = dict[str, PointDiagnosis | DiagnosisFailure]
"""Diagnoses and failures of points, by `DiagnosisPoint.name`."""


def successful(outcomes: DiagnosisByPoint) -> dict[str, PointDiagnosis]:
    """Return the diagnoses without the failures, in the same order."""
    return {name: d for name, d in outcomes.items() if isinstance(d, PointDiagnosis)}


@dataclass(frozen=True, eq=False)
class Phases:
    """Progress counters of the two phases of a device's diagnosis.

    Parameters
    ----------
    alone : ProgressCounter
        Individual diagnoses.
    together : ProgressCounter
        Diagnoses with the effects shared by the device.
    """

    alone: ProgressCounter
    together: ProgressCounter

    @classmethod
    def of(cls, progress: Progress | None, points: int) -> Phases:
        """Return counters for a number of points."""
        return cls(
            ProgressCounter(progress, "each point by itself", points),
            ProgressCounter(progress, "with what other points show", 0),
        )


def diagnose_points(
    points: Sequence[DiagnosisPoint], request: DiagnosisRequest, workers: Workers
) -> DiagnosisByPoint:
    """Diagnose points that have records, those of one device together.

    Points whose device has known effects are diagnosed individually.
    """
    points = _with_device_largest(points)
    predict_last = request.leave_out is None
    if request.device:
        knowledge = InstrumentKnowledge.from_values(request.device, request.spread)
        counter = ProgressCounter(request.progress, "each point with what is known", len(points))
        outcomes = diagnose_all(
            points, [knowledge] * len(points), workers, counter, predict_last=predict_last
        )
        declared = declared_device(request.device, request.spread)
        complete = {name: with_device(d, declared) for name, d in successful(outcomes).items()}
        return outcomes | complete
    phases = Phases.of(request.progress, len(points))
    outcomes = {}
    diagnose = partial(diagnose_device, workers=workers, leave_out=request.leave_out, phases=phases)
    for outcomes_of_device in workers.at_once(diagnose, _by_device(points)):
        outcomes |= outcomes_of_device
    return outcomes


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


def diagnose_all(
    points: Sequence[DiagnosisPoint],
    instruments: Sequence[InstrumentKnowledge],
    workers: Workers,
    counter: ProgressCounter,
    *,
    predict_last: bool = True,
    step: str = "individual",
) -> DiagnosisByPoint:
    """Diagnose points that have records, in order.

    Parameters
    ----------
    points : sequence of DiagnosisPoint
    instruments : sequence of InstrumentKnowledge
        For each point, what is known of the device.
    workers : Workers
    counter : ProgressCounter
    predict_last : bool
        True: the last drop of each point is held out and predicted from the others.
    step : str
        Name of the step, unique within the request.
    """
    records = [point.records for point in points]
    names = [point.name for point in points]
    files = [workers.file_of(name, step) for name in names]
    diagnose = partial(_diagnose_once, predict_last=predict_last)
    outcomes = workers.map(diagnose, records, instruments, files)
    return dict(zip(names, counter.counted(names, outcomes), strict=True))


def _diagnose_once(
    records: PointRecords, instrument: InstrumentKnowledge, file: Path | None, *, predict_last: bool
) -> PointDiagnosis | DiagnosisFailure:
    """Return the diagnosis that an interrupted run stored in the file, or diagnose and store."""
    outcome: PointDiagnosis | DiagnosisFailure
    if file is not None:
        with contextlib.suppress(Exception):  # missing or damaged: unpickling may raise any error
            outcome = pickle.loads(file.read_bytes())
            return outcome
    outcome = _diagnose(records, instrument, predict_last=predict_last)
    if file is not None:
        with contextlib.suppress(OSError):  # the result is valid without the file
            file.parent.mkdir(parents=True, exist_ok=True)
            with replaced_at_once(file) as draft:
                draft.write_bytes(pickle.dumps(outcome))
    return outcome


def _diagnose(
    records: PointRecords, instrument: InstrumentKnowledge, *, predict_last: bool
) -> PointDiagnosis | DiagnosisFailure:
    start = time.perf_counter()
    try:
        diagnosis = diagnose_point(
            records, library_of_process(), instrument, predict_last=predict_last
        )
    except InversionError as err:
        return DiagnosisFailure(str(err))
    except np.linalg.LinAlgError as err:
        # A record that breaks the fit must not stop the diagnosis of the other points.
        reason = f"the fit broke down ({err}): check the header, and the unit of the times"
        return DiagnosisFailure(reason)
    return replace(diagnosis, elapsed=time.perf_counter() - start)


def diagnose_device(
    points: Sequence[DiagnosisPoint],
    workers: Workers,
    leave_out: LeaveOut | None,
    phases: Phases,
) -> DiagnosisByPoint:
    """Diagnose the points of one device; points without a device are diagnosed individually.

    Parameters
    ----------
    points : sequence of DiagnosisPoint
    workers : Workers
    leave_out : "next", "drop", "sensor", "point" or None
        "point": each point is fitted with the device effects of the others. None: the last drop of
        each point is predicted. For the other values `with_predictions` makes the prediction later.
    phases : Phases
    """
    no_knowledge = [InstrumentKnowledge()] * len(points)
    if points[0].device is None or len(points) < 2:
        return diagnose_all(
            points, no_knowledge, workers, phases.alone, predict_last=leave_out is None
        )
    first = _first_points(points)
    phases.alone.total += len(first) - len(points)
    individual_outcomes = diagnose_all(
        first, no_knowledge[: len(first)], workers, phases.alone, predict_last=False
    )
    individual = successful(individual_outcomes)
    gains = [diagnosis.gains for diagnosis in individual.values()]
    shared, absent = shared_effects(gains) if len(individual) > 1 else (frozenset(), frozenset())
    knowledge = [
        InstrumentKnowledge(
            effects=shared,
            absent=absent,
            peer_points=tuple(
                diagnosis.summary
                for name, diagnosis in individual.items()
                if name != point.name and diagnosis.summary is not None
            ),
            starting_structures=_nearby(point.name, individual),
        )
        for point in points
    ]
    phases.together.expect(len(points))
    predict = leave_out is None
    outcomes = diagnose_all(
        points, knowledge, workers, phases.together, predict_last=predict, step="together"
    )
    odd = [point for point in points if point.name in _odd_points(outcomes) - set(individual)]
    if odd:
        phases.together.expect(len(odd))
        reconsidered = diagnose_all(
            odd,
            no_knowledge[: len(odd)],
            workers,
            phases.together,
            predict_last=predict,
            step="odd",
        )
        for name, diagnosis in successful(reconsidered).items():
            individual[name] = diagnosis
            if _discrepancy(diagnosis) < _IMPROVED_RATIO * _discrepancy(successful(outcomes)[name]):
                outcomes[name] = diagnosis
    together = successful(outcomes)
    findings = device_findings(list(together.values()), shared)
    if not findings.values:
        return outcomes
    errors: dict[str, HeldOutPart] = {}
    if leave_out == "point":
        errors = _held_out_points(points, together, workers, phases)
    alternatives = alternatives_of(list(individual.values()))
    for name, diagnosis in together.items():
        complete = with_device(diagnosis, findings, alternatives)
        if name in individual:
            complete = replace(
                complete, warnings=(*complete.warnings, *contradictions(individual[name], findings))
            )
        if name in errors:
            complete = replace(complete, held_out=HeldOut.of("point", [errors[name]]))
        outcomes[name] = complete
    return outcomes


def _first_points(points: Sequence[DiagnosisPoint]) -> list[DiagnosisPoint]:
    """Return the points that are diagnosed individually first: all if they are few, else a sample.

    The choice does not depend on the order of the files.
    """
    if len(points) < _MIN_POINTS_FOR_SAMPLE:
        return list(points)
    ordered = sorted(points, key=lambda point: point.name)
    return [ordered[(2 * k + 1) * len(points) // (2 * _SAMPLE_SIZE)] for k in range(_SAMPLE_SIZE)]


def _discrepancy(diagnosis: PointDiagnosis) -> float:
    """Return the discrepancy of a point over its peak; NaN: the point was not fitted."""
    discrepancy = diagnosis.after.discrepancy_over_peak
    return math.nan if discrepancy is None else discrepancy


def _odd_points(outcomes: DiagnosisByPoint) -> set[str]:
    """Return the names of points with more than twice the usual discrepancy."""
    discrepancies = {
        name: _discrepancy(diagnosis) for name, diagnosis in successful(outcomes).items()
    }
    fitted = [value for value in discrepancies.values() if math.isfinite(value)]
    typical = max(median(fitted), EXPLAINED_TO) if fitted else math.inf
    return {name for name, value in discrepancies.items() if value > _ODD_RATIO * typical}


def _nearby(name: str, individual: Mapping[str, PointDiagnosis]) -> tuple[frozenset[str], ...]:
    """Return the effect sets from which the search at a point starts.

    These are the set of effects that most points have, and the set of the point's individual
    diagnosis, or of all individual diagnoses if it has none.
    """
    counts = Counter(effect for diagnosis in individual.values() for effect in diagnosis.structure)
    common = frozenset(effect for effect, count in counts.items() if 2 * count > len(individual))
    sources = [individual[name]] if name in individual else individual.values()
    return tuple(dict.fromkeys([common, *(source.structure for source in sources)]))


def _held_out_points(
    points: Sequence[DiagnosisPoint],
    diagnoses: Mapping[str, PointDiagnosis],
    workers: Workers,
    phases: Phases,
) -> dict[str, HeldOutPart]:
    """Return each point's residual with the device effects of the other points."""
    held_out = [point for point in points if point.name in diagnoses]
    knowledge = []
    for point in held_out:
        remaining = [d for name, d in diagnoses.items() if name != point.name]
        shared = frozenset(e.name for d in remaining for e in d.effects if e.scope == "device")
        values: DeviceValues = device_findings(remaining, shared).values
        knowledge.append(InstrumentKnowledge(declared_effects=values))
    phases.together.expect(len(held_out))
    transferred = successful(
        diagnose_all(
            held_out, knowledge, workers, phases.together, predict_last=False, step="held-out"
        )
    )
    return {name: _as_part(name, diagnosis) for name, diagnosis in transferred.items()}


def _as_part(name: str, diagnosis: PointDiagnosis) -> HeldOutPart:
    """Return the residuals of a point that was fitted with fixed device effects."""
    before, after = diagnosis.before, diagnosis.after
    return HeldOutPart(
        name=name,
        fitted=_fitted_numbers(diagnosis),
        before=before.residual_rms_over_peak,
        after=after.residual_rms_over_peak,
        contact_before=before.contact_residual_rms_over_peak,
        contact_after=after.contact_residual_rms_over_peak,
    )


def _fitted_numbers(diagnosis: PointDiagnosis) -> tuple[str, ...]:
    """Return the names of the parameters that were fitted to a point."""
    summary = diagnosis.summary
    if summary is None:
        return ()
    of_all = [f"{coordinate} ({effect or 'ground'})" for effect, coordinate in summary.values]
    of_drops = [
        f"{coordinate} ({effect}, drop {diagnosis.numbers[drop]})"
        for (effect, coordinate), by_drop in summary.deviations.items()
        for drop in by_drop
    ]
    stiffness = [
        f"stiffness (drop {diagnosis.numbers[drop]})"
        for drop, ratio in summary.stiffness.items()
        if ratio != 0.0
    ]
    return (*of_all, *of_drops, *stiffness)


# Smallest number of points for an estimate of the spread between points. Ratio of the standard
# deviation of a normal distribution to its median absolute deviation. A value contradicts the other
# points if it differs by more than this number of deviations and by more than this fraction.
_MIN_POINTS_FOR_SPREAD, _DEVIATION_OF_MEDIAN, _CONTRADICTION_DEVIATIONS, _CONTRADICTION_PART = (
    3,
    1.4826,
    4.0,
    0.05,
)
# Number of alternatives reported for an effect that points of a device share.
_MAX_ALTERNATIVES = 2


def device_findings(diagnoses: Sequence[PointDiagnosis], shared: Collection[str]) -> DeviceFindings:
    """Return medians and spreads of the shared device effects over the points of a device.

    The standard deviation of a median decreases with the square root of the number of points.

    Parameters
    ----------
    diagnoses : sequence of PointDiagnosis
        Diagnoses of the points, each with the values at the others as its prior.
    shared : collection of str
        Names of the device effects.
    """
    values: DeviceValues = {}
    deviations: DeviceValues = {}
    spread: DeviceValues = {}
    for name in sorted(shared):  # the order of a set differs from run to run
        shared_results = [e for d in diagnoses for e in d.effects if e.name == name]
        for parameter in BY_NAME[name].parameters:
            numbers = [p for e in shared_results for p in e.parameters if p.name == parameter.name]
            if not numbers:
                continue
            sample = [p.value for p in numbers]
            central = median(sample)
            deviations_of_points = [p.sd for p in numbers if math.isfinite(p.sd)]
            typical = median(deviations_of_points) if deviations_of_points else math.nan
            values.setdefault(name, {})[parameter.name] = central
            if len(sample) >= _MIN_POINTS_FOR_SPREAD:
                wide = _DEVIATION_OF_MEDIAN * median([abs(value - central) for value in sample])
                spread.setdefault(name, {})[parameter.name] = wide
                typical = math.hypot(wide, 0.0 if math.isnan(typical) else typical)
            deviations.setdefault(name, {})[parameter.name] = typical / math.sqrt(len(sample))
    drops = sum(len(diagnosis.numbers) for diagnosis in diagnoses)
    return DeviceFindings(values, deviations, drops, spread)


def contradictions(diagnosis: PointDiagnosis, findings: DeviceFindings) -> list[Notice]:
    """Return a warning for each device effect that contradicts the other points."""
    warnings = []
    for effect in diagnosis.effects:
        for p in effect.parameters:
            name, value = p.name, p.value
            wide = findings.spread.get(effect.name, {}).get(name)
            if effect.scope != "device" or wide is None:
                continue
            deviation = p.sd if math.isfinite(p.sd) else 0.0
            shared = findings.values[effect.name][name]
            away = abs(value - shared)
            if away > _CONTRADICTION_DEVIATIONS * math.hypot(
                wide, deviation
            ) and away > _CONTRADICTION_PART * abs(shared):
                values: dict[str, Value] = {
                    "effect": effect.name,
                    "parameter": name,
                    "shared": shared,
                    "own": value,
                    "unit": "" if p.unit == "-" else f" {p.unit}",
                }
                warnings.append(Notice("device-contradicted", values))
    return warnings


def alternatives_of(alone: Sequence[PointDiagnosis]) -> dict[str, tuple[str, ...]]:
    """Return, for each device effect, the two effects most often named as alternatives to it.

    Parameters
    ----------
    alone : sequence of PointDiagnosis
        Individual diagnoses.
    """
    counts: dict[str, Counter[str]] = {}
    for diagnosis in alone:
        for effect in diagnosis.effects:
            if effect.scope == "device":
                counts.setdefault(effect.name, Counter()).update(effect.alternatives)
    return {
        name: tuple(alternative for alternative, _ in counter.most_common(_MAX_ALTERNATIVES))
        for name, counter in counts.items()
    }


def declared_device(device: DeviceValues, spread: DeviceValues | None) -> DeviceFindings:
    """Return the device effects whose values are fixed.

    Effects with a standard deviation are left out.

    Parameters
    ----------
    device, spread : mapping
        Declared values and standard deviations, by effect and parameter.
    """
    effects = without_error_budget(device)
    held = {name: values for name, values in effects.items() if not (spread or {}).get(name)}
    unknown = {name: dict.fromkeys(values, math.nan) for name, values in held.items()}
    return DeviceFindings(held, unknown, 0)


def with_device(
    diagnosis: PointDiagnosis,
    findings: DeviceFindings,
    alternatives: Mapping[str, Sequence[str]] | None = None,
) -> PointDiagnosis:
    """Return the diagnosis of a point with the shared effects of its device added.

    Parameters
    ----------
    diagnosis : PointDiagnosis
    findings : DeviceFindings
        Values of the shared effects.
    alternatives : mapping, optional
        For each shared effect, the effects that explain the records equally well.
    """
    ambiguous = {
        name: tuple(alternatives.get(name, ())) if alternatives else () for name in findings.values
    }
    shared = tuple(
        effect_result(
            name,
            "device",
            BY_NAME[name].advice,
            [
                EffectParameter(
                    name=p.name,
                    unit=p.unit,
                    value=values[p.name],
                    sd=findings.deviations[name][p.name],
                    spread=findings.spread.get(name, {}).get(p.name),
                )
                for p in BY_NAME[name].parameters
                if p.name in values
            ],
            alternatives=ambiguous[name],
            probability=math.nan,
        )
        for name, values in findings.values.items()
    )
    warnings = [
        Notice("effect-ambiguous", {"effect": name, "others": names})
        for name, names in ambiguous.items()
        if names
    ]
    point_effects = tuple(
        effect for effect in diagnosis.effects if effect.name not in findings.values
    )
    return replace(
        diagnosis,
        effects=(*shared, *point_effects),
        warnings=(*diagnosis.warnings, *warnings),
    )
