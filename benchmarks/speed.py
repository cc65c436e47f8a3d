"""Analysis times on one core, and those of the forward model."""

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.output import Reporter
from inversion import Grounds, PlateProblem, Record, Settings, SurrogateLibrary, invert
from inversion.forward.laplace import SEARCH_BAND_HZ
from inversion.forward.model import ForwardModel
from inversion.measured.record import prepare
from inversion.threads import single_threaded_blas
from pfwd.analysis.analyse import record_of
from pfwd.files.traces import read_traces

_SOLVES = 8000
_BATCH = 80


def run(arguments: list[str]) -> int:
    """Print the times; return the exit status 0."""
    report = Reporter(arguments)
    record = _centre_record()
    library = SurrogateLibrary()
    report.title("analysis of one drop, centre sensor, surrogate at hand (median of 7, s)")
    for depth, name in ((1.2, "given"), ("unknown", "unknown")):
        for method in ("mpga", "posterior"):
            settings = Settings(bedrock_depth=depth, method=method)  # type: ignore[arg-type]
            seconds, solves = _analysis_time(record, settings, library)
            report.record(
                what="analysis", method=method, depth=name, seconds=seconds, forward_solves=solves
            )
    report.title(f"{_SOLVES} forward solves (s)")
    fast = _surrogate_solves(record, library)
    report.record(what="surrogate", solves=_SOLVES, seconds=fast, each_us=fast / _SOLVES * 1e6)
    return 0


def _centre_record() -> Record:
    """Return the record of the centre sensor of a finite-element drop with noise."""
    from simulators.demo import demo_drops

    with TemporaryDirectory() as folder:
        point = read_traces(demo_drops(1, 0, Path(folder)))
    record = record_of(point.drops[0], point.setup)
    return Record(
        record.time, record.load, record.sensors[:1], record.instrument, record.poisson_ratio
    )


def _analysis_time(
    record: Record, settings: Settings, library: SurrogateLibrary
) -> tuple[float, int]:
    results = [invert(record, settings, library) for _ in range(8)]
    elapsed = statistics.median(result.elapsed_s or 0.0 for result in results[1:])
    return elapsed, results[-1].forward_solves or 0


def _surrogate_solves(record: Record, library: SurrogateLibrary) -> float:
    """Return the time of 8,000 displacement histories, computed from tables in batches of 80, s."""
    drop = prepare(record)
    surrogate = library.get(PlateProblem("rigid-rough", record.poisson_ratio), None)
    times = drop.time[drop.window][::3]
    model = ForwardModel(
        surrogate, record.instrument, drop.time, drop.load, times, SEARCH_BAND_HZ, single=True
    )
    rng = np.random.default_rng(0)
    grounds = Grounds(
        rng.uniform(20e6, 80e6, _BATCH),
        rng.uniform(0.0, 1e5, _BATCH),
        rng.uniform(1500.0, 2300.0, _BATCH),
        1.0 / rng.uniform(0.5, 5.0, _BATCH),
    )

    def solve() -> None:
        for _ in range(_SOLVES // _BATCH):
            model.displacement(grounds)

    with single_threaded_blas():
        return _median(solve, 5)


def _median(action: Callable[[], None], runs: int) -> float:
    action()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)
