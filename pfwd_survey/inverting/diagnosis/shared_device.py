"""Diagnoses of the points of one device: effects of the device are those that most points show.

Of a large survey a few points are diagnosed first, from a cold start. If they show an effect of the
device, the other points start at the values of the first ones, and again from a cold start where
more residual is left. An effect that few points show is tried on the others.

Then the values of the device are fitted to all points together, and each point is diagnosed again
with them. A point that leaves more residual than the others gets another cold start. A point at
which the device leaves more residual than no device at all keeps the diagnosis of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from inversion.diagnosis import (
    NEARLY_EXPLAINED,
    DeviceFindings,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    UnknownKey,
    left_out_error,
)
from inversion.diagnosis.findings import HeldOut
from inversion.notices import Notice
from pfwd_survey.inverting.diagnosis.device_effects import (
    alternatives_of,
    contradictions,
    device_findings,
    device_names,
    with_device,
)
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint
from pfwd_survey.inverting.diagnosis.minority_effects import try_minority_effects
from pfwd_survey.inverting.diagnosis.points import (
    DeviceValues,
    DiagnosisByPoint,
    DiagnosisFailure,
    DiagnosisRequest,
    Progress,
    ProgressCounter,
    Workers,
    are_plain,
    diagnose_all,
    successful,
)

TRANSFERS: tuple[LeaveOut | None, ...] = (None, "point")
"""What is left out with its own numbers fitted to it; other modes predict."""
MIN_SHOWING_SHARE = 0.2
"""Share of the points that show an effect, from which on it is tried on the others."""
N_FIRST_POINTS = 4
"""Points with a cold start in a survey that has twice as many or more."""
MAX_RESIDUAL_RATIO = 1.5
"""Residual over the median of the first points, above which a point gets a cold start too."""
MAX_RESIDUAL_RATIO_WITH_DEVICE = 1.2
"""The same over the median of all points, once each is diagnosed with the device."""


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
    leave_out : None and "point": the point, where those of the device share something, else a drop;
        others: nothing, they are held out by diagnoses without them
    """
    within = leave_out in TRANSFERS
    outcomes, brief = diagnose_individually(points, workers, within, phases.alone)
    again = rediagnose_with_device(points, outcomes, workers, leave_out, phases.together)
    rest = [point for point in points if point.name in brief - again.keys()]
    phases.alone.expect(len(rest))
    requests = [DiagnosisRequest(leave_out=within)] * len(rest)
    return outcomes | again | diagnose_all(rest, requests, workers, phases.alone)


def diagnose_individually(
    points: Sequence[DiagnosisPoint], workers: Workers, leave_out: bool, counter: ProgressCounter
) -> tuple[DiagnosisByPoint, set[str]]:
    """Diagnose each point by itself; return also the names of those diagnosed in brief."""
    outcomes: DiagnosisByPoint = {}

    def diagnose(chosen: Sequence[DiagnosisPoint], request: DiagnosisRequest) -> None:
        outcomes.update(diagnose_all(chosen, [request] * len(chosen), workers, counter))

    cold = DiagnosisRequest(leave_out=leave_out)
    if points[0].device is None:
        diagnose(points, cold)
        return outcomes, set()
    first = set(range(len(points)))
    if len(points) >= 2 * N_FIRST_POINTS:
        step = (len(points) - 1) / (N_FIRST_POINTS - 1)
        first = {round(i * step) for i in range(N_FIRST_POINTS)}
    diagnose([point for i, point in enumerate(points) if i in first], cold)
    others = [point for i, point in enumerate(points) if i not in first]
    shown = list(successful(outcomes).values())
    brief: set[str] = set()
    if device_names(shown):
        likely, middle = _shown_effects(shown, ())
        starts = [middle, *(d.values for d in shown)]
        plain = are_plain(shown)
        diagnose(
            others, DiagnosisRequest(likely=sorted(likely), begun=starts, plain=plain, brief=True)
        )
        limit = MAX_RESIDUAL_RATIO * median([d.after.left_over_peak for d in shown])
        diagnoses = successful(outcomes)
        worse = [
            point
            for point in others
            if point.name in diagnoses and _ended_worse(diagnoses[point.name], limit)
        ]
        counter.expect(len(worse))
        diagnose(worse, DiagnosisRequest(brief=True))
        brief = {point.name for point in others}
    else:
        diagnose(others, cold)
    return outcomes, brief | try_minority_effects(points, outcomes, workers, counter)


def _ended_worse(diagnosis: PointDiagnosis, limit: float) -> bool:
    """Return whether the residual exceeds a limit, and is too large for a corrected modulus."""
    limit = max(limit, NEARLY_EXPLAINED)
    return diagnosis.verdict == "unexplained" and diagnosis.after.left_over_peak > limit


def rediagnose_with_device(
    points: Sequence[DiagnosisPoint],
    alone: DiagnosisByPoint,
    workers: Workers,
    leave_out: LeaveOut | None,
    counter: ProgressCounter,
) -> DiagnosisByPoint:
    """Diagnose the points again with the device effects that most of them show.

    Parameters
    ----------
    alone : diagnoses of the points, each by itself

    Returns
    -------
    DiagnosisByPoint
        Empty where the points share no device effect.
    """
    alone = {point.name: alone[point.name] for point in points}
    own = successful(alone)
    if points[0].device is None or len(own) < 2:
        return {}
    records = [point.records for point in points if point.name in own]
    (findings,) = workers.map(device_findings, [records], [list(own.values())])
    if findings is None:
        return {}
    requests = _requests_with_device(alone, findings)
    counter.expect(len(points))
    brief_requests = [replace(requests[point.name], leave_out=False) for point in points]
    again = diagnose_all(points, brief_requests, workers, counter)
    _rediagnose_worse(points, again, findings, workers, counter)
    as_points = leave_out in TRANSFERS
    by_itself = _diagnose_without_device(points, again, as_points, workers, counter)
    diagnoses = {n: d for n, d in successful(again).items() if n not in by_itself}
    errors: dict[str, HeldOutPart] = {}
    if as_points:
        of_others = dict(zip(own, findings.of_others, strict=True))
        errors = _held_out_errors(points, diagnoses, of_others, workers)
    alternatives = alternatives_of(list(own.values()))
    for name, diagnosis in diagnoses.items():
        diagnosis = with_device(diagnosis, findings, alternatives)
        if name in own:
            warnings = contradictions(own[name], findings)
            diagnosis = replace(diagnosis, warnings=(*diagnosis.warnings, *warnings))
        if name in errors:
            diagnosis = replace(diagnosis, held_out=HeldOut.of("point", [errors[name]]))
        again[name] = diagnosis
    return again | by_itself


def _rediagnose_worse(
    points: Sequence[DiagnosisPoint],
    outcomes: DiagnosisByPoint,
    findings: DeviceFindings,
    workers: Workers,
    counter: ProgressCounter,
) -> None:
    """Replace diagnoses that leave more than the others, where a cold start leaves less.

    The values of the point alone, and those of other points, may be a start in the wrong place.
    """
    diagnoses = successful(outcomes)
    if not diagnoses:
        return
    residuals = [d.after.left_over_peak for d in diagnoses.values()]
    limit = MAX_RESIDUAL_RATIO_WITH_DEVICE * median(residuals)
    worse = [
        point
        for point in points
        if point.name in diagnoses and _ended_worse(diagnoses[point.name], limit)
    ]
    counter.expect(len(worse))
    cold = DiagnosisRequest(device=findings.values, leave_out=False)
    others = diagnose_all(worse, [cold] * len(worse), workers, counter)
    for name, other in successful(others).items():
        if other.after.left_over_peak < diagnoses[name].after.left_over_peak:
            outcomes[name] = other


def _diagnose_without_device(
    points: Sequence[DiagnosisPoint],
    outcomes: DiagnosisByPoint,
    leave_out: bool,
    workers: Workers,
    counter: ProgressCounter,
) -> DiagnosisByPoint:
    """Diagnose by itself each point at which the device leaves more than the base model does."""
    worse = {
        name: diagnosis
        for name, diagnosis in successful(outcomes).items()
        if diagnosis.after.left_over_peak > diagnosis.before.left_over_peak
    }
    counter.expect(len(worse))
    request = DiagnosisRequest(leave_out=leave_out)
    chosen = [point for point in points if point.name in worse]
    by_itself = diagnose_all(chosen, [request] * len(chosen), workers, counter)
    for name, other in successful(by_itself).items():
        residuals = {
            "with_device_over_peak": worse[name].after.left_over_peak,
            "without_device_over_peak": worse[name].before.left_over_peak,
        }
        warning = Notice("device-left-out", residuals)
        by_itself[name] = replace(other, warnings=(*other.warnings, warning))
    return by_itself


def _requests_with_device(
    alone: DiagnosisByPoint, findings: DeviceFindings
) -> dict[str, DiagnosisRequest]:
    """Return the requests by which points are diagnosed with their device.

    A point starts at its own values and at the medians of the survey, since alone it may have ended
    in the wrong place. If it leaves more than the median residual, it starts also at the values of
    the point that leaves the least. Effects that it does not have are removed by their evidence.
    """
    diagnoses = list(successful(alone).values())
    common, middle = _shown_effects(diagnoses, findings.values)
    usual = median([d.after.left_over_peak for d in diagnoses])
    best = min(diagnoses, key=lambda d: d.after.left_over_peak)
    requests = {}
    for name, outcome in alone.items():
        if isinstance(outcome, DiagnosisFailure):
            requests[name] = DiagnosisRequest(device=findings.values)
            continue
        own = {e.key for e in outcome.effects} - set(findings.values)
        ground = {key: value for key, value in outcome.values.items() if not key[1]}
        starts = [outcome.values, middle | ground]
        if outcome.after.left_over_peak > usual:
            starts.append(dict(best.values) | ground)
        requests[name] = DiagnosisRequest(
            device=findings.values,
            likely=sorted(own | common),
            begun=starts,
            plain=outcome.plain,
        )
    return requests


def _shown_effects(
    diagnoses: Sequence[PointDiagnosis], known: Collection[str]
) -> tuple[set[str], dict[UnknownKey, float]]:
    """Return the effects that several points show, known ones apart, and medians of all values."""
    named = [{e.key for e in d.effects if e.key not in known} for d in diagnoses]
    counts = {name: sum(name in own for own in named) for name in set().union(*named)}
    limit = max(2, MIN_SHOWING_SHARE * len(named))
    common = {name for name, count in counts.items() if count >= limit}
    shown: dict[UnknownKey, list[float]] = {}
    for diagnosis in diagnoses:
        for key, value in diagnosis.values.items():
            shown.setdefault(key, []).append(value)
    return common, {key: median(values) for key, values in shown.items()}


def _held_out_errors(
    points: Sequence[DiagnosisPoint],
    diagnoses: Mapping[str, PointDiagnosis],
    of_others: Mapping[str, DeviceValues],
    workers: Workers,
) -> dict[str, HeldOutPart]:
    """Return the error of each point with the device values of the other points."""
    held_out = [p for p in points if p.name in diagnoses and of_others.get(p.name)]
    errors = workers.map(
        left_out_error,
        [point.records for point in held_out],
        [diagnoses[point.name] for point in held_out],
        [of_others[point.name] for point in held_out],
    )
    return {point.name: error for point, error in zip(held_out, errors, strict=True)}
