"""Coverage of the stated 95 % intervals, on finite-element drops over the full range of parameters.

Every drop is simulated by axisymmetric finite elements, which share nothing with the forward model,
written with noise as a trace file without the true values, read again and inverted by least
squares. The same drops without noise, at their true parameters, give the error of the forward
model, which sets the error floor of the inversion.
"""

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from benchmarks.output import Reporter, parse_options
from inversion import (
    Grounds,
    Instrument,
    InversionError,
    PlateProblem,
    Record,
    Settings,
    SurrogateLibrary,
    invert,
)
from inversion.forward.laplace import FULL_BAND_HZ
from inversion.forward.model import ForwardModel
from inversion.measured.record import CONTACT_END_FRACTION
from inversion.threads import single_threaded_blas
from pfwd.analysis.analyse import record_of
from pfwd.files.traces import read_traces
from pfwd.jobs import Jobs
from pfwd_plugins.quantities import MotionName
from simulators.drop import Hammer, SimulatedDrop, simulate_drop
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Recording, write_traces

Group = Literal["depth declared", "depth unknown", "three sensors"]
GROUPS: tuple[Group, ...] = ("depth declared", "depth unknown", "three sensors")

TIME_STEP = 2e-4
_HAMMER_SPEED_M_S = 4.0  # m/s, of the hammer
_MAX_DEFLECTION_M = 0.020  # limit of a geophone's stroke and of small strains
# Sensors in plate radii; one layout per Poisson's ratio limits the number of surrogates.
_OFFSET_RATIOS = {
    0.1: (0.0, 3.0, 6.0),
    0.25: (0.0, 2.0, 4.0),
    0.35: (0.0, 2.0, 4.0),
    0.45: (0.0, 2.0, 4.0),
    0.49: (0.0, 3.0, 6.0),
}
TARGET_COVERAGE, TARGET_HALF_WIDTH = 0.95, 0.03


@dataclass(frozen=True)
class CoverageCase:
    """True values of one simulated drop and of its recording, SI units."""

    number: int
    group: Group
    modulus: float
    viscosity: float
    density: float
    depth: float
    poisson_ratio: float
    radius: float
    plate_mass: float
    pulse: float
    pressure: float
    quantity: MotionName
    noise: float
    pre_trigger: float

    @property
    def ground(self) -> SoilProfile:
        """Simulated ground."""
        return SoilProfile.uniform(
            self.modulus, self.viscosity, self.density, self.poisson_ratio, self.depth
        )

    @property
    def plate(self) -> Plate:
        """Plate, bonded to the ground."""
        return Plate(self.radius, self.plate_mass)

    @property
    def hammer(self) -> Hammer:
        """Hammer that has this pulse duration and mean pressure on rigid ground."""
        mass = self.pressure * self.radius**2 * self.pulse / _HAMMER_SPEED_M_S
        return Hammer(mass, mass * (math.pi / self.pulse) ** 2, _HAMMER_SPEED_M_S)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Distances of the sensors, m."""
        return tuple(ratio * self.radius for ratio in self._ratios)

    @property
    def problem(self) -> PlateProblem:
        """Plate problem of the response table for the inversion."""
        return PlateProblem("rigid-rough", self.poisson_ratio, self._ratios)

    @property
    def _ratios(self) -> tuple[float, ...]:
        return _OFFSET_RATIOS[self.poisson_ratio] if self.group == "three sensors" else (0.0,)


@dataclass(frozen=True)
class ModelDifference:
    """Error of the forward model at the true parameters, without noise, over the sensor's peak."""

    plate_rms: float
    """Root mean square error of the plate up to the end of the contact."""
    plate_largest: float
    """Largest error of the plate over the full record."""
    far_rms: float | None
    """Root mean square error of the worst sensor on the ground up to the end of the contact; None:
    no sensor."""
    far_largest: float | None
    """Largest error of the sensors on the ground over the full record; None: no sensor."""


@dataclass(frozen=True)
class CoverageResult:
    """Result of the inversion of one case; SI units, relative errors as fractions."""

    case: CoverageCase
    modulus: float
    low: float
    high: float
    depth: float
    explained: bool
    at_bound: tuple[str, ...]
    depth_not_unique: bool
    window_residual: float
    model_error: ModelDifference
    fault: str = ""

    @property
    def error(self) -> float:
        """Relative error of the modulus."""
        return self.modulus / self.case.modulus - 1.0

    @property
    def half_width(self) -> float:
        """Half-width of the 95 % interval over the fitted modulus."""
        return (self.high - self.low) / (2.0 * self.modulus)

    @property
    def covered(self) -> bool:
        """True if the interval contains the true modulus."""
        return self.low <= self.case.modulus <= self.high


def draw_case(number: int, seed: int = 0) -> CoverageCase:
    """Return a case with random values; the groups alternate with the number."""
    rng = np.random.default_rng([seed, number])
    while True:
        radius = round(float(rng.uniform(0.1, 0.3)), 2)
        size = (radius**2 - 0.1**2) / (0.3**2 - 0.1**2)
        case = CoverageCase(
            number=number,
            group=GROUPS[number % len(GROUPS)],
            modulus=math.exp(rng.uniform(math.log(5e6), math.log(1e9))),
            viscosity=float(rng.uniform(0.0, 300e3)),
            density=float(rng.uniform(1200.0, 2600.0)),
            depth=radius * math.exp(rng.uniform(math.log(2.0), math.log(60.0))),
            poisson_ratio=float(rng.choice(list(_OFFSET_RATIOS))),
            radius=radius,
            plate_mass=round(float(np.clip((5 + 35 * size) * rng.uniform(0.8, 1.2), 5, 40)), 1),
            pulse=float(rng.uniform(8e-3, 30e-3)),
            pressure=float(rng.uniform(50e3, 150e3)),
            quantity="velocity" if rng.uniform() < 0.5 else "displacement",
            noise=float(rng.uniform(0.001, 0.003)),
            pre_trigger=float(rng.uniform(0.010, 0.020)),
        )
        if rng.uniform() < 0.1:
            case = replace(case, depth=math.inf)
        static = math.pi / 2 * (1 - case.poisson_ratio**2) * case.pressure * radius / case.modulus
        if static < _MAX_DEFLECTION_M:
            return case


def simulate(case: CoverageCase) -> SimulatedDrop:
    """Simulate the drop of a case by finite elements, without noise."""
    duration = max(0.03, round(2.5 * case.hammer.pulse_duration, 3))
    return simulate_drop(case.ground, case.plate, case.hammer, case.offsets, duration, TIME_STEP)


def recorded(case: CoverageCase, drop: SimulatedDrop) -> Record:
    """Return the drop with noise, as read from a trace file that does not state the true values."""
    motion = drop.ground_velocity if case.quantity == "velocity" else drop.ground_displacement
    recording = Recording(
        quantity=case.quantity,
        pre_trigger=case.pre_trigger,
        load_noise=case.noise * float(np.max(drop.load)),
        sensor_noise=case.noise * float(np.max(np.abs(motion[0]))),
    )
    declared: dict[str, float | str] = {"calibrated": "2026-01-05"}
    if case.group == "depth declared":
        declared["bedrock_depth_m"] = case.depth
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drop.csv"
        write_traces(path, [drop], case.plate, case.poisson_ratio, recording, case.number, declared)
        point = read_traces(path)
    return record_of(point.drops[0], point.setup)


def model_error(
    case: CoverageCase, drop: SimulatedDrop, library: SurrogateLibrary
) -> ModelDifference:
    """Return the error of the forward model at the true parameters."""
    model = ForwardModel(
        library.get(case.problem, case.depth / case.radius),
        Instrument(case.radius, case.plate_mass),
        drop.time,
        drop.load,
        drop.time[1:],
        FULL_BAND_HZ,
    )
    truth = (case.modulus, case.viscosity, case.density, 1.0 / case.depth)
    predicted = model.displacement(Grounds(*(np.array([value]) for value in truth)))[0]
    peaks = np.max(np.abs(drop.ground_displacement), axis=1)
    # The weights of the inversion: a distant sensor with little motion counts less.
    weights = np.hypot(peaks, 0.1 * peaks[0])[:, None]
    residual = (predicted - drop.ground_displacement[:, 1:]) / weights
    loaded = np.flatnonzero(drop.load > CONTACT_END_FRACTION * np.max(drop.load))
    rms = np.sqrt(np.mean(residual[:, : int(loaded[-1]) + 1] ** 2, axis=1))
    largest = np.max(np.abs(residual), axis=1)
    far = (None, None) if rms.size == 1 else (float(np.max(v[1:])) for v in (rms, largest))
    return ModelDifference(float(rms[0]), float(largest[0]), *far)


def analyse(case: CoverageCase, drop: SimulatedDrop, library: SurrogateLibrary) -> CoverageResult:
    """Write, read and invert a drop, and compare the result with the true values."""
    error = model_error(case, drop, library)
    try:
        result = invert(recorded(case, drop), Settings(method="posterior"), library)
    except InversionError as err:
        nan = math.nan
        return CoverageResult(case, nan, nan, nan, nan, False, (), False, nan, error, str(err))
    low, high = result.modulus_interval_pa or (math.nan, math.nan)
    depth, warnings = result.bedrock_depth_m, result.warnings
    return CoverageResult(
        case=case,
        modulus=result.modulus_pa or math.nan,
        low=low,
        high=high,
        depth=math.inf if depth is None else depth,
        explained=bool(result.explained),
        at_bound=result.at_bound or (),
        depth_not_unique=any(warning.code == "depth-not-unique" for warning in warnings),
        window_residual=result.window_residual_rms_over_peak or math.nan,
        model_error=error,
    )


def simulate_and_analyse(case: CoverageCase) -> CoverageResult:
    """Simulate and invert one case, in a worker process."""
    with single_threaded_blas():
        return analyse(case, simulate(case), SurrogateLibrary())


def _build(problem: PlateProblem) -> None:
    with single_threaded_blas():
        SurrogateLibrary().get(problem, None)


def run(arguments: list[str]) -> int:
    """Print coverage, widths and errors; return the exit status: 0, or 1 if a target is missed."""
    options, report = parse_options(
        "coverage",
        __doc__,
        arguments,
        cases=(100, "number of drops"),
        jobs=(2, "processes"),
        seed=(0, "of everything random"),
    )
    cases = [draw_case(number, options.seed) for number in range(options.cases)]
    with Jobs(options.jobs) as pool:
        # Built first, so that the workers read them from the cache.
        list(pool.map(_build, list(dict.fromkeys(case.problem for case in cases))))
        outcomes = list(pool.map(simulate_and_analyse, cases))
    return summarise(report, outcomes)


def summarise(report: Reporter, outcomes: Sequence[CoverageResult]) -> int:
    """Print the tables of a campaign; return the exit status: 0, or 1 if a target is missed."""
    report.title(f"{len(outcomes)} finite-element drops, least squares, 95 % intervals")
    for group in GROUPS:
        _summary(report, group, [o for o in outcomes if o.case.group == group])
    met = _summary(report, "all", outcomes)
    report.title("forward model at the truth against finite elements (over the peak)")
    for name in ModelDifference.__dataclass_fields__:
        errors = [getattr(o.model_error, name) for o in outcomes]
        values = [value for value in errors if value is not None]
        if values:
            report.record(model_error=name, drops=len(values), **_quantiles(values))
    report.title("truth outside of the interval")
    for outcome in outcomes:
        if not outcome.covered:
            report.record(**_failure(outcome))
    return 0 if met else 1


def _summary(report: Reporter, group: str, outcomes: Sequence[CoverageResult]) -> bool:
    sound = [o for o in outcomes if not o.fault]
    if not sound:
        return not outcomes
    covered = sum(o.covered for o in outcomes) / len(outcomes)
    width = statistics.median(o.half_width for o in sound)
    errors = [abs(o.error) for o in sound]
    report.record(
        group=group,
        drops=len(outcomes),
        covered=covered,
        median_half_width=width,
        median_error=float(np.median(errors)),
        error_90=float(np.quantile(errors, 0.9)),
        worst_error=max(errors),
        mean_error=statistics.mean(o.error for o in sound),
        explained=sum(o.explained for o in outcomes),
        depth_not_unique=sum(o.depth_not_unique for o in outcomes),
        faults=len(outcomes) - len(sound),
    )
    return covered >= TARGET_COVERAGE and width <= TARGET_HALF_WIDTH


def _quantiles(values: Iterable[float]) -> dict[str, float]:
    data = np.array(list(values))
    return {
        "median": float(np.median(data)),
        "at_90": float(np.quantile(data, 0.9)),
        "at_95": float(np.quantile(data, 0.95)),
        "largest": float(np.max(data)),
    }


def _failure(outcome: CoverageResult) -> dict[str, object]:
    values = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in asdict(outcome.case).items()
    }
    return {
        "failure": values.pop("number"),
        "error": outcome.error,
        "half_width": outcome.half_width,
        "found_depth": outcome.depth if math.isfinite(outcome.depth) else None,
        "explained": outcome.explained,
        "residual": outcome.window_residual,
        "model_error": outcome.model_error.plate_rms,
        "at_bound": list(outcome.at_bound),
        "fault": outcome.fault,
    } | values
