"""Verdicts of random surveys, compared with those of a judge that reads raw drops and edits."""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from pfwd.judging import Job, job_of, point_views
from pfwd.procedures import Procedure, Quantity
from pfwd_device.recording import Survey, SurveyDrop, SurveyPoint, read_survey
from tests.pfwd.judging.stories import PlayedSession, story_of
from tests.records import known

N_STORIES, N_EVERYDAY = 300, 36


def played(number: int, folder: Path) -> Survey:
    """Measure the survey of a story."""
    session = PlayedSession(folder)
    session.play(story_of(number))
    return read_survey(folder)


# A judge that knows nothing of the program's: it reads the raw drops and the edits.


@dataclass
class RawDrop:
    """Peaks and edits of one drop."""

    number: int
    load: float
    deflection: float
    result: Mapping[str, Any] | None
    discarded: bool = False
    moved: bool = False
    rejected: bool = False
    seating: bool = False


def raw_drop(drop: SurveyDrop) -> RawDrop:
    """Read the traces of a drop, without noise and offset, and what was done with it."""
    record = drop.read().drop
    raw = RawDrop(
        drop.drop,
        float(np.max(record.load)),
        float(np.max(record.channels[0].values)),
        next(drop.readable_results(dict), None),
    )
    for edit in drop.edits:
        if edit["what"] == "discard":
            raw.discarded, raw.moved = True, isinstance(edit.get("value"), dict)
        elif edit["what"] == "restore":
            raw.discarded = raw.moved = False
    return raw


def sort_raw(drops: Sequence[RawDrop], procedure: Procedure) -> list[RawDrop]:
    """Mark rejected and seating drops; return those that are averaged."""
    large = [drop.load for drop in drops if drop.load >= 1000.0 and not drop.moved]
    for drop in drops:
        small = drop.load < 1000.0 or drop.load < 0.2 * max(large, default=0.0)
        drop.rejected = drop.moved or small
    loading = [drop for drop in drops if not drop.rejected]
    for place, drop in enumerate(loading):
        seats = procedure.seating_drops
        # The header of these surveys declares one seating drop.
        drop.seating = drop.number <= 1 and not drop.discarded if seats is None else place < seats
    usable = [drop for drop in loading if not drop.seating and not drop.discarded]
    return usable[: procedure.measured_drops]


def target_of(point: SurveyPoint, job: Job, quantity: Quantity) -> float | None:
    """Return the first target of the judged quantity: of point, station, survey."""
    of_point: float | None = None
    for edit in point.edits:
        if edit["what"] == "target":
            of_point = edit.get("value")
    stations = {station.name: station.target for station in job.stations}
    targets = (of_point, stations.get(point.title), job.target)
    is_deflection = quantity is Quantity.DEFLECTION
    fitting = [t for t in targets if t is not None and (t < 1.0) == is_deflection]
    return fitting[0] if fitting else None


def naive_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return Student's 95 % interval of a mean."""
    if len(values) < 3:
        return None
    half = student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values))
    return float(np.mean(values) - half), float(np.mean(values) + half)


def naive_value(
    used: Sequence[RawDrop], procedure: Procedure, diagnosis: Mapping[str, Any] | None
) -> tuple[float | None, Any, int]:
    """Return value, interval and number of drops of the judged quantity."""
    radius = 0.15
    if procedure.quantity.is_fitted:
        if diagnosis is not None:
            after = diagnosis["after"]
            return after["modulus_pa"], after["modulus_interval_pa"], 0
        fitted = [drop.result for drop in used if drop.result is not None]
        if not fitted:
            return None, None, 0
        logarithms = np.log([result["modulus_pa"] for result in fitted])
        if len(fitted) == 1:
            return fitted[0]["modulus_pa"], fitted[0]["modulus_interval_pa"], 1
        n = len(fitted)
        half = student.ppf(0.975, n - 1) * np.std(logarithms, ddof=1) / math.sqrt(n)
        ends = np.log([result["modulus_interval_pa"] for result in fitted])
        below, above = np.mean(np.abs(ends - logarithms[:, None]), axis=0)
        average = float(np.mean(logarithms))
        low, high = average - math.hypot(below, half), average + math.hypot(above, half)
        return math.exp(average), (math.exp(low), math.exp(high)), n
    if not used:
        return None, None, 0
    deflections = np.array([drop.deflection for drop in used])
    loads = np.array([drop.load for drop in used])
    if procedure.quantity is Quantity.DEFLECTION:
        return float(np.mean(deflections)), naive_interval(deflections.tolist()), len(used)
    factor = known(procedure.factor).value
    if procedure.quantity is Quantity.E_VD:
        # 0.1 MPa under any plate, whatever the load was.
        moduli = factor * radius * 1e5 / deflections
        of_means = factor * radius * 1e5 / np.mean(deflections)
    else:
        moduli = factor * (1 - 0.35**2) * loads / (math.pi * radius * deflections)
        of_means = factor * (1 - 0.35**2) * np.mean(loads) / (math.pi * radius * deflections.mean())
    value = float(np.mean(moduli)) if procedure.average == "modulus" else float(of_means)
    interval = naive_interval(moduli.tolist())
    if interval is not None:
        shift = value - float(np.mean(moduli))
        interval = interval[0] + shift, interval[1] + shift
    return value, interval, len(used)


def diagnosis_in_force(point: SurveyPoint, drops: Sequence[RawDrop]) -> Mapping[str, Any] | None:
    """Return the last diagnosis of a point if the same drops count as when it was made."""
    counted = [drop.number for drop in drops if not drop.rejected and not drop.discarded]
    for drop in reversed(point.drops):
        actual = drop.read_diagnosis(dict)
        if actual is not None:
            return actual if counted and set(actual["drops"]) == set(counted) else None
    return None


def naive_outcome(point: SurveyPoint, job: Job) -> dict[str, Any]:
    """Judge a point from its raw drops and edits."""
    procedure = job.procedure_in_force
    drops = [raw_drop(drop) for drop in point.drops]
    used = sort_raw(drops, procedure)
    diagnosis = diagnosis_in_force(point, drops)
    value, interval, n_with_value = naive_value(used, procedure, diagnosis)
    target = target_of(point, job, procedure.quantity)
    required = procedure.measured_drops
    copies = len({(drop.load, drop.deflection) for drop in used}) < len(used)
    nominal = procedure.nominal_load
    wrong_load = nominal is not None and any(
        abs(drop.load - nominal.value) > 0.1 * nominal.value for drop in used
    )
    lacking = required is not None and diagnosis is None and n_with_value < len(used)
    if procedure.quantity is Quantity.MODULUS and diagnosis is not None:
        without = [drop for drop in used if drop.result is None]
        lacking = required is not None and 0 < len(without) < len(used)
    verdict = "undecided"
    if target is None or point.discarded:
        verdict = "none"
    elif not (wrong_load or len(used) < (required or 1) or lacking or copies or interval is None):
        low, high = interval
        smaller_is_better = procedure.quantity is Quantity.DEFLECTION
        if high <= target if smaller_is_better else low >= target:
            verdict = "pass"
        elif low > target if smaller_is_better else high < target:
            verdict = "fail"
    return {
        "verdict": verdict,
        "target": target,
        "value": value,
        "interval": interval and list(interval),
        "used": [drop.number for drop in used],
    }


# The tests.


def differences(number: int) -> Iterator[str]:
    """Yield each value of a story in which the program and the naive judge differ."""
    with tempfile.TemporaryDirectory() as place:
        survey = played(number, Path(place) / "s")
        job = job_of(survey)
        for point, view in zip(survey.points, point_views(survey), strict=True):
            progress = view.progress.as_dict()
            actual_outcome = progress | (progress["value"] or {"interval": None})
            for key, value in naive_outcome(point, job).items() if point.drops else ():
                # Student's quantiles of the program are rounded to four digits.
                actual = actual_outcome[key]
                close = pytest.approx(value, rel=2e-4) if isinstance(value, float | list) else value
                if actual != close:
                    yield f"{point.name}, {key}: {actual!r}, naive {value!r}"


@pytest.mark.parametrize("part", [*range(6), pytest.param(6, marks=pytest.mark.slow)])
def test_stories_have_the_naive_verdicts(part: int) -> None:
    numbers = range(part, N_EVERYDAY, 6) if part < 6 else range(N_EVERYDAY, N_STORIES)
    assert {number: list(differences(number)) for number in numbers} == {n: [] for n in numbers}
