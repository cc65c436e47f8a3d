"""Measured drops of several sensors fitted by homogeneous ground, layers, and instrument effects.

The fits are those of ``pfwd diagnose`` with fixed sets of effects instead of a search. Residuals
are the root mean square over all sensors and drops of a point after the drift of each sensor, in %
of its peak.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.output import Reporter
from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.fitting.layer_count import held_out_errors
from inversion.inference.posterior import Posterior
from inversion.inference.structures import fit_drops
from inversion.threads import single_threaded_blas
from pfwd.analysis.diagnosis.entries import entries_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.spawning import WorkerPool

LADDER: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...] = (
    ("homogeneous", ((), ("bedrock",))),
    ("layers", (("layer",), ("layer", "bedrock"))),
    (
        "layers, instrument",
        (
            ("layer", "geophone_response", "sensor_lag"),
            ("layer", "bedrock", "geophone_response", "sensor_lag"),
        ),
    ),
)
"""Steps of models, each with its sets of effects; the set with the largest evidence represents the
step."""


def measured(report: Reporter, files: Sequence[Path], header: Path | None, jobs: int) -> None:
    """Report the residuals of all steps at every point, and errors at held-out sensors."""
    options = AnalysisOptions(header=None if header is None else str(header))
    points = [
        entry.records
        for file in files
        for entry in entries_of(str(file), options)
        if entry.records is not None and len(entry.records.records[0].sensors) > 1
    ]
    report.title("measured drops of several sensors (residual in % of the peak, E of the subgrade)")
    if jobs > 1:
        with WorkerPool(jobs) as pool:
            ladders = list(pool.map(_ladder, points))
    else:
        ladders = [_ladder(records) for records in points]
    for records, (steps, errors, seconds) in zip(points, ladders, strict=True):
        sensors = len(records.records[0].sensors)
        for step, full, contact, modulus, names in steps:
            report.record(
                point=records.name,
                drops=len(records.records),
                sensors=sensors,
                step=step,
                contact=100 * contact,
                whole=100 * full,
                modulus_mpa=1e-6 * modulus,
                effects="+".join(names) or "-",
            )
        report.record(
            point=records.name,
            left_out_median=100 * float(np.median(errors)),
            left_out_worst=100 * float(np.max(errors)),
            processor_s=seconds,
        )
    for step, _ in LADDER:
        rows = [row for steps, _, _ in ladders for row in steps if row[0] == step]
        report.record(
            what="median over points",
            step=step,
            contact=100 * float(np.median([row[2] for row in rows])),
            whole=100 * float(np.median([row[1] for row in rows])),
        )


Step = tuple[str, float, float, float, tuple[str, ...]]


def _ladder(records: PointRecords) -> tuple[list[Step], np.ndarray, float]:
    start = time.process_time()
    with single_threaded_blas():
        point = Point(records, SurrogateLibrary())
        every = range(len(point.drops))
        steps = []
        for step, sets in LADDER:
            fits = [(names, fit_drops(point, frozenset(names), every, {})) for names in sets]
            names, best = max(fits, key=lambda named_fit: named_fit[1].log_evidence)
            steps.append(_step(step, names, best))
        seconds = time.process_time() - start
        estimate = point.drops[0].context.layers
        assert estimate is not None
        rock = "bedrock" in steps[-1][4]
        fit = estimate.fit(rock=rock, geophone=True, lag=True)
        sensors = [int(k) for k in fit.misfit.sensors]
        errors = held_out_errors(fit, np.random.default_rng(0), sensors)
    return steps, errors, seconds


def _step(step: str, names: tuple[str, ...], fit: Posterior) -> Step:
    full, contact = (
        float(np.sqrt(np.mean(np.square(fit.residuals_over_peak(contact_only=only)))))
        for only in (False, True)
    )
    return step, full, contact, fit.model.modulus(fit.values), tuple(sorted(names))
