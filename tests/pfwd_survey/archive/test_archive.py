"""An archive is inverted once, whatever happens in between."""

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil
import pytest

from pfwd_survey.archive import run as running
from pfwd_survey.archive.ledger import Ledger
from pfwd_survey.archive.local import LocalWorkers
from pfwd_survey.archive.run import Summary, invert_archive, invert_stream
from pfwd_survey.archive.sources import Source, find_sources, pieces_of
from pfwd_survey.archive.work import Failure, SourceOutcome, invert_batch
from pfwd_survey.archive.workers import MOST_DEATHS, Batch
from pfwd_survey.errors import OptionError, SurveyError
from pfwd_survey.files.importing import import_files
from pfwd_survey.files.reading import read_points
from pfwd_survey.inverting.analysis import analyse_files
from pfwd_survey.inverting.options import AnalysisOptions

pytest.importorskip("pyarrow")
from pyarrow import dataset as tables


class HereWorkers:
    """Works in this process, or as a test says."""

    def __init__(self, options: AnalysisOptions) -> None:
        self.options = options
        self.taken: list[Batch] = []

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        for batch in batches:
            self.taken.append(batch)
            yield self.work(batch)

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return invert_batch(list(batch.sources), self.options)

    def close(self) -> None:
        pass


class QuickWorkers(HereWorkers):
    """Invents a result a source: for what has nothing to do with inverting."""

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return [SourceOutcome(source, [invented(source)]) for source in batch.sources]


def invented(source: Source) -> dict[str, Any]:
    return {"file": source.path, "drop": 1, "status": "measured", "modulus_pa": 4e7}


def rows(archive: Path, table: str = "results") -> list[dict[str, Any]]:
    where = archive / table
    if not where.is_dir():
        return []
    found = tables.dataset(where, format="parquet", partitioning="hive").to_table().to_pylist()
    return sorted(found, key=lambda row: (row["file"], row.get("drop") or 0))


def facts(archive: Path) -> list[tuple[Any, ...]]:
    """What must not depend on how often a run was cut off."""
    return [(row["file"], row["drop"], row["status"], row["modulus_pa"]) for row in rows(archive)]


def test_results_are_those_of_plain_inverting(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    workers = HereWorkers(options)
    summary = invert_archive([str(drops)], tmp_path / "out", options, workers)
    files = [str(path) for path in sorted(drops.rglob("*.csv"))]
    plain = [record for one in analyse_files(files, options) for record in one.results]
    assert summary.drops == len(plain) == 12
    assert summary.failed_in_all == 0
    for row, record in zip(rows(tmp_path / "out"), plain, strict=True):
        same = ("file", "drop", "status", "modulus_pa", "r_squared", "at_bound", "plate", "point")
        assert {key: row[key] for key in same} == {key: record[key] for key in same}
        low, high = record["modulus_interval_pa"]
        assert (row["modulus_interval_low_pa"], row["modulus_interval_high_pa"]) == (low, high)
        assert row["half_sine_duration_s"] == record["half_sine"]["duration_s"]
        assert row["device"] == "demo"


def test_a_second_run_does_nothing(drops: Path, tmp_path: Path, options: AnalysisOptions) -> None:
    out = tmp_path / "out"
    invert_archive([str(drops)], out, options, QuickWorkers(options))
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    again = QuickWorkers(options)
    summary = invert_archive([str(drops)], out, options, again)
    assert again.taken == []
    assert (summary.done_before, summary.drops, summary.parts) == (6, 0, 0)
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}


def test_moved_touched_and_copied_files_are_not_done_again(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    invert_archive([str(drops)], out, options, QuickWorkers(options))
    first, second, third = sorted(drops.rglob("*.csv"))[:3]
    os.utime(first, ns=(1, 1))
    second.rename(second.with_name("moved.csv"))
    third.with_name("copy.csv").write_bytes(third.read_bytes())
    again = QuickWorkers(options)
    summary = invert_archive([str(drops)], out, options, again)
    assert again.taken == []
    assert summary.duplicates == 2
    assert len(rows(out)) == 6
    assert invert_archive([str(drops)], out, options, again).done_before == 7


def test_copies_within_one_run_are_done_once(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    text = (drops / "area-0" / "point-0.csv").read_bytes()
    (drops / "area-0" / "point-0-copy.csv").write_bytes(text)
    summary = invert_archive([str(drops)], tmp_path / "out", options, QuickWorkers(options))
    assert (summary.duplicates, summary.drops) == (1, 6)
    same = [row["same_as"] for row in rows(tmp_path / "out", "sources") if row["same_as"]]
    assert len(same) == 1


def test_a_changed_file_is_done_again_and_its_old_rows_go(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    invert_archive([str(drops)], out, options, QuickWorkers(options))
    changed = drops / "area-0" / "point-0.csv"
    changed.write_text(changed.read_text().replace("demo-0", "renamed"))
    again = QuickWorkers(options)
    invert_archive([str(drops)], out, options, again)
    assert [source.path for batch in again.taken for source in batch.sources] == [str(changed)]
    assert len(rows(out)) == 6
    assert len(rows(out, "sources")) == 6


def test_other_options_are_another_run_beside_the_first(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    other = AnalysisOptions(method="least-squares", seed=1)
    one = invert_archive([str(drops)], out, options, QuickWorkers(options))
    two = invert_archive([str(drops)], out, other, QuickWorkers(other))
    assert one.run != two.run
    assert {row["run"] for row in rows(out)} == {one.run, two.run}
    assert json.loads((out / "runs" / f"{two.run}.json").read_text())["options"]["seed"] == 1


def test_the_content_of_a_header_file_is_part_of_the_run(tmp_path: Path) -> None:
    header = tmp_path / "header.toml"
    keys = set()
    for mass in (10, 12):
        header.write_text(f"plate_mass_kg = {mass}\n")
        options = AnalysisOptions(header=str(header))
        keys.add(running.run_key(running.run_identity(options)))
    assert len(keys) == 2


def test_damaged_and_foreign_files_are_collected_with_their_reasons(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    damaged = drops / "area-1" / "damaged.csv"
    whole = (drops / "area-0" / "point-0.csv").read_text(encoding="utf-8")
    damaged.write_text(whole[: len(whole) // 2] + "x", encoding="utf-8")
    (drops / "broken.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + b"\0" * 100)
    (drops / "broken.dynz").write_bytes(b"PK\x03\x04")
    (drops / "photo.jpg").write_bytes(b"no source")
    out = tmp_path / "out"
    met: list[Failure] = []
    summary = invert_archive(
        [str(drops)], out, options, HereWorkers(options), lambda _, new: met.extend(new)
    )
    assert (summary.sources, summary.drops, summary.failed_in_all) == (9, 12, 3)
    failures = {Path(row["file"]).name: row for row in rows(out, "failures")}
    assert set(failures) == {"damaged.csv", "broken.h5", "broken.dynz"}
    assert "damaged.csv, line" in failures["damaged.csv"]["reason"]
    assert {row["kind"] for row in failures.values()} == {"refused"}
    assert sorted(failure.reason for failure in met) == sorted(
        row["reason"] for row in failures.values()
    )
    again = HereWorkers(options)
    assert invert_archive([str(drops)], out, options, again).failed_in_all == 3
    assert again.taken == []


def test_an_error_nobody_foresaw_costs_its_source_alone(
    drops: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfwd_survey.files import reading

    def read(path: str, *args: object) -> Any:
        if path.endswith("point-0.csv"):
            raise ZeroDivisionError("a bug")
        return read_points(path)

    monkeypatch.setattr(reading, "read_points", read)
    outcomes = list(invert_stream([str(drops)], options, HereWorkers(options)))
    (failure,) = [failure for one in outcomes for failure in one.failures]
    assert (failure.kind, "ZeroDivisionError: a bug" in failure.reason) == ("unforeseen", True)
    assert sum(len(one.results) for one in outcomes) == 10


def test_a_file_that_is_written_to_meanwhile_is_tried_again(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    class Writing(HereWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            with open(batch.sources[0].path, "a") as stream:
                stream.write("\n")
            return super().work(batch)

    out = tmp_path / "out"
    summary = invert_archive([str(drops)], out, options, Writing(options))
    assert (summary.drops, summary.failed_in_all) == (10, 1)
    (line,) = (out / "unfinished" / f"{summary.run}.jsonl").read_text().splitlines()
    assert json.loads(line)["kind"] == "changed"
    summary = invert_archive([str(drops)], out, options, HereWorkers(options))
    assert (summary.drops, summary.failed_in_all) == (2, 0)
    assert not (out / "unfinished" / f"{summary.run}.jsonl").exists()


def test_a_run_that_is_stopped_keeps_what_is_done(
    drops: Path, tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "BATCH_SOURCES", 1)

    class Stopped(QuickWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            if len(self.taken) > 4:
                raise KeyboardInterrupt
            return super().work(batch)

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        invert_archive([str(drops)], out, options, Stopped(options))
    assert len(rows(out)) == 4
    summary = invert_archive([str(drops)], out, options, QuickWorkers(options))
    assert (summary.done_before, summary.drops) == (4, 2)


def test_an_interrupt_right_after_a_part_leaves_no_row_twice(
    drops: Path, tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    add = Ledger.add
    interrupted = []

    def late(self: Ledger, number: int, found: Any) -> None:
        add(self, number, found)
        if not interrupted:
            interrupted.append(number)
            raise KeyboardInterrupt

    monkeypatch.setattr(Ledger, "add", late)
    with pytest.raises(KeyboardInterrupt):
        invert_archive([str(drops)], out, options, QuickWorkers(options), part_rows=1)
    assert interrupted
    assert len(rows(out)) == 6
    assert invert_archive([str(drops)], out, options, QuickWorkers(options)).drops == 0


@pytest.mark.parametrize("table", ["results", "failures", "sources"])
def test_a_crash_between_the_tables_of_a_part_leaves_no_row_twice(
    table: str,
    drops: Path,
    tmp_path: Path,
    options: AnalysisOptions,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from pfwd_survey.archive.dataset import Dataset

    (drops / "damaged.csv").write_text("# pfwd-traces = 1\n")
    out = tmp_path / "out"
    write = Dataset._write_table

    def crash(self: Dataset, name: str, number: int, content: Any) -> None:
        if name == table:
            raise KeyboardInterrupt
        write(self, name, number, content)

    class Quick(QuickWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            broken = [s for s in batch.sources if s.path.endswith("damaged.csv")]
            sound = Batch(tuple(s for s in batch.sources if s not in broken))
            failed = [SourceOutcome(s, failures=[Failure("refused", "bad")]) for s in broken]
            return super().work(sound) + failed

    with monkeypatch.context() as patch:
        patch.setattr(Dataset, "_write_table", crash)
        with pytest.raises(KeyboardInterrupt):
            invert_archive([str(drops)], out, options, Quick(options))
    assert rows(out, "sources") == []
    invert_archive([str(drops)], out, options, Quick(options))
    assert len(rows(out)) == 6
    assert len(rows(out, "failures")) == 1


@pytest.mark.parametrize("damage", ["lost", "damaged", "behind"])
def test_the_ledger_is_made_anew_from_the_tables(
    damage: str, drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    ledger = out / "ledger.sqlite"
    invert_archive([str(drops / "area-0")], out, options, QuickWorkers(options))
    old = ledger.read_bytes()
    invert_archive([str(drops)], out, options, QuickWorkers(options))
    if damage == "lost":
        ledger.unlink()
    else:
        ledger.write_bytes(old if damage == "behind" else b"SQLite format 3\0" + b"x" * 5000)
    again = QuickWorkers(options)
    assert invert_archive([str(drops)], out, options, again).done_before == 6
    assert again.taken == []


def test_a_part_that_is_deleted_is_done_again(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    run = invert_archive([str(drops)], out, options, QuickWorkers(options)).run
    (out / "sources" / f"run={run}" / "part-000001.parquet").unlink()
    assert invert_archive([str(drops)], out, options, QuickWorkers(options)).drops == 6
    assert len(rows(out)) == 6


def test_a_damaged_part_is_said_with_what_to_do(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"
    run = invert_archive([str(drops)], out, options, QuickWorkers(options)).run
    (out / "sources" / f"run={run}" / "part-000001.parquet").write_bytes(b"PAR1")
    (out / "ledger.sqlite").unlink()
    with pytest.raises(SurveyError, match=r"part-000001.*remove it"):
        invert_archive([str(drops)], out, options, QuickWorkers(options))


def test_the_results_within_the_drops_are_no_drops(drops: Path, options: AnalysisOptions) -> None:
    out = drops / "out"
    invert_archive([str(drops)], out, options, QuickWorkers(options))
    (out / "table.csv").write_text("a table made of the results")
    assert invert_archive([str(drops)], out, options, QuickWorkers(options)).sources == 6


def test_two_programs_cannot_work_on_one_archive(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out = tmp_path / "out"

    class Meddling(QuickWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            with pytest.raises(SurveyError, match="nobody else works on"):
                invert_archive([str(drops)], out, self.options, QuickWorkers(self.options))
            return super().work(batch)

    assert invert_archive([str(drops)], out, options, Meddling(options)).drops == 6


def test_a_folder_with_something_else_is_left_alone(drops: Path, options: AnalysisOptions) -> None:
    with pytest.raises(OptionError, match=r"--archive .*expected a folder that is new"):
        invert_archive([str(drops)], drops, options, QuickWorkers(options))
    assert not (drops / "archive.json").exists()


def test_what_does_not_exist_is_refused_before_anything_is_made(
    tmp_path: Path, options: AnalysisOptions
) -> None:
    with pytest.raises(OptionError, match="nothing of that name"):
        invert_archive(["/no/such"], tmp_path / "out", options, QuickWorkers(options))
    assert not (tmp_path / "out").exists()


# Surveys


@pytest.fixture
def survey(drops: Path, tmp_path: Path) -> Path:
    """A survey of six points."""
    folder = tmp_path / "surveys" / "road"
    folder.parent.mkdir()
    files = [str(path) for path in sorted(drops.rglob("*.csv"))]
    for _ in import_files(files, str(folder)):
        pass
    return folder


def test_a_survey_in_a_folder_is_one_source(survey: Path) -> None:
    (found,) = find_sources([str(survey.parent)])
    assert (found.path, found.survey) == (str(survey), True)


def test_a_large_survey_is_done_in_pieces_that_can_be_continued(
    survey: Path, tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    (whole,) = find_sources([str(survey)])
    pieces = pieces_of(whole, 4)
    assert [(one.first_point, one.end_point) for one in pieces] == [(0, 2), (2, 4), (4, 6)]
    monkeypatch.setattr(running, "pieces_of", lambda source: pieces_of(source, 4))
    monkeypatch.setattr(running, "BATCH_SOURCES", 1)

    class Stopped(HereWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            if len(self.taken) > 1:
                raise KeyboardInterrupt
            return super().work(batch)

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        invert_archive([str(survey)], out, options, Stopped(options))
    assert len(rows(out)) == 4
    summary = invert_archive([str(survey)], out, options, HereWorkers(options))
    assert (summary.inverted, summary.drops) == (2, 8)
    plain = [record for one in analyse_files([str(survey)], options) for record in one.results]
    assert sorted(row["modulus_pa"] for row in rows(out)) == sorted(
        record["modulus_pa"] for record in plain
    )
    again = HereWorkers(options)
    assert invert_archive([str(survey)], out, options, again).done_before == 1
    assert again.taken == []


# Processes


def test_a_killed_worker_costs_nothing_but_time(
    drops: Path, tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "BATCH_SOURCES", 2)
    killed = []

    with contextlib.closing(LocalWorkers(options, 2)) as workers:

        def tell(summary: Summary, failures: Sequence[Failure]) -> None:
            if not killed:
                # All of them: whoever has work is among them.
                for process in workers.processes:
                    psutil.Process(process).kill()
                    killed.append(process)

        summary = invert_archive([str(drops)], tmp_path / "out", options, workers, tell)
    assert killed
    assert (summary.drops, summary.failed_in_all) == (12, 0)
    assert len(facts(tmp_path / "out")) == 12


def test_a_source_that_kills_its_workers_is_given_up_alone(
    drops: Path, tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The processes are started anew and read this file's name from the environment.
    monkeypatch.setattr("pfwd_survey.archive.local._serve", deadly)
    with contextlib.closing(LocalWorkers(options, 2)) as workers:
        summary = invert_archive([str(drops)], tmp_path / "out", options, workers)
    assert (summary.drops, summary.failed_in_all) == (5, 1)
    (line,) = (tmp_path / "out" / "unfinished" / f"{summary.run}.jsonl").read_text().splitlines()
    failure = json.loads(line)
    assert failure["file"].endswith("point-3.csv")
    assert f"the end of the worker process, {MOST_DEATHS} times" in failure["reason"]


def deadly(line: Any, options: AnalysisOptions) -> None:
    """A worker that dies of one file and invents the others' results."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            sources = line.recv()
            if any(source.path.endswith("point-3.csv") for source in sources):
                os._exit(9)
            line.send([SourceOutcome(source, [invented(source)]) for source in sources])


def test_processes_that_always_die_end_the_run(
    drops: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd_survey.archive.local._serve", stillborn)
    monkeypatch.setattr("pfwd_survey.archive.local._MOST_DEATHS_IN_A_ROW", 3)
    with (
        contextlib.closing(LocalWorkers(options, 1)) as workers,
        pytest.raises(SurveyError, match="expected processes that stay alive, came 3"),
    ):
        list(invert_stream([str(drops)], options, workers))


def stillborn(line: Any, options: AnalysisOptions) -> None:
    """A worker that does not live to do anything."""
    os._exit(1)


MAIN = """
import contextlib, sys
from pfwd_survey.archive import run
from pfwd_survey.archive.ledger import Ledger
from pfwd_survey.archive.local import LocalWorkers
from pfwd_survey.inverting.options import AnalysisOptions

if __name__ == "__main__":
    run.BATCH_SOURCES = 1
    options = AnalysisOptions(method="least-squares", sensors="centre", bedrock_depth=1.2)
    with contextlib.closing(LocalWorkers(options, 2)) as workers:
        run.invert_archive(
            [sys.argv[1]], sys.argv[2], options, workers,
            lambda summary, failures: print(summary.parts, flush=True), part_rows=2,
        )
"""


def test_a_killed_main_process_goes_on_where_it_was(
    drops: Path, tmp_path: Path, options: AnalysisOptions
) -> None:
    out, script = tmp_path / "out", tmp_path / "main.py"
    script.write_text(MAIN)
    top = str(Path(__file__).resolve().parents[3])
    environment = {**os.environ, "PYTHONPATH": top}
    command = [sys.executable, str(script), str(drops), str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as main:
        assert main.stdout is not None
        told = next(text for text in main.stdout if int(text) >= 2)
        children = psutil.Process(main.pid).children(recursive=True)
        main.kill()
    assert int(told) >= 2
    # They end by themselves once nobody listens.
    _gone, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
    # Results without their sources may have been left: they do not count.
    kept = sum(row["drops"] for row in rows(out, "sources"))
    assert kept >= 2
    summary = invert_archive([str(drops)], out, options, HereWorkers(options))
    assert summary.drops == 12 - kept
    whole = tmp_path / "whole"
    invert_archive([str(drops)], whole, options, HereWorkers(options))
    assert facts(out) == facts(whole)


def test_memory_does_not_grow_with_the_archive(
    tmp_path: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 40_000
    found = (Source(f"/drops/{number}.csv", 20_000, number) for number in range(count))
    monkeypatch.setattr(running, "find_sources", lambda *_: found)
    monkeypatch.setattr(running, "content_digest", lambda source: f"{source.mtime_ns:064d}")
    monkeypatch.setattr(running, "pieces_of", lambda source: [source])
    monkeypatch.setattr(running, "PART_SOURCES", 2_000)
    process = psutil.Process()
    resident: list[int] = []

    def tell(summary: Summary, failures: Sequence[Failure]) -> None:
        if summary.drops % 4_000 == 0:
            resident.append(process.memory_info().rss)

    invert_archive(
        [str(tmp_path)], tmp_path / "out", options, QuickWorkers(options), tell, part_rows=2_000
    )
    assert len(resident) >= 10
    # A row takes 3 kB as Python objects: all of them would be 100 MB.
    assert max(resident[3:]) - resident[2] < 30e6


def test_no_more_is_taken_than_is_worked_on(
    drops: Path, options: AnalysisOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd_survey.archive.local._serve", quick)
    taken = itertools.count()
    seen = 0

    def endless() -> Iterator[Batch]:
        while True:
            yield Batch((Source(f"/{next(taken)}", 1, 1),))

    with contextlib.closing(LocalWorkers(options, 2)) as workers:
        for _ in workers.run(endless()):
            seen += 1
            if seen == 20:
                break
    assert next(taken) <= 20 + 2 + 2 + 1


def quick(line: Any, options: AnalysisOptions) -> None:
    """A worker that invents results."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            line.send([SourceOutcome(source, [invented(source)]) for source in line.recv()])


@pytest.mark.skipif(os.name == "nt", reason="signals between processes")
def test_an_interrupt_ends_the_processes_too(drops: Path, tmp_path: Path) -> None:
    command = [
        sys.executable, "-c", "import sys; from tui.cli import main; sys.exit(main())",
        "invert", str(drops), "--archive", str(tmp_path / "out"), "--jobs", "2",
    ]  # fmt: skip
    top = Path(__file__).resolve().parents[3]
    with subprocess.Popen(command, cwd=top, stderr=subprocess.PIPE, text=True) as main:
        until = time.monotonic() + 60
        while not (children := psutil.Process(main.pid).children()):
            assert time.monotonic() < until
            time.sleep(0.05)
        main.send_signal(signal.SIGINT)
        _, said = main.communicate(timeout=60)
    assert main.returncode == 0
    assert said.splitlines()[-1:] == ["pfwd: stopped"]
    assert psutil.wait_procs(children, timeout=30)[1] == []
