"""Verdicts that the rules of this version decide otherwise than those of version 0.1.

Surveys do not store verdicts. So that nobody is surprised by one that changed, a survey that was
last recorded under the earlier rules is judged by both, and the differences are reported. A session
or an import that begins a survey writes an event with its rules; then nothing is compared.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pfwd_device.recording.survey_content import SurveyContent
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.judging.contents import measured_point
from pfwd_survey.judging.drops import compared
from pfwd_survey.judging.job import Job
from pfwd_survey.judging.verdicts import (
    MeasuredPoint,
    diagnosis_now,
    judge_point,
    plate_of_point,
)
from pfwd_survey.procedures import PointDrop, PointProgress, PointValue, Quantity, Verdict
from pfwd_survey.procedures.judging import RULES_EVENT, RULES_VERSION
from pfwd_survey.procedures.moduli import e_lwd, e_vd, half_width_95, mean
from pfwd_survey.procedures.point import ReasonCode
from pfwd_survey.procedures.valuing import known


def changed_verdicts(survey: SurveyContent, job: Job) -> Iterator[str]:
    """Yield one sentence for each point whose verdict these rules changed.

    Parameters
    ----------
    survey : SurveyContent
    job : Job
        Of the survey.
    """
    if any(_rules_of(event) >= RULES_VERSION for event in survey.events):
        return
    for point in survey.points:
        if point.discarded:
            continue
        measured = measured_point(point)
        progress = judge_point(job, measured)
        earlier = earlier_verdict(job, measured, progress)
        if earlier is not progress.verdict:
            yield (
                f"point {point.title}: the verdict was {earlier.word}, by the rules of this "
                f"version it is {progress.verdict.word}: {progress.verdict_reason}"
            )


def _rules_of(event: Mapping[str, Any]) -> float:
    details = event.get("details", event)
    if event.get("event") != RULES_EVENT or not isinstance(details, Mapping):
        return 1
    version = details.get("version")
    return version if isinstance(version, int | float) else 1


def earlier_verdict(job: Job, point: MeasuredPoint, progress: PointProgress) -> Verdict:
    """Return the verdict that version 0.1 gave.

    Parameters
    ----------
    job : Job
    point : MeasuredPoint
    progress : PointProgress
        Of the point by the present rules.
    """
    if progress.target is None or progress.verdict is Verdict.NONE:
        return Verdict.NONE
    used = [drop for drop in compared(point.drops) if drop.number in progress.used]
    other_faults = (ReasonCode.VALUE_MISSING, ReasonCode.SCATTER)
    if progress.value is None or not progress.complete:
        return Verdict.UNDECIDED
    if progress.verdict_reason_code in other_faults or plate_of_point(point.drops).faults:
        return Verdict.UNDECIDED
    ends = _earlier_interval(job, used, progress.value, diagnosis_now(point))
    if ends is None:
        return Verdict.UNDECIDED
    low, high = ends
    if progress.value.quantity is Quantity.DEFLECTION:
        low, high, target = -high, -low, -progress.target
    else:
        target = progress.target
    if low >= target:
        return Verdict.PASS
    return Verdict.FAIL if high < target else Verdict.UNDECIDED


def _earlier_interval(
    job: Job, used: list[PointDrop], value: PointValue, diagnosis: DiagnosisResult | None
) -> tuple[float, float] | None:
    """Return the interval that version 0.1 gave: the same half-width to either side."""
    if value.quantity is Quantity.MODULUS:
        after = None if diagnosis is None else diagnosis.after
        if diagnosis is not None and diagnosis.corrected and after and after.modulus_pa:
            return after.modulus_interval_pa
        moduli = known(used, "modulus")
        if not moduli:
            return None
        intervals = [drop.modulus_interval for drop in used if drop.modulus_interval is not None]
        model = mean([(high - low) / 2 for low, high in intervals]) if intervals else None
        parts = [part for part in (half_width_95(moduli), model) if part is not None]
        middle, half = mean(moduli), math.hypot(*parts) if parts else None
    else:
        middle, half = value.value, half_width_95(_peak_values(job, used, value))
    return None if half is None else (middle - half, middle + half)


def _peak_values(job: Job, used: list[PointDrop], value: PointValue) -> list[float]:
    """Return the judged quantity of every drop, from its peaks."""
    drops = [drop for drop in used if drop.peak_deflection]
    deflections, loads = known(drops, "peak_deflection"), known(drops, "peak_load")
    if value.quantity is Quantity.DEFLECTION:
        return deflections
    radius, factor = value.plate_radius or 0.0, value.factor or 1.0
    if value.quantity is Quantity.E_VD:
        return [e_vd(w, radius, factor, value.pressure or 0.0) for w in deflections]
    ratio = value.poisson_ratio or 0.0
    return [e_lwd(f, w, radius, ratio, factor) for f, w in zip(loads, deflections, strict=True)]
