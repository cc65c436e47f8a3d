"""The processes that invert an archive: killed, interrupted, and held back."""

import contextlib
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import psutil
import pytest

from pfwd.archive import run as running
from pfwd.archive import work
from pfwd.archive.run import Summary, invert_archive, invert_stream
from pfwd.archive.work import ArchiveWorkers, Source, SourceFailure
from pfwd.errors import SurveyError

pytest.importorskip("pyarrow")
from tests.pfwd.archive.stand_ins import OPTIONS, LocalWorkers, QuickWorkers, facts, rows
from tests.pfwd.archive.worker_functions import deadly, held, quick, stillborn

Replace = Callable[..., None]


@pytest.fixture
def work_by(monkeypatch: pytest.MonkeyPatch) -> Replace:
    """Replaces the inversion of a batch, and the numbers of failures after which work ends."""

    def replace(function: Callable[..., object], **limits: int) -> None:
        monkeypatch.setattr(work, "invert_batch", function)
        for name, value in limits.items():
            monkeypatch.setattr(work, name, value)

    return replace


def test_the_work_of_a_killed_worker_is_repeated(
    drops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, work_by: Replace
) -> None:
    monkeypatch.setattr(running, "BATCH_SOURCES", 1)
    work_by(held)
    killed = []
    with contextlib.closing(ArchiveWorkers(OPTIONS, 2)) as workers:

        def tell(summary: Summary, failures: Sequence[SourceFailure]) -> None:
            if not killed:
                for process in workers._jobs.processes:
                    process.kill()
                    killed.append(process)
                (drops / "go").touch()

        summary = invert_archive([str(drops)], tmp_path / "out", workers, tell)
    assert killed
    assert (summary.drops, summary.failed_in_all) == (6, 0)
    assert len(facts(tmp_path / "out")) == 6


def test_a_source_that_kills_its_workers_is_skipped(
    drops: Path, tmp_path: Path, work_by: Replace
) -> None:
    work_by(deadly, MAX_DEATHS_PER_SOURCE=1)
    with contextlib.closing(ArchiveWorkers(OPTIONS)) as workers:
        summary = invert_archive([str(drops)], tmp_path / "out", workers)
    assert (summary.drops, summary.failed_in_all) == (5, 1)
    (line,) = (tmp_path / "out" / "unfinished" / f"{summary.run}.jsonl").read_text().splitlines()
    failure = json.loads(line)
    assert failure["file"].endswith("point-3.csv")
    assert "the end of the worker process, 1 times" in failure["reason"]


def test_processes_that_always_die_end_the_run(drops: Path, work_by: Replace) -> None:
    work_by(stillborn, MAX_DEATHS_PER_SOURCE=1, MAX_CONSECUTIVE_FAILURES=2)
    with (
        contextlib.closing(ArchiveWorkers(OPTIONS)) as workers,
        pytest.raises(SurveyError, match="expected processes that stay alive, got 2"),
    ):
        list(invert_stream([str(drops)], workers))


MAIN = """
import contextlib, sys
from pfwd.archive import run
from pfwd.archive.work import ArchiveWorkers
from pfwd.analysis.options import AnalysisOptions

run.BATCH_SOURCES = 1
run.PART_ROWS = 2
options = AnalysisOptions(method="posterior", sensors="centre", bedrock_depth=1.2)
with contextlib.closing(ArchiveWorkers(options, 2)) as workers:
    run.invert_archive(
        [sys.argv[1]], sys.argv[2], workers,
        lambda summary, failures: print(summary.parts, flush=True),
    )
"""


def test_a_killed_main_process_goes_on_where_it_was(drops: Path, tmp_path: Path) -> None:
    out, script = tmp_path / "out", tmp_path / "main.py"
    script.write_text(MAIN)
    top = str(Path(__file__).resolve().parents[3])
    environment = {**os.environ, "PYTHONPATH": top}
    command = [sys.executable, str(script), str(drops), str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as main:
        assert main.stdout is not None
        n_parts = next(int(text) for text in main.stdout if int(text) >= 2)
        children = psutil.Process(main.pid).children(recursive=True)
        main.kill()
    assert n_parts >= 2
    # They end by themselves once nobody listens.
    _ended, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
    # Results without their sources may have been left: they do not count.
    stored = sum(row["drops"] for row in rows(out, "sources"))
    assert stored >= 2
    summary = invert_archive([str(drops)], out, LocalWorkers())
    assert summary.drops == 12 - stored
    complete = tmp_path / "whole"
    invert_archive([str(drops)], complete, LocalWorkers())
    assert facts(out) == facts(complete)


def test_memory_does_not_grow_with_the_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 20_000
    sources = (Source(f"/drops/{number}.csv", 20_000, number) for number in range(count))
    monkeypatch.setattr(running, "find_sources", lambda *_: sources)
    monkeypatch.setattr(running, "content_digest", lambda source: f"{source.mtime_ns:064d}")
    monkeypatch.setattr(running, "pieces_of", lambda source: [source])
    monkeypatch.setattr(running, "PART_SOURCES", 2_000)
    monkeypatch.setattr(running, "PART_ROWS", 2_000)
    process = psutil.Process()
    resident: list[int] = []

    def tell(summary: Summary, failures: Sequence[SourceFailure]) -> None:
        if summary.drops % 2_000 == 0:
            resident.append(process.memory_info().rss)

    invert_archive([str(tmp_path)], tmp_path / "out", QuickWorkers(), tell)
    assert len(resident) >= 10
    # A row takes 3 kB as Python objects: all of them would be 60 MB.
    assert max(resident[3:]) - resident[2] < 30e6


def test_batches_are_read_only_when_needed(work_by: Replace) -> None:
    work_by(quick)
    count = itertools.count()
    endless = ((Source(f"/{next(count)}", 1, 1),) for _ in itertools.repeat(None))
    with contextlib.closing(ArchiveWorkers(OPTIONS)) as workers:
        assert len(list(itertools.islice(workers.run(endless), 20))) == 20
    assert next(count) <= 20 + 1 + 2 + 1
