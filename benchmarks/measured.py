"""The loop closed on measured drops by ``pfwd diagnose`` itself, judged by what was left out.

Needs files of real devices; they are not part of the project.  Files of one device are one survey,
as for the command: a point that is left out is fitted with device effects that the other points
ask for together, its ground alone is its own.  Root mean squares over the peak, in %.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import Reporter
from inversion.diagnosis import PointDiagnosis
from pfwd_survey.errors import SurveyError
from pfwd_survey.inverting.diagnosis.diagnose import diagnose_entries
from pfwd_survey.inverting.diagnosis.entries import DiagnosisPoint, entries_of
from pfwd_survey.inverting.options import AnalysisOptions


def run(arguments: list[str]) -> int:
    """Diagnose, print; 0, 1 when there is nothing to read."""
    parser = argparse.ArgumentParser(prog="pfwd bench measured", description=__doc__)
    parser.add_argument("paths", nargs="+", type=Path, help="files of real devices, or folders")
    parser.add_argument("--header", type=Path, help="what the files do not declare")
    parser.add_argument("--device", help="only this one")
    parser.add_argument("--leave-out", choices=("drop", "sensor", "point"), help="as the command")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument("--figures", type=Path, metavar="FOLDER", help="draw a picture there")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    header = None if options.header is None else str(options.header)
    surveys = find_points(options.paths, AnalysisOptions(header=header))
    if options.device is not None:
        surveys = {name: points for name, points in surveys.items() if name == options.device}
    if not surveys:
        where = ", ".join(map(str, options.paths))
        print(f"pfwd bench measured: no measured drops in {where}", file=sys.stderr)
        return 1
    report = Reporter(arguments)
    middles = {}
    for name, points in surveys.items():
        begun = time.perf_counter()
        done = diagnose_entries(points, None, options.jobs, options.leave_out)
        found = [item.diagnosis for item in done if item.diagnosis is not None]
        middles[name] = tell(report, name, found, time.perf_counter() - begun)
    if options.figures is not None:
        draw(middles, options.figures / "measured-loop.svg")
    return 0


def find_points(paths: Sequence[Path], options: AnalysisOptions) -> dict[str, list[DiagnosisPoint]]:
    """Measured points by device; files that cannot be read are left to the command to refuse."""
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


def tell(
    report: Reporter, name: str, found: Sequence[PointDiagnosis], seconds: float
) -> dict[str, float | None]:
    """Every point of a survey, then the medians."""
    report.title(f"{name}: {len(found)} points; rms over the peak in %, E in MPa")
    rows = [_row(point) for point in found]
    for point, row in zip(found, rows, strict=True):
        report.record(device=name, point=point.name, **row)
    keys = [key for key, value in rows[0].items() if key.startswith(("before", "after", "left"))]
    middle = {key: _median([row[key] for row in rows]) for key in keys}
    report.record(device=name, what="median", seconds=seconds, **middle)
    for effect in sorted({effect.name for point in found for effect in point.effects}):
        named = [e for point in found for e in point.effects if e.name == effect]
        if named[0].scope != "device":
            report.record(device=name, effect=effect, points=len(named))
            continue
        values = {
            p.name: _median([q.value for e in named for q in e.parameters if q.name == p.name])
            for p in named[0].parameters
        }
        report.record(device=name, effect=effect, points=len(named), **values)
    return middle


def _row(point: PointDiagnosis) -> dict[str, Any]:
    low, high = point.after.modulus_interval
    parts = point.held_out_by
    contacts = [part.contact_after for part in parts]
    return {
        "verdict": point.verdict,
        "corrected": int(point.corrected),
        "before_whole": 100 * point.before.residual_rms_over_peak,
        "before_contact": 100 * point.before.contact_residual_rms_over_peak,
        "after_whole": 100 * point.after.residual_rms_over_peak,
        "after_contact": 100 * point.after.contact_residual_rms_over_peak,
        "left_out": point.held_out_mode,
        "left_out_whole": None if not parts else 100 * float(point.held_out_after or 0.0),
        "left_out_contact": None
        if not parts
        else 100 * float(np.sqrt(np.mean(np.square(contacts)))),
        "modulus_before": 1e-6 * point.before.modulus,
        "modulus_after": 1e-6 * point.after.modulus,
        "low": 1e-6 * low,
        "high": 1e-6 * high,
    }


def _median(values: Sequence[Any]) -> float | None:
    numbers = [float(value) for value in values if isinstance(value, float)]
    return float(np.median(numbers)) if numbers else None


def draw(middles: Mapping[str, Mapping[str, float | None]], file: Path) -> None:
    """What is left of each device's points, before, after and left out."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    axes = figure.add_subplot()
    steps = (
        ("before_whole", "before"),
        ("after_whole", "after"),
        ("left_out_whole", "after, left out"),
    )
    places = np.arange(len(middles))
    for index, (key, label) in enumerate(steps):
        heights = [values[key] or 0.0 for values in middles.values()]
        bars = axes.bar(places + 0.27 * (index - 1), heights, 0.25, label=label)
        axes.bar_label(bars, fmt="%.2g", fontsize=7)
    axes.set_xticks(places, list(middles))
    axes.set_yscale("log")
    axes.set_ylabel("rms over the peak, %")
    axes.legend(fontsize=7, frameon=False)
    figure.savefig(file, metadata={"Date": None})
