r"""Log evidence of ground structures at the points of an instrument, and of other causes than rock.

A structure is a set of effects. The log evidence of the candidate structures is summed over the
points. With ``--hypotheses`` three causes in the instrument whose effect resembles that of rock are
compared: a mass that swings on the plate, a resonance of the sensor's carrier, and a ringing load
cell. Each is fitted to the last drop of each point, with and without rock.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measured import find_points
from benchmarks.output import Reporter
from inversion import SurrogateLibrary
from inversion.arrays import ComplexArray
from inversion.diagnosis import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects.base import DropContext, Effect, Values
from inversion.effects.carrier_resonance import CarrierResonance
from inversion.fitting.coordinates import Coordinate
from inversion.fitting.parameters import Parameter
from inversion.inference.point_model import PointModel
from inversion.inference.posterior import PointFit, Posterior
from inversion.inference.structures import (
    Structure,
    candidate_structures,
    effects_of,
    fit_briefly,
)
from inversion.threads import single_threaded_blas
from pfwd.analysis.options import AnalysisOptions
from pfwd.spawning import WorkerPool

# Effects that a diagnosis of the published survey detected; part of every fit with --hypotheses.
_COMMON_EFFECTS: Structure = frozenset(
    {"sensor_lag", "plate_inertia", "stress_dependence", "hysteretic_unloading"}
    | {"geophone_response", "rebound"}
)
_ROCK: Structure = frozenset({"bedrock"})
_ITERATIONS = 8


class _Resonance(Effect):
    """Resonance in the instrument between 15 and 200 Hz."""

    scope = "device"
    parameters = (
        Parameter("strength", "-", -2.0, 2.0, (-0.1, 0.1), prior=(0.0, 0.3), absent=0.0),
        *CarrierResonance.parameters[1:],
    )

    def coordinates(self, drop: DropContext) -> tuple[Coordinate, ...]:
        """Return strength, and logarithms of frequency and damping, as the unknowns."""
        strength = self.parameters[0]
        strength_coordinate = Coordinate(
            "strength", 0.0, 0.3, strength.lower, strength.upper, strength.starts
        )
        return strength_coordinate, *CarrierResonance().coordinates(drop)[1:]


class LoadCellResonance(_Resonance):
    """Ringing of the load cell: the load on the ground differs from the recorded one."""

    name = "ringing_load_cell"

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Return displacement over recorded load, m/N."""
        omega, damping = 2.0 * math.pi * values["frequency"], values["damping"]
        mode = s**2 / (s**2 + 2.0 * damping * omega * s + omega**2)
        result: ComplexArray = compliance * (1.0 + values["strength"] * mode)
        return result


class SwingingMass(_Resonance):
    """Mass on a spring on the plate, like a frame on its buffers; the strength is in 100 kg."""

    name = "swinging_mass"
    parameters = (
        Parameter("strength", "100 kg", 0.0, 30.0, (0.6, 0.3), prior=(0.0, 1.5), absent=0.0),
        *CarrierResonance.parameters[1:],
    )

    def compliance(
        self, compliance: ComplexArray, s: ComplexArray, values: Values, drop: DropContext
    ) -> ComplexArray:
        """Return the compliance with the force of the mass on the plate."""
        omega, damping = 2.0 * math.pi * values["frequency"], values["damping"]
        spring = 2.0 * damping * omega * s + omega**2
        mass = 100.0 * values["strength"] * spring / (s**2 + spring)
        plate = int(np.argmin(drop.offsets))
        result: ComplexArray = compliance / (1.0 + compliance[plate] * mass * s**2)
        return result


HYPOTHESES: tuple[Effect, ...] = (SwingingMass(), CarrierResonance(), LoadCellResonance())


def hypothesis_evidence(records: PointRecords) -> dict[str, float]:
    """Return the log evidence of rock, of each hypothesis, and of both together."""
    point = Point(records, SurrogateLibrary())
    evidence = {}
    with single_threaded_blas():
        for rock in (frozenset[str](), _ROCK):
            for hypothesis in (None, *HYPOTHESES):
                effects = effects_of(_COMMON_EFFECTS | rock)
                names = [*sorted(rock), *([hypothesis.name] if hypothesis else [])]
                if hypothesis is not None:
                    effects = (*effects, hypothesis)
                best = _best_of_starts(point, effects)
                evidence[" with ".join(names) or "neither"] = best.log_evidence
    return evidence


def _best_of_starts(point: Point, effects: Sequence[Effect]) -> Posterior:
    """Return the best short fit of the last drop."""
    drop = len(point.drops) - 1
    fits = []
    for variant in range(2):
        model = PointModel(point, effects, [drop], variant=variant)
        fits.append(PointFit(model).run_briefly(_ITERATIONS))
    return max(fits, key=lambda fit: fit.log_evidence)


def candidate_evidence(records: PointRecords) -> dict[str, float]:
    """Return the log evidence of all candidate structures for the last drop, by their names."""
    point = Point(records, SurrogateLibrary())
    candidates = candidate_structures([model.context for model in point.drops])
    fits = {s: fit_briefly(point, s, len(point.drops) - 1, {}) for s in candidates}
    return {
        ", ".join(sorted(structure)): fit.log_evidence
        for structure, fit in fits.items()
        if fit is not None
    }


def run(arguments: list[str]) -> int:
    """Fit the points and print the evidence.

    Return the exit status: 0, or 1 if no file has measured drops.
    """
    parser = argparse.ArgumentParser(prog="pfwd bench structures", description=__doc__)
    parser.add_argument("paths", nargs="+", type=Path, help="files of real devices, or folders")
    parser.add_argument("--header", type=Path, help="what the files do not declare")
    parser.add_argument("--hypotheses", action="store_true", help="causes in place of rock")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    header = None if options.header is None else str(options.header)
    surveys = find_points(options.paths, AnalysisOptions(header=header))
    points = [point for of_device in surveys.values() for point in of_device]
    records = [point.records for point in points if point.records is not None]
    if not records:
        where = ", ".join(map(str, options.paths))
        print(f"pfwd bench structures: no measured drops in {where}", file=sys.stderr)
        return 1
    report = Reporter(arguments)
    report.title(f"log evidence of the last drop, {len(records)} points")
    function = hypothesis_evidence if options.hypotheses else candidate_evidence
    with WorkerPool(options.jobs) as pool:
        rows = list(pool.map(function, records))
    for name, row in summed(rows).items():
        report.record(structure=name, **row)
    return 0


def summed(rows: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return, by structure, how much its summed evidence is below the best one's.

    Also returned is the number of points at which it is the best.

    Parameters
    ----------
    rows : sequence of mapping
        For each point, log evidence by structure.
    """
    names = set.intersection(*(set(row) for row in rows))
    totals = {name: sum(row[name] for row in rows) for name in names}
    best = max(totals.values())
    wins = [max(names, key=lambda name: row[name]) for row in rows]
    return {
        name: {"below_best": round(best - totals[name], 1), "best_at_points": wins.count(name)}
        for name in sorted(names, key=lambda name: -totals[name])
    }
