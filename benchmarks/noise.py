"""Test of the stated random uncertainty, with many noisy copies of one finite-element drop.

The drop is recorded without noise once and with noise many times. If the stated standard deviations
are right and errors are normal, 68 and 95 % of the copies are within one and two of their own
deviations from the modulus of the record without noise.
"""

import argparse
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from benchmarks.output import Reporter
from inversion import Instrument, Record, Sensor, Settings, SurrogateLibrary, invert
from inversion.arrays import FloatArray
from inversion.records import known
from inversion.threads import single_threaded_blas
from simulators.drop import DropSimulator, Hammer
from simulators.mesh import Ground, Plate

_PLATE = Plate(radius=0.15, mass=15.0)
_HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=4.2)
_DEPTH, _POISSON_RATIO = 1.2, 0.35
_OFFSETS = (0.0, 0.3, 0.6)
_DURATION, _TIME_STEP, _PRE_TRIGGER = 0.05, 2e-4, 0.02
_NOISE_OVER_PEAK = 0.005  # of load and sensors
_CORRELATION = 0.8  # between successive samples

Quantity = Literal["velocity", "displacement"]


@dataclass(frozen=True)
class NoiseCase:
    """Kind of noise, sensors and declaration for one row of the result."""

    noise: Literal["white", "correlated"]
    quantity: Quantity
    sensors: int
    depth_declared: bool

    @property
    def name(self) -> str:
        """Name in the report."""
        depth = "known" if self.depth_declared else "unknown"
        return f"{self.noise}, {self.quantity}, {self.sensors} sensor(s), depth {depth}"


SETUPS = (
    NoiseCase("white", "velocity", 1, True),
    NoiseCase("correlated", "velocity", 1, True),
    NoiseCase("white", "displacement", 1, True),
    NoiseCase("correlated", "displacement", 1, True),
    NoiseCase("white", "velocity", 3, False),
)


def clean_record(quantity: Quantity) -> Record:
    """Return the record of all sensors without noise, of velocity or displacement."""
    ground = Ground.uniform(45e6, 54e3, 1900.0, _POISSON_RATIO, _DEPTH)
    simulator = DropSimulator(
        ground, _PLATE, _OFFSETS, _DURATION, _TIME_STEP, _HAMMER.pulse_duration
    )
    drop = simulator.run(_HAMMER)
    wait = round(_PRE_TRIGGER / _TIME_STEP)
    motion = drop.ground_velocity if quantity == "velocity" else drop.ground_displacement
    return Record(
        time=np.arange(-wait, drop.time.size) * _TIME_STEP,
        load=np.pad(drop.load, (wait, 0)),
        sensors=tuple(
            Sensor(offset, quantity, np.pad(values, (wait, 0)))
            for offset, values in zip(_OFFSETS, motion, strict=True)
        ),
        instrument=Instrument(_PLATE.radius, _PLATE.mass),
        poisson_ratio=_POISSON_RATIO,
        bedrock_depth=_DEPTH,
    )


def noise_of(
    rng: np.random.Generator, kind: Literal["white", "correlated"], count: int
) -> FloatArray:
    """Return noise (count,) of unit variance, white or autoregressive of first order."""
    white = rng.standard_normal(count)
    if kind == "white":
        return white
    result = np.empty(count)
    result[0] = white[0]
    for k in range(1, count):
        result[k] = _CORRELATION * result[k - 1] + math.sqrt(1 - _CORRELATION**2) * white[k]
    return result


def noisy(record: Record, kind: Literal["white", "correlated"], rng: np.random.Generator) -> Record:
    """Return a copy of a record with noise on the load and on every sensor."""
    count = record.time.size
    level = _NOISE_OVER_PEAK * float(np.max(np.abs(record.sensors[0].values)))
    return replace(
        record,
        load=record.load
        + _NOISE_OVER_PEAK * float(np.max(record.load)) * noise_of(rng, kind, count),
        sensors=tuple(
            replace(sensor, values=sensor.values + level * noise_of(rng, kind, count))
            for sensor in record.sensors
        ),
    )


def run(arguments: list[str]) -> int:
    """Print the fractions within one and two standard deviations; return the exit status 0."""
    parser = argparse.ArgumentParser(prog="pfwd bench noise", description=__doc__)
    parser.add_argument("--cases", type=int, default=200, help="noisy copies of the drop (200)")
    parser.add_argument("--seed", type=int, default=0, help="of the noise (0)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    report = Reporter(arguments)
    library = SurrogateLibrary()
    clean: dict[Quantity, Record] = {q: clean_record(q) for q in ("velocity", "displacement")}
    report.title(f"{options.cases} copies with noise of {100 * _NOISE_OVER_PEAK:g} % of the peak")
    with single_threaded_blas():
        for setup in SETUPS:
            record = clean[setup.quantity]
            record = replace(record, sensors=record.sensors[: setup.sensors])
            _report(report, setup, record, options.cases, options.seed, library)
    return 0


def _report(
    report: Reporter,
    setup: NoiseCase,
    record: Record,
    copies: int,
    seed: int,
    library: SurrogateLibrary,
) -> None:
    depth: float | Literal["unknown"] = _DEPTH if setup.depth_declared else "unknown"
    settings = Settings(method="posterior", bedrock_depth=depth)
    reference = known(invert(record, settings, library).modulus_pa)
    ratios, shifts, deviations = [], [], []
    for number in range(copies):
        rng = np.random.default_rng([seed, number])
        result = invert(noisy(record, setup.noise, rng), settings, library)
        modulus, deviation = known(result.modulus_pa), known(result.modulus_sd_pa)
        shifts.append(modulus / reference - 1.0)
        deviations.append(deviation / modulus)
        ratios.append((modulus - reference) / deviation)
    report.record(setup=setup.name, copies=copies, **_shares(ratios, shifts, deviations))


def _shares(
    ratios: Sequence[float], shifts: Sequence[float], deviations: Sequence[float]
) -> dict[str, float]:
    return {
        "within_1_sd": float(np.mean(np.abs(ratios) <= 1.0)),
        "within_2_sd": float(np.mean(np.abs(ratios) <= 2.0)),
        "stated_deviation": statistics.median(deviations),
        "actual_deviation": float(np.std(shifts)),
        "mean_shift": statistics.mean(shifts),
        "rms_of_ratio": float(np.sqrt(np.mean(np.square(ratios)))),
    }
