"""An archive is inverted once, also after interruptions."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.analyse import analyse_files
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.result_columns import result_columns
from pfwd.analysis.results import DropResult, LayerResult
from pfwd.archive import dataset, work
from pfwd.archive import run as running
from pfwd.archive.dataset import RESULT_COLUMNS, result_row
from pfwd.archive.run import find_sources, invert_archive, invert_stream, pieces_of
from pfwd.archive.work import Batch, SourceFailure, SourceOutcome
from pfwd.errors import OptionError, SurveyError
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points

pytest.importorskip("pyarrow")
from tests.pfwd.archive.stand_ins import OPTIONS, LocalWorkers, QuickWorkers, rows


def test_an_archive_has_the_results_of_an_inversion(drops: Path, tmp_path: Path) -> None:
    summary = invert_archive([str(drops)], tmp_path / "out", LocalWorkers())
    files = [str(path) for path in sorted(drops.rglob("*.csv"))]
    plain = [
        record.to_json() for outcome in analyse_files(files, OPTIONS) for record in outcome.results
    ]
    assert (summary.drops, summary.failed_in_all) == (len(plain), 0) == (12, 0)
    for row, record in zip(rows(tmp_path / "out"), plain, strict=True):
        same = ("file", "drop", "status", "modulus_pa", "r_squared", "at_bound", "plate", "point")
        same += ("deflection_recorded_m", "deflection_corrected_m", "peak_load_n")
        assert {key: row[key] for key in same} == {key: record[key] for key in same}
        ends = [row["modulus_interval_low_pa"], row["modulus_interval_high_pa"]]
        assert ends == record["modulus_interval_pa"]
        assert row["half_sine_duration_s"] == record["half_sine"]["duration_s"]
        assert row["device"] == "demo"
    # Intervals and the half-sine stand in several columns; what tells of the fit and not of the
    # ground, and what is the same for all rows of a run, in none.
    parted = {"modulus_interval_pa", "bedrock_depth_interval_m", "half_sine", "modulus_depth_m"}
    parted |= {"effective_modulus_interval_pa", "equivalent_modulus_interval_pa"}
    without = {"half_sine_equal_area", "contact_end_s", "window_end_s", "facts", "warning_codes"}
    without |= {"structures", "added_mass_kg", "sensor_lag_s", "drift_m"}
    without |= {"question", "software", "settings", "priors"}
    assert set(plain[0]) - set(rows(tmp_path / "out")[0]) == parted | without


def test_every_number_of_a_result_has_a_column() -> None:
    names = [name for name, _ in RESULT_COLUMNS]
    assert len(set(names)) == len(names)
    for place in ("established", "layers", "last"):
        columns = [(column.name, column.kind) for column in result_columns(place)]
        assert set(columns) <= set(RESULT_COLUMNS), place
    medium = {"viscosity_pa_s": 3e4, "density_kg_m3": 1900.0, "poisson_ratio": 0.35}
    layers = (
        LayerResult(modulus_pa=9e7, modulus_interval_pa=(8e7, 1e8), thickness_m=0.3, **medium),
        LayerResult(modulus_pa=4e7, modulus_interval_pa=(3e7, 5e7), **medium),
    )
    row = result_row(DropResult(layers=layers, effective_depth_m=0.9), "d", {})
    assert (row["layers"], row["layer_1_modulus_pa"], row["layer_1_thickness_m"]) == (2, 9e7, 0.3)
    assert (row["layer_2_modulus_interval_high_pa"], row["effective_depth_m"]) == (5e7, 0.9)
    assert row["layer_2_thickness_m"] is row["layer_3_modulus_pa"] is None


def test_moved_touched_and_copied_files_are_not_repeated(drops: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, second, third = sorted(drops.rglob("*.csv"))[:3]
    third.with_name("same.csv").write_bytes(third.read_bytes())
    summary = invert_archive([str(drops)], out, QuickWorkers())
    assert (summary.duplicates, summary.drops) == (1, 6)
    assert sum(bool(row["same_as"]) for row in rows(out, "sources")) == 1
    os.utime(first, ns=(1, 1))
    second.rename(second.with_name("moved.csv"))
    third.with_name("copy.csv").write_bytes(third.read_bytes())
    repeated = QuickWorkers()
    summary = invert_archive([str(drops)], out, repeated)
    assert (repeated.batches, summary.duplicates, len(rows(out))) == ([], 2, 6)
    assert invert_archive([str(drops)], out, repeated).done_before == 8


def test_a_changed_file_replaces_its_rows(drops: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    invert_archive([str(drops)], out, QuickWorkers())
    changed = drops / "area-0" / "point-0.csv"
    changed.write_text(changed.read_text().replace("demo-0", "renamed"))
    repeated = QuickWorkers()
    invert_archive([str(drops)], out, repeated)
    assert [source.path for batch in repeated.batches for source in batch] == [str(changed)]
    assert len(rows(out)) == len(rows(out, "sources")) == 6


def test_different_options_are_a_separate_run(drops: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    reseeded = AnalysisOptions(method="posterior", seed=1)
    first, second = (
        invert_archive([str(drops)], out, QuickWorkers(each)).run for each in (OPTIONS, reseeded)
    )
    assert {row["run"] for row in rows(out)} == {first, second}
    assert first != second
    assert json.loads((out / "runs" / f"{second}.json").read_text())["options"]["seed"] == 1


def test_the_content_of_a_header_file_is_part_of_the_run(tmp_path: Path) -> None:
    header = tmp_path / "header.toml"
    keys = set()
    for mass in (10, 12):
        header.write_text(f"plate_mass_kg = {mass}\n")
        options = AnalysisOptions(header=str(header))
        keys.add(running.run_identity(options)["header_sha256"])
    assert len(keys) == 2


def test_damaged_and_foreign_files_are_collected_with_their_reasons(
    drops: Path, tmp_path: Path
) -> None:
    damaged = drops / "area-1" / "damaged.csv"
    complete = (drops / "area-0" / "point-0.csv").read_text(encoding="utf-8")
    damaged.write_text(complete[: len(complete) // 2] + "x", encoding="utf-8")
    (drops / "broken.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + b"\0" * 100)
    (drops / "broken.dynz").write_bytes(b"PK\x03\x04")
    (drops / "photo.jpg").write_bytes(b"no source")
    out = tmp_path / "out"
    met: list[SourceFailure] = []
    summary = invert_archive([str(drops)], out, LocalWorkers(), lambda _, new: met.extend(new))
    assert (summary.sources, summary.drops, summary.failed_in_all) == (9, 12, 3)
    failures = {Path(row["file"]).name: row for row in rows(out, "failures")}
    assert set(failures) == {"damaged.csv", "broken.h5", "broken.dynz"}
    assert "damaged.csv, line" in failures["damaged.csv"]["reason"]
    assert {row["kind"] for row in failures.values()} == {"refused"}
    assert sorted(failure.reason for failure in met) == sorted(
        row["reason"] for row in failures.values()
    )
    repeated = LocalWorkers()
    assert invert_archive([str(drops)], out, repeated).failed_in_all == 3
    assert repeated.batches == []


def test_an_unforeseen_error_fails_its_source_only(
    drops: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(path: str, *args: object) -> Any:
        if path.endswith("point-0.csv"):
            raise ZeroDivisionError("a bug")
        return read_points(path)

    monkeypatch.setattr(work, "read_points", read)
    outcomes = list(invert_stream([str(drops)], LocalWorkers()))
    (failure,) = [failure for outcome in outcomes for failure in outcome.failures]
    assert (failure.kind, "ZeroDivisionError: a bug" in failure.reason) == ("unforeseen", True)
    assert sum(len(outcome.results) for outcome in outcomes) == 10


def test_a_file_that_changes_during_the_run_is_retried(drops: Path, tmp_path: Path) -> None:
    class Writing(LocalWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            with open(batch[0].path, "a") as stream:
                stream.write("\n")
            return super().work(batch)

    out = tmp_path / "out"
    summary = invert_archive([str(drops)], out, Writing())
    assert (summary.drops, summary.failed_in_all) == (10, 1)
    (line,) = (out / "unfinished" / f"{summary.run}.jsonl").read_text().splitlines()
    assert json.loads(line)["kind"] == "changed"
    summary = invert_archive([str(drops)], out, LocalWorkers())
    assert (summary.drops, summary.failed_in_all) == (2, 0)
    assert not (out / "unfinished" / f"{summary.run}.jsonl").exists()


@pytest.mark.parametrize("table", ["results", "failures", "sources", None])
def test_a_crash_between_or_after_the_tables_of_a_part_leaves_no_row_twice(
    table: str | None, drops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (drops / "damaged.csv").write_text("# pfwd-traces = 1\n")
    out = tmp_path / "out"
    write, write_part = dataset.ArchiveFolder._write_table, dataset.ArchiveFolder.write

    def crash(self: dataset.ArchiveFolder, name: str, number: int, content: Any) -> None:
        if name == table:
            raise KeyboardInterrupt
        write(self, name, number, content)

    def crash_after(self: dataset.ArchiveFolder, number: int, *tables: Any) -> None:
        write_part(self, number, *tables)
        raise KeyboardInterrupt

    class Quick(QuickWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            broken = [s for s in batch if s.path.endswith("damaged.csv")]
            sound = tuple(s for s in batch if s not in broken)
            failed = [SourceOutcome(s, failures=[SourceFailure("refused", "bad")]) for s in broken]
            return super().work(sound) + failed

    with monkeypatch.context() as patch:
        patch.setattr(dataset.ArchiveFolder, "_write_table", crash)
        if table is None:
            patch.setattr(dataset.ArchiveFolder, "write", crash_after)
        with pytest.raises(KeyboardInterrupt):
            invert_archive([str(drops)], out, Quick())
    assert bool(rows(out, "sources")) == (table is None)
    invert_archive([str(drops)], out, Quick())
    assert len(rows(out)) == 6
    assert len(rows(out, "failures")) == 1


def test_a_table_that_was_cut_off_is_no_part_for_its_readers(
    drops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(running, "BATCH_SOURCES", 2)
    monkeypatch.setattr(running, "PART_SOURCES", 2)
    replaced = dataset.replaced_durably

    @contextlib.contextmanager
    def cut_off(path: Path) -> Iterator[Path]:
        if path.name == "part-000002.parquet":
            draft = path.with_name(f".{path.name}.1.tmp")  # a killed process does not remove it
            yield draft
            draft.write_bytes(draft.read_bytes()[:100])
            raise KeyboardInterrupt
        with replaced(path) as draft:
            yield draft

    with monkeypatch.context() as patch:
        patch.setattr(dataset, "replaced_durably", cut_off)
        with pytest.raises(KeyboardInterrupt):
            invert_archive([str(drops)], out, QuickWorkers())
    # As pyarrow reads a folder: with all files in it that are not hidden.
    assert len(rows(out)) == len(rows(out, "sources")) == 2
    assert list(out.glob("**/*.tmp"))
    invert_archive([str(drops)], out, QuickWorkers())
    assert len(rows(out)) == 6
    assert list(out.glob("**/*.tmp")) == []


def test_rows_of_a_content_stay_until_no_file_has_it(drops: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first, second, *_ = sorted(drops.rglob("*.csv"))
    text = first.read_text()
    invert_archive([str(drops)], out, QuickWorkers())
    second.write_text(text)
    assert invert_archive([str(drops)], out, QuickWorkers()).duplicates == 1
    assert len(rows(out)) == 5
    first.write_text(text.replace("demo-0", "other"))
    assert invert_archive([str(drops)], out, QuickWorkers()).drops == 1
    assert len(rows(out)) == 6
    second.write_text(text.replace("demo-0", "another"))
    assert invert_archive([str(drops)], out, QuickWorkers()).drops == 1
    assert len(rows(out)) == len(rows(out, "sources")) == 6


@pytest.fixture
def part(drops: Path, tmp_path: Path) -> Path:
    """Table of the sources of an archive with one part."""
    run = invert_archive([str(drops)], tmp_path / "out", QuickWorkers()).run
    return tmp_path / "out" / "sources" / f"run={run}" / "part-000001.parquet"


def test_a_deleted_part_is_repeated(drops: Path, tmp_path: Path, part: Path) -> None:
    out = tmp_path / "out"
    part.unlink()
    assert invert_archive([str(drops)], out, QuickWorkers()).drops == 6
    assert len(rows(out)) == 6


def test_the_results_within_the_drops_are_no_drops(drops: Path) -> None:
    out = drops / "out"
    invert_archive([str(drops)], out, QuickWorkers())
    (out / "table.csv").write_text("a table made of the results")
    assert invert_archive([str(drops)], out, QuickWorkers()).sources == 6


def test_two_programs_cannot_share_an_archive(drops: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    class Meddling(QuickWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            with pytest.raises(SurveyError, match="no other program uses"):
                invert_archive([str(drops)], out, QuickWorkers())
            return super().work(batch)

    assert invert_archive([str(drops)], out, Meddling()).drops == 6


def test_a_folder_with_foreign_files_is_rejected(drops: Path) -> None:
    with pytest.raises(OptionError, match=r"--archive .*expected a folder that is new"):
        invert_archive([str(drops)], drops, QuickWorkers())
    assert not (drops / "archive.json").exists()


# Surveys


@pytest.fixture
def survey(drops: Path, tmp_path: Path) -> Path:
    """A survey of six points."""
    folder = tmp_path / "surveys" / "road"
    folder.parent.mkdir()
    list(import_files([str(path) for path in sorted(drops.rglob("*.csv"))], folder))
    return folder


def test_a_large_survey_is_inverted_in_pieces(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (source,) = find_sources([str(survey.parent)])
    assert (source.path, source.survey) == (str(survey), True)
    monkeypatch.setattr("pfwd.archive.run.PIECE_DROPS", 4)
    pieces = [(piece.first_point, piece.end_point) for piece in pieces_of(source)]
    assert pieces == [(0, 2), (2, 4), (4, 6)]
    monkeypatch.setattr(running, "BATCH_SOURCES", 1)

    class Stopped(LocalWorkers):
        def work(self, batch: Batch) -> list[SourceOutcome]:
            if len(self.batches) > 1:
                raise KeyboardInterrupt
            return super().work(batch)

    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        invert_archive([str(survey)], out, Stopped())
    assert len(rows(out)) == 4
    summary = invert_archive([str(survey)], out, LocalWorkers())
    assert (summary.inverted, summary.drops) == (2, 8)
    (outcome,) = analyse_files([str(survey)], OPTIONS)
    assert sorted(row["modulus_pa"] for row in rows(out)) == sorted(
        result.modulus_pa for result in outcome.results
    )
    repeated = LocalWorkers()
    assert invert_archive([str(survey)], out, repeated).done_before == 1
    assert repeated.batches == []


def write_repeated_text(path: Path, count: int, length: int) -> None:
    """Write a packed table of some kB in which a text is repeated `count` times."""
    import pyarrow
    from pyarrow import parquet

    def column(field: Any) -> Any:
        if field.type == pyarrow.int64():
            return pyarrow.array(np.ones(count, np.int64))
        text = pyarrow.array(["x" * length])
        return pyarrow.DictionaryArray.from_arrays(np.zeros(count, np.int32), text)

    schema = parquet.read_schema(path)
    parquet.write_table(
        pyarrow.table({field.name: column(field) for field in schema}),
        path,
        compression="zstd",
        store_schema=False,
    )


def refused(part: Path, drops: Path, message: str) -> None:
    with pytest.raises(SurveyError, match=rf"part-000001.*{message}.*remove it"):
        invert_archive([str(drops)], part.parents[2], QuickWorkers())


def test_a_damaged_part_is_rejected_with_a_remedy(drops: Path, part: Path) -> None:
    part.write_bytes(b"PAR1")
    refused(part, drops, "expected")


@pytest.mark.parametrize(("count", "length"), [(3_000_000, 1), (20_000, 100_000)])
def test_a_part_that_unpacks_to_gigabytes_is_refused(
    drops: Path, part: Path, count: int, length: int
) -> None:
    assert (dataset.MAX_PARQUET_ROWS, dataset.MAX_TABLE_BYTES) == (
        10 * running.PART_ROWS,
        64 * 2**20,
    )
    write_repeated_text(part, count, length)
    assert part.stat().st_size < 200_000
    refused(part, drops, "expected a Parquet table")


@pytest.mark.parametrize(
    "change",
    [{"piece": 1}, {"piece": -1}, {"pieces": 10**9}, {"failures": None}, {"file": None}, None],
)
def test_a_part_with_impossible_numbers_or_columns_is_refused(
    drops: Path, part: Path, change: dict[str, Any] | None
) -> None:
    import pyarrow
    from pyarrow import parquet

    table = parquet.read_table(part, partitioning=None)
    changed = [{**row, **(change or {})} for row in table.to_pylist()]
    other = pyarrow.Table.from_pylist(changed, table.schema)
    parquet.write_table(other if change else other.select(["file"]), part)
    refused(part, drops, "got impossible values" if change else "got other columns")
