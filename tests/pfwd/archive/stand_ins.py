"""Stand-ins for the processes of an archive, and what its tables hold."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pyarrow import dataset as tables

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.archive.work import ArchiveWorkers, Batch, Source, SourceOutcome, invert_batch


class HereWorkers(ArchiveWorkers):
    """Works in this process, or as a test says."""

    def __init__(self, options: AnalysisOptions) -> None:
        super().__init__(options)
        self.taken: list[Batch] = []

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        for batch in batches:
            self.taken.append(batch)
            yield self.work(batch)

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return invert_batch(batch, self.options)


class QuickWorkers(HereWorkers):
    """Invents a result a source: for what has nothing to do with inverting."""

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return [SourceOutcome(source, [(invented(source), {})]) for source in batch]


def invented(source: Source) -> DropResult:
    return DropResult(file=source.path, drop=1, status="measured", modulus_pa=4e7)


def rows(archive: Path, table: str = "results") -> list[dict[str, Any]]:
    where = archive / table
    if not where.is_dir():
        return []
    found = tables.dataset(where, format="parquet", partitioning="hive").to_table().to_pylist()
    return sorted(found, key=lambda row: (row["file"], row.get("drop") or 0))


def facts(archive: Path) -> list[tuple[Any, ...]]:
    """What must not depend on how often a run was cut off."""
    return [(row["file"], row["drop"], row["status"], row["modulus_pa"]) for row in rows(archive)]
