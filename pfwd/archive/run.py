"""A run over an archive: what is not done yet is found, inverted, and kept part by part.

>>> options = AnalysisOptions(method="least-squares")         # doctest: +SKIP
>>> with contextlib.closing(LocalWorkers(options, 2)) as workers:
...     summary = invert_archive(["drops"], "results", options, workers)
>>> summary.drops, summary.failed
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.dataset import Dataset, Row, diagnosis_row, result_row
from pfwd.archive.identity import run_identity, run_key
from pfwd.archive.ledger import Ledger
from pfwd.archive.sources import (
    Source,
    content_digest,
    find_sources,
    pieces_of,
    refuse_missing,
)
from pfwd.archive.work import Failure, SourceOutcome
from pfwd.archive.workers import Batch, Workers
from pfwd.errors import SurveyError, refusal

BATCH_SOURCES = 16
BATCH_BYTES = 2_000_000
"""Of a batch: a second of work, so that handing it over costs a thousandth of it."""

PART_ROWS = 10_000
PART_SOURCES = 10_000
PART_SECONDS = 60.0
"""When a part is written: what is gathered is lost when this process is killed."""


@dataclass(slots=True)
class Summary:
    """What a run did; counts of sources where nothing else is said."""

    archive: str
    run: str
    """Key of options and software; the tables of this run are in folders of that name."""
    sources: int = 0
    """Found so far."""
    done_before: int = 0
    """Of these, done by a former run."""
    duplicates: int = 0
    """Of these, with the content of another one."""
    inverted: int = 0
    """Of these, inverted now; a survey counts once for each of its pieces."""
    drops: int = 0
    """Drops inverted now, rejected ones among them."""
    points: int = 0
    """Points diagnosed now."""
    failed: int = 0
    """Failures met now."""
    failed_in_all: int = 0
    """Sources of the run with a failure, this run's and former ones'."""
    parts: int = 0
    """Parts written now."""
    processor_seconds: float = 0.0
    """Time of the workers' processors."""
    elapsed_s: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """For a machine."""
        return asdict(self)


Tell = Callable[[Summary, Sequence[Failure]], None]
"""Told of the state after every batch, and of its failures."""


def invert_archive(
    paths: Sequence[str],
    archive: str | os.PathLike[str],
    options: AnalysisOptions,
    workers: Workers,
    tell: Tell | None = None,
    *,
    part_rows: int = PART_ROWS,
    part_seconds: float = PART_SECONDS,
) -> Summary:
    """Invert what is not done yet and keep the results.

    Whatever ends this early costs the work since the last part; the same call goes on.

    Parameters
    ----------
    paths : files, surveys and folders
    archive : folder of the results, see :mod:`pfwd.archive.dataset`
    options : AnalysisOptions
    workers : Workers
    tell : optional
    part_rows, part_seconds : drops and s after which a part is written

    Raises
    ------
    OptionError
        If a path does not exist, or the folder of the results is something else.
    SurveyError
        If another program works on the archive, the disk does not take it, or the workers are lost.
    """
    refuse_missing(paths)
    identity = run_identity(options)
    dataset = Dataset(archive, run_key(identity), identity)
    lock = FileLock(dataset.folder / "archive.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout as err:
        expected = "an archive that nobody else works on"
        hint = "wait for the other program to end"
        raise SurveyError(refusal(str(archive), expected, "one that is", hint)) from err
    with lock:
        dataset.clear_leftovers()
        ledger = Ledger(dataset)
        try:
            run = _Run(dataset, ledger, tell, part_rows, part_seconds)
            return run.go(paths, workers)
        finally:
            ledger.close()


def invert_stream(
    paths: Sequence[str], options: AnalysisOptions, workers: Workers
) -> Iterator[SourceOutcome]:
    """Outcomes of sources as they are done; nothing is kept.

    Raises
    ------
    OptionError
        If a path does not exist.
    SurveyError
        If the workers are lost.
    """
    refuse_missing(paths)
    pieces = (piece for source in find_sources(paths) for piece in pieces_of(source))
    for outcomes in workers.run(batches_of(pieces)):
        yield from outcomes


def batches_of(sources: Iterator[Source]) -> Iterator[Batch]:
    """Sources in batches of about equal work."""
    batch: list[Source] = []
    size = 0
    for source in sources:
        batch.append(source)
        size += max(0, source.size)
        if len(batch) >= BATCH_SOURCES or size >= BATCH_BYTES:
            yield Batch(tuple(batch))
            batch, size = [], 0
    if batch:
        yield Batch(tuple(batch))


@dataclass(frozen=True, slots=True)
class _Done:
    """All rows of a source: gathered in one go, so that no interrupt can part them."""

    source: Row
    results: list[dict[str, Any]] = field(default_factory=list)
    diagnoses: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)


@dataclass(slots=True)
class _Buffer:
    """What is gathered for the next part."""

    sources: list[_Done] = field(default_factory=list)
    begun: float = field(default_factory=time.monotonic)
    number: int | None = None
    """Of the part, once it is being written: written again after an interrupt, it is the same."""
    drops: int = 0
    """Rows of results."""


class _Run:
    def __init__(
        self,
        dataset: Dataset,
        ledger: Ledger,
        tell: Tell | None,
        part_rows: int,
        part_seconds: float,
    ) -> None:
        self._dataset, self._ledger, self._tell = dataset, ledger, tell
        self._part_rows, self._part_seconds = part_rows, part_seconds
        self._summary = Summary(str(dataset.folder), dataset.key)
        self._buffer = _Buffer()
        # Under way or gathered: what the ledger does not know of yet.
        self._pending: dict[str, list[Source]] = {}
        self._settled: dict[str, tuple[str, int]] = {}
        self._unfinished = _Unfinished(dataset.folder / "unfinished" / f"{dataset.key}.jsonl")

    def go(self, paths: Sequence[str], workers: Workers) -> Summary:
        begun = time.perf_counter()
        summary = self._summary
        try:
            self._remove_stale()
            batches = batches_of(self._to_do(paths))
            for outcomes in workers.run(batches):
                self._take(outcomes)
                self._write_if_due()
                summary.elapsed_s = time.perf_counter() - begun
        finally:
            # Also when it was stopped: what is done is done.
            self._write()
            self._unfinished.close()
        self._remove_stale()
        summary.failed_in_all = self._ledger.refused() + self._unfinished.count
        summary.elapsed_s = time.perf_counter() - begun
        self._say([])
        return summary

    def _to_do(self, paths: Sequence[str]) -> Iterator[Source]:
        """Pieces that nobody has inverted."""
        for found in find_sources(paths, str(self._dataset.folder)):
            self._summary.sources += 1
            if self._ledger.is_known(found):
                self._summary.done_before += 1
                continue
            try:
                source = replace(found, digest=content_digest(found))
            except OSError as err:
                reason = refusal(found.path, "a readable file", err.strerror or str(err))
                self._fail(found, [Failure("refused", reason)])
                continue
            known = False
            for piece in pieces_of(source):
                if self._ledger.has_piece(piece):
                    known = True
                elif self._is_new(piece):
                    self._pending[piece.key] = []
                    yield piece
            if known:
                self._ledger.touch(source)
                self._summary.done_before += self._ledger.is_known(source)
            self._write_if_due()

    def _is_new(self, piece: Source) -> bool:
        if piece.key in self._pending:
            if piece.path not in {each.path for each in self._pending[piece.key]}:
                self._pending[piece.key].append(piece)
            return False
        if piece.key in self._settled:
            file, failures = self._settled[piece.key]
            self._add_duplicate(piece, file, failures)
            return False
        other = self._ledger.file_with(piece.digest, piece.piece, piece.pieces)
        if other is not None:
            self._add_duplicate(piece, other, 0)
            return False
        return True

    def _take(self, outcomes: Sequence[SourceOutcome]) -> None:
        met: list[Failure] = []
        for outcome in outcomes:
            source, summary = outcome.source, self._summary
            duplicates = self._pending.pop(source.key, [])
            summary.processor_seconds += outcome.processor_seconds
            met += outcome.failures
            summary.inverted += 1
            summary.drops += len(outcome.results)
            summary.points += len(outcome.diagnoses)
            if not outcome.final:
                self._fail(source, outcome.failures)
                continue
            summary.failed += len(outcome.failures)
            failures = len(outcome.failures)
            done = _Done(
                _source_row(source, len(outcome.results), failures, None),
                [result_row(result, source.digest) for result in outcome.results],
                [diagnosis_row(result, source.digest) for result in outcome.diagnoses],
                [_failure_row(source, failure) for failure in outcome.failures],
            )
            self._buffer.sources.append(done)
            self._buffer.drops += len(done.results) + len(done.diagnoses)
            self._settled[source.key] = (source.path, failures)
            for duplicate in duplicates:
                self._add_duplicate(duplicate, source.path, failures)
        self._say(met)

    def _add_duplicate(self, piece: Source, file: str, failures: int) -> None:
        if piece.path == file:  # named twice
            return
        self._summary.duplicates += 1
        self._buffer.sources.append(_Done(_source_row(piece, 0, failures, file)))

    def _fail(self, source: Source, failures: Sequence[Failure]) -> None:
        """Failures that are no property of the content: tried again by the next run."""
        self._summary.failed += len(failures)
        for failure in failures:
            self._unfinished.add(_failure_row(source, failure))

    def _write_if_due(self) -> None:
        buffer = self._buffer
        old = time.monotonic() - buffer.begun >= self._part_seconds
        full = buffer.drops >= self._part_rows or len(buffer.sources) >= PART_SOURCES
        if full or old:
            self._write()

    def _write(self) -> None:
        buffer = self._buffer
        if buffer.sources:
            if buffer.number is None:
                buffer.number = self._ledger.next_number()
            sources = [done.source for done in buffer.sources]
            self._dataset.write(
                buffer.number,
                [row for done in buffer.sources for row in done.results],
                [row for done in buffer.sources for row in done.diagnoses],
                [row for done in buffer.sources for row in done.failures],
                sources,
            )
            self._ledger.add(buffer.number, sources)
            self._summary.parts += 1
        self._settled.clear()
        self._buffer = _Buffer()

    def _remove_stale(self) -> None:
        """Rows of files that have been written anew since."""
        for number, digests in self._ledger.stale().items():
            self._dataset.remove_content(number, digests)
            self._ledger.clean(number)

    def _say(self, met: Sequence[Failure]) -> None:
        if self._tell is not None:
            self._tell(self._summary, met)


class _Unfinished:
    """The file with what the next run will try again; there is none when there is nothing."""

    def __init__(self, path: Path) -> None:
        self._path, self._draft = path, path.with_name(path.name + ".tmp")
        self._stream: Any = None
        self.count = 0

    def add(self, row: Row) -> None:
        if self._stream is None:
            self._path.parent.mkdir(exist_ok=True)
            self._stream = open(self._draft, "w", encoding="utf-8", newline="\n")  # noqa: SIM115
        self._stream.write(json.dumps(row) + "\n")
        self.count += 1

    def close(self) -> None:
        if self._stream is None:
            self._path.unlink(missing_ok=True)
            return
        self._stream.close()
        os.replace(self._draft, self._path)


def _failure_row(source: Source, failure: Failure) -> dict[str, Any]:
    return {
        "file": source.path,
        "source_sha256": source.digest,
        "point": failure.point,
        "kind": failure.kind,
        "reason": failure.reason,
    }


def _source_row(source: Source, drops: int, failures: int, same_as: str | None) -> dict[str, Any]:
    return {
        "file": source.path,
        "source_sha256": source.digest,
        "size_bytes": source.size,
        "mtime_ns": source.mtime_ns,
        "piece": source.piece,
        "pieces": source.pieces,
        "drops": drops,
        "failures": failures,
        "same_as": same_as,
    }
