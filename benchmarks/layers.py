"""Layered ground: accuracy of the fast computation, and its cost with and without derivatives.

Times are the smallest processor time of many repetitions with one thread in the linear algebra,
which depends least on other programs. With ``--inverted`` finite-element drops on random grounds
with noise are inverted as by ``pfwd invert --layers``, which uses only the traces.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.output import Reporter, parse_options
from inversion import (
    Grounds,
    Instrument,
    PlateProblem,
    Record,
    Settings,
    SurrogateLibrary,
    invert,
    plate_compliance,
)
from inversion.forward.contact import PLATE_MODELS, QuadratureRule
from inversion.forward.laplace import DampedTransform
from inversion.forward.layered import (
    CONVERGED,
    FAST,
    LayeredForwardModel,
    LayeredGround,
    LayeredGrounds,
    Medium,
    PlateSetup,
    displacement_per_force,
    displacement_slopes,
)
from inversion.forward.layered.quadrature import NodeLayout, nodes
from inversion.forward.model import transfer_function
from inversion.measured.record import CALIBRATED_ERROR, Sensor
from inversion.records import known
from inversion.result import InversionResult
from inversion.threads import single_threaded_blas
from pfwd.jobs import Jobs
from pfwd_plugins.quantities import Measurand
from simulators.drop import Hammer, simulate_drop
from simulators.mesh import Plate, SoilLayer, SoilProfile

Array = NDArray[Any]

_RADIUS = 0.15
# Nine sensors of a trailer, four of a portable device, m.
_TRAILER = (0.0, 0.203, 0.305, 0.457, 0.610, 0.914, 1.219, 1.524, 1.829)
_PORTABLE = (0.0, 0.3, 0.6, 0.9)
# Transform with 41 frequencies: a record of 60 ms up to 533 Hz.
_TRANSFORM = DampedTransform(0.06, 533.0)
_TIME = np.linspace(0.0, 0.06, 241)[1:]


def run(arguments: list[str]) -> int:
    """Print errors and times; return 0."""
    options, report = parse_options(
        "layers",
        __doc__,
        arguments,
        short=(False, "fewer grounds, no finite elements"),
        inverted=(False, "invert drops with a known truth, nothing else"),
        cases=(60, "drops that are inverted"),
        seed=(1, "of their grounds"),
        jobs=(1, "processes for them"),
    )
    if options.inverted:
        _inversion_speed(report)
        _inverted_finite_elements(report, options.cases, options.seed, options.jobs)
        return 0
    with single_threaded_blas():
        _speed(report)
        _homogeneous(report)
        _accuracy(report, 12 if options.short else 60)
        if not options.short:
            _finite_elements(report)
    return 0


def _speed(report: Reporter) -> None:
    frequencies = _TRANSFORM.s.size
    report.title(f"one solve, {frequencies} frequencies, nine sensors, one core (ms)")
    for plate in ("rigid-rough", "rigid-smooth", "averaged", "uniform"):
        for media in (1, 2, 3, 4):
            _speed_of(report, plate, media)
    batch = LayeredGrounds.of([_pavement(3)] * 16)
    setup = PlateSetup("rigid-rough", _RADIUS, _TRAILER)
    each = _milliseconds(lambda: displacement_per_force(setup, batch, _TRANSFORM.s, FAST)) / 16
    report.record(what="16 grounds in one call, three media, rigid-rough", ms_each=each)
    surrogate = SurrogateLibrary().get(PlateProblem("rigid-rough", 0.35), None)
    grounds = Grounds(*(np.array([v]) for v in (6e7, 5e4, 2000.0, 0.5)))
    instrument = Instrument(_RADIUS)
    single = _milliseconds(lambda: transfer_function(surrogate, instrument, _TRANSFORM.s, grounds))
    report.record(what="surrogate of homogeneous ground, one sensor, one ground", ms=single)
    eighty_grounds = Grounds(*(np.full(80, v) for v in (6e7, 5e4, 2000.0, 0.5)))
    eighty = _milliseconds(
        lambda: transfer_function(surrogate, instrument, _TRANSFORM.s, eighty_grounds, single=True)
    )
    report.record(what="surrogate, one of 80 grounds in one call", ms=eighty / 80)


def _speed_of(report: Reporter, plate: Any, media: int) -> None:
    ground = LayeredGrounds.of([_pavement(media)])
    setup = PlateSetup(plate, _RADIUS, _TRAILER)
    s = _TRANSFORM.s
    parameters = ground.parameters
    fixed_ratio = [p for p in parameters if p.field != "poisson_ratio"]
    solve = _milliseconds(lambda: displacement_per_force(setup, ground, s, FAST))
    some = _milliseconds(lambda: displacement_slopes(setup, ground, s, fixed_ratio, FAST))
    every = _milliseconds(lambda: displacement_slopes(setup, ground, s, parameters, FAST))
    report.record(
        plate=plate,
        media=media,
        nodes=_nodes(setup, ground),
        solve_ms=solve,
        with_slopes_ms=some,
        parameters=len(fixed_ratio),
        solves=some / solve,
        with_poisson_ratios_ms=every,
        all_parameters=len(parameters),
    )


def _nodes(setup: PlateSetup, ground: LayeredGrounds) -> int:
    media = ground.at(_TRANSFORM.s, setup.radius)
    return int(nodes(NodeLayout.of(FAST, media, ground.rock, setup.farthest))[0].size)


def _pavement(media: int) -> LayeredGround:
    """Return asphalt, base, subbase and subgrade, or the first and the last of them."""
    above = (
        Medium(4e9, 4e6, 2350.0, 0.35, 0.15),
        Medium(4e8, 3e5, 2100.0, 0.35, 0.30),
        Medium(2e8, 1.5e5, 2000.0, 0.35, 0.40),
    )
    return LayeredGround((*above[: media - 1], Medium(1e8, 1e5, 1900.0, 0.4)))


def _milliseconds(action: Callable[[], Any], repeats: int = 20) -> float:
    """Return the smallest processor time of one call, ms, over ``repeats`` calls or a second."""
    action()
    shortest, start, count = math.inf, time.perf_counter(), 0
    while count < repeats or time.perf_counter() - start < 1.0:
        before = time.process_time_ns()
        action()
        shortest = min(shortest, time.process_time_ns() - before)
        count += 1
    return shortest * 1e-6


def _homogeneous(report: Reporter) -> None:
    report.title("one medium against the converged rule of homogeneous ground (largest over peak)")
    s = _TRANSFORM.s
    for plate in PLATE_MODELS:
        worst = 0.0
        for nu in (0.25, 0.35, 0.45, 0.49):
            for modulus, viscosity, depth in (
                (4e7, 0.0, 0.5),
                (4e7, 5e4, 2.0),
                (2e7, 0.0, math.inf),
            ):
                ground = LayeredGround(
                    (Medium(modulus, viscosity, 2000.0, nu, depth),), math.isfinite(depth)
                )
                transfer = displacement_per_force(
                    PlateSetup(plate, _RADIUS, _PORTABLE), LayeredGrounds.of([ground]), s
                )[0]
                shear = (modulus + viscosity * s) / (2 + 2 * nu)
                problem = PlateProblem(plate, nu, tuple(r / _RADIUS for r in _PORTABLE))
                z = 2000.0 * _RADIUS**2 * s**2 / shear
                rule = QuadratureRule.for_poisson_ratio(nu, refine=2)
                phi = plate_compliance(problem, z, np.full(z.size, depth / _RADIUS), rule).T
                expected = _histories(phi / (shear * _RADIUS), 0.015)
                worst = max(worst, _error(_histories(transfer, 0.015), expected))
        report.record(plate=plate, cases=12, worst=worst)


def _accuracy(report: Reporter, cases: int) -> None:
    report.title(
        "the fast rule against the converged one: largest difference over each sensor's peak "
        "(that of a far sensor counts at least a tenth of the plate's)"
    )
    for plate in ("rigid-rough", "rigid-smooth", "uniform"):
        for name, offsets, pulse in (("trailer", _TRAILER, 0.025), ("portable", _PORTABLE, 0.015)):
            for damped in (True, False):
                rng = np.random.default_rng(11)
                setup = PlateSetup(plate, _RADIUS, offsets)
                errors, counts = [], []
                for number in range(cases):
                    ground = LayeredGrounds.of([_drawn(rng, number % 2 == 0, damped)])
                    fast, exact = (
                        _histories(
                            displacement_per_force(setup, ground, _TRANSFORM.s, rule)[0], pulse
                        )
                        for rule in (FAST, CONVERGED)
                    )
                    errors.append(_error(fast, exact))
                    counts.append(_nodes(setup, ground))
                report.record(
                    plate=plate,
                    sensors=name,
                    ground="viscous" if damped else "elastic",
                    cases=cases,
                    median=float(np.median(errors)),
                    p90=float(np.quantile(errors, 0.9)),
                    worst=max(errors),
                    nodes=int(np.median(counts)),
                )


def _drawn(rng: np.random.Generator, firm: bool, damped: bool) -> LayeredGround:
    """Return a random ground of two to four media: a pavement (``firm``), or soft layers."""

    def between(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    count = int(rng.integers(2, 5))
    rock = bool(rng.uniform() < 0.5)
    media = []
    for j in range(count):
        if firm:
            low, high = ((1.5e9, 8e9), (1e8, 8e8), (5e7, 2.5e8), (5e7, 2.5e8))[j]
        else:
            low, high = 1e7, 3e8
        modulus = between(low, high)
        thickness = between(0.08, 0.5)
        if j == count - 1:
            thickness = between(0.3, 4.0) if rock else math.inf
        viscosity = modulus * between(2e-4, 2e-3) if damped else 0.0
        media.append(
            Medium(modulus, viscosity, rng.uniform(1600, 2400), rng.uniform(0.25, 0.45), thickness)
        )
    return LayeredGround(tuple(media), rock)


def _histories(transfer: Array, duration: float) -> Array:
    """Return the displacement under a half-sine of 1 N, (n_sensors, n_times), m."""
    s = _TRANSFORM.s
    pulse = np.pi * duration * (1 + np.exp(-s * duration)) / (s**2 * duration**2 + np.pi**2)
    result: Array = ((transfer * pulse) @ _TRANSFORM.synthesis(_TIME)).real
    return result


def _error(histories: Array, expected: Array) -> float:
    peak = np.max(np.abs(expected), axis=-1)
    peak = np.maximum(peak, 0.1 * np.max(peak))
    return float(np.max(np.max(np.abs(histories - expected), axis=-1) / peak))


_DROPS = {
    "crust on half-space": SoilProfile(
        (SoilLayer(2.2e8, 1.9e5, 2050, 0.35, 0.23), SoilLayer(5.9e7, 1e5, 2030, 0.35)), "none"
    ),
    "soft top on rock": SoilProfile(
        (SoilLayer(2.5e7, 2e4, 1900, 0.30, 0.3), SoilLayer(8e7, 8e4, 2050, 0.40, 1.2)), "rigid"
    ),
    "pavement": SoilProfile(
        (
            SoilLayer(2e9, 1e6, 2350, 0.35, 0.12),
            SoilLayer(3e8, 2e5, 2100, 0.35, 0.3),
            SoilLayer(8e7, 6e4, 1900, 0.40),
        ),
        "none",
    ),
}


def _finite_elements(report: Reporter) -> None:
    report.title("the simulators' finite elements, true parameters (% of each sensor's own peak)")
    for name, ground in _DROPS.items():
        for contact in ("rough", "smooth"):
            drop = simulate_drop(
                ground,
                Plate(_RADIUS, 12.0, contact),
                Hammer(10.0, 5.6e5, 3.0),
                _PORTABLE,
                duration=0.05,
                time_step=2e-4,
            )
            media = tuple(
                Medium(m.modulus, m.viscosity, m.density, m.poisson_ratio, m.thickness)
                for m in ground.layers
            )
            model = LayeredForwardModel(
                f"rigid-{contact}",  # type: ignore[arg-type]
                Instrument(_RADIUS, 12.0),
                _PORTABLE,
                drop.time,
                drop.load,
                drop.time[1:],
                1600.0,
            )
            layered = LayeredGrounds.of([LayeredGround(media, ground.base == "rigid")])
            expected = drop.ground_displacement[:, 1:]
            error = np.abs(model.displacement(layered)[0] - expected)
            percent = 100 * np.max(error, axis=1) / np.max(np.abs(expected), axis=1)
            values = {f"at_{r:g}_m": float(p) for r, p in zip(_PORTABLE, percent, strict=True)}
            report.record(ground=name, contact=contact, **values)


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


def record_of_case(case: LayeredCase, seed: int = 5) -> Record:
    """Return the record with noise, as input of the inversion."""
    drop = simulate_drop(
        SoilProfile(case.layers, "rigid" if case.rock else "none"),
        Plate(_RADIUS, _MASS, "rough"),
        Hammer(10.0, 5.6e5, 3.0),
        case.offsets,
        duration=0.06,
        time_step=_STEP,
    )
    rng = np.random.default_rng((seed, case.number))
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


def _solved(case: LayeredCase) -> tuple[LayeredCase, InversionResult, InversionResult, float]:
    record = record_of_case(case)
    start = time.process_time()
    every = invert(record, Settings(layers=len(case.layers)))
    spent = time.process_time() - start
    centre = invert(record, Settings(layers=len(case.layers), all_sensors=False))
    return case, every, centre, spent


def _inverted_finite_elements(report: Reporter, count: int, seed: int, jobs: int) -> None:
    """Report errors and intervals over random grounds of the simulators' finite elements."""
    report.title(
        f"{count} drops of the simulators' finite elements, four sensors, noise "
        f"{100 * _NOISE:g} %, true number of media (%)"
    )
    drawn = cases(count, seed)
    with Jobs.for_calls(jobs, count) as pool:
        solved = list(pool.map(_solved, drawn))
    for quantity, place in (("subgrade", -1), ("top", 0)):
        errors, inside, widths, alone = [], [], [], []
        for case, every, centre, _ in solved:
            truth, layer_result = case.moduli[place], known(every.layers)[place]
            errors.append(abs(known(layer_result.modulus_pa) / truth - 1.0))
            low, high = known(layer_result.modulus_interval_pa)
            inside.append(low <= truth <= high)
            widths.append(0.5 * math.log(high / low))
            low, high = known(known(centre.layers)[place].modulus_interval_pa)
            alone.append(low <= truth <= high)
        report.record(
            what=quantity, **_summary(errors, inside, widths), centre_alone=100 * _fraction(alone)
        )
    errors, inside, widths = [], [], []
    for case, every, _, _ in solved:
        for layer, layer_result in zip(case.layers[:-1], known(every.layers)[:-1], strict=True):
            errors.append(abs(known(layer_result.thickness_m) / layer.thickness - 1.0))
            low, high = known(layer_result.thickness_interval_m)
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


def _inversion_speed(report: Reporter) -> None:
    """Report the time of a layered inversion over that of homogeneous ground."""
    report.title("an inversion, as a ratio to that of homogeneous ground (processor time)")
    portable = replace(cases(3, 7)[2], offsets=(0.0, 0.3, 0.6, 0.9))
    trailer = replace(portable, offsets=(0.0, 0.2, 0.3, 0.45, 0.6, 0.9, 1.2, 1.5, 1.8))
    for name, case in (("4 sensors", portable), ("9 sensors", trailer)):
        record = record_of_case(case)
        plain = 1e-3 * _milliseconds(partial(invert, record, Settings()), 3)
        layered = 1e-3 * _milliseconds(partial(invert, record, Settings(layers=3)), 3)
        report.record(
            sensors=name, homogeneous_s=plain, three_media_s=layered, ratio=layered / plain
        )
