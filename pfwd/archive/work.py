"""Inversion or diagnosis of a batch of sources by one worker.

Nothing is written, so that a batch may be repeated at any time, on any computer.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass, field
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
from pfwd.archive.sources import Source, is_unchanged
from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_survey_file
from pfwd.files.header import declarations_of
from pfwd.files.opening import survey_content
from pfwd.files.reading import points_of, read_points
from pfwd.files.traces import TracePoint
from pfwd.jobs import Jobs, WorkerDied
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey

FailureKind = Literal["refused", "damage", "unforeseen", "worker", "changed"]

TRANSIENT_FAILURES: frozenset[FailureKind] = frozenset({"worker", "changed"})
"""Kinds of failures that have no cause in the source; it is tried again when the archive is
continued."""

MAX_CONSECUTIVE_DEATHS = 20
"""Processes that may die without a completed batch in between; more have a cause in the computer
and not in a source."""

MAX_DEATHS_PER_SOURCE = 3
"""Workers that may die while they work on a source, before it counts as failed; the first ones may
have been killed for another reason."""


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


@dataclass(frozen=True, slots=True)
class Batch:
    """Sources that are sent to one worker together."""

    sources: tuple[Source, ...]
    deaths: int = 0
    """Number of workers that died while they worked on this batch."""

    def retries_after_death(self) -> "list[Batch]":
        """Return the batches to try after a worker died; empty after three deaths over one source.

        Each source is then alone in its batch, which shows the source that is the cause.
        """
        if len(self.sources) > 1:
            return [Batch((source,), self.deaths + 1) for source in self.sources]
        if self.deaths + 1 >= MAX_DEATHS_PER_SOURCE:
            return []
        return [Batch(self.sources, self.deaths + 1)]

    def worker_failures(self) -> list[SourceOutcome]:
        """Return an outcome for each source that reports the death of its workers as a failure."""
        return [
            SourceOutcome(
                source,
                failures=[
                    SourceFailure(
                        "worker",
                        f"{source.path}: expected an outcome, got the end of the worker process, "
                        f"{MAX_DEATHS_PER_SOURCE} times; it may need more memory than there is",
                    )
                ],
            )
            for source in self.sources
        ]


class ArchiveWorkers:
    """Worker processes on this computer; if one dies, its batch is repeated.

    Parameters
    ----------
    options : AnalysisOptions
    count : int, >= 1
        Number of processes.
    """

    def __init__(self, options: AnalysisOptions, count: int = 1) -> None:
        self._options = options
        self._jobs = Jobs(count, attempts=1)

    def run(self, batches: Iterator[Batch]) -> Iterator[list[SourceOutcome]]:
        """Yield the outcomes of each batch when it is complete, in any order.

        Batches are taken from the iterator only when a worker is free or will be next.

        Raises
        ------
        SurveyError
            If the workers are lost, or 20 die without a completed batch in between.
        """
        submitted: dict[Any, Batch] = {}
        waiting: list[Batch] = []
        deaths = 0
        while True:
            while len(submitted) < self._max_batches():
                batch = waiting.pop() if waiting else next(batches, None)
                if batch is None:
                    break
                request = self._submit(invert_batch, list(batch.sources), self._options)
                submitted[request] = batch
            if not submitted:
                return
            for request in self._wait(submitted):
                batch = submitted.pop(request)
                outcomes = self._outcomes(request)
                deaths = deaths + 1 if outcomes is None else 0
                if deaths >= MAX_CONSECUTIVE_DEATHS:
                    expected, actual = "processes that stay alive", f"{deaths} that ended"
                    raise SurveyError(refusal("worker processes", expected, actual))
                if outcomes is None:
                    retries = batch.retries_after_death()
                    waiting += retries
                    outcomes = [] if retries else batch.worker_failures()
                if outcomes:
                    yield outcomes

    def close(self) -> None:
        """End the workers; outcomes that were not yielded are lost."""
        self._jobs.close()

    def _max_batches(self) -> int:
        """Return the number of batches to keep requested."""
        return 2 * self._jobs.count

    def _submit(self, *call: Any) -> Any:
        return self._jobs.submit(*call)

    def _wait(self, requests: Iterable[Any]) -> Iterable[Any]:
        """Wait until at least one request is complete; return the complete ones."""
        return wait(requests, return_when=FIRST_COMPLETED).done

    def _outcomes(self, request: Any) -> list[SourceOutcome] | None:
        """Return the outcomes of a complete request; None: its worker died."""
        try:
            outcomes: list[SourceOutcome] = request.result()
        except WorkerDied:
            return None
        return outcomes


def invert_batch(sources: list[Source], options: AnalysisOptions) -> list[SourceOutcome]:
    """Return the outcomes of sources, in their order; an error of a source is in its outcome."""
    return [_invert(source, options) for source in sources]


def _invert(source: Source, options: AnalysisOptions) -> SourceOutcome:
    start_s = time.process_time()
    results: list[tuple[DropResult, Mapping[str, Any]]] = []
    diagnoses: list[DiagnosisResult] = []
    failures: list[SourceFailure] = []
    points: list[TracePoint] = []
    try:
        if not is_unchanged(source) and source.size >= 0:
            raise _Changed
        for point in _points(source, options):
            if isinstance(point, SourceFailure):
                failures.append(point)
            elif options.diagnose:
                points.append(point)
            else:
                results += _results(source, point, options)
        for diagnosis in _diagnoses(source, points, options):
            if isinstance(diagnosis, SourceFailure):
                failures.append(diagnosis)
            else:
                diagnoses.append(diagnosis)
        if not is_unchanged(source) and source.size >= 0:
            raise _Changed
    except _Changed:
        reason = refusal(source.path, "a file that does not change", "one that was written to")
        results, diagnoses, failures = [], [], [SourceFailure("changed", reason)]
    except (SurveyError, InversionError) as error:
        results, diagnoses = [], []
        failures = [*failures, SourceFailure("refused", str(error))]
    except Exception as error:
        # One bad source must not stop the archive; the reason is stored with the failures.
        reason = f"{source.path}: an unexpected error: {type(error).__name__}: {error}"
        results, diagnoses = [], []
        failures = [*failures, SourceFailure("unforeseen", reason)]
    seconds = time.process_time() - start_s
    return SourceOutcome(source, results, diagnoses, failures, seconds)


def _diagnoses(
    source: Source, points: Sequence[TracePoint], options: AnalysisOptions
) -> Iterator[DiagnosisResult | SourceFailure]:
    """Yield the diagnoses of a survey's points.

    Points with the same device are diagnosed together.
    """
    if not points:
        return
    entries: list[DiagnosisPoint] = []
    for point in points:
        try:
            entries.append(entry_of(source.path, point, options))
        except InversionError as error:
            yield SourceFailure("refused", f"{source.path}: {error}", str(point.setup.point or ""))
    for diagnosis in diagnose_entries(entries):
        if diagnosis.result is not None:
            yield diagnosis.result
        elif diagnosis.error is not None:
            yield SourceFailure("refused", diagnosis.error)


class _Changed(Exception):
    pass


def _points(source: Source, options: AnalysisOptions) -> Iterator[TracePoint | SourceFailure]:
    if source.survey or is_survey_file(source.path):
        yield from _survey_points(source, options)
    else:
        yield from read_points(source.path, options.header, options.overrides())


def _survey_points(
    source: Source, options: AnalysisOptions
) -> Iterator[TracePoint | SourceFailure]:
    """Yield the points of a survey; damage to one point does not affect the others."""
    content = _content(source.path, source.size, source.mtime_ns)
    if source.piece == 0:
        for text in content.damage:
            yield SourceFailure("damage", f"{source.path}: damaged survey: {text}")
        if not content.points:
            yield SourceFailure("refused", refusal(source.path, "a survey with drops", "none"))
    declared = declarations_of(options.header, options.overrides())
    for point in content.points[source.first_point : source.end_point]:
        try:
            yield from points_of(source.path, point, declared)
        except (RecordingError, SurveyError) as error:
            yield SourceFailure("refused", str(error), point.title)


@lru_cache(maxsize=1)
def _content(path: str, _size: int, _mtime_ns: int) -> Survey:
    """Return the content of a survey; cached because its pieces follow one another."""
    return survey_content(path)


def _results(
    source: Source, point: TracePoint, options: AnalysisOptions
) -> list[tuple[DropResult, Mapping[str, Any]]]:
    setup = point.setup
    values = {
        "site": setup.site,
        "operator": setup.operator,
        "device": setup.device,
        "time_utc": setup.time_utc,
        "latitude": setup.latitude,
        "longitude": setup.longitude,
    }
    declared = {key: value for key, value in values.items() if value is not None}
    return [
        (drop_result(source.path, analysis, point.warnings, setup.point), declared)
        for analysis in analyse_point(point, options, library_of_process())
    ]
