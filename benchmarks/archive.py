"""An archive inverted anew: drops a second and core, two workers against one, memory, a million.

The drops are simulated with finite-element ground (see `benchmarks.archive_drops`), five to a trace
file, three files of four with the centre sensor alone, the others with three.  The processor time
a drop is what others on the machine disturb least; the time by the clock stands beside it, with
the part of the machine that others used meanwhile.
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
_YOUNG_S = 2.0
"""s; while a process is being started it may still count the memory of the one that starts it."""
_TURNS = 3
_TARGETS = {
    "least-squares, depth declared": 40.0,
    "least-squares, depth unknown": 40.0,
    "full search, depth declared": 3.5,
    "full search, depth unknown": 1.2,
}
_TARGET_SPEED_UP = 1.8


@dataclass
class Measured:
    """One run over an archive, the drops per second and core by processor time."""

    summary: Summary
    main_seconds: float
    """Processor time of the process that hands out and writes."""
    main_memory: int
    """Bytes, its largest resident set."""
    worker_memory: int
    """Bytes, the largest of a worker."""
    others: float
    """Cores that other programs kept busy, on average."""
    steady: float
    """Drops a second by the clock once every worker has done a batch: starting is left out."""
    steady_seconds_a_drop: float
    """Processor time of the workers in that part."""

    @property
    def seconds_a_drop(self) -> float:
        """Processor time, handing out and writing included."""
        return (self.summary.processor_seconds + self.main_seconds) / max(1, self.summary.drops)

    @property
    def by_the_clock(self) -> float:
        """Drops a second."""
        return self.summary.drops / self.summary.elapsed_s


@dataclass
class _Watch:
    """Samples the memory of this process and its workers."""

    main: int = 0
    worker: int = 0
    _end: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        process = psutil.Process()
        while not self._end.wait(_SAMPLING_S):
            self.main = max(self.main, process.memory_info().rss)
            for child in process.children():
                with contextlib.suppress(psutil.NoSuchProcess):
                    if time.time() - child.create_time() > _YOUNG_S:
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
) -> Measured:
    """Invert an archive; with `kill_after` a worker is killed once so many drops are done."""
    watch = _Watch()
    own, begun = time.process_time(), time.perf_counter()
    all_before = _busy()
    with watch.watching(), contextlib.closing(LocalWorkers(options, workers)) as pool:
        killed: list[int] = []
        told: list[tuple[float, float, int]] = []

        def tell(summary: Summary, failures: Sequence[Failure]) -> None:
            told.append((time.perf_counter(), summary.processor_seconds, summary.drops))
            if kill_after is not None and not killed and summary.drops >= kill_after:
                killed.append(pool.processes[0])
                psutil.Process(killed[0]).kill()

        summary = invert_archive([str(drops)], out, options, pool, tell)
    main_seconds = time.process_time() - own
    busy = (_busy() - all_before) / (time.perf_counter() - begun)
    mine = (summary.processor_seconds + main_seconds) / (time.perf_counter() - begun)
    steady, steady_seconds = 0.0, 0.0
    if len(told) > workers:
        first, last = told[workers - 1], told[-1]
        clock, seconds, done = (b - a for a, b in zip(first, last, strict=True))
        if done:
            steady, steady_seconds = done / clock, seconds / done
    return Measured(
        summary,
        main_seconds,
        watch.main,
        watch.worker,
        max(0.0, busy - mine),
        steady,
        steady_seconds,
    )


def _busy() -> float:
    """Seconds that all processors have worked."""
    times = psutil.cpu_times()
    return float(times.user + times.system + getattr(times, "nice", 0.0))


def run(arguments: list[str]) -> int:
    """Print the figures; 0, 1 where a target is missed."""
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
        """All of it."""
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
            begun = time.perf_counter()
            place = self.folder / name
            write_archive(place, count, cache, depth_declared=declared, seed=len(name))
            size = sum(path.stat().st_size for path in place.rglob("*.csv"))
            self.report.record(
                archive=name,
                drops=count,
                bytes_a_drop=size / count,
                seconds=time.perf_counter() - begun,
            )
        self.report.title(f"drops a second and core, {self.jobs} workers")
        large = self._rate("least-squares, depth declared", "declared", quick)
        self._rate("least-squares, depth unknown", "unknown", quick)
        self._rate("full search, depth declared", "few-declared", full)
        self._rate("full search, depth unknown", "few-unknown", full)
        self._workers(quick)
        self._killed(quick)
        self._again(large, quick)
        return 0 if self.met else 1

    def _rate(self, what: str, name: str, options: AnalysisOptions) -> Path:
        out = self._out()
        found = measure(self.folder / name, out, options, self.jobs)
        size = sum(path.stat().st_size for path in out.rglob("*.parquet"))
        target = _TARGETS.get(what)
        rate = 1.0 / found.seconds_a_drop
        self.met &= target is None or rate >= target
        self.report.record(
            what=what,
            drops=found.summary.drops,
            failures=found.summary.failed,
            drops_a_second_and_core=rate,
            target=target or "none",
            drops_a_second_by_the_clock=found.by_the_clock,
            cores_used_by_others=found.others,
            share_of_handing_out=found.main_seconds
            / (found.main_seconds + found.summary.processor_seconds),
            megabytes_main=found.main_memory / 1e6,
            megabytes_a_worker=found.worker_memory / 1e6,
            bytes_a_result=size / max(1, found.summary.drops),
            million_core_hours=MILLION * found.seconds_a_drop / 3600.0,
            million_gigabytes=MILLION * size / max(1, found.summary.drops) / 1e9,
        )
        return out

    def _workers(self, options: AnalysisOptions) -> None:
        """One and two workers, turn by turn, so that a busy machine slows both alike."""
        self.report.title("two workers against one")
        turns: dict[int, list[Measured]] = {1: [], 2: []}
        for _ in range(_TURNS):
            for count, kept in turns.items():
                kept.append(measure(self.folder / "turns", self._out(), options, count))
        clock = {count: max(m.steady for m in kept) for count, kept in turns.items()}
        cost = {
            count: statistics.median(m.steady_seconds_a_drop for m in kept)
            for count, kept in turns.items()
        }
        # By processor time: what two workers would do together if nobody else were there.
        # What the two lose by waiting for work would show by the clock only.
        speed_up = 2.0 * cost[1] / cost[2]
        self.met &= max(speed_up, clock[2] / clock[1]) >= _TARGET_SPEED_UP
        self.report.record(
            drops=turns[1][0].summary.drops,
            turns=_TURNS,
            speed_up_by_the_clock=clock[2] / clock[1],
            speed_up_by_processor_time=speed_up,
            target=_TARGET_SPEED_UP,
            cores_used_by_others=statistics.mean(m.others for each in turns.values() for m in each),
        )

    def _killed(self, options: AnalysisOptions) -> None:
        self.report.title("a worker killed in the middle")
        place = self.folder / "turns"
        whole, cut = self._out(), self._out()
        quiet = measure(place, whole, options, self.jobs)
        found = measure(place, cut, options, self.jobs, kill_after=quiet.summary.drops // 2)
        same = moduli(whole) == moduli(cut)
        self.met &= same
        self.report.record(
            drops=found.summary.drops,
            failures=found.summary.failed,
            same_results=same,
            seconds=found.summary.elapsed_s,
            seconds_undisturbed=quiet.summary.elapsed_s,
        )

    def _again(self, out: Path, options: AnalysisOptions) -> None:
        self.report.title("a second run over the large archive")
        found = measure(self.folder / "declared", out, options, self.jobs)
        summary = found.summary
        nothing = summary.inverted == 0 and summary.parts == 0
        self.met &= nothing
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
    """Modulus of every drop, Pa, in the order of files and drops."""
    from pyarrow import dataset

    columns = ["file", "drop", "modulus_pa"]
    table = dataset.dataset(archive / "results", format="parquet").to_table(columns)
    rows = zip(*(table[name].to_pylist() for name in columns), strict=True)
    return sorted((os.path.basename(file), drop, modulus) for file, drop, modulus in rows)
