"""Rows of a large survey as text, made by two processes at once.

The work needs the processor all the time, which threads of one Python process cannot share. The
second process starts while the first one still reads the survey. The points are divided into parts.
The first process works from the first part on and the second one from the last part back, until
they meet; thus a slow second process delays little. The second process receives the places of the
drops in the survey's journal and reads them itself. If a drop cannot be read there, its part is
left to the first process, which finds further copies.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, NoReturn

from pfwd.export.rows import Order, Row, point_rows_of
from pfwd.files.folders import has_ledger_of
from pfwd.judging import Job, point_view
from pfwd.spawning import HelperProcess, beside, helper_result, processors
from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.drop_place import DropPlace
from pfwd_device.recording.index import no_collections
from pfwd_device.recording.record import DropRecord
from pfwd_device.recording.survey_content import (
    Result,
    ResultFile,
    SurveyDrop,
    SurveyPoint,
)

MIN_LEDGER_BYTES = 600_000
"""Size of the list of acknowledged drops above which a second process is started: with 2,000 drops
the rows take as long as the start of the process."""

MIN_DROPS_IN_PART = 250
"""Smallest number of drops in a part, some 100 ms of work, for which one process may have to wait
for the other at the end. A part ends with the point that reaches this number."""

Texts = Callable[[Iterable[Row]], Iterator[str]]
"""Type of a function that yields the texts of rows; it must be importable, not a lambda."""

Points = Sequence[SurveyPoint]


class Part(NamedTuple):
    """Text of a part of the rows, made by the second process."""

    text: str
    results: int
    """Number of drops with a result."""


class SecondProcess(HelperProcess):
    """Process that makes parts of the rows as text."""

    def __init__(self) -> None:
        super().__init__(_load)

    def make(
        self, survey_id: str, job: Job, texts: Texts, parts: Sequence[Points]
    ) -> Sequence[Future[Part] | None]:
        """Request parts, the last one first.

        Parameters
        ----------
        survey_id : str
        job : Job
        texts : callable
            Function that yields the texts of rows.
        parts : sequence of sequences of SurveyPoint

        Returns
        -------
        sequence of Future or None
            One for each part; None: the process has ended.
        """
        points = [_RemotePoints(part, job) for part in parts]
        return self.submit(partial(_part, texts, survey_id), points)


def second_process(survey: str, jobs: int) -> AbstractContextManager[SecondProcess | None]:
    """Return a context with a second process, or with None if it would not help or cannot be
    started.

    Parameters
    ----------
    survey : path of a survey
    jobs : int
        Number of processes that may work, this one included.
    """
    return beside(
        SecondProcess, jobs > 1 and processors() > 1 and has_ledger_of(survey, MIN_LEDGER_BYTES)
    )


def row_texts(order: Order, texts: Texts) -> Iterator[str]:
    """Yield the texts of all rows, point by point; a text may hold several rows.

    Parameters
    ----------
    order : Order
        Its attribute `results` is set to the number of drops with a result.
    texts : callable
        Function that yields the texts of rows.
    """
    parts = parts_of(order.content.points)
    futures: Sequence[Future[Part] | None] = [None] * len(parts)
    if order.row_maker is not None and order.inverted is None:
        futures = order.row_maker.make(order.content.survey_id, order.job, texts, parts)
    count = 0
    for part, future in zip(parts, futures, strict=True):
        made = helper_result(future)
        if made is not None:
            count += made.results
            yield made.text
            continue
        for point in part:
            rows = list(order.rows_of(order.point(point)))
            count += sum(row.has_result for row in rows)
            yield from texts(rows)
    vars(order)["results"] = count  # where `cached_property` stores its value


def parts_of(points: Points) -> list[Points]:
    """Divide the points with drops into parts of at least `MIN_DROPS_IN_PART` drops."""
    parts: list[Points] = []
    part: list[SurveyPoint] = []
    drops = 0
    for point in points:
        if not point.drops:
            continue
        part.append(point)
        drops += len(point.drops)
        if drops >= MIN_DROPS_IN_PART:
            parts.append(part)
            part, drops = [], 0
    return [*parts, part] if part else parts


class _RemotePoints:
    """Points for the second process, which reads and judges them.

    They are prepared when they are pickled, because most parts are made by the first process and
    never pickled.
    """

    def __init__(self, points: Points, job: Job) -> None:
        self._points, self._job = points, job

    def __reduce__(self) -> tuple[Any, ...]:
        sent = [(replace(point, drops=()), list(map(_sent, point.drops))) for point in self._points]
        stations = [self._job.station(point.title) for point in self._points]
        # The rest of the job is not needed there, and a job may have very many stations.
        job = replace(self._job, stations=tuple(filter(None, stations)), changes=())
        return _received_points, (job, sent)


def _sent(drop: SurveyDrop) -> tuple[Any, ...]:
    place = drop.place
    if place is None:
        raise RecordingError(f"drop {drop.number} is not in the journal")
    diagnosis = None
    with contextlib.suppress(RecordingError):  # the first process reports the damage
        diagnosis = drop.read_diagnosis()
    edited = (drop.discarded, drop.notes, drop.position, drop.target, drop.edits)
    return (place, drop.result_files, diagnosis, *edited)


# The code below runs in the second process.


class _MissingDrop(Exception):
    """The second process cannot read a drop; the first process makes its part."""


def _load() -> None:
    """Import this module in the second process, which happens before the function is called."""


def _received_points(job: Job, sent: list[tuple[SurveyPoint, Any]]) -> tuple[Job, Points]:
    points = [replace(point, drops=tuple(_drop(*drop) for drop in drops)) for point, drops in sent]
    return job, points


def _drop(
    place: DropPlace,
    results: tuple[ResultFile, ...],
    diagnosis: Result | None,
    discarded: bool,
    notes: tuple[str, ...],
    position: Any,
    target: Any,
    edits: tuple[dict[str, Any], ...],
) -> SurveyDrop:
    return SurveyDrop(
        number=place.number,
        point=place.point,
        drop=place.drop,
        discarded=discarded,
        notes=notes,
        position=position,
        target=target,
        edits=edits,
        source="journal",
        _origin=_RemoteDrop(place, results, diagnosis),
    )


class _RemoteDrop:
    """Data of one drop in the second process, with the interface of a survey."""

    def __init__(
        self, place: DropPlace, results: tuple[ResultFile, ...], diagnosis: Result | None
    ) -> None:
        self._place = place
        self._results = results
        self._diagnosis = diagnosis

    def place_of(self, _number: int) -> DropPlace:
        return self._place

    def read_facts(self, _number: int) -> DropFacts:
        try:
            return self._place.read_facts()
        except RecordingError as err:
            raise _MissingDrop(str(err)) from err

    def read_traces(self, _number: int) -> DropRecord:
        try:
            return self._place.read_traces()
        except RecordingError as err:
            raise _MissingDrop(str(err)) from err

    def read_last_result(self, _number: int) -> Result | None:
        return next(self._read(self._results[-1:]), None)

    def results_of(self, _number: int) -> tuple[ResultFile, ...]:
        return self._results

    def result_count_of(self, _number: int) -> int:
        return len(self._results)

    def read_results(self, _number: int) -> tuple[Result, ...]:
        return tuple(self._read(self._results))

    def readable_results(self, _number: int) -> Iterator[Result]:
        return self._read(self._results[::-1])

    def _read(self, files: tuple[ResultFile, ...]) -> Iterator[Result]:
        try:
            yield from (file.read() for file in files)
        except RecordingError as err:
            raise _MissingDrop(str(err)) from err

    def key_of(self, number: int) -> NoReturn:
        _refuse(number)

    def file_of(self, number: int) -> NoReturn:
        _refuse(number)

    def read_drop(self, number: int) -> NoReturn:
        _refuse(number)

    def read_diagnosis(self, _number: int) -> Result | None:
        return self._diagnosis


def _refuse(number: int) -> NoReturn:
    raise _MissingDrop(f"drop {number}: the second process does not have this")


def _part(texts: Texts, survey_id: str, sent: Any) -> Part:
    """Return the text of a part; `sent` is a `_RemotePoints` after pickling."""
    job, points = sent
    with no_collections():
        rows = [row for point in points for row in point_rows_of(survey_id, point_view(point, job))]
        return Part("".join(texts(rows)), sum(row.has_result for row in rows))
