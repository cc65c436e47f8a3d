"""Measured drops of several sensors: from homogeneous ground over layers to the instrument's terms.

The fits are those that ``pfwd diagnose`` makes, with sets of effects that are given instead of
searched; ``pfwd diagnose`` itself may go on from there. Residuals, after the drift of each sensor,
in % of its own peak, root mean square over all sensors and drops of a point.
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
from inversion.fitting.layered.number import left_out_errors
from inversion.inference.posterior import Posterior
from inversion.inference.structures import fit_drops
from inversion.threads import single_threaded_blas
from pfwd.analysis.diagnosis.entries import entries_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.spawning import worker_pool

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
"""Step, and the sets of effects of which the one with most evidence stands for it."""


def measured(report: Reporter, files: Sequence[Path], header: Path | None, jobs: int) -> None:
    """The ladder of every point of files, and how sensors are predicted that were left out."""
    options = AnalysisOptions(header=None if header is None else str(header))
    points = [
        entry.records
        for file in files
        for entry in entries_of(str(file), options)
        if entry.records is not None and len(entry.records.records[0].sensors) > 1
    ]
    report.title("measured drops of several sensors (residual in % of the peak, E of the subgrade)")
    if jobs > 1:
        with worker_pool(jobs) as pool:
            found = list(pool.map(_ladder, points))
    else:
        found = [_ladder(records) for records in points]
    for records, (steps, left_out, seconds) in zip(points, found, strict=True):
        sensors = len(records.records[0].sensors)
        for step, whole, contact, modulus, names in steps:
            report.record(
                point=records.name,
                drops=len(records.records),
                sensors=sensors,
                step=step,
                contact=100 * contact,
                whole=100 * whole,
                modulus_mpa=1e-6 * modulus,
                effects="+".join(names) or "-",
            )
        report.record(
            point=records.name,
            left_out_median=100 * float(np.median(left_out)),
            left_out_worst=100 * float(np.max(left_out)),
            processor_s=seconds,
        )
    for step, _ in LADDER:
        rows = [row for steps, _, _ in found for row in steps if row[0] == step]
        report.record(
            what="median over points",
            step=step,
            contact=100 * float(np.median([row[2] for row in rows])),
            whole=100 * float(np.median([row[1] for row in rows])),
        )


Step = tuple[str, float, float, float, tuple[str, ...]]


def _ladder(records: PointRecords) -> tuple[list[Step], np.ndarray, float]:
    begun = time.process_time()
    with single_threaded_blas():
        point = Point(records, SurrogateLibrary())
        every = range(len(point.drops))
        steps = []
        for step, sets in LADDER:
            fits = [(names, fit_drops(point, frozenset(names), every, {})) for names in sets]
            names, best = max(fits, key=lambda one: one[1].log_evidence)
            steps.append(_step(step, names, best))
        spent = time.process_time() - begun
        look = point.drops[0].context.layers
        assert look is not None
        rock = "bedrock" in steps[-1][4]
        fit = look.fit(rock=rock, geophone=True, lag=True)
        sensors = [int(k) for k in fit.misfit.sensors]
        errors = left_out_errors(fit, np.random.default_rng(0), sensors)
    return steps, errors, spent


def _step(step: str, names: tuple[str, ...], fit: Posterior) -> Step:
    whole, contact = (
        float(np.sqrt(np.mean(np.square(fit.residuals_over_peak(contact_only=only)))))
        for only in (False, True)
    )
    return step, whole, contact, fit.model.modulus(fit.values), tuple(sorted(names))
