"""Fit and held-out prediction of measured drops by ``pfwd diagnose``.

Files of real devices are required, which are not part of the project. Files of one device are one
survey, as for the command. By default the last drop of each point is predicted from its load, by a
diagnosis of the survey without the last drops. The prediction is compared with the preceding
record, scaled by the peak loads. Errors are root mean squares over the peak, in %.
"""

import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import Reporter, parse_options
from pfwd.analysis.diagnosis.diagnose import diagnose_entries
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, DiagnosisRequest, entries_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import SurveyError


def run(arguments: list[str]) -> int:
    """Diagnose files and print the errors.

    Return the exit status: 0, or 1 if no file has measured drops.
    """
    options, report = parse_options(
        "measured",
        __doc__,
        arguments,
        paths=(Path, "files of real devices, or folders"),
        header=(str, "file with what the files do not declare"),
        device=(str, "name of the only device"),
        leave_out=(("next", "drop", "sensor", "point"), "as the command (next)"),
        allow=((None, "stiffness"), "as the command"),
        jobs=(2, "processes"),
    )
    surveys = find_points(options.paths, AnalysisOptions(header=options.header))
    if options.device is not None:
        surveys = {name: points for name, points in surveys.items() if name == options.device}
    if not surveys:
        where = ", ".join(map(str, options.paths))
        print(f"pfwd bench measured: no measured drops in {where}", file=sys.stderr)
        return 1
    for name, points in surveys.items():
        start = time.perf_counter()
        request = DiagnosisRequest(
            leave_out=options.leave_out, allow=options.allow, jobs=options.jobs
        )
        diagnosed = [item.result for item in diagnose_entries(points, request)]
        results = [result for result in diagnosed if result is not None and result.curves]
        _report_survey(report, name, results, time.perf_counter() - start)
    return 0


def find_points(paths: Sequence[Path], options: AnalysisOptions) -> dict[str, list[DiagnosisPoint]]:
    """Return the measured points by device; errors of invalid files are printed."""
    files: list[Path] = []
    for path in paths:
        files += sorted(path.glob("*.csv")) if path.is_dir() else [path]
    surveys: dict[str, list[DiagnosisPoint]] = {}
    for file in files:
        try:
            entries = entries_of(str(file), options)
        except SurveyError as err:
            print(err, file=sys.stderr)
            continue
        for entry in entries:
            if entry.records is not None:
                surveys.setdefault(str(entry.device or file.name), []).append(entry)
    return surveys


def _report_survey(
    report: Reporter,
    name: str,
    points: Sequence[DiagnosisResult],
    seconds: float,
) -> None:
    """Report every point of a survey, then the medians of the errors, %, and of the effects."""
    report.title(f"{name}: {len(points)} points; rms over the peak in %, E in MPa")
    rows = [_row(point) for point in points]
    for point, row in zip(points, rows, strict=True):
        report.record(device=name, point=point.point or point.file, **row)
    keys = [key for key in rows[0] if key.endswith(("_whole", "_contact"))]
    medians = {key: _median([row[key] for row in rows]) for key in keys}
    report.record(device=name, what="median", seconds=seconds, **medians)
    for effect in sorted({effect.name for point in points for effect in point.effects}):
        named = [e for point in points for e in point.effects if e.name == effect]
        if named[0].scope != "device":
            report.record(device=name, effect=effect, points=len(named))
            continue
        values = {
            name: _median([e.values_by_name[name] for e in named if name in e.values_by_name])
            for name in named[0].values_by_name
        }
        report.record(device=name, effect=effect, points=len(named), **values)


def _row(point: DiagnosisResult) -> dict[str, Any]:
    before, after, held = point.before, point.after, point.held_out
    assert before is not None  # only diagnosed points are reported
    assert after is not None
    low, high = after.modulus_interval_pa or (math.nan, math.nan)

    def held_out(name: str) -> float | None:
        return _percent(getattr(held, name, None))

    return {
        "verdict": point.verdict,
        "corrected": int(point.corrected),
        "before_whole": 100 * before.residual_rms_over_peak,
        "before_contact": _percent(before.contact_residual_rms_over_peak),
        "after_whole": 100 * after.residual_rms_over_peak,
        "after_contact": _percent(after.contact_residual_rms_over_peak),
        "held_out": held and held.mode,
        "fitted": len(held.fitted) if held else 0,
        "base_held_out_whole": held_out("before"),
        "base_held_out_contact": held_out("contact_before"),
        "held_out_whole": held_out("after"),
        "held_out_contact": held_out("contact_after"),
        "scaled_record_whole": held_out("scaled_record"),
        "scaled_record_contact": held_out("contact_scaled_record"),
        "modulus_before": 1e-6 * before.fitted_modulus,
        "modulus_after": 1e-6 * after.fitted_modulus,
        "low": 1e-6 * low,
        "high": 1e-6 * high,
    }


def _percent(error: float | None) -> float | None:
    return None if error is None else 100 * error


def _median(values: Sequence[Any]) -> float | None:
    numbers = [float(value) for value in values if isinstance(value, float)]
    return float(np.median(numbers)) if numbers else None
