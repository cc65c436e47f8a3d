"""Figures of docs/closing-the-loop.md: finite-element drops, measured drops, blind campaign.

The part with measured drops needs a folder with files of real devices (``--measured``, see `pfwd
bench measured`); otherwise it is omitted.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import loop, measured
from benchmarks.output import Reporter
from inversion import Record, Sensor, Settings, SurrogateLibrary, invert
from inversion.forward.model import Instrument
from inversion.records import known
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Ground, Plate

RADIUS, MASS, POISSON = 0.15, 12.0, 0.35
# Modulus (Pa), viscosity (Pa s), density (kg/m3) and bedrock depth (m) of each ground, within the
# range of the tables in doi 10.11835/j.issn.2096-6717.2022.021.
GROUNDS = (
    (20e6, 40e3, 1800.0, 0.8),
    (30e6, 54e3, 1900.0, 1.2),
    (40e6, 54e3, 1900.0, 0.6),
    (45e6, 54e3, 2000.0, 2.0),
    (60e6, 80e3, 1900.0, 1.0),
    (90e6, 60e3, 2000.0, 1.5),
)
# Corrections of the model, one after the other: title, settings, and declared plate mass, kg.
STEPS = (
    (
        "the paper's model: half-sine, pressure of the static plate, force above the plate",
        Settings(plate="published", load="half-sine-equal-area", method="least-squares"),
        0.0,
    ),
    (
        "measured load instead of a half-sine",
        Settings(plate="published", method="least-squares"),
        0.0,
    ),
    (
        "plate between load cell and ground declared",
        Settings(plate="published", method="least-squares"),
        MASS,
    ),
    (
        "rigid smooth plate with its dynamic pressure",
        Settings(plate="rigid-smooth", method="least-squares"),
        MASS,
    ),
    ("rigid rough plate", Settings(plate="rigid-rough", method="least-squares"), MASS),
)


def run(arguments: list[str]) -> int:
    """Run all parts; return the exit status."""
    parser = argparse.ArgumentParser(prog="pfwd bench closing", description=__doc__)
    parser.add_argument("--measured", type=Path, metavar="FOLDER", help="measured drops")
    parser.add_argument("--jobs", default="2", help="processes (2)")
    parser.add_argument("--cache", help="of finite-element answers (the platform's)")
    parser.add_argument("--figures", metavar="FOLDER", help="draw the ladder there")
    parser.add_argument("--no-campaign", action="store_true", help="leave the blind campaign out")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    finite_elements(Reporter(arguments))
    common = ["--jobs", options.jobs, *(["--json"] if options.json else [])]
    status = 0
    if options.measured is not None:
        figures = ["--figures", options.figures] if options.figures else []
        status = measured.run([str(options.measured), *common, *figures])
    if not options.no_campaign:
        cache = ["--cache", options.cache] if options.cache else []
        status = max(status, loop.run(["--seed", "55", "--cases", "2", *common, *cache]))
    return status


def finite_elements(report: Reporter) -> None:
    """Report the error of the modulus of finite-element drops after each correction."""
    report.title("finite-element drops, depth declared: error of the modulus in %")
    library, records = SurrogateLibrary(), [_drop(*ground) for ground in GROUNDS]
    for title, settings, mass in STEPS:
        errors = []
        for record, (modulus, *_) in zip(records, GROUNDS, strict=True):
            declared = replace(record, instrument=replace(record.instrument, plate_mass=mass))
            result = invert(declared, settings, library)
            errors.append(100 * (known(result.modulus_pa) / modulus - 1))
        report.record(
            model=title,
            mean=float(np.mean(errors)),
            lowest=float(min(errors)),
            highest=float(max(errors)),
        )


def _drop(modulus: float, viscosity: float, density: float, depth: float) -> Record:
    ground = Ground.uniform(modulus, viscosity, density, POISSON, depth)
    hammer = Hammer(mass=10.0, stiffness=4e5, velocity=3.5)
    drop = simulate_drop(ground, Plate(RADIUS, MASS), hammer, duration=0.05, time_step=1e-4)
    quiet = 150
    time = 1e-4 * np.arange(-quiet, drop.time.size)
    rng = np.random.default_rng(1)
    moved = np.concatenate([np.zeros(quiet), drop.plate_displacement])
    moved += 1e-3 * moved.max() * rng.standard_normal(moved.size)
    return Record(
        time,
        np.concatenate([np.zeros(quiet), drop.load]),
        (Sensor(0.0, "displacement", moved),),
        Instrument(plate_radius=RADIUS, plate_mass=MASS),
        poisson_ratio=POISSON,
        bedrock_depth=depth,
    )
