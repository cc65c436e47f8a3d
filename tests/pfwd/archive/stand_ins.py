"""Stand-ins for the processes of an archive, and the content of its tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pyarrow import dataset as tables

from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.work import ArchiveWorkers, Batch, SourceOutcome, invert_batch
from tests.pfwd.archive.worker_functions import quick

OPTIONS = AnalysisOptions(method="posterior", sensors="centre", bedrock_depth=1.2)
"""Quick settings of the inversion."""


class LocalWorkers(ArchiveWorkers):
    """Work in this process."""

    def __init__(self, options: AnalysisOptions = OPTIONS) -> None:
        super().__init__(options)
        self.batches: list[Batch] = []

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        for batch in batches:
            self.batches.append(batch)
            yield self.work(batch)

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return invert_batch(batch, self.options)


class QuickWorkers(LocalWorkers):
    """Invent a result for each source, for tests of anything but the inversion."""

    def work(self, batch: Batch) -> list[SourceOutcome]:
        return quick(batch, self.options)


def rows(archive: Path, table: str = "results") -> list[dict[str, Any]]:
    where = archive / table
    if not where.is_dir():
        return []
    records = tables.dataset(where, format="parquet", partitioning="hive").to_table().to_pylist()
    return sorted(records, key=lambda row: (row["file"], row.get("drop") or 0))


def facts(archive: Path) -> list[tuple[Any, ...]]:
    """Return the values that must not depend on interruptions."""
    return [(row["file"], row["drop"], row["status"], row["modulus_pa"]) for row in rows(archive)]
