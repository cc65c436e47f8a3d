"""Inversion of an archive: sources without stored results are inverted, and theirs are stored.

>>> options = AnalysisOptions(method="posterior")         # doctest: +SKIP
>>> with contextlib.closing(ArchiveWorkers(options, 2)) as workers:  # doctest: +SKIP
...     summary = invert_archive(["drops"], "results", workers)
>>> summary.drops, summary.failed  # doctest: +SKIP
"""

import hashlib
import itertools
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from filelock import FileLock, Timeout

from pfwd.analysis.options import AnalysisOptions
from pfwd.archive.dataset import (
    TABLES,
    ArchiveFolder,
    Row,
    SourceRow,
    diagnosis_row,
    result_row,
)
from pfwd.archive.work import (
    ArchiveWorkers,
    Batch,
    Source,
    SourceFailure,
    SourceOutcome,
    source_of_file,
    source_of_survey,
    survey_files,
)
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.folders import SURVEY_FILE_SUFFIX, is_survey, is_survey_file
from pfwd.files.foreign.registry import foreign_suffixes
from pfwd.files.opening import survey_content
from pfwd.files.output_path import replaced_at_once
from pfwd_device.recording.drop_file import software_version

TABLE_VERSION = 1
"""Version of the tables, part of the run's key: raised when a column changes its meaning, so that
old and new rows do not mix."""

PFWD_SUFFIXES = (".csv", ".h5", SURVEY_FILE_SUFFIX)
"""Suffixes, in small letters, of this program's own files with drops."""

PIECE_DROPS = 500
"""Drops in a piece of a survey: half a minute of work, which an interruption loses."""

_CHUNK_BYTES = 1 << 20

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


def find_sources(paths: Sequence[str], leave_out: str | None = None) -> Iterator[Source]:
    """Yield the named files and surveys, and those in named folders, sorted by name.

    A file in a folder is a source if its suffix is one of this program or of a format that it
    imports; a file that is named itself always is. Links to folders are not followed.

    Parameters
    ----------
    paths : sequence of str
        Files, surveys and folders.
    leave_out : str, optional
        Folder that is skipped: the one for the results.

    Raises
    ------
    OptionError
        If one of `paths` does not exist.
    """
    refuse_missing(paths)
    skipped = None if leave_out is None else os.path.realpath(leave_out)
    suffixes = (*PFWD_SUFFIXES, *foreign_suffixes())
    for path in paths:
        absolute = os.path.abspath(path)
        if os.path.isdir(absolute):
            yield from _sources_below(absolute, skipped, suffixes)
        else:
            yield source_of_file(absolute)


def refuse_missing(paths: Sequence[str]) -> None:
    """Raise an error for the first path that does not exist.

    Raises
    ------
    OptionError
    """
    for path in paths:
        if not os.path.exists(path):
            raise OptionError(refusal(path, "a file or folder", "nothing of that name"))


def _sources_below(folder: str, skipped: str | None, suffixes: tuple[str, ...]) -> Iterator[Source]:
    if skipped is not None and os.path.realpath(folder) == skipped:
        return
    if is_survey(folder):
        yield source_of_survey(folder)
        return
    try:
        with os.scandir(folder) as listing:
            entries = sorted(listing, key=lambda entry: entry.name)
    except OSError:
        # Reading it as a file fails with the reason, which is stored like any other failure.
        yield Source(folder, -1, 0)
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _sources_below(entry.path, skipped, suffixes)
        elif entry.name.lower().endswith(suffixes):
            yield source_of_file(entry.path)


def content_digest(source: Source) -> str:
    """Return the SHA-256 of the content of a source, in hexadecimal digits.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    if not source.survey:
        with open(source.path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    digest = hashlib.sha256()
    for name in survey_files(source.path):
        path = os.path.join(source.path, name)
        if not os.path.isfile(path):
            continue
        digest.update(f"{name.replace(os.sep, '/')}\0{os.path.getsize(path)}\0".encode())
        with open(path, "rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    return digest.hexdigest()


def pieces_of(source: Source) -> list[Source]:
    """Divide a survey into pieces of complete points, with about `PIECE_DROPS` drops each.

    Other sources, and a survey that cannot be read, are one piece: its inversion then reports the
    reason.
    """
    # Any error is reported later, by the inversion of the source.
    try:
        if not (source.survey or is_survey_file(source.path)):
            return [source]
        points = survey_content(source.path).points
    except Exception:
        return [source]
    ends, drops = [0], 0
    for number, point in enumerate(points, start=1):
        drops += len(point.drops)
        if drops >= PIECE_DROPS:
            ends.append(number)
            drops = 0
    if ends[-1] < len(points):
        ends.append(len(points))
    if len(ends) <= 2:
        return [source]
    bounds = list(itertools.pairwise(ends))
    return [
        replace(source, piece=n, pieces=len(bounds), first_point=first, end_point=end)
        for n, (first, end) in enumerate(bounds)
    ]


def invert_archive(
    paths: Sequence[str],
    archive: str | os.PathLike[str],
    workers: ArchiveWorkers,
    report: ReportProgress | None = None,
) -> Summary:
    """Invert the sources that have no stored results, and store theirs.

    After an interruption the work since the last part is lost; the same call continues from there.

    Parameters
    ----------
    paths : sequence of str
        Files, surveys and folders.
    archive : path
        Folder of the results, see :mod:`pfwd.archive.dataset`.
    workers : ArchiveWorkers
    report : callable, optional
        Receives the counts after every batch.

    Raises
    ------
    OptionError
        If a path does not exist, or the folder of the results holds other files.
    SurveyError
        If another program uses the archive, it cannot be written, or the workers are lost.
    """
    dataset = ArchiveFolder(archive, run_identity(workers.options))
    try:
        with FileLock(dataset.folder / "archive.lock", timeout=0):
            return _Run(dataset, report).go(paths, workers)
    except Timeout as err:
        expected, hint = "an archive that no other program uses", "wait for that program to end"
        raise SurveyError(refusal(str(archive), expected, "one in use", hint)) from err


def invert_stream(paths: Sequence[str], workers: ArchiveWorkers) -> Iterator[SourceOutcome]:
    """Yield the outcome of each source when it is complete; nothing is stored.

    Raises
    ------
    OptionError
        If a path does not exist.
    SurveyError
        If the workers are lost.
    """
    pieces = (piece for source in find_sources(paths) for piece in pieces_of(source))
    for outcomes in workers.run(batches_of(pieces)):
        yield from outcomes


def batches_of(sources: Iterator[Source]) -> Iterator[Batch]:
    """Yield the sources in batches of at most 16, or of about 2 MB."""
    batch: Batch = ()
    size = 0
    for source in sources:
        batch = (*batch, source)
        size += max(0, source.size)
        if len(batch) >= BATCH_SOURCES or size >= BATCH_BYTES:
            yield batch
            batch, size = (), 0
    if batch:
        yield batch


SourceRows = Mapping[str, list[Row]]
"""Rows of one source in each of `TABLES`."""


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
    def __init__(self, dataset: ArchiveFolder, report: ReportProgress | None) -> None:
        self._dataset, self._report = dataset, report
        self._stored = StoredSources()
        self._next_number = 1
        for number in dataset.clear_leftovers():
            self._stored.add(dataset.sources(number))
            self._next_number = number + 1
        self._summary = Summary(str(dataset.folder), dataset.key)
        # Rows for the next part of the tables. All rows of a source are one element, so that an
        # interrupt cannot separate them.
        self._buffer: list[SourceRows] = []
        self._n_rows = 0
        self._part_start_s = time.monotonic()
        # Sources that were sent to a worker, each with its copies.
        self._pending: dict[str, list[Source]] = {}
        self._unfinished: list[Row] = []

    def go(self, paths: Sequence[str], workers: ArchiveWorkers) -> Summary:
        start_s = time.perf_counter()
        summary = self._summary
        try:
            self._remove_stale()
            for outcomes in workers.run(batches_of(self._missing_pieces(paths))):
                self._add_outcomes(outcomes)
                self._write_if_due()
                summary.elapsed_s = time.perf_counter() - start_s
        finally:
            # Store the completed sources after an interrupt, too.
            self._write()
            self._write_unfinished()
        self._remove_stale()
        summary.failed_in_all = self._stored.n_refused() + len(self._unfinished)
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
            self._add_rows(
                {
                    "results": [
                        result_row(result, source.digest, declared)
                        for result, declared in outcome.results
                    ],
                    "diagnoses": [diagnosis_row(d, source.digest) for d in outcome.diagnoses],
                    "failures": [_failure_row(source, failure) for failure in outcome.failures],
                    "sources": [
                        _source_row(
                            source, drops=len(outcome.results), failures=len(outcome.failures)
                        )
                    ],
                }
            )
            for duplicate in duplicates:
                self._add_duplicate(duplicate, source.path)
        self._report_progress(batch_failures)

    def _add_duplicate(self, piece: Source, file: str) -> None:
        if piece.path == file:  # named twice
            return
        self._summary.duplicates += 1
        row = _source_row(piece, failures=self._stored.n_failures(file), same_as=file)
        self._add_rows({"results": [], "diagnoses": [], "failures": [], "sources": [row]})

    def _add_rows(self, rows: SourceRows) -> None:
        self._buffer.append(rows)
        self._n_rows += len(rows["results"]) + len(rows["diagnoses"])
        self._stored.add(rows["sources"])

    def _fail(self, source: Source, failures: Sequence[SourceFailure]) -> None:
        """Record failures that have no cause in the content, so that the next run tries again."""
        self._summary.failed += len(failures)
        self._unfinished += [_failure_row(source, failure) for failure in failures]

    def _write_if_due(self) -> None:
        is_late = time.monotonic() - self._part_start_s >= PART_SECONDS
        if self._n_rows >= PART_ROWS or len(self._buffer) >= PART_SOURCES or is_late:
            self._write()

    def _write(self) -> None:
        if self._buffer:
            tables = {name: [row for rows in self._buffer for row in rows[name]] for name in TABLES}
            self._dataset.write(self._next_number, tables)
            self._summary.parts += 1
            # In this order: after an interrupt the same rows may be written once more to this part.
            self._buffer = []
            self._n_rows = 0
            self._next_number += 1
        self._part_start_s = time.monotonic()

    def _write_unfinished(self) -> None:
        """List the sources to be tried again in a file; remove it if there are none."""
        path = self._dataset.folder / "unfinished" / f"{self._dataset.key}.jsonl"
        if not self._unfinished:
            path.unlink(missing_ok=True)
            return
        path.parent.mkdir(exist_ok=True)
        lines = [json.dumps(row) + "\n" for row in self._unfinished]
        with replaced_at_once(path) as draft:
            draft.write_text("".join(lines), encoding="utf-8", newline="\n")

    def _remove_stale(self) -> None:
        """Remove the stored rows of files that have changed since."""
        if self._stored.stale:
            self._dataset.remove_content(self._stored.stale)
            self._stored.stale.clear()

    def _report_progress(self, failures: Sequence[SourceFailure]) -> None:
        if self._report is not None:
            self._report(self._summary, failures)


def _failure_row(source: Source, failure: SourceFailure) -> Row:
    return {"file": source.path, "source_sha256": source.digest, **asdict(failure)}


def _source_row(source: Source, **counts: Any) -> Row:
    identity = (source.path, source.digest, source.size, source.mtime_ns)
    return asdict(SourceRow(*identity, source.piece, source.pieces, **counts))
