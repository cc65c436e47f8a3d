"""Diagnoses of the points of one device: what the device has in common, and then each point.

Each point is diagnosed by itself. An effect of the device is shared if the evidence of all points
together says so. Then every point is diagnosed with these effects; what the other points say of
their numbers is its prior.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from inversion.diagnosis import LeaveOut, PointDiagnosis
from inversion.diagnosis.findings import HeldOut, HeldOutPart
from inversion.inference.instrument import InstrumentKnowledge, shared_effects
from pfwd_survey.inverting.diagnosis.device_effects import (
    alternatives_of,
    contradictions,
    device_findings,
    with_device,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.points import (
    DeviceValues,
    DiagnosisByPoint,
    Progress,
    ProgressCounter,
    Workers,
    diagnose_all,
    successful,
)

PREDICTED: tuple[LeaveOut, ...] = ("next", "drop", "sensor")
"""What is held out and predicted without anything fitted to it."""


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
    alone = diagnose_all(points, nothing, workers, phases.alone, predict_last=False)
    own = successful(alone)
    gains = [diagnosis.gains for diagnosis in own.values()]
    shared, absent = shared_effects(gains) if len(own) > 1 else (frozenset(), frozenset())
    known = [
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
    again = diagnose_all(points, known, workers, phases.together, predict_last=leave_out is None)
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


def _nearby(name: str, own: Mapping[str, PointDiagnosis]) -> tuple[frozenset[str], ...]:
    """Return the structure of a point by itself, and of the effects that most points have."""
    counts = Counter(effect for diagnosis in own.values() for effect in diagnosis.structure)
    common = frozenset(effect for effect, count in counts.items() if 2 * count > len(own))
    return tuple({own[name].structure, common}) if name in own else (common,)


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
