"""Inversion of an archive: drops per second and core, two workers against one, memory.

The drops are simulated with finite-element ground (see `benchmarks.archive_drops`), five per trace
file. Three files of four have only the centre sensor, the others three sensors.  The processor time
per drop depends least on other programs. The elapsed time is reported too, with the cores that
other programs used.
"""

import argparse
import contextlib
import os
import statistics
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
from platformdirs import user_cache_path

from benchmarks.archive_drops import write_archive
from benchmarks.output import Reporter
from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.local import LocalWorkers
from pfwd.archive.run import Summary, invert_archive
from pfwd.archive.work import Failure

MILLION = 1_000_000
_SAMPLING_S = 0.2
_STARTING_S = 2.0
"""Age below which the memory of a process is not counted, s: at first it may share its parent's."""
_N_ROUNDS = 3
_TARGETS = {
    "least-squares, depth declared": 40.0,
    "least-squares, depth unknown": 40.0,
    "full search, depth declared": 3.5,
    "full search, depth unknown": 1.2,
}
_TARGET_SPEED_UP = 1.8


@dataclass
class RunFigures:
    """Figures of one run over an archive."""

    summary: Summary
    main_seconds: float
    """Processor time of the main process, which distributes drops and writes results, s."""
    main_memory: int
    """Largest resident set of the main process, bytes."""
    worker_memory: int
    """Largest resident set of a worker, bytes."""
    other_cores: float
    """Average number of cores that other programs used."""
    steady_rate: float
    """Drops per second of elapsed time, after every worker has done its first batch."""
    steady_seconds_per_drop: float
    """Processor time of the workers per drop in that time, s."""

    @property
    def seconds_per_drop(self) -> float:
        """Processor time per drop of all processes, s."""
        return (self.summary.processor_seconds + self.main_seconds) / max(1, self.summary.drops)

    @property
    def drops_per_second(self) -> float:
        """Drops per second of elapsed time."""
        return self.summary.drops / self.summary.elapsed_s


@dataclass
class _MemoryWatch:
    """Sampler of the memory of this process and its workers."""

    main: int = 0
    worker: int = 0
    _end: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        process = psutil.Process()
        while not self._end.wait(_SAMPLING_S):
            self.main = max(self.main, process.memory_info().rss)
            for child in process.children():
                with contextlib.suppress(psutil.NoSuchProcess):
                    if time.time() - child.create_time() > _STARTING_S:
                        self.worker = max(self.worker, child.memory_info().rss)

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        thread = threading.Thread(target=self.run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._end.set()
            thread.join()


def measure(
    drops: Path, out: Path, options: AnalysisOptions, workers: int, kill_after: int | None = None
) -> RunFigures:
    """Invert an archive and return the figures of the run.

    Parameters
    ----------
    drops : Path
        Folder with the trace files.
    out : Path
        Folder for the results.
    options : AnalysisOptions
    workers : int
        Number of worker processes.
    kill_after : int, optional
        Number of drops after which one worker is killed.
    """
    watch = _MemoryWatch()
    processor_start, start = time.process_time(), time.perf_counter()
    all_before = _busy()
    with watch.watching(), contextlib.closing(LocalWorkers(options, workers)) as pool:
        killed: list[int] = []
        progress: list[tuple[float, float, int]] = []

        def record_progress(summary: Summary, failures: Sequence[Failure]) -> None:
            progress.append((time.perf_counter(), summary.processor_seconds, summary.drops))
            if kill_after is not None and not killed and summary.drops >= kill_after:
                killed.append(pool.processes[0])
                psutil.Process(killed[0]).kill()

        summary = invert_archive([str(drops)], out, options, pool, record_progress)
    main_seconds = time.process_time() - processor_start
    busy = (_busy() - all_before) / (time.perf_counter() - start)
    own_cores = (summary.processor_seconds + main_seconds) / (time.perf_counter() - start)
    steady_rate, steady_seconds = 0.0, 0.0
    if len(progress) > workers:
        first, last = progress[workers - 1], progress[-1]
        clock, seconds, drops_done = (b - a for a, b in zip(first, last, strict=True))
        if drops_done:
            steady_rate, steady_seconds = drops_done / clock, seconds / drops_done
    return RunFigures(
        summary,
        main_seconds,
        watch.main,
        watch.worker,
        max(0.0, busy - own_cores),
        steady_rate,
        steady_seconds,
    )


def _busy() -> float:
    """Return the processor time of all programs since the start of the machine, s."""
    times = psutil.cpu_times()
    return float(times.user + times.system + getattr(times, "nice", 0.0))


def run(arguments: list[str]) -> int:
    """Print the figures; return the exit status: 0, or 1 if a target is missed."""
    parser = argparse.ArgumentParser(prog="pfwd bench archive", description=__doc__)
    parser.add_argument("--short", action="store_true", help="a twentieth of the drops")
    parser.add_argument("--drops", type=int, help="drops by least squares (20000; short: 1000)")
    parser.add_argument("--searches", type=int, help="drops by the full search (300; short: 50)")
    parser.add_argument("--jobs", type=int, default=2, help="workers (2)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    drops = options.drops or (1_000 if options.short else 20_000)
    searches = options.searches or (50 if options.short else 300)
    with TemporaryDirectory() as folder:
        return _Bench(Reporter(arguments), Path(folder), options.jobs).run(drops, searches)


class _Bench:
    def __init__(self, report: Reporter, folder: Path, jobs: int) -> None:
        self.report, self.folder, self.jobs = report, folder, jobs
        self.met = True
        self._outputs = 0

    def run(self, drops: int, searches: int) -> int:
        """Run all parts; return the exit status."""
        quick = AnalysisOptions(method="least-squares")
        full = AnalysisOptions()
        cache = user_cache_path("pfwd", appauthor=False) / "bench"
        parts = {
            "declared": (drops, True),
            "unknown": (drops // 10, False),
            "few-declared": (searches, True),
            "few-unknown": (searches, False),
            "turns": (max(600, drops // 20), True),
        }
        self.report.title("drops by finite elements")
        for name, (count, declared) in parts.items():
            start = time.perf_counter()
            place = self.folder / name
            write_archive(place, count, cache, depth_declared=declared, seed=len(name))
            size = sum(path.stat().st_size for path in place.rglob("*.csv"))
            self.report.record(
                archive=name,
                drops=count,
                bytes_a_drop=size / count,
                seconds=time.perf_counter() - start,
            )
        self.report.title(f"drops a second and core, {self.jobs} workers")
        large = self._rate("least-squares, depth declared", "declared", quick)
        self._rate("least-squares, depth unknown", "unknown", quick)
        self._rate("full search, depth declared", "few-declared", full)
        self._rate("full search, depth unknown", "few-unknown", full)
        self._workers(quick)
        self._killed(quick)
        self._second_run(large, quick)
        return 0 if self.met else 1

    def _rate(self, what: str, name: str, options: AnalysisOptions) -> Path:
        out = self._out()
        figures = measure(self.folder / name, out, options, self.jobs)
        size = sum(path.stat().st_size for path in out.rglob("*.parquet"))
        target = _TARGETS.get(what)
        rate = 1.0 / figures.seconds_per_drop
        self.met &= target is None or rate >= target
        self.report.record(
            what=what,
            drops=figures.summary.drops,
            failures=figures.summary.failed,
            drops_a_second_and_core=rate,
            target=target or "none",
            drops_a_second_by_the_clock=figures.drops_per_second,
            cores_used_by_others=figures.other_cores,
            share_of_handing_out=figures.main_seconds
            / (figures.main_seconds + figures.summary.processor_seconds),
            megabytes_main=figures.main_memory / 1e6,
            megabytes_a_worker=figures.worker_memory / 1e6,
            bytes_a_result=size / max(1, figures.summary.drops),
            million_core_hours=MILLION * figures.seconds_per_drop / 3600.0,
            million_gigabytes=MILLION * size / max(1, figures.summary.drops) / 1e9,
        )
        return out

    def _workers(self, options: AnalysisOptions) -> None:
        """Compare one and two workers in alternating runs, so that other programs affect both."""
        self.report.title("two workers against one")
        runs_by_workers: dict[int, list[RunFigures]] = {1: [], 2: []}
        for _ in range(_N_ROUNDS):
            for count, runs in runs_by_workers.items():
                runs.append(measure(self.folder / "turns", self._out(), options, count))
        clock = {count: max(m.steady_rate for m in runs) for count, runs in runs_by_workers.items()}
        cost = {
            count: statistics.median(m.steady_seconds_per_drop for m in runs)
            for count, runs in runs_by_workers.items()
        }
        # By processor time, the speed-up of two workers on a machine without other programs. Time
        # lost by waiting for work affects only the elapsed time.
        speed_up = 2.0 * cost[1] / cost[2]
        self.met &= max(speed_up, clock[2] / clock[1]) >= _TARGET_SPEED_UP
        self.report.record(
            drops=runs_by_workers[1][0].summary.drops,
            turns=_N_ROUNDS,
            speed_up_by_the_clock=clock[2] / clock[1],
            speed_up_by_processor_time=speed_up,
            target=_TARGET_SPEED_UP,
            cores_used_by_others=statistics.mean(
                m.other_cores for each in runs_by_workers.values() for m in each
            ),
        )

    def _killed(self, options: AnalysisOptions) -> None:
        self.report.title("a worker killed in the middle")
        place = self.folder / "turns"
        undisturbed_out, disturbed_out = self._out(), self._out()
        undisturbed = measure(place, undisturbed_out, options, self.jobs)
        figures = measure(
            place, disturbed_out, options, self.jobs, kill_after=undisturbed.summary.drops // 2
        )
        same = moduli(undisturbed_out) == moduli(disturbed_out)
        self.met &= same
        self.report.record(
            drops=figures.summary.drops,
            failures=figures.summary.failed,
            same_results=same,
            seconds=figures.summary.elapsed_s,
            seconds_undisturbed=undisturbed.summary.elapsed_s,
        )

    def _second_run(self, out: Path, options: AnalysisOptions) -> None:
        self.report.title("a second run over the large archive")
        figures = measure(self.folder / "declared", out, options, self.jobs)
        summary = figures.summary
        is_idle = summary.inverted == 0 and summary.parts == 0
        self.met &= is_idle
        self.report.record(
            sources=summary.sources,
            done_before=summary.done_before,
            inverted=summary.inverted,
            seconds=summary.elapsed_s,
        )

    def _out(self) -> Path:
        self._outputs += 1
        return self.folder / f"results-{self._outputs}"


def moduli(archive: Path) -> list[tuple[str, int, float | None]]:
    """Return the modulus of every drop, Pa, in the order of files and drops."""
    from pyarrow import dataset

    columns = ["file", "drop", "modulus_pa"]
    table = dataset.dataset(archive / "results", format="parquet").to_table(columns)
    rows = zip(*(table[name].to_pylist() for name in columns), strict=True)
    return sorted((os.path.basename(file), drop, modulus) for file, drop, modulus in rows)
