"""Sources of an archive, and their inversion or diagnosis by one worker.

Nothing is written, so that a batch may be repeated at any time, on any computer.
"""

import contextlib
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

from inversion import InversionError
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.diagnosis.diagnose import diagnose_entries
from pfwd.analysis.diagnosis.entries import DiagnosisPoint, entry_of
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.response_tables import library_of_process
from pfwd.analysis.results import DiagnosisResult, DropResult
from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_survey_file
from pfwd.files.header import declarations_of
from pfwd.files.opening import survey_content
from pfwd.files.reading import points_of, read_points
from pfwd.files.traces import TracePoint
from pfwd.jobs import Jobs, WorkerDied
from pfwd.judging.verdicts import modulus_in_force
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey

_RECORD_FOLDERS = ("journal", "drops")
"""Folders of a survey with its recorded drops; other files in it do not change its content."""
_SURVEY_LEDGER = "acknowledged.txt"


@dataclass(frozen=True, slots=True)
class Source:
    """File or survey to be inverted, or a piece of a large survey: a range of its points."""

    path: str
    """Absolute path."""
    size: int
    """Size in bytes; for a survey the sum over its files."""
    mtime_ns: int
    """Time of the last change, ns since 1970; for a survey that of the file changed last."""
    survey: bool = False
    """True if the source is the folder of a survey."""
    digest: str = ""
    """SHA-256 of the content; empty: not computed yet."""
    piece: int = 0
    """Number of this piece of a survey, from 0."""
    pieces: int = 1
    """Number of pieces of the survey."""
    first_point: int = 0
    """Index of the first point in the piece."""
    end_point: int | None = None
    """Index after the last point in the piece; None: up to the last point of the survey."""

    @property
    def key(self) -> str:
        """Identity of content and piece; sources with the same key are inverted once."""
        return self.digest if self.pieces == 1 else f"{self.digest}:{self.piece}/{self.pieces}"


def source_of_file(path: str) -> Source:
    try:
        status = os.stat(path)
    except OSError:
        return Source(path, -1, 0)
    return Source(path, status.st_size, status.st_mtime_ns)


def source_of_survey(folder: str) -> Source:
    size = latest = 0
    for name in survey_files(folder):
        try:
            status = os.stat(os.path.join(folder, name))
        except OSError:
            continue
        size, latest = size + status.st_size, max(latest, status.st_mtime_ns)
    return Source(folder, size, latest, survey=True)


def survey_files(folder: str) -> list[str]:
    names = [_SURVEY_LEDGER]
    for part in _RECORD_FOLDERS:
        with contextlib.suppress(OSError):
            listing = sorted(os.listdir(os.path.join(folder, part)))
            names += [os.path.join(part, name) for name in listing]
    return names


def is_unchanged(source: Source) -> bool:
    """Return whether the file or survey still has the size and time that the source records."""
    now = source_of_survey(source.path) if source.survey else source_of_file(source.path)
    return (now.size, now.mtime_ns) == (source.size, source.mtime_ns)


FailureKind = Literal["refused", "damage", "unforeseen", "worker", "changed"]

TRANSIENT_FAILURES: frozenset[FailureKind] = frozenset({"worker", "changed"})
"""Kinds of failures that have no cause in the source; it is tried again when the archive is
continued."""

MAX_DEATHS_PER_SOURCE = 3
"""Workers that may die while they work on a batch, and then on each of its sources by itself; the
first ones may have been killed for another reason."""

MAX_CONSECUTIVE_FAILURES = 7
"""Batches that may fail by the death of workers without a completed batch in between; more have a
cause in the computer and not in a source."""


@dataclass(frozen=True, slots=True)
class SourceFailure:
    """Reason why a source, or a point of it, has no result."""

    kind: FailureKind
    """refused: source or point is not valid; damage: its data were lost before; unforeseen: an
    error of this program; worker: the worker process died; changed: the source changed during the
    work."""
    reason: str
    """Reason in one line."""
    point: str | None = None
    """Name of the test point; None: the failure concerns the source as a whole."""


@dataclass(frozen=True, slots=True)
class SourceOutcome:
    """Results and failures of one source, or of one piece of a survey."""

    source: Source
    results: list[tuple[DropResult, Mapping[str, Any]]] = field(default_factory=list)
    """One for each drop, with the declarations of its point."""
    diagnoses: list[DiagnosisResult] = field(default_factory=list)
    """One for each point, if the options request diagnoses in place of inversions."""
    failures: list[SourceFailure] = field(default_factory=list)
    processor_seconds: float = 0.0
    """Processor time of the work, s."""

    @property
    def final(self) -> bool:
        """True if another attempt would have the same outcome."""
        return not any(failure.kind in TRANSIENT_FAILURES for failure in self.failures)


Batch = tuple[Source, ...]
"""Sources that are sent to one worker together."""


class ArchiveWorkers:
    """Worker processes on this computer; if one dies, its batch is repeated.

    Parameters
    ----------
    options : AnalysisOptions
    count : int, >= 1
        Number of processes.
    """

    def __init__(self, options: AnalysisOptions, count: int = 1) -> None:
        self.options = options
        self._jobs = Jobs(count, attempts=MAX_DEATHS_PER_SOURCE)
        self._executor: Executor | Jobs = self._jobs

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Yield the outcomes of each batch when it is complete, in any order.

        Batches are taken from the iterator only when a worker is free or will be next.

        Raises
        ------
        SurveyError
            If the workers are lost, or none of them stays alive.
        """
        submitted: dict[Future[list[SourceOutcome]], Batch] = {}
        waiting: list[Batch] = []
        failed = 0
        while True:
            while len(submitted) < self._max_batches():
                batch = waiting.pop() if waiting else next(batches, None)
                if batch is None:
                    break
                request = self._executor.submit(invert_batch, batch, self.options)
                submitted[request] = batch
            if not submitted:
                return
            for request in wait(submitted, return_when=FIRST_COMPLETED).done:
                batch = submitted.pop(request)
                outcomes = self._outcomes(request)
                failed = failed + 1 if outcomes is None else 0
                if failed >= MAX_CONSECUTIVE_FAILURES:
                    actual = f"{failed * MAX_DEATHS_PER_SOURCE} that ended"
                    expected = "processes that stay alive"
                    raise SurveyError(refusal("worker processes", expected, actual))
                if outcomes is not None:
                    yield outcomes
                elif len(batch) > 1:  # by itself, the source that is the cause shows
                    waiting += [(source,) for source in batch]
                else:
                    yield [SourceOutcome(batch[0], failures=[_death_of_workers(batch[0])])]

    def close(self) -> None:
        """End the workers; outcomes that were not yielded are lost."""
        self._jobs.close()

    def _max_batches(self) -> int:
        """Return the number of batches to keep requested."""
        return 2 * self._jobs.count

    def _outcomes(self, request: Future[list[SourceOutcome]]) -> list[SourceOutcome] | None:
        """Return the outcomes of a complete request; None: its worker died."""
        try:
            return request.result()
        except WorkerDied:
            return None


def _death_of_workers(source: Source) -> SourceFailure:
    actual = f"the end of the worker process, {MAX_DEATHS_PER_SOURCE} times"
    hint = "it may need more memory than there is"
    return SourceFailure("worker", refusal(source.path, "an outcome", actual, hint))


def invert_batch(sources: Batch, options: AnalysisOptions) -> list[SourceOutcome]:
    """Return the outcomes of sources, in their order; an error of a source is in its outcome."""
    return [_invert(source, options) for source in sources]


def _invert(source: Source, options: AnalysisOptions) -> SourceOutcome:
    start_s = time.process_time()
    outcome = SourceOutcome(source)
    try:
        _require_unchanged(source)
        points = _points(source, options, outcome.failures)
        if options.diagnose:
            outcome.diagnoses.extend(_diagnoses(source, points, options, outcome.failures))
        else:
            for point in points:
                outcome.results.extend(_results(source, point, options))
        _require_unchanged(source)
    except Exception as error:
        # One bad source must not stop the archive; the reason is stored with the failures.
        outcome.results.clear()
        outcome.diagnoses.clear()
        outcome.failures.append(_failure_of(source, error))
    return replace(outcome, processor_seconds=time.process_time() - start_s)


def _failure_of(source: Source, error: Exception) -> SourceFailure:
    if isinstance(error, _Changed):
        return SourceFailure("changed", str(error))
    if isinstance(error, SurveyError | InversionError):
        return SourceFailure("refused", str(error))
    reason = f"{source.path}: an unexpected error: {type(error).__name__}: {error}"
    return SourceFailure("unforeseen", reason)


class _Changed(SurveyError):
    pass


def _require_unchanged(source: Source) -> None:
    if source.size >= 0 and not is_unchanged(source):
        expected, actual = "a file that does not change", "one that was written to"
        raise _Changed(refusal(source.path, expected, actual))


def _points(
    source: Source, options: AnalysisOptions, failures: list[SourceFailure]
) -> Iterator[TracePoint]:
    """Yield the points of a source; damage to a point of a survey does not affect the others."""
    if not (source.survey or is_survey_file(source.path)):
        yield from read_points(source.path, options.header, options.overrides())
        return
    content = _content(source.path, source.size, source.mtime_ns)
    if source.piece == 0:
        for text in content.damage:
            reason = f"{source.path}: damaged survey: {text}"
            failures.append(SourceFailure("damage", reason))
        if not content.points:
            reason = refusal(source.path, "a survey with drops", "none")
            failures.append(SourceFailure("refused", reason))
    declared = declarations_of(options.header, options.overrides())
    for point in content.points[source.first_point : source.end_point]:
        try:
            yield from points_of(source.path, point, declared)
        except (RecordingError, SurveyError) as error:
            failures.append(SourceFailure("refused", str(error), point.title))


@lru_cache(maxsize=1)
def _content(path: str, _size: int, _mtime_ns: int) -> Survey:
    """Return the content of a survey; cached because its pieces follow one another."""
    return survey_content(path)


def _diagnoses(
    source: Source,
    points: Iterable[TracePoint],
    options: AnalysisOptions,
    failures: list[SourceFailure],
) -> Iterator[DiagnosisResult]:
    """Yield the diagnoses of a survey's points; those with the same device are one request."""
    entries: list[DiagnosisPoint] = []
    for point in points:
        try:
            entries.append(entry_of(source.path, point, options))
        except InversionError as error:
            reason = f"{source.path}: {error}"
            failures.append(SourceFailure("refused", reason, str(point.setup.point or "")))
    for diagnosis in diagnose_entries(entries):
        if diagnosis.result is not None:
            modulus = modulus_in_force(diagnosis.result)
            yield replace(diagnosis.result, point_modulus=modulus)
        elif diagnosis.error is not None:
            failures.append(SourceFailure("refused", diagnosis.error))


DECLARED_COLUMNS = ("device", "site", "operator", "time_utc", "latitude", "longitude")
"""Declarations of a point that are columns of the table of results."""


def _results(
    source: Source, point: TracePoint, options: AnalysisOptions
) -> Iterator[tuple[DropResult, Mapping[str, Any]]]:
    values = {name: getattr(point.setup, name) for name in DECLARED_COLUMNS}
    declared = {name: value for name, value in values.items() if value is not None}
    for analysis in analyse_point(point, options, library_of_process()):
        yield drop_result(source.path, analysis, point.warnings, point.setup.point), declared
