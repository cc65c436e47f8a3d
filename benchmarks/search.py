"""The genetic search on test functions: how often it finds the minimum, and what it costs.

Every run may spend 8,000 evaluations, sample, scouts and polish included.  The minimum lies at a
random place within four fifths of the box, another for every seed.  The time is that spent
outside the objective, per 80 evaluations: one generation.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution

from benchmarks.output import Reporter
from inversion.arrays import FloatArray
from inversion.search.multi_population import MultiPopulationSearch, SearchSettings, paper_settings
from inversion.threads import single_threaded_blas

_GENERATION = 80
_GENERATIONS = 100

Objective = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Problem:
    """A function with minimum 0 within a box."""

    objective: Objective
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True)
class Run:
    """What one search reached."""

    misfit: float
    evaluations: int
    overhead: float


Engine = Callable[[Problem, int], Run]


def _box(width: float, size: int = 3) -> tuple[FloatArray, FloatArray]:
    return np.full(size, -width / 2.0), np.full(size, width / 2.0)


def _place(rng: np.random.Generator, width: float, size: int = 3) -> FloatArray:
    return rng.uniform(-0.4, 0.4, size) * width


def _rotation(rng: np.random.Generator, size: int = 3) -> FloatArray:
    return np.asarray(np.linalg.qr(rng.standard_normal((size, size)))[0])


def rastrigin(rng: np.random.Generator, rotated: bool = False, size: int = 3) -> Problem:
    """A lattice of ten local minima along each gene on a wide bowl."""
    width = 10.24
    turn = _rotation(rng, size) if rotated else np.eye(size)
    place = _place(rng, width, size)

    def objective(points: FloatArray) -> FloatArray:
        z = (points - place) @ turn
        return np.asarray(10.0 * size + (z**2 - 10.0 * np.cos(2.0 * np.pi * z)).sum(axis=1))

    return Problem(objective, *_box(width, size))


def ackley(rng: np.random.Generator, rotated: bool = False) -> Problem:
    """A cone with ripples, 65 of them along each gene; not smooth at its minimum."""
    width = 65.536
    turn = _rotation(rng) if rotated else np.eye(3)
    place = _place(rng, width)

    def objective(points: FloatArray) -> FloatArray:
        z = (points - place) @ turn
        cone = -20.0 * np.exp(-0.2 * np.sqrt((z**2).mean(axis=1)))
        ripples = -np.exp(np.cos(2.0 * np.pi * z).mean(axis=1))
        return np.asarray(cone + ripples + 20.0 + np.e)

    return Problem(objective, *_box(width))


def quadratic(rng: np.random.Generator, power: float = 1.0) -> Problem:
    """A rotated bowl of condition 1e6; with power 1/2 a cone, as a misfit without noise is."""
    turn, place = _rotation(rng), _place(rng, 2.0)
    curvature = 10.0 ** np.array([0.0, 3.0, 6.0])

    def objective(points: FloatArray) -> FloatArray:
        return np.asarray((((points - place) @ turn) ** 2 @ curvature) ** power)

    return Problem(objective, *_box(2.0))


def rosenbrock(rng: np.random.Generator) -> Problem:
    """A curved valley with a flat bottom."""
    place = rng.uniform(-3.0, 3.0, 3)

    def objective(points: FloatArray) -> FloatArray:
        z = points - place + 1.0
        across = 100.0 * (z[:, 1:] - z[:, :-1] ** 2) ** 2
        return np.asarray((across + (1.0 - z[:, :-1]) ** 2).sum(axis=1))

    return Problem(objective, *_box(10.0))


def two_basins(rng: np.random.Generator, size: int = 3) -> Problem:
    """A narrow curved valley with the minimum, 0.5 to 3.5 % of the box, and a wide one of 0.1.

    The first gene plays the bedrock depth, the second the modulus: the valley of the truth lies
    at small depth, and everywhere else the misfit leads to a deep base.
    """
    depth, modulus = rng.uniform(0.05, 0.2), rng.uniform(0.3, 0.7)
    others = rng.uniform(0.2, 0.8, size - 2)
    wide_depth = rng.uniform(0.6, 0.95)
    wide_modulus = modulus + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.25)
    wide_others = rng.uniform(0.1, 0.9, size - 2)

    def objective(points: FloatArray) -> FloatArray:
        along = points[:, 0] - depth
        across = points[:, 1] - modulus - 1.5 * along - 6.0 * along**2
        rest = 0.3 * ((points[:, 2:] - others) ** 2).sum(axis=1)
        narrow = np.sqrt(9.0 * along**2 + (12.0 * across) ** 2 + rest)
        along = points[:, 0] - wide_depth
        across = points[:, 1] - wide_modulus - 0.15 * along
        rest = 0.3 * ((points[:, 2:] - wide_others) ** 2).sum(axis=1)
        wide = np.sqrt(0.01 + 0.1 * along**2 + (1.5 * across) ** 2 + rest)
        return np.asarray(np.minimum(narrow, wide))

    return Problem(objective, np.zeros(size), np.ones(size))


def minimum_on_a_bound(rng: np.random.Generator) -> Problem:
    """A rotated bowl of condition 100 cut off by a face of the box."""
    turn, place = _rotation(rng), _place(rng, 2.0)
    place[0] = -1.0
    curvature = 10.0 ** np.array([0.0, 1.0, 2.0])

    def objective(points: FloatArray) -> FloatArray:
        z = points - place
        return np.asarray((z @ turn) ** 2 @ curvature + 20.0 * z[:, 0])

    return Problem(objective, *_box(2.0))


MAIN: dict[str, Callable[[np.random.Generator], Problem]] = {
    "Rastrigin": rastrigin,
    "Ackley": ackley,
}
FURTHER: dict[str, Callable[[np.random.Generator], Problem]] = {
    "Rastrigin, rotated": lambda rng: rastrigin(rng, rotated=True),
    "Ackley, rotated": lambda rng: ackley(rng, rotated=True),
    "quadratic, condition 1e6": quadratic,
    "cone, condition 1e3": lambda rng: quadratic(rng, power=0.5),
    "Rosenbrock": rosenbrock,
    "narrow and wide basin": two_basins,
    "minimum on a bound": minimum_on_a_bound,
    "Rastrigin, 4 genes": lambda rng: rastrigin(rng, size=4),
    "Rastrigin, rotated, 4 genes": lambda rng: rastrigin(rng, rotated=True, size=4),
    "narrow and wide basin, 4 genes": lambda rng: two_basins(rng, size=4),
}


def own(settings: SearchSettings) -> Engine:
    """The project's search with one of its presets."""

    def engine(problem: Problem, seed: int) -> Run:
        timed = _Timed(problem.objective)
        begun = time.perf_counter()
        search = MultiPopulationSearch(
            timed, problem.lower, problem.upper, np.random.default_rng([seed, 1]), settings
        )
        while search.has_next():
            search.next()
        result = search.result()
        elapsed = time.perf_counter() - begun - timed.seconds
        return Run(result.misfit, result.evaluations, elapsed / result.evaluations * _GENERATION)

    return engine


def scipy_differential_evolution(problem: Problem, seed: int) -> Run:
    """The vectorised engine of scipy with the same number of evaluations."""
    rng = np.random.default_rng([seed, 1])
    start = problem.lower + (problem.upper - problem.lower) * rng.random(
        (_GENERATION, problem.lower.size)
    )
    timed = _Timed(lambda points: problem.objective(points.T))
    begun = time.perf_counter()
    result = differential_evolution(
        timed,
        list(zip(problem.lower, problem.upper, strict=True)),
        init=start,
        maxiter=_GENERATIONS - 1,
        tol=0.0,
        atol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        seed=rng,
    )
    elapsed = time.perf_counter() - begun - timed.seconds
    evaluations = _GENERATION * _GENERATIONS
    return Run(float(result.fun), evaluations, elapsed / _GENERATIONS)


class _Timed:
    """An objective that knows how long it has worked."""

    def __init__(self, objective: Objective) -> None:
        self._objective = objective
        self.seconds = 0.0

    def __call__(self, points: FloatArray) -> FloatArray:
        begun = time.perf_counter()
        values = self._objective(points)
        self.seconds += time.perf_counter() - begun
        return values


def run(arguments: list[str]) -> int:
    """Print success rates and times; 0."""
    parser = argparse.ArgumentParser(prog="pfwd bench search", description=__doc__)
    parser.add_argument("--seeds", type=int, default=50, help="runs per function (50)")
    parser.add_argument("--first-seed", type=int, default=0, help="seeds count from here (0)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    report = Reporter(arguments)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    engines: dict[str, Engine] = {
        "default": own(SearchSettings()),
        "paper": own(paper_settings()),
        "scipy differential_evolution": scipy_differential_evolution,
    }
    with single_threaded_blas():
        report.title(f"3 genes, 8,000 evaluations, {len(seeds)} seeds: presets and scipy")
        for function, make in MAIN.items():
            _compare(report, function, make, engines, seeds)
        report.title("harder functions, default preset")
        for function, make in FURTHER.items():
            _compare(report, function, make, {"default": engines["default"]}, seeds)
    return 0


def _compare(
    report: Reporter,
    function: str,
    make: Callable[[np.random.Generator], Problem],
    engines: dict[str, Engine],
    seeds: range,
) -> None:
    runs: dict[str, list[Run]] = {name: [] for name in engines}
    # Engine after engine for each seed, so that a busy machine slows all of them alike.
    for seed in seeds:
        for name, engine in engines.items():
            runs[name].append(engine(make(np.random.default_rng(seed)), seed))
    reference = _overhead(runs[next(iter(engines))])
    for name, done in runs.items():
        report.record(
            function=function,
            engine=name,
            seeds=len(done),
            below_1e_2=sum(each.misfit < 1e-2 for each in done),
            below_1e_6=sum(each.misfit < 1e-6 for each in done),
            evaluations=statistics.median(each.evaluations for each in done),
            overhead_seconds=_overhead(done),
            overhead_ratio=_overhead(done) / reference,
        )


def _overhead(runs: list[Run]) -> float:
    return statistics.median(each.overhead for each in runs)
