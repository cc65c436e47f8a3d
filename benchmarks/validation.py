"""The 48 cases of the published study, simulated by finite elements and inverted by both methods.

The study is doi 10.11835/j.issn.2096-6717.2022.021. Both its method and that of this project are
used. Ground, hammer and plate are those of the study. Its errors are reported too if its
transcribed tables are available. A ladder of variants, each with one change, shows the parts of the
systematic error of the published method.
"""

import csv
import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.output import Reporter, parse_options
from inversion import (
    InversionResult,
    PlateProblem,
    Record,
    Settings,
    SurrogateLibrary,
    invert,
)
from inversion.threads import single_threaded_blas
from pfwd.analysis.analyse import record_of, settings_of
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.traces import read_traces
from pfwd.jobs import Jobs
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Recording, write_traces

MODULI = (30e6, 40e6, 50e6, 60e6)
VISCOSITIES = (0.0, 54e3, 134e3)
DEPTHS = (0.5, 1.0, 2.0, 3.0)
POISSON_RATIO = 0.35
# The study does not state the mass of its plate.  Its Table 1 (837.6 um and a mean pressure of
# 146.5 kPa on 30 MPa, 54 kPa s, 1 m) implies 25 to 35 kg.
PLATE = Plate(radius=0.15, mass=30.0)
HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=4.2)
_DURATION, _TIME_STEP = 0.04, 2.5e-4
_TABLES = Path(__file__).resolve().parents[2] / "shared" / "seed"

PUBLISHED, HALF_SPACE, ELASTIC = "published", "published, half-space", "published, elastic"
PEAK, DEPTH_DECLARED, DEPTH_UNKNOWN = (
    "peak values",
    "default, depth known",
    "default, depth unknown",
)
# The published method uses the reading of the load cell as the force on the ground. Variants with
# this suffix use the true force on the ground, as the study may have done with its finite elements.
ON_CONTACT = ", contact force"
_PUBLISHED_OPTIONS: dict[str, dict[str, Any]] = {
    PUBLISHED: {},
    HALF_SPACE: {"bedrock_depth": "none"},
    ELASTIC: {"elastic": True},
}
METHODS = (
    *_PUBLISHED_OPTIONS,
    *(name + ON_CONTACT for name in _PUBLISHED_OPTIONS),
    PEAK,
    DEPTH_DECLARED,
    DEPTH_UNKNOWN,
)
# Each step differs from the one before in one respect; from the second on least squares is used.
LADDER = (
    "1 published (genetic search on its own fitness)",
    "2 least squares on the same model and data",
    "3 load as recorded instead of the half-sine",
    "4 contact force as load (plate mass accounted for)",
    "5 deflection averaged over the contact instead of r = 0",
    "6 bonded rigid plate: this project, depth given",
)
# Columns of the study's tables with its error in per cent.
_PRINTED = {
    PUBLISHED: (3, "bedrock_model_error_pct"),
    HALF_SPACE: (3, "half_space_error_pct"),
    ELASTIC: (5, "elastic_error_pct"),
    PEAK: (4, "peak_method_error_pct"),
}


@dataclass(frozen=True)
class StudyCase:
    """Ground of the study: modulus (Pa), viscosity (Pa s), depth of rock (m)."""

    modulus: float
    viscosity: float
    depth: float

    @property
    def key(self) -> tuple[float, float, float]:
        """Key of the case in the study's tables: viscosity (kPa s), depth (m), modulus (MPa)."""
        return self.viscosity / 1e3, self.depth, self.modulus / 1e6


@dataclass(frozen=True)
class Finding:
    """Relative error of the modulus by one method, and whether its interval is right."""

    error: float
    covered: bool | None


@dataclass(frozen=True)
class CaseReport:
    """Results of all methods for one case."""

    case: StudyCase
    peak_deflection: float
    peak_contact_pressure: float
    methods: dict[str, Finding]
    ladder: dict[str, Finding]


def simulate(case: StudyCase) -> SimulatedDrop:
    """Return the finite-element drop of a case, with a bonded plate.

    The ground is a Kelvin-Voigt solid in shear and volume.
    """
    ground = SoilProfile.uniform(
        case.modulus, case.viscosity, poisson_ratio=POISSON_RATIO, bedrock_depth=case.depth
    )
    return simulate_drop(ground, PLATE, HAMMER, (0.0,), _DURATION, _TIME_STEP)


def study(case: StudyCase) -> CaseReport:
    """Simulate one case and invert it by all methods."""
    with single_threaded_blas():
        return examine(case, simulate(case), SurrogateLibrary())


def examine(case: StudyCase, drop: SimulatedDrop, library: SurrogateLibrary) -> CaseReport:
    """Invert one simulated drop by all methods."""
    on_ground = replace(drop, load=drop.contact_force)
    results = {}
    for name in _PUBLISHED_OPTIONS:
        results[name] = _published(case, drop, library, name)
        results[name + ON_CONTACT] = _published(case, on_ground, library, name)
    unknown = AnalysisOptions(bedrock_depth="unknown")
    declared_depth = _invert(drop, library, AnalysisOptions(), case.depth)
    results[DEPTH_DECLARED] = declared_depth
    results[DEPTH_UNKNOWN] = _invert(drop, library, unknown, case.depth)
    methods = {name: _finding(case, result) for name, result in results.items()}
    peak = declared_depth.peak_modulus_pa or math.nan
    methods[PEAK] = Finding(peak / case.modulus - 1.0, None)
    rungs = [results[PUBLISHED], *_steps(case, drop, library), declared_depth]
    area = math.pi * PLATE.radius**2
    return CaseReport(
        case,
        float(drop.plate_displacement.max()),
        float(drop.contact_force.max()) / area,
        methods,
        {name: _finding(case, rung) for name, rung in zip(LADDER, rungs, strict=True)},
    )


def _published(
    case: StudyCase, drop: SimulatedDrop, library: SurrogateLibrary, name: str = PUBLISHED
) -> InversionResult:
    choices = {"bedrock_depth": case.depth, **_PUBLISHED_OPTIONS[name]}
    return _invert(drop, library, AnalysisOptions(published=True, **choices), None)


def _steps(
    case: StudyCase, drop: SimulatedDrop, library: SurrogateLibrary
) -> Iterable[InversionResult]:
    """Yield the results of steps two to five of the ladder."""
    options = AnalysisOptions(published=True, bedrock_depth=case.depth)
    record, settings = _through_file(drop, PLATE, options, None)
    settings = replace(settings, method="posterior")
    yield invert(record, settings, library)
    settings = replace(settings, load="measured")
    yield invert(record, settings, library)
    on_ground = replace(drop, load=drop.contact_force)
    record, _ = _through_file(on_ground, replace(PLATE, mass=0.0), options, None)
    yield invert(record, settings, library)
    yield invert(record, replace(settings, plate="averaged"), library)


def _invert(
    drop: SimulatedDrop,
    library: SurrogateLibrary,
    options: AnalysisOptions,
    declared_depth: float | None,
) -> InversionResult:
    record, settings = _through_file(drop, PLATE, options, declared_depth)
    return invert(record, settings, library)


def _through_file(
    drop: SimulatedDrop, plate: Plate, options: AnalysisOptions, declared_depth: float | None
) -> tuple[Record, Settings]:
    """Write a drop to a trace file and read it, as the command line does.

    Return record and settings.
    """
    declared = {} if declared_depth is None else {"bedrock_depth_m": declared_depth}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drop.csv"
        recording = Recording(quantity="displacement")
        write_traces(path, [drop], plate, POISSON_RATIO, recording, declared=declared)
        point = read_traces(path)
    record = record_of(point.drops[0], point.setup, options)
    return record, settings_of(options, point.setup)


def _finding(case: StudyCase, result: InversionResult) -> Finding:
    modulus = result.modulus_pa or math.nan
    low, high = result.modulus_interval_pa or (math.nan, math.nan)
    return Finding(modulus / case.modulus - 1.0, low <= case.modulus <= high)


def run(arguments: list[str]) -> int:
    """Print the errors of both methods and the ladder; return the exit status 0."""
    options, report = parse_options(
        "validation",
        __doc__,
        arguments,
        cases=(48, "number of cases, spread"),
        jobs=(2, "processes"),
        tables=(_TABLES, "folder of the study's tables as CSV"),
    )
    cases = [StudyCase(e, n, h) for n, h, e in product(VISCOSITIES, DEPTHS, MODULI)]
    cases = cases[:: max(1, len(cases) // options.cases)][: options.cases]
    _build_surrogates()
    with Jobs(options.jobs) as pool:
        reports = list(pool.map(study, cases))
    summarise(report, reports, printed_errors(options.tables))
    return 0


def _build_surrogates() -> None:
    """Build the surrogates, so that the workers read them from the cache."""
    library = SurrogateLibrary()
    with single_threaded_blas():
        for plate in ("published", "averaged", "rigid-rough"):
            library.get(PlateProblem(plate, POISSON_RATIO), None)


Printed = dict[str, dict[tuple[float, float, float], float]]


def printed_errors(folder: Path) -> Printed:
    """Return the study's errors, as fractions, by method and case.

    The result is empty without the tables of the study.
    """
    errors: Printed = {}
    for method, (number, column) in _PRINTED.items():
        path = folder / f"table{number}.csv"
        if path.is_file():
            with path.open(encoding="utf-8") as file:
                errors[method] = {
                    _key(row): float(row[column]) / 100 for row in csv.DictReader(file)
                }
    return errors


def _key(row: dict[str, str]) -> tuple[float, float, float]:
    return float(row["viscosity_kPa_s"]), float(row["bedrock_m"]), float(row["modulus_MPa"])


def summarise(report: Reporter, reports: Sequence[CaseReport], printed: Printed) -> None:
    """Print the errors of every case, then means by viscosity and depth, then the ladder."""
    report.title("error of the modulus by case, %")
    for case_report in reports:
        viscosity, depth, modulus = case_report.case.key
        errors = {name: 100 * case_report.methods[name].error for name in METHODS}
        report.record(
            viscosity_kpa_s=viscosity,
            depth_m=depth,
            modulus_mpa=modulus,
            peak_um=1e6 * case_report.peak_deflection,
            contact_kpa=case_report.peak_contact_pressure / 1e3,
            **errors,
        )
    by_viscosity, by_depth = defaultdict(list), defaultdict(list)
    for case_report in reports:
        by_viscosity[f"{case_report.case.viscosity / 1e3:g} kPa s"].append(case_report)
        by_depth[f"{case_report.case.depth:g} m"].append(case_report)
    report.title("mean error, %, ours and the study's")
    for name, part in {"all": reports, **by_viscosity, **by_depth}.items():
        for method in METHODS:
            report.record(cases=name, method=method, **_means(part, method, printed))
    report.title("what the published method's error is made of: mean error by rung, %")
    for rung in LADDER:
        percent = {
            name: [100 * case_report.ladder[rung].error for case_report in part]
            for name, part in {"all": reports, **by_viscosity}.items()
        }
        means = {name: statistics.mean(values) for name, values in percent.items()}
        report.record(rung=rung, **means, largest=max(map(abs, percent["all"])))


def _means(part: Sequence[CaseReport], method: str, printed: Printed) -> dict[str, Any]:
    findings = [case_report.methods[method] for case_report in part]
    values: dict[str, Any] = {
        "mean": 100 * statistics.mean(f.error for f in findings),
        "largest": 100 * max(abs(f.error) for f in findings),
    }
    covered = [f.covered for f in findings if f.covered is not None]
    if covered and method in (DEPTH_DECLARED, DEPTH_UNKNOWN):
        values["covered"] = sum(covered) / len(covered)
    table = printed.get(method.removesuffix(ON_CONTACT), {})
    theirs = [table[case_report.case.key] for case_report in part if case_report.case.key in table]
    if theirs:
        values |= {"printed_mean": 100 * statistics.mean(theirs), "printed_cases": len(theirs)}
    return values
