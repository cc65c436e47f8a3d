"""Inversion of an archive: sources without stored results are inverted, and theirs are stored.

>>> options = AnalysisOptions(method="posterior")         # doctest: +SKIP
>>> with contextlib.closing(ArchiveWorkers(options, 2)) as workers:  # doctest: +SKIP
...     summary = invert_archive(["drops"], "results", options, workers)
>>> summary.drops, summary.failed  # doctest: +SKIP
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.dataset import ArchiveFolder, Row, diagnosis_row, result_row
from pfwd.archive.sources import (
    Source,
    content_digest,
    find_sources,
    pieces_of,
    refuse_missing,
)
from pfwd.archive.work import ArchiveWorkers, Batch, SourceFailure, SourceOutcome
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd_device.recording.drop_file import software_version

TABLE_VERSION = 1
"""Version of the tables, part of the run's key: raised when a column changes its meaning, so that
old and new rows do not mix."""

BATCH_SOURCES = 16
BATCH_BYTES = 2_000_000
"""Largest number of sources and of bytes in a batch: about a second of work, so that sending it to
a worker costs 0.1 %."""

PART_ROWS = 10_000
PART_SOURCES = 10_000
PART_SECONDS = 60.0
"""Number of rows and of sources, and time, after which a part is written; rows in memory are lost
if this process is killed."""


@dataclass(slots=True)
class Summary:
    """Counts of an inversion of an archive; the field names are the JSON keys.

    A source is a file, or a survey.
    """

    archive: str
    run: str
    """Key of options and software; names the folders with the tables of this run."""
    sources: int = 0
    """Sources listed so far."""
    done_before: int = 0
    """Sources whose results were stored by an earlier call."""
    duplicates: int = 0
    """Sources with the same content as another one."""
    inverted: int = 0
    """Sources inverted by this call; a large survey counts once for each of its pieces."""
    drops: int = 0
    """Drops inverted by this call, rejected ones included."""
    points: int = 0
    """Points diagnosed by this call."""
    failed: int = 0
    """Failures of this call."""
    failed_in_all: int = 0
    """Sources with a failure, in this or an earlier call with the same key."""
    parts: int = 0
    """Parts of the tables written by this call."""
    processor_seconds: float = 0.0
    """Processor time of the workers, s."""
    elapsed_s: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as JSON data."""
        return asdict(self)


ReportProgress = Callable[[Summary, Sequence[SourceFailure]], None]
"""Function that is called after every batch with the counts so far and the failures of the batch.
"""


def run_identity(options: AnalysisOptions) -> dict[str, Any]:
    """Return the options, the software versions and the table version that results depend on.

    The file of ``--header`` enters by the SHA-256 of its content.

    Raises
    ------
    OptionError
        If the file of ``--header`` cannot be read.
    """
    settings = asdict(options)
    header = settings.pop("header")
    digest = None
    if header is not None:
        try:
            with open(header, "rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
        except OSError as err:
            reason = err.strerror or str(err)
            raise OptionError(refusal(f"--header {header}", "a TOML file", reason)) from err
    return {
        "format": TABLE_VERSION,
        "software": software_version(),
        "options": settings,
        "header_sha256": digest,
    }


def run_key(identity: dict[str, Any]) -> str:
    """Return the key of a run: the first twelve hexadecimal digits of its identity's SHA-256."""
    text = json.dumps(identity, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def invert_archive(
    paths: Sequence[str],
    archive: str | os.PathLike[str],
    options: AnalysisOptions,
    workers: ArchiveWorkers,
    report: ReportProgress | None = None,
    *,
    part_rows: int = PART_ROWS,
    part_seconds: float = PART_SECONDS,
) -> Summary:
    """Invert the sources that have no stored results, and store theirs.

    After an interruption the work since the last part is lost; the same call continues from there.

    Parameters
    ----------
    paths : sequence of str
        Files, surveys and folders.
    archive : path
        Folder of the results, see :mod:`pfwd.archive.dataset`.
    options : AnalysisOptions
    workers : ArchiveWorkers
    report : callable, optional
        Receives the counts after every batch.
    part_rows : int
        Number of drops after which a part is written.
    part_seconds : float, s
        Time after which a part is written.

    Raises
    ------
    OptionError
        If a path does not exist, or the folder of the results holds other files.
    SurveyError
        If another program uses the archive, it cannot be written, or the workers are lost.
    """
    refuse_missing(paths)
    identity = run_identity(options)
    dataset = ArchiveFolder(archive, run_key(identity), identity)
    lock = FileLock(dataset.folder / "archive.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout as err:
        expected, hint = "an archive that no other program uses", "wait for that program to end"
        raise SurveyError(refusal(str(archive), expected, "one in use", hint)) from err
    with lock:
        return _Run(dataset, report, part_rows, part_seconds).go(paths, workers)


def invert_stream(
    paths: Sequence[str], options: AnalysisOptions, workers: ArchiveWorkers
) -> Iterator[SourceOutcome]:
    """Yield the outcome of each source when it is complete; nothing is stored.

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
    """Yield the sources in batches of at most 16, or of about 2 MB."""
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
class _SourceRows:
    """All rows of one source, kept in one object so that an interrupt cannot separate them."""

    source: Row
    results: list[dict[str, Any]] = field(default_factory=list)
    diagnoses: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)


@dataclass(slots=True)
class _Buffer:
    """Rows in memory for the next part of the tables."""

    sources: list[_SourceRows] = field(default_factory=list)
    start_s: float = field(default_factory=time.monotonic)
    number: int | None = None
    """Number of the part; set at the first attempt to write it, and kept if that is interrupted."""
    result_rows: int = 0
    """Number of result rows and diagnosis rows."""


@dataclass(slots=True)
class _StoredFile:
    digest: str
    pieces: int
    size: int = -1
    mtime_ns: int = 0
    stored: int = 0
    """Bit n is set if the results of piece n are stored."""
    failures: int = 0


class StoredSources:
    """Sources whose results are stored in a run, with about 0.6 kB of memory for each."""

    def __init__(self) -> None:
        self._files: dict[str, _StoredFile] = {}
        """Files and surveys by path."""
        self._paths: dict[str, list[str]] = {}
        """Paths of the files with a content, by its SHA-256."""
        self.stale: set[str] = set()
        """SHA-256 of the contents of changed files that no other file has."""

    def add(self, rows: Iterable[Row]) -> None:
        """Add rows of the table ``sources``; a row replaces an earlier one of the same file."""
        for row in rows:
            path, digest = row["file"], row["source_sha256"]
            file = self._files.get(path)
            if file is None or (file.digest, file.pieces) != (digest, row["pieces"]):
                if file is not None:
                    paths = self._paths[file.digest]
                    paths.remove(path)
                    if not paths:
                        del self._paths[file.digest]
                        self.stale.add(file.digest)
                file = self._files[path] = _StoredFile(digest, row["pieces"])
                self._paths.setdefault(digest, []).append(path)
                self.stale.discard(digest)
            file.size, file.mtime_ns = row["size_bytes"], row["mtime_ns"]
            file.stored |= 1 << row["piece"]
            file.failures += row["failures"]

    def is_complete(self, source: Source) -> bool:
        """Return whether all pieces are stored; path, size and time have to agree."""
        file = self._files.get(source.path)
        if file is None or (file.size, file.mtime_ns) != (source.size, source.mtime_ns):
            return False
        return file.stored == (1 << file.pieces) - 1

    def has_piece(self, source: Source) -> bool:
        """Return whether this piece is stored for the present content of the source."""
        file = self._files.get(source.path)
        content = (source.digest, source.pieces)
        if file is None or (file.digest, file.pieces) != content:
            return False
        return bool(file.stored >> source.piece & 1)

    def file_with(self, source: Source) -> str | None:
        """Return a file whose results for a piece with the same content are stored, or None."""
        paths = self._paths.get(source.digest, ())
        return next((path for path in paths if self.has_piece(replace(source, path=path))), None)

    def touch(self, source: Source) -> None:
        """Note the present size and time of a source whose content has not changed."""
        file = self._files[source.path]
        file.size, file.mtime_ns = source.size, source.mtime_ns

    def n_failures(self, path: str) -> int:
        """Return the number of failures of a stored file."""
        return self._files[path].failures

    def n_refused(self) -> int:
        """Return the number of files with at least one failure."""
        return sum(file.failures > 0 for file in self._files.values())


class _Run:
    def __init__(
        self,
        dataset: ArchiveFolder,
        report: ReportProgress | None,
        part_rows: int,
        part_seconds: float,
    ) -> None:
        self._dataset, self._report = dataset, report
        self._stored = StoredSources()
        self._next_number = 1
        for number in dataset.clear_leftovers():
            self._stored.add(dataset.sources(number))
            self._next_number = number + 1
        self._part_rows, self._part_seconds = part_rows, part_seconds
        self._summary = Summary(str(dataset.folder), dataset.key)
        self._buffer = _Buffer()
        # Sources that were sent to a worker, each with its copies.
        self._pending: dict[str, list[Source]] = {}
        self._unfinished = _Unfinished(dataset.folder / "unfinished" / f"{dataset.key}.jsonl")

    def go(self, paths: Sequence[str], workers: ArchiveWorkers) -> Summary:
        start_s = time.perf_counter()
        summary = self._summary
        try:
            self._remove_stale()
            batches = batches_of(self._missing_pieces(paths))
            for outcomes in workers.run(batches):
                self._add_outcomes(outcomes)
                self._write_if_due()
                summary.elapsed_s = time.perf_counter() - start_s
        finally:
            # Store the completed sources after an interrupt, too.
            self._write()
            self._unfinished.close()
        self._remove_stale()
        summary.failed_in_all = self._stored.n_refused() + self._unfinished.count
        summary.elapsed_s = time.perf_counter() - start_s
        self._report_progress([])
        return summary

    def _missing_pieces(self, paths: Sequence[str]) -> Iterator[Source]:
        """Yield the pieces of sources without stored results."""
        for source in find_sources(paths, str(self._dataset.folder)):
            self._summary.sources += 1
            if self._stored.is_complete(source):
                self._summary.done_before += 1
                continue
            try:
                source = replace(source, digest=content_digest(source))
            except OSError as err:
                reason = refusal(source.path, "a readable file", err.strerror or str(err))
                self._fail(source, [SourceFailure("refused", reason)])
                continue
            is_stored = False
            for piece in pieces_of(source):
                if self._stored.has_piece(piece):
                    is_stored = True
                elif self._is_new(piece):
                    self._pending[piece.key] = []
                    yield piece
            if is_stored:
                self._stored.touch(source)
                self._summary.done_before += self._stored.is_complete(source)
            self._write_if_due()

    def _is_new(self, piece: Source) -> bool:
        if piece.key in self._pending:
            if piece.path not in {each.path for each in self._pending[piece.key]}:
                self._pending[piece.key].append(piece)
            return False
        file = self._stored.file_with(piece)
        if file is not None:
            self._add_duplicate(piece, file)
        return file is None

    def _add_outcomes(self, outcomes: Sequence[SourceOutcome]) -> None:
        batch_failures: list[SourceFailure] = []
        for outcome in outcomes:
            source, summary = outcome.source, self._summary
            duplicates = self._pending.pop(source.key, [])
            summary.processor_seconds += outcome.processor_seconds
            batch_failures += outcome.failures
            summary.inverted += 1
            summary.drops += len(outcome.results)
            summary.points += len(outcome.diagnoses)
            if not outcome.final:
                self._fail(source, outcome.failures)
                continue
            summary.failed += len(outcome.failures)
            rows = _SourceRows(
                _source_row(source, len(outcome.results), len(outcome.failures), None),
                [result_row(item, source.digest, declared) for item, declared in outcome.results],
                [diagnosis_row(result, source.digest) for result in outcome.diagnoses],
                [_failure_row(source, failure) for failure in outcome.failures],
            )
            self._add_rows(rows)
            self._buffer.result_rows += len(rows.results) + len(rows.diagnoses)
            for duplicate in duplicates:
                self._add_duplicate(duplicate, source.path)
        self._report_progress(batch_failures)

    def _add_duplicate(self, piece: Source, file: str) -> None:
        if piece.path == file:  # named twice
            return
        self._summary.duplicates += 1
        failures = self._stored.n_failures(file)
        self._add_rows(_SourceRows(_source_row(piece, 0, failures, file)))

    def _add_rows(self, rows: _SourceRows) -> None:
        self._buffer.sources.append(rows)
        self._stored.add([rows.source])

    def _fail(self, source: Source, failures: Sequence[SourceFailure]) -> None:
        """Record failures that have no cause in the content, so that the next run tries again."""
        self._summary.failed += len(failures)
        for failure in failures:
            self._unfinished.add(_failure_row(source, failure))

    def _write_if_due(self) -> None:
        buffer = self._buffer
        if (
            buffer.result_rows >= self._part_rows
            or len(buffer.sources) >= PART_SOURCES
            or time.monotonic() - buffer.start_s >= self._part_seconds
        ):
            self._write()

    def _write(self) -> None:
        buffer = self._buffer
        if buffer.sources:
            if buffer.number is None:
                buffer.number = self._next_number
                self._next_number += 1
            self._dataset.write(
                buffer.number,
                [row for each in buffer.sources for row in each.results],
                [row for each in buffer.sources for row in each.diagnoses],
                [row for each in buffer.sources for row in each.failures],
                [each.source for each in buffer.sources],
            )
            self._summary.parts += 1
        self._buffer = _Buffer()

    def _remove_stale(self) -> None:
        """Remove the stored rows of files that have changed since."""
        if self._stored.stale:
            self._dataset.remove_content(self._stored.stale)
            self._stored.stale.clear()

    def _report_progress(self, failures: Sequence[SourceFailure]) -> None:
        if self._report is not None:
            self._report(self._summary, failures)


class _Unfinished:
    """File that lists the sources to be tried again; removed when there are none."""

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


def _failure_row(source: Source, failure: SourceFailure) -> dict[str, Any]:
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
