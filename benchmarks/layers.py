"""Inversion of layered ground: errors and intervals against the truth of finite-element drops.

Drops on random grounds with noise are inverted as by ``pfwd invert --layers``, which uses only the
traces.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.output import Reporter, parse_options
from inversion import Instrument, Record, Settings, invert
from inversion.measured.record import CALIBRATED_ERROR, Sensor
from inversion.result import InversionResult
from pfwd.jobs import Jobs
from pfwd_plugins.quantities import Measurand
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilLayer, SoilProfile

_RADIUS = 0.15
_MASS = 5.0
_STEP = 2e-4
# Root mean square noise of velocity and load, over their peaks.
_NOISE, _LOAD_NOISE = 0.002, 0.002
_BEFORE_S = 0.012


@dataclass(frozen=True)
class LayeredCase:
    """Layered ground, with the distances of the sensors, m."""

    number: int
    layers: tuple[SoilLayer, ...]
    rock: bool
    offsets: tuple[float, ...]

    @property
    def moduli(self) -> list[float]:
        """Moduli of the layers from the top, Pa."""
        return [layer.modulus for layer in self.layers]

    @property
    def rock_depth(self) -> float:
        """Depth of the rock, m; inf: no rock."""
        return sum(layer.thickness for layer in self.layers) if self.rock else math.inf


def cases(count: int, seed: int) -> list[LayeredCase]:
    """Return random grounds for four sensors: a stiff or soft top, or three layers.

    Half of the grounds are on rock, the depth of which is declared.
    """
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    cases_ = []
    for number in range(count):
        media, rock = (3 if number % 3 == 2 else 2), bool(number % 2)
        modulus = between(3e7, 1.2e8)
        moduli = [modulus]
        for _ in range(media - 1):
            factor = between(1.5, 5.0)
            moduli.insert(0, moduli[0] * (factor if rng.uniform() < 0.6 else 1.0 / factor))
        above = [between(0.15, 0.45) for _ in range(media - 1)]
        last = between(0.7, 2.5) if rock else math.inf
        layers = tuple(
            SoilLayer(m, m * between(0.5e-3, 2e-3), rng.uniform(1750, 2200), 0.35, h)
            for m, h in zip(moduli, [*above, last], strict=True)
        )
        offsets = (0.0, 0.3, 0.6, float(round(between(0.85, 1.2), 2)))
        cases_.append(LayeredCase(number, layers, rock, offsets))
    return cases_


def record_of_case(case: LayeredCase) -> Record:
    """Return the record with noise, as input of the inversion."""
    drop = simulate_drop(
        SoilProfile(case.layers, "rigid" if case.rock else "none"),
        Plate(_RADIUS, _MASS, "rough"),
        Hammer(10.0, 5.6e5, 3.0),
        case.offsets,
        duration=0.06,
        time_step=_STEP,
    )
    rng = np.random.default_rng((5, case.number))
    quiet = round(_BEFORE_S / _STEP)
    velocities = np.gradient(drop.ground_displacement, _STEP, axis=1)
    size = quiet + drop.time.size
    load = np.zeros(size)
    load[quiet:] = drop.load
    sensors = []
    for offset, row in zip(case.offsets, velocities, strict=True):
        values = np.zeros(size)
        values[quiet:] = row
        values += rng.normal(0.0, _NOISE * np.abs(row).max(), size)
        sensors.append(Sensor(offset, Measurand.VELOCITY, values))
    load += rng.normal(0.0, _LOAD_NOISE * drop.load.max(), size)
    return Record(
        time=_STEP * (np.arange(size) - quiet),
        load=load,
        sensors=tuple(sensors),
        instrument=Instrument(_RADIUS, _MASS),
        poisson_ratio=0.35,
        bedrock_depth=case.rock_depth,
        modulus_error=CALIBRATED_ERROR,
    )


Solved = tuple[LayeredCase, InversionResult, InversionResult, float]
"""Ground, results of all sensors and of the centre alone, and processor time of the first, s."""


def _solved(case: LayeredCase) -> Solved:
    record = record_of_case(case)
    start = time.process_time()
    every = invert(record, Settings(layers=len(case.layers)))
    spent = time.process_time() - start
    centre = invert(record, Settings(layers=len(case.layers), all_sensors=False))
    return case, every, centre, spent


def run(arguments: list[str]) -> int:
    """Print errors and intervals; return the exit status 0."""
    options, report = parse_options(
        "layers",
        __doc__,
        arguments,
        cases=(60, "drops that are inverted"),
        seed=(1, "of their grounds"),
        jobs=(1, "processes"),
    )
    report.title(
        f"{options.cases} drops of the simulators' finite elements, four sensors, noise "
        f"{100 * _NOISE:g} %, true number of media (%)"
    )
    drawn = cases(options.cases, options.seed)
    with Jobs.for_calls(options.jobs, options.cases) as pool:
        solved = list(pool.map(_solved, drawn))
    summarise(report, solved)
    return 0


def summarise(report: Reporter, solved: Sequence[Solved]) -> None:
    """Print errors and intervals of moduli and thicknesses, then processor times."""
    for quantity, place in (("subgrade", -1), ("top", 0)):
        errors, inside, widths, alone = [], [], [], []
        for case, every, centre, _ in solved:
            truth, layer_result = case.moduli[place], (every.layers or ())[place]
            errors.append(abs(layer_result.modulus_pa / truth - 1.0))
            low, high = layer_result.modulus_interval_pa
            inside.append(low <= truth <= high)
            widths.append(0.5 * math.log(high / low))
            low, high = (centre.layers or ())[place].modulus_interval_pa
            alone.append(low <= truth <= high)
        report.record(
            what=quantity, **_summary(errors, inside, widths), centre_alone=100 * _fraction(alone)
        )
    errors, inside, widths = [], [], []
    for case, every, _, _ in solved:
        for layer, layer_result in zip(case.layers[:-1], (every.layers or ())[:-1], strict=True):
            errors.append(abs((layer_result.thickness_m or math.nan) / layer.thickness - 1.0))
            low, high = layer_result.thickness_interval_m or (math.nan, math.nan)
            inside.append(low <= layer.thickness <= high)
            widths.append(0.5 * math.log(high / low))
    report.record(what="thickness", **_summary(errors, inside, widths))
    report.record(
        what="processor time, s",
        two_media=_median([s for c, _, _, s in solved if len(c.layers) == 2]),
        three_media=_median([s for c, _, _, s in solved if len(c.layers) == 3]),
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median; None without values, as a few cases may have no ground of three media."""
    return float(np.median(values)) if values else None


def _summary(
    errors: Sequence[float], inside: Sequence[bool], widths: Sequence[float]
) -> dict[str, Any]:
    return {
        "median": 100 * float(np.median(errors)),
        "p90": 100 * float(np.quantile(errors, 0.9)),
        "worst": 100 * max(errors),
        "interval_holds": 100 * _fraction(inside),
        "half_width": 100 * float(np.median(widths)),
        "cases": len(errors),
    }


def _fraction(holds: Sequence[bool]) -> float:
    return sum(holds) / len(holds)
