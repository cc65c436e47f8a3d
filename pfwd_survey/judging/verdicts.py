"""From the job and the drops of a point to its value, interval, target and verdict."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pfwd_survey.inverting.diagnosis.holding import holds
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.judging.drops import MeasuredDrop, compared
from pfwd_survey.judging.job import Job
from pfwd_survey.procedures import (
    DiagnosedModulus,
    Kind,
    PointModulus,
    PointProgress,
    PointValue,
    Verdict,
    judge,
)
from pfwd_survey.procedures.judging import is_for
from pfwd_survey.procedures.point import in_force_as_dict
from pfwd_survey.procedures.profile import OUR_TOLERANCES
from pfwd_survey.procedures.valuing import moduli_of, residual_fault, value_of

USUAL_RADIUS = 0.15
"""m; stands in for the plate where no drop says it, and nothing is computed with it."""

SAME_PLATE = 1e-9
"""Relative difference up to which two declared radii are one."""


@dataclass(frozen=True, slots=True)
class MeasuredPoint:
    """What is known of one point."""

    name: str
    """As it was named last."""
    drops: Sequence[MeasuredDrop]
    """All of them, in the order they fell."""
    target: float | None = None
    """Said of the point itself, Pa or m; None: nobody did."""
    discarded: bool = False
    diagnosis: DiagnosisResult | None = None
    """The last one, whether or not it still holds; None: its residual was not diagnosed."""


@dataclass(frozen=True, slots=True)
class JudgedPoint:
    """A point and how it stands."""

    name: str
    progress: PointProgress
    discarded: bool = False

    def as_json(self) -> dict[str, Any]:
        """The line of a point, SI units."""
        return point_line(self.name, self.progress)


def point_line(name: str, progress: PointProgress) -> dict[str, Any]:
    """A point as one JSON object: its name, and what ``pfwd report --json`` has for it."""
    said: Mapping[str, Any] = progress.as_dict()
    return {
        "point": name,
        "complete": progress.complete,
        "value": said["value"],
        "target": progress.target,
        "verdict": progress.verdict.value,
        "verdict_reason": progress.verdict_reason,
        "verdict_reason_code": said["verdict_reason_code"],
        **in_force_as_dict(progress.modulus_in_force),
        "used": list(progress.used),
        "compaction": said["compaction"],
    }


def diagnosis_now(point: MeasuredPoint) -> DiagnosisResult | None:
    """The diagnosis of a point, while its drops and what is declared are as they were."""
    if point.diagnosis is None or not point.drops:
        return None
    left_out = (Kind.DISCARDED, Kind.REJECTED)
    numbers = [fact.number for fact in compared(point.drops) if fact.kind not in left_out]
    return point.diagnosis if holds(point.diagnosis, point.drops[-1].setup, numbers) else None


def _diagnosed(point: MeasuredPoint) -> DiagnosedModulus | None:
    diagnosis = diagnosis_now(point)
    after = None if diagnosis is None else diagnosis.after
    if diagnosis is None or after is None or after.modulus_pa is None:
        return None
    return DiagnosedModulus(
        after.modulus_pa, after.modulus_interval_pa, diagnosis.use, diagnosis.use_reason
    )


def fit_before_diagnosis(diagnosis: DiagnosisResult) -> PointModulus | None:
    """Return the modulus of the base model; None: nothing was fitted."""
    before = diagnosis.before
    if before is None or before.modulus_pa is None:
        return None
    limit = OUR_TOLERANCES["most_residual"]
    fault = residual_fault(before.contact_residual_rms_over_peak, limit)
    return PointModulus(before.modulus_pa, before.modulus_interval_pa, "fitted", fault)


def modulus_in_force(
    diagnosis: DiagnosisResult, point: MeasuredPoint | None = None, job: Job | None = None
) -> PointModulus | None:
    """Return the modulus that a diagnosis puts in force at its point; None: there is none.

    Parameters
    ----------
    diagnosis : DiagnosisResult
    point : MeasuredPoint, optional
        As its survey has it. Without fits there, or without a survey, the fit is that of the base
        model.
    job : Job, optional
        Of the survey.
    """
    fitted = None
    if point is not None:
        progress = judge_point(job or Job(), dataclasses.replace(point, diagnosis=diagnosis))
        fitted = progress.fitted_modulus
    after = diagnosis.after
    if diagnosis.use != "do-not-use" and after is not None and after.modulus_pa is not None:
        return PointModulus(after.modulus_pa, after.modulus_interval_pa, "diagnosed")
    fitted = fitted or fit_before_diagnosis(diagnosis)
    return None if fitted is None or fitted.not_supported is not None else fitted


def judge_point(
    job: Job, point: MeasuredPoint, *, fallback: tuple[float, str] | None = None
) -> PointProgress:
    """What the job's procedure says of a point.

    Parameters
    ----------
    job : Job
    point : MeasuredPoint
    fallback : tuple of float and str, optional
        Target (Pa or m) of points for which the survey has none, and where it is from.

    Returns
    -------
    PointProgress
        With the target in this order: said of the point, of its station, of the job, `fallback`,
        the procedure's own.
    """
    procedure = job.procedure_in_force
    facts = compared(point.drops)
    radius, ratio, faults = plate_of_point(point.drops)
    target, source = target_of(job, point, fallback)
    setup = point.drops[-1].setup if point.drops else None
    progress = judge(
        procedure,
        facts,
        plate_radius=radius,
        poisson_ratio=ratio,
        target=target,
        moisture=None if setup is None else setup.moisture,
        material=None if setup is None or setup.material is None else str(setup.material),
        diagnosed=_diagnosed(point),
        found_before=faults,
    )
    if progress.target is not None and progress.target == target:
        progress = dataclasses.replace(progress, target_source=source)
    if point.discarded:
        progress = dataclasses.replace(
            progress,
            verdict=Verdict.NONE,
            verdict_reason="the point is discarded",
            verdict_reason_code=None,
        )
    return progress


def target_of(
    job: Job, point: MeasuredPoint, fallback: tuple[float, str] | None = None
) -> tuple[float | None, str]:
    """What a point has to reach, Pa or m, and who said so; the first of the quantity judged."""
    station = job.station(point.name)
    said = (
        (point.target, "of the point"),
        (None if station is None else station.target, "of the station"),
        (job.target, "of the survey"),
        fallback or (None, ""),
    )
    known = [(value, source) for value, source in said if value is not None]
    if not known:
        return None, ""
    fitting = [pair for pair in known if is_for(job.procedure_in_force, pair[0])]
    # One of another quantity is handed on, so that the judgement can say that it does not count.
    return (fitting or known)[0]


class PointPlate(NamedTuple):
    """The plate of a point."""

    radius: float
    """m; 0: there was no plate."""
    poisson_ratio: float | None
    """As declared; None: it is not."""
    faults: list[str]
    """One sentence where drops were measured with different plates."""


def plate_of_point(drops: Sequence[MeasuredDrop]) -> PointPlate:
    """Return plate and Poisson's ratio that are declared for the drops of a point."""
    loaded = [
        drop
        for drop, fact in zip(drops, compared(drops), strict=True)
        if fact.kind not in (Kind.REJECTED, Kind.DISCARDED)
    ]
    if not loaded:
        if not drops:
            return PointPlate(USUAL_RADIUS, None, [])
        setup = drops[-1].setup
        return PointPlate(setup.plate_radius or USUAL_RADIUS, setup.poisson_ratio, [])
    last = loaded[-1].setup
    radii = sorted({drop.setup.plate_radius for drop in loaded})
    faults = []
    if radii[-1] - radii[0] > SAME_PLATE * radii[-1]:
        listed = " and ".join(f"{radius:g} m" for radius in radii)
        faults.append(f"its drops were measured with plates of {listed} radius")
    return PointPlate(last.plate_radius, last.poisson_ratio, faults)


def value_of_drop(job: Job, drop: MeasuredDrop) -> PointValue | None:
    """What the job's procedure judges, of one drop alone; None: the drop does not say it.

    One drop has no scatter: only the modulus of the inversion has an interval, that of its model.
    """
    if drop.facts.kind is Kind.REJECTED:
        return None
    setup, procedure, drops = drop.setup, job.procedure_in_force, [drop.facts]
    modulus, _ = moduli_of(procedure, drops, None)
    return value_of(procedure, drops, setup.plate_radius, setup.poisson_ratio, [], modulus)
