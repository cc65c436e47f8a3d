"""What a worker does: a batch of sources in, their results out. It keeps nothing and writes
nothing, so that a batch may be repeated at any time, anywhere."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from pfwd.archive.sources import Source, unchanged
from pfwd.errors import SurveyError, refusal

if TYPE_CHECKING:
    # Only for annotations: a worker limits its threads before it loads these.
    from inversion import SurrogateLibrary
    from pfwd.analysis.options import AnalysisOptions
    from pfwd.analysis.results import DiagnosisResult, DropResult
    from pfwd.files.traces import TracePoint
    from pfwd_device.recording.survey_content import SurveyContent

FailureKind = Literal["refused", "damage", "unforeseen", "worker", "changed"]

PASSING: frozenset[FailureKind] = frozenset({"worker", "changed"})
"""Failures that say nothing of the source: it is tried again when the archive is continued."""

ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that keep linear algebra to one thread, where they are set before it is loaded."""

_TABLES_KEPT = 100
"""Response tables in memory, 0.1 to 2 MB each; an archive may declare any number of depths."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Something that gave no result, and why."""

    kind: FailureKind
    """refused: the source, or a point of a survey; damage: lost before; unforeseen: an error of the
    program; worker: its process died; changed: the source was written to meanwhile."""
    reason: str
    """One line."""
    point: str | None = None
    """The test point, where it is one of a survey."""


@dataclass(frozen=True, slots=True)
class SourceOutcome:
    """What came of one source."""

    source: Source
    results: list[DropResult] = field(default_factory=list)
    """One a drop; what is declared of its point is among the keys that a result does not know."""
    diagnoses: list[DiagnosisResult] = field(default_factory=list)
    """One a point, where points are diagnosed in place of drops being inverted."""
    failures: list[Failure] = field(default_factory=list)
    processor_seconds: float = 0.0
    """Time of the processor that it took."""

    @property
    def final(self) -> bool:
        """Whether trying again could not change it."""
        return not any(failure.kind in PASSING for failure in self.failures)


_library: SurrogateLibrary | None = None
_last_survey: tuple[Source, SurveyContent] | None = None


def limit_threads() -> None:
    """Keep linear algebra, loaded later, to one thread: the processes are the parallel part."""
    for name in ONE_THREAD:
        os.environ[name] = "1"


def invert_batch(sources: list[Source], options: AnalysisOptions) -> list[SourceOutcome]:
    """Outcomes of sources in their order; whatever goes wrong with one is its outcome."""
    return [_invert(source, options) for source in sources]


def _invert(source: Source, options: AnalysisOptions) -> SourceOutcome:
    from inversion import InversionError

    begun = time.process_time()
    results: list[DropResult] = []
    diagnoses: list[DiagnosisResult] = []
    failures: list[Failure] = []
    points: list[TracePoint] = []
    try:
        if not unchanged(source) and source.size >= 0:
            raise _Changed
        for found in _points(source, options):
            if isinstance(found, Failure):
                failures.append(found)
            elif options.diagnose:
                points.append(found)
            else:
                results += _results(source, found, options)
        for diagnosed in _diagnosed(source, points, options):
            if isinstance(diagnosed, Failure):
                failures.append(diagnosed)
            else:
                diagnoses.append(diagnosed)
        if not unchanged(source) and source.size >= 0:
            raise _Changed
    except _Changed:
        reason = refusal(source.path, "a file at rest", "one that was written to meanwhile")
        results, diagnoses, failures = [], [], [Failure("changed", reason)]
    except (SurveyError, InversionError) as error:
        results, diagnoses = [], []
        failures = [*failures, Failure("refused", str(error))]
    except Exception as error:
        # One source in a million must not end the others; its reason is kept with the rest.
        reason = f"{source.path}: an unexpected error: {type(error).__name__}: {error}"
        results, diagnoses = [], []
        failures = [*failures, Failure("unforeseen", reason)]
    spent = time.process_time() - begun
    return SourceOutcome(source, results, diagnoses, failures, spent)


def _diagnosed(
    source: Source, points: Sequence[TracePoint], options: AnalysisOptions
) -> Iterator[DiagnosisResult | Failure]:
    """What is behind the residuals of points that are one survey, where they name one device."""
    if not points:
        return
    from inversion import InversionError
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries
    from pfwd.analysis.diagnosis.entries import DiagnosisPoint, entry_of

    entries: list[DiagnosisPoint] = []
    for point in points:
        try:
            entries.append(entry_of(source.path, point, options))
        except InversionError as error:
            yield Failure("refused", f"{source.path}: {error}", str(point.setup.point or ""))
    for found in diagnose_entries(entries):
        if found.result is not None:
            yield found.result
        elif found.error is not None:
            yield Failure("refused", found.error)


class _Changed(Exception):
    pass


def _points(source: Source, options: AnalysisOptions) -> Iterator[TracePoint | Failure]:
    from pfwd.files.reading import read_points
    from pfwd.files.survey_file import is_survey_file

    if source.survey or (_is_hdf5(source.path) and is_survey_file(source.path)):
        yield from _survey_points(source, options)
    else:
        yield from read_points(source.path, options.header, options.overrides())


def _is_hdf5(path: str) -> bool:
    from pfwd.files.reading import HDF5_SIGNATURE

    try:
        with open(path, "rb") as stream:
            return stream.read(len(HDF5_SIGNATURE)) == HDF5_SIGNATURE
    except OSError:
        return False  # reading it says why


def _survey_points(source: Source, options: AnalysisOptions) -> Iterator[TracePoint | Failure]:
    """The points of a survey, one after the other; one that is not whole does not cost the rest."""
    from pfwd.files.header import Declaration, read_header_file
    from pfwd.files.reading import points_of
    from pfwd_device.errors import RecordingError

    content = _content(source)
    if source.piece == 0:
        for text in content.damage:
            yield Failure("damage", f"{source.path}: damaged survey: {text}")
        if not content.points:
            yield Failure("refused", refusal(source.path, "a survey with drops", "none"))
    said = dict(read_header_file(options.header)) if options.header is not None else {}
    said |= {key: Declaration(v, "command line") for key, v in options.overrides().items()}
    for point in content.points[source.first_point : source.end_point]:
        try:
            yield from points_of(source.path, point, said)
        except (RecordingError, SurveyError) as error:
            yield Failure("refused", str(error), point.title)


def _content(source: Source) -> SurveyContent:
    """What the survey holds; kept, because its pieces come one after the other."""
    from pfwd.files.reading import survey_content

    global _last_survey
    if _last_survey is not None:
        known, content = _last_survey
        if (known.path, known.size, known.mtime_ns) == (source.path, source.size, source.mtime_ns):
            return content
    content = survey_content(source.path)
    _last_survey = (source, content)
    return content


def _results(source: Source, point: TracePoint, options: AnalysisOptions) -> list[DropResult]:
    from pfwd.analysis.analyse import analyse_point
    from pfwd.analysis.drop_result import drop_result

    setup = point.setup
    declared = {
        "site": setup.site,
        "operator": setup.operator,
        "device": setup.device,
        "time_utc": setup.time_utc,
        "latitude": setup.latitude,
        "longitude": setup.longitude,
    }
    known = {key: value for key, value in declared.items() if value is not None}
    return [
        replace(drop_result(source.path, analysis, point.warnings, setup.point), more=known)
        for analysis in analyse_point(point, options, _tables())
    ]


def _tables() -> SurrogateLibrary:
    """The response tables of this process."""
    global _library
    if _library is None:
        from pfwd.archive.tables import BoundedLibrary

        _library = BoundedLibrary(_TABLES_KEPT)
    return _library
