"""Comparison of verdicts with those that version 0.1 of the program gave.

Surveys do not store verdicts. A survey that was last recorded under the rules of version 0.1 is
judged by both sets of rules, and the differences are reported. Newer versions write an event with
the version of their rules when a survey begins; such a survey is not compared.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pfwd.analysis.results import DiagnosisResult
from pfwd.judging.verdicts import PointView
from pfwd.procedures import PointDrop, PointValue, Quantity, Verdict
from pfwd.procedures.judging import RULES_EVENT, RULES_VERSION
from pfwd.procedures.point import ReasonCode
from pfwd.procedures.values import e_lwd, e_vd, half_width_95, mean, recorded_values
from pfwd_device.recording.survey_content import SurveyContent


def changed_verdicts(survey: SurveyContent, points: Iterable[PointView]) -> Iterator[str]:
    """Yield one sentence for each point whose verdict differs from that of version 0.1.

    Parameters
    ----------
    survey : SurveyContent
        Holds the event with the version of the rules that it was recorded under.
    points : iterable of PointView
        The points of the survey.
    """
    if any(_rules_of(event) >= RULES_VERSION for event in survey.events):
        return
    for point in points:
        if point.discarded:
            continue
        progress = point.progress
        earlier = earlier_verdict(point)
        if earlier is not progress.verdict:
            yield (
                f"point {point.shown_name}: the verdict was {earlier.word}, by the rules of this "
                f"version it is {progress.verdict.word}: {progress.verdict_reason}"
            )


def _rules_of(event: Mapping[str, Any]) -> float:
    details = event.get("details", event)
    if event.get("event") != RULES_EVENT or not isinstance(details, Mapping):
        return 1
    version = details.get("version")
    return version if isinstance(version, int | float) else 1


def earlier_verdict(point: PointView) -> Verdict:
    """Return the verdict on a point by the rules of version 0.1."""
    progress = point.progress
    if progress.target is None or progress.verdict is Verdict.NONE:
        return Verdict.NONE
    used = [drop for drop in point.facts if drop.number in progress.used]
    missing_data = (ReasonCode.VALUE_MISSING, ReasonCode.SCATTER)
    if progress.value is None or not progress.complete:
        return Verdict.UNDECIDED
    if progress.verdict_reason_code in missing_data or point.plate.faults:
        return Verdict.UNDECIDED
    ends = _earlier_interval(used, progress.value, point.diagnosis_in_force)
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
    used: list[PointDrop], value: PointValue, diagnosis: DiagnosisResult | None
) -> tuple[float, float] | None:
    """Return the 95 % interval of version 0.1: symmetric about the mean."""
    if value.quantity is Quantity.MODULUS:
        after = None if diagnosis is None else diagnosis.after
        if diagnosis is not None and diagnosis.corrected and after and after.modulus_pa:
            return after.modulus_interval_pa
        moduli = recorded_values(used, "modulus")
        if not moduli:
            return None
        intervals = [drop.modulus_interval for drop in used if drop.modulus_interval is not None]
        model = mean([(high - low) / 2 for low, high in intervals]) if intervals else None
        parts = [part for part in (half_width_95(moduli), model) if part is not None]
        average, half = mean(moduli), math.hypot(*parts) if parts else None
    else:
        average, half = value.value, half_width_95(_peak_values(used, value))
    return None if half is None else (average - half, average + half)


def _peak_values(used: list[PointDrop], value: PointValue) -> list[float]:
    """Return the judged quantity of every drop, computed from its peaks."""
    drops = [drop for drop in used if drop.peak_deflection]
    deflections, loads = (
        recorded_values(drops, "peak_deflection"),
        recorded_values(drops, "peak_load"),
    )
    if value.quantity is Quantity.DEFLECTION:
        return deflections
    radius, factor = value.plate_radius or 0.0, value.factor or 1.0
    if value.quantity is Quantity.E_VD:
        return [e_vd(w, radius, factor, value.pressure or 0.0) for w in deflections]
    ratio = value.poisson_ratio or 0.0
    return [e_lwd(f, w, radius, ratio, factor) for f, w in zip(loads, deflections, strict=True)]
