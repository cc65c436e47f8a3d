"""Example files of `pfwd.example`, simulated by finite elements.

The true values are in ``pfwd/scripting/data/README.md`` and not in the headers of the files.
"""

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.output import parse_options
from pfwd.analysis.analyse import analyse_files
from pfwd.analysis.options import AnalysisOptions
from pfwd.export.export import export_survey
from pfwd.files.importing import import_files
from pfwd_device.recording import SurveyWriter, read_survey
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Recording, write_traces
from tests.campaigns.effects.channels import delayed

FOLDER = Path(__file__).resolve().parents[1] / "pfwd" / "scripting" / "data"

PLATE = Plate(radius=0.15, mass=10.6)
HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=3.0)
"""Hammer with a pulse of 13 ms and a peak of about 7 kN, like a light deflectometer."""
POISSON_RATIO = 0.35
DENSITY = 1900.0
DURATION = 0.045
TIME_STEP = 2.5e-4
NOISE_OVER_PEAK = 0.002
"""Root mean square of the noise over the peak of each channel."""
RESOLUTION_OVER_PEAK = 2.0**-13
"""Resolution over the peak, that of a converter of 14 bits; it keeps the files small."""
SURVEY_TIME_STEP = 5e-4


@dataclass(frozen=True)
class Truth:
    """True properties of the ground under one test point, which the files do not declare."""

    modulus: float
    """Young's modulus, Pa."""
    viscosity: float
    """Viscosity, Pa s."""
    bedrock_depth: float = math.inf
    """Depth of the rock, m."""

    @property
    def ground(self) -> SoilProfile:
        """Ground of the finite elements."""
        return SoilProfile.uniform(
            self.modulus, self.viscosity, DENSITY, POISSON_RATIO, self.bedrock_depth
        )


HALF_SPACE = Truth(60e6, 50e3)
LAYER = Truth(45e6, 54e3, 0.9)
THREE_SENSORS = Truth(80e6, 60e3, 1.4)
UNEXPLAINED = Truth(50e6, 50e3)
LAG_S = 5e-4
"""Lag of the sensor in the example file `unexplained`, s."""
SURVEY = {
    "km 0+000": Truth(62e6, 55e3),
    "km 0+025": Truth(48e6, 50e3),
    "km 0+050": Truth(31e6, 40e3),
    "km 0+075": Truth(55e6, 52e3),
}


def run(arguments: list[str]) -> int:
    """Make all files in ``--output FOLDER`` (default pfwd/scripting/data)."""
    options, report = parse_options(
        "example_files", __doc__, arguments, output=(FOLDER, "folder of the files")
    )
    options.output.mkdir(parents=True, exist_ok=True)
    for name, make in TRACES.items():
        path = options.output / f"{name}.csv"
        make(path)
        report.record(file=path.name, bytes=path.stat().st_size)
    path = options.output / "survey.pfwdz"
    make_survey(path)
    report.record(file=path.name, bytes=path.stat().st_size)
    return 0


def half_space(path: Path) -> None:
    """Write one drop with the centre sensor on a declared half-space."""
    declared = {"bedrock_depth_m": math.inf}
    _write(path, [simulate(HALF_SPACE, (0.0,))], declared)


def layer(path: Path) -> None:
    """Write three drops from slightly different heights with the centre sensor on declared rock."""
    drop = simulate(LAYER, (0.0,))
    drops = [drop.scaled(factor) for factor in (1.0, 1.02, 0.99)]
    _write(path, drops, {"bedrock_depth_m": LAYER.bedrock_depth})


def three_sensors(path: Path) -> None:
    """Write one drop with sensors at 0, 0.3 and 0.6 m on undeclared rock."""
    _write(path, [simulate(THREE_SENSORS, (0.0, 0.3, 0.6))], {})


def unexplained(path: Path) -> None:
    """Write one drop with an undeclared lag of the sensor."""
    drop = simulate(UNEXPLAINED, (0.0,))
    samples = LAG_S / TIME_STEP
    late = replace(
        drop,
        ground_displacement=delayed(drop.ground_displacement, samples),
        ground_velocity=delayed(drop.ground_velocity, samples),
    )
    _write(path, [late], {"bedrock_depth_m": math.inf})


TRACES: Mapping[str, Callable[[Path], None]] = {
    "half-space": half_space,
    "layer": layer,
    "three-sensors": three_sensors,
    "unexplained": unexplained,
}


def make_survey(path: Path) -> None:
    """Write a survey of four points with a seating and a measured drop, positions and results."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = []
        for index, (point, truth) in enumerate(SURVEY.items()):
            drop = simulate(truth, (0.0,), SURVEY_TIME_STEP)
            declared: dict[str, str | float | int] = {
                "bedrock_depth_m": math.inf,
                "seating_drops": 1,
                "device": "simulated",
                "calibrated": "2026-01-05",
                "site": "example road",
                "point": point,
                "latitude": 52.0 + 2.25e-4 * index,
                "longitude": 5.0,
                "time_utc": f"2026-05-04T09:{10 * index:02d}:00+00:00",
            }
            drops = [drop.scaled(factor) for factor in (0.97, 1.0)]
            file = folder / f"{index}.csv"
            _write(file, drops, declared, seed=index + 1)
            files.append(str(file))
        for imported in import_files(files, folder / "survey"):
            if imported.error is not None:
                raise RuntimeError(imported.error)
        _store_results(folder / "survey")
        export_survey(folder / "survey", "survey", path, force=True)


def simulate(
    truth: Truth, offsets: tuple[float, ...], time_step: float = TIME_STEP
) -> SimulatedDrop:
    """Return one drop of the hammer on the ground of a point, by finite elements."""
    return simulate_drop(truth.ground, PLATE, HAMMER, offsets, DURATION, time_step)


def _write(
    path: Path,
    drops: list[SimulatedDrop],
    declared: Mapping[str, str | float | int],
    seed: int = 0,
) -> None:
    load = float(np.max(drops[0].load))
    velocity = float(np.max(np.abs(drops[0].ground_velocity)))
    recording = Recording(
        load_noise=NOISE_OVER_PEAK * load,
        sensor_noise=NOISE_OVER_PEAK * velocity,
        load_resolution=RESOLUTION_OVER_PEAK * load,
        sensor_resolution=RESOLUTION_OVER_PEAK * velocity,
    )
    header = {"source": "simulated by finite elements", **declared}
    write_traces(path, drops, PLATE, POISSON_RATIO, recording, seed, header)


def _store_results(survey: Path) -> None:
    (outcome,) = analyse_files([str(survey)], AnalysisOptions())
    if outcome.error is not None:
        raise RuntimeError(outcome.error)
    numbers = {(drop.point, drop.drop): drop.number for drop in read_survey(survey).drops}
    with SurveyWriter.open(survey) as writer:
        for result in outcome.results:
            number = numbers[str(result.point), result.drop]
            writer.save_result(number, {**result.to_stored(), "file": "survey"})
