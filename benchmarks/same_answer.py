"""Comparison of the answers for the same drops from more and from fewer data.

Files of real devices are required, which are not part of the project. Files of one device are one
survey. The diagnosis of each point is repeated with less: the point alone, its last drop alone,
the first four points as a survey, and each of two halves of the survey. `median` and `largest` are
differences of a modulus in %, `contained` counts the points of which each interval contains the
other's value.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured import find_points
from benchmarks.output import Proportion, Reporter, parse_options
from inversion.diagnosis.findings import PointDiagnosis
from inversion.records import known
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, with_unique_names
from pfwd.analysis.diagnosis.shared_device import Phases, diagnose_device, successful
from pfwd.analysis.diagnosis.workers import Workers
from pfwd.analysis.options import AnalysisOptions

_PART = 4
# Quantities that are compared: values and intervals of `FittedState`.
_QUANTITIES = {
    "modulus": ("fitted_modulus", "modulus_interval_pa"),
    "equivalent modulus": ("equivalent_modulus_pa", "equivalent_modulus_interval_pa"),
}


def run(arguments: list[str]) -> int:
    """Diagnose surveys with all and with fewer data, print differences, and return 0."""
    options, report = parse_options(
        "same_answer",
        __doc__,
        arguments,
        paths=(Path, "files of real devices, or folders"),
        device=(str, "name of the only device"),
        jobs=(2, "processes"),
    )
    for name, points in find_points(options.paths, AnalysisOptions()).items():
        points = with_unique_names(points)
        if options.device in (None, name) and len(points) > 1:
            report.title(f"{name}: {len(points)} points")
            _compare(report, points, options.jobs)
    return 0


def _compare(report: Reporter, points: Sequence[DiagnosisPoint], jobs: int) -> None:
    apart = [replace(point, device=None) for point in points]
    last = [
        replace(p, records=replace(r, records=r.records[-1:], numbers=r.numbers[-1:]))
        for p in apart
        if (r := p.records) is not None
    ]
    survey, alone, alone_last, part, *halves = (
        _diagnose(some, jobs)
        for some in (points, apart, last, points[:_PART], points[::2], points[1::2])
    )
    pairs = {
        "alone, survey": (alone, survey),
        "last drop, all drops": (alone_last, alone),
        "four points, survey": (part, survey),
    }
    for what, (first, second) in pairs.items():
        for quantity, names in _QUANTITIES.items():
            report.record(pair=what, quantity=quantity, **_agreement(first, second, *names))
    for name, found in (("survey", survey), ("odd", halves[0]), ("even", halves[1])):
        for key, values in _device_effects(found).items():
            report.record(half=name, effect=key, **values)
    for name in survey:
        for which, found in {"alone": alone, "last": alone_last, "survey": survey}.items():
            report.record(
                point=name, data=which, result=_moduli(found[name]) if name in found else ""
            )


def _diagnose(points: Sequence[DiagnosisPoint], jobs: int) -> dict[str, PointDiagnosis]:
    with Workers(jobs) as workers:
        phases = Phases.of(None, len(points))
        return successful(diagnose_device(points, workers, "next", phases))


def _agreement(
    first: Mapping[str, PointDiagnosis],
    second: Mapping[str, PointDiagnosis],
    name: str,
    name_of_interval: str,
) -> dict[str, Any]:
    """Return differences of a quantity in %, and how many intervals contain the other's value."""
    differences, contained, missing = [], [], 0
    for point in first.keys() & second.keys():
        states = [found[point].after for found in (first, second)]
        values = [getattr(state, name) for state in states]
        limits = [getattr(state, name_of_interval) for state in states]
        if None in (*values, *limits) or not all(map(math.isfinite, values)):
            missing += 1
            continue
        differences.append(100 * math.expm1(abs(math.log(values[0] / values[1]))))
        inside = zip(limits, values[::-1], strict=True)
        contained.append(all(low <= value <= high for (low, high), value in inside))
    return {
        "median": float(np.median(differences)) if differences else math.nan,
        "largest": max(differences, default=math.nan),
        "contained": Proportion(sum(contained), len(contained)),
        "missing": missing,
    }


def _device_effects(diagnoses: Mapping[str, PointDiagnosis]) -> dict[str, dict[str, float]]:
    """Return values and standard deviations of the effects that the points of a device share."""
    effects = [e for d in diagnoses.values() for e in d.effects if e.scope == "device"]
    return {
        effect.key: {
            key: known(value)
            for p in effect.numbers
            for key, value in ((known(p.name), p.value), (f"sd_of_{p.name}", p.sd))
        }
        for effect in effects
    }


def _moduli(diagnosis: PointDiagnosis) -> str:
    """Return the compared moduli of a point with their intervals, MPa, and its misfit."""
    texts = []
    for name, name_of_interval in _QUANTITIES.values():
        value, limits = getattr(diagnosis.after, name), getattr(diagnosis.after, name_of_interval)
        low, high = limits or (math.nan, math.nan)
        texts.append(f"{1e-6 * (value or math.nan):.3g} ({1e-6 * low:.3g} to {1e-6 * high:.3g})")
    misfit = 100 * known(diagnosis.after.discrepancy_over_peak)
    return f"{', '.join(texts)} MPa; {misfit:.2g} %; {' '.join(sorted(diagnosis.structure))}"
