"""Diagnoses of the points of one device: what the device has in common, and then each point.

Points are diagnosed by themselves, of many some. An effect of the device is shared if the evidence
of these together says so. Then every point is diagnosed with these effects; what the other points
say of their numbers is its prior. A point that this leaves far worse than the others is diagnosed
by itself, too.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from inversion.diagnosis import DeviceFindings, LeaveOut, PointDiagnosis
from inversion.diagnosis.findings import EffectParameter, HeldOut, HeldOutPart, effect_result
from inversion.effects import BY_NAME
from inversion.inference.diagnose import EXPLAINED_TO
from inversion.inference.instrument import InstrumentKnowledge, shared_effects
from inversion.notices import Notice, Value
from inversion.records import known
from pfwd.analysis.diagnosis.entries import DiagnosisPoint
from pfwd.analysis.diagnosis.points import (
    DeviceValues,
    DiagnosisByPoint,
    Progress,
    ProgressCounter,
    Workers,
    diagnose_all,
    successful,
)

PREDICTED: tuple[LeaveOut, ...] = ("next", "drop", "sensor")
"""Modes in which the held-out part is predicted without anything fitted to it."""
# Of so many points, so many are diagnosed by themselves first.
_MANY_POINTS, _FIRST_POINTS = 8, 4
# Of the usual discrepancy, what makes a point odd; and of that with the others' device, what it has
# to leave by itself to be told so.
_FAR_MORE, _BY_ITSELF = 2.0, 2.0 / 3.0


@dataclass(frozen=True, eq=False)
class Phases:
    """Counters for the progress of the two parts of the work.

    Parameters
    ----------
    alone : ProgressCounter, points by themselves
    together : ProgressCounter, points with what others show
    """

    alone: ProgressCounter
    together: ProgressCounter

    @classmethod
    def of(cls, progress: Progress | None, points: int) -> Phases:
        """Return the counters for a number of points."""
        return cls(
            ProgressCounter(progress, "each point by itself", points),
            ProgressCounter(progress, "with what other points show", 0),
        )


def diagnose_device(
    points: Sequence[DiagnosisPoint],
    workers: Workers,
    leave_out: LeaveOut | None,
    phases: Phases,
) -> DiagnosisByPoint:
    """Diagnose the points of one device, or points that share none.

    Parameters
    ----------
    leave_out : "point": each point with the values of its device from the others; None: the last
        drop of each point; others: the prediction is made elsewhere
    """
    nothing = [InstrumentKnowledge()] * len(points)
    if points[0].device is None or len(points) < 2:
        return diagnose_all(points, nothing, workers, phases.alone, predict_last=leave_out is None)
    first = _first_points(points)
    phases.alone.total += len(first) - len(points)
    alone = diagnose_all(first, nothing[: len(first)], workers, phases.alone, predict_last=False)
    own = successful(alone)
    gains = [diagnosis.gains for diagnosis in own.values()]
    shared, absent = shared_effects(gains) if len(own) > 1 else (frozenset(), frozenset())
    known_of = [
        InstrumentKnowledge(
            effects=shared,
            absent=absent,
            other_points=tuple(
                diagnosis.summary
                for name, diagnosis in own.items()
                if name != point.name and diagnosis.summary is not None
            ),
            nearby=_nearby(point.name, own),
        )
        for point in points
    ]
    phases.together.expect(len(points))
    predict = leave_out is None
    again = diagnose_all(points, known_of, workers, phases.together, predict_last=predict)
    odd = [point for point in points if point.name in _odd_points(again) - set(own)]
    if odd:
        phases.together.expect(len(odd))
        found = diagnose_all(
            odd, nothing[: len(odd)], workers, phases.together, predict_last=predict
        )
        for name, diagnosis in successful(found).items():
            own[name] = diagnosis
            if _left(diagnosis) < _BY_ITSELF * _left(successful(again)[name]):
                again[name] = diagnosis
    together = successful(again)
    findings = device_findings(list(together.values()), shared)
    if not findings.values:
        return again
    errors: dict[str, HeldOutPart] = {}
    if leave_out == "point":
        errors = _held_out_points(points, together, workers, phases)
    alternatives = alternatives_of(list(own.values()))
    for name, diagnosis in together.items():
        told = with_device(diagnosis, findings, alternatives)
        if name in own:
            told = replace(told, warnings=(*told.warnings, *contradictions(own[name], findings)))
        if name in errors:
            told = replace(told, held_out=HeldOut.of("point", [errors[name]]))
        again[name] = told
    return again


def _first_points(points: Sequence[DiagnosisPoint]) -> list[DiagnosisPoint]:
    """Return the points that are diagnosed by themselves: all of few, some of many.

    Which ones does not depend on the order of the files.
    """
    if len(points) < _MANY_POINTS:
        return list(points)
    ordered = sorted(points, key=lambda point: point.name)
    return [ordered[(2 * k + 1) * len(points) // (2 * _FIRST_POINTS)] for k in range(_FIRST_POINTS)]


def _left(diagnosis: PointDiagnosis) -> float:
    """Return what no effect tells of a point, over the peak; NaN: it was not fitted."""
    left = diagnosis.after.discrepancy_over_peak
    return math.nan if left is None else left


def _odd_points(outcomes: DiagnosisByPoint) -> set[str]:
    """Return the names of points of which the device of the others leaves far more than usual."""
    left = {name: _left(diagnosis) for name, diagnosis in successful(outcomes).items()}
    fitted = [value for value in left.values() if math.isfinite(value)]
    usual = max(median(fitted), EXPLAINED_TO) if fitted else math.inf
    return {name for name, value in left.items() if value > _FAR_MORE * usual}


def _nearby(name: str, own: Mapping[str, PointDiagnosis]) -> tuple[frozenset[str], ...]:
    """Return the structure of a point by itself, or of others, and what most points have."""
    counts = Counter(effect for diagnosis in own.values() for effect in diagnosis.structure)
    common = frozenset(effect for effect, count in counts.items() if 2 * count > len(own))
    others = [own[name]] if name in own else own.values()
    return tuple(dict.fromkeys([common, *(other.structure for other in others)]))


def _held_out_points(
    points: Sequence[DiagnosisPoint],
    diagnoses: Mapping[str, PointDiagnosis],
    workers: Workers,
    phases: Phases,
) -> dict[str, HeldOutPart]:
    """Return the error of each point with the device's values held as the other points say."""
    held_out = [point for point in points if point.name in diagnoses]
    known = []
    for point in held_out:
        others = [d for name, d in diagnoses.items() if name != point.name]
        shared = frozenset(e.key for d in others for e in d.effects if e.scope == "device")
        values: DeviceValues = device_findings(others, shared).values
        known.append(InstrumentKnowledge(declared_effects=values))
    phases.together.expect(len(held_out))
    again = successful(diagnose_all(held_out, known, workers, phases.together, predict_last=False))
    return {name: _as_part(name, diagnosis) for name, diagnosis in again.items()}


def _as_part(name: str, diagnosis: PointDiagnosis) -> HeldOutPart:
    """Return what is left of a point of which everything but its device was fitted."""
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
    """Return the names of the numbers that were fitted to a point."""
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


# Points from which on their spread is told; of a normal distribution its middle distance from the
# middle, as a deviation; and what contradicts the others: so many deviations, and this part.
_FEWEST_FOR_SPREAD, _OF_NORMAL, _CONTRADICTS, _SAME_DEVICE = 3, 1.4826, 4.0, 0.05
# Of an effect that points of a device share.
_MOST_ALTERNATIVES = 2


def device_findings(diagnoses: Sequence[PointDiagnosis], shared: Collection[str]) -> DeviceFindings:
    """Return what points say of the effects of their device: medians, and by how much they differ.

    The median of several points is known by the root of their number better than one of them.

    Parameters
    ----------
    diagnoses : of the points, each with what the others say as its prior
    shared : names of the effects of the device
    """
    values: DeviceValues = {}
    deviations: DeviceValues = {}
    spread: DeviceValues = {}
    for name in shared:
        shown = [e for d in diagnoses for e in d.effects if e.key == name]
        for parameter in BY_NAME[name].parameters:
            numbers = [p for e in shown for p in e.numbers if p.name == parameter.name]
            if not numbers:
                continue
            sample = [known(p.value) for p in numbers]
            middle = median(sample)
            own = [p.sd for p in numbers if p.sd is not None and math.isfinite(p.sd)]
            typical = median(own) if own else math.nan
            values.setdefault(name, {})[parameter.name] = middle
            if len(sample) >= _FEWEST_FOR_SPREAD:
                wide = _OF_NORMAL * median([abs(value - middle) for value in sample])
                spread.setdefault(name, {})[parameter.name] = wide
                typical = math.hypot(wide, 0.0 if math.isnan(typical) else typical)
            deviations.setdefault(name, {})[parameter.name] = typical / math.sqrt(len(sample))
    drops = sum(len(diagnosis.numbers) for diagnosis in diagnoses)
    return DeviceFindings(values, deviations, drops, spread)


def contradictions(diagnosis: PointDiagnosis, findings: DeviceFindings) -> list[Notice]:
    """Return the warnings where a point alone shows another device than the others do."""
    warnings = []
    for effect in diagnosis.effects:
        for p in effect.numbers:
            name, value = known(p.name), known(p.value)
            wide = findings.spread.get(effect.key, {}).get(name)
            if effect.scope != "device" or wide is None:
                continue
            own = p.sd if p.sd is not None and math.isfinite(p.sd) else 0.0
            shared = findings.values[effect.key][name]
            away = abs(value - shared)
            if away > _CONTRADICTS * math.hypot(wide, own) and away > _SAME_DEVICE * abs(shared):
                values: dict[str, Value] = {
                    "effect": effect.key,
                    "parameter": name,
                    "shared": shared,
                    "own": value,
                    "unit": "" if p.unit == "-" else f" {p.unit}",
                }
                warnings.append(Notice("device-contradicted", values))
    return warnings


def alternatives_of(alone: Sequence[PointDiagnosis]) -> dict[str, tuple[str, ...]]:
    """Return the alternatives of device effects at single points, the most frequent first.

    As many as a point has.
    """
    counts: dict[str, Counter[str]] = {}
    for diagnosis in alone:
        for effect in diagnosis.effects:
            if effect.scope == "device":
                counts.setdefault(effect.key, Counter()).update(effect.alternatives or ())
    return {
        name: tuple(other for other, _ in found.most_common(_MOST_ALTERNATIVES))
        for name, found in counts.items()
    }


def given_device(device: DeviceValues, spread: DeviceValues | None) -> DeviceFindings:
    """Return the device effects that are held; those with deviations belong to each point."""
    held = {name: values for name, values in device.items() if not (spread or {}).get(name)}
    unknown = {name: dict.fromkeys(values, math.nan) for name, values in held.items()}
    return DeviceFindings(held, unknown, 0)


def with_device(
    diagnosis: PointDiagnosis,
    findings: DeviceFindings,
    others: Mapping[str, Sequence[str]] | None = None,
) -> PointDiagnosis:
    """The diagnosis with the effects of the survey's device among its effects.

    Parameters
    ----------
    others : of effects what they cannot be told from
    """
    told = {name: tuple(others.get(name, ())) if others else () for name in findings.values}
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
            alternatives=told[name],
            probability=math.nan,
        )
        for name, values in findings.values.items()
    )
    said = [
        Notice("effect-ambiguous", {"effect": name, "others": names})
        for name, names in told.items()
        if names
    ]
    own = tuple(effect for effect in diagnosis.effects if effect.key not in findings.values)
    return replace(
        diagnosis,
        effects=(*shared, *own),
        warnings=(*diagnosis.warnings, *said),
    )
