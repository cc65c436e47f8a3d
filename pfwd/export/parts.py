"""The rows of a large survey as text, made by two processes from both ends.

Making rows keeps one processor busy, and nothing of it can be shared between threads. The second
process starts while the first reads the survey. It is told where the journal has the drops of a
part, and makes the last part, then the one before, and so on, until the first process has come
there from the beginning: whichever is quicker makes more, and a second process that never gets
anything done delays little. What it does not find at its place is left to the first, which looks
for it elsewhere.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
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
    SurveyDrop,
    SurveyPoint,
    read_result,
)

LARGE_LEDGER = 600_000
"""Bytes of a ledger, those of 2,000 drops: in the time that a second process takes to start the
rows of so many are made."""

DROPS_AT_ONCE = 250
"""In a part, or more where its last point has them: some 100 ms, for which one process may have to
wait for the other in the end."""

Texts = Callable[[Iterable[Row]], Iterator[str]]
"""Makes the text of each row, one after the other; a function that a module has by its name."""

Points = Sequence[SurveyPoint]


class Part(NamedTuple):
    """What the second process has made."""

    text: str
    results: int
    """How many of the drops have a result."""


class SecondProcess(HelperProcess):
    """A process that makes parts of the rows."""

    def __init__(self) -> None:
        super().__init__(_load)

    def make(
        self, survey_id: str, job: Job, texts: Texts, parts: Sequence[Points]
    ) -> Sequence[Future[Part] | None]:
        """Request these parts, the last one first; None: the process has ended."""
        points = [_PointsElsewhere(part, job) for part in parts]
        return self.submit(partial(_part, texts, survey_id), points)


def second_process(survey: str, jobs: int) -> AbstractContextManager[SecondProcess | None]:
    """One for the block; None when it would not help, or cannot be had.

    Parameters
    ----------
    survey : path of a survey
    jobs : int
        Processes that may work, this one included.
    """
    return beside(
        SecondProcess, jobs > 1 and processors() > 1 and has_ledger_of(survey, LARGE_LEDGER)
    )


def row_texts(order: Order, texts: Texts) -> Iterator[str]:
    """The texts of all rows, point by point; those of several rows in one where it comes so.

    Parameters
    ----------
    order : Order
        Is told how many drops have a result.
    texts : callable
    """
    parts = parts_of(order.content.points)
    asked: Sequence[Future[Part] | None] = [None] * len(parts)
    if order.second is not None and order.inverted is None:
        asked = order.second.make(order.content.survey_id, order.job, texts, parts)
    count = 0
    for part, future in zip(parts, asked, strict=True):
        made = helper_result(future)
        if made is not None:
            count += made.results
            yield made.text
            continue
        for point in part:
            rows = list(order.rows_of(order.point(point)))
            count += sum(row.has_result for row in rows)
            yield from texts(rows)
    vars(order)["results"] = count  # where `cached_property` keeps it


def parts_of(points: Points) -> list[Points]:
    """Points in parts of some drops each, without those that have none; a point is never parted."""
    parts: list[Points] = []
    part: list[SurveyPoint] = []
    drops = 0
    for point in points:
        if not point.drops:
            continue
        part.append(point)
        drops += len(point.drops)
        if drops >= DROPS_AT_ONCE:
            parts.append(part)
            part, drops = [], 0
    return [*parts, part] if part else parts


class _PointsElsewhere:
    """Points as they are sent to the other process, which reads and judges them itself.

    They are made ready when they are sent, and most of those that the first process makes are not.
    """

    def __init__(self, points: Points, job: Job) -> None:
        self._points, self._job = points, job

    def __reduce__(self) -> tuple[Any, ...]:
        sent = [(replace(point, drops=()), list(map(_sent, point.drops))) for point in self._points]
        stations = [self._job.station(point.title) for point in self._points]
        # Nothing else of it is looked at, and a job may have very many stations.
        job = replace(self._job, stations=tuple(filter(None, stations)), changes=())
        return _points_here, (job, sent)


def _sent(drop: SurveyDrop) -> tuple[Any, ...]:
    place = drop.place
    if place is None:
        raise RecordingError(f"drop {drop.number} is not in the journal")
    diagnosis = None
    with contextlib.suppress(RecordingError):  # as nobody had asked for it
        diagnosis = drop.read_diagnosis()
    said = (drop.discarded, drop.notes, drop.position, drop.target, drop.edits)
    return (place, tuple(map(os.fspath, drop.results)), diagnosis, *said)


# In the second process.


class _NotThere(Exception):
    """A drop is not whole at its place; the first process looks for it elsewhere, or says so."""


def _load() -> None:
    """Nothing: what the other functions need has been imported for it."""


def _points_here(job: Job, sent: list[tuple[SurveyPoint, Any]]) -> tuple[Job, Points]:
    points = [replace(point, drops=tuple(_drop(*drop) for drop in drops)) for point, drops in sent]
    return job, points


def _drop(
    place: DropPlace,
    results: tuple[str, ...],
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
        _origin=_Elsewhere(place, tuple(map(Path, results)), diagnosis),
    )


class _Elsewhere:
    """The survey of one drop, as far as its row and the verdict of its point need it."""

    def __init__(
        self, place: DropPlace, results: tuple[Path, ...], diagnosis: Result | None
    ) -> None:
        self._place = place
        self._results = results
        self._diagnosis = diagnosis

    def place_of(self, _number: int) -> DropPlace:
        return self._place

    def last_result_of(self, _number: int) -> Path | None:
        return self._results[-1] if self._results else None

    def read_facts(self, _number: int) -> DropFacts:
        try:
            return self._place.read_facts()
        except RecordingError as err:
            raise _NotThere(str(err)) from err

    def read_traces(self, _number: int) -> DropRecord:
        try:
            return self._place.read_traces()
        except RecordingError as err:
            raise _NotThere(str(err)) from err

    def read_last_result(self, _number: int) -> Result | None:
        return read_result(self._results[-1]) if self._results else None

    def results_of(self, _number: int) -> tuple[Path, ...]:
        return self._results

    def result_count_of(self, _number: int) -> int:
        return len(self._results)

    def read_results(self, _number: int) -> tuple[Result, ...]:
        return tuple(map(read_result, self._results))

    def key_of(self, number: int) -> NoReturn:
        _refuse(number)

    def file_of(self, number: int) -> NoReturn:
        _refuse(number)

    def file_bytes_of(self, number: int) -> NoReturn:
        _refuse(number)

    def read_drop(self, number: int) -> NoReturn:
        _refuse(number)

    def read_diagnosis(self, _number: int) -> Result | None:
        return self._diagnosis


def _refuse(number: int) -> NoReturn:
    raise _NotThere(f"of drop {number} a row needs nothing else")


def _part(texts: Texts, survey_id: str, sent: Any) -> Part:
    """What was sent were `_PointsElsewhere`."""
    job, points = sent
    with no_collections():
        rows = [row for point in points for row in point_rows_of(survey_id, point_view(point, job))]
        return Part("".join(texts(rows)), sum(row.has_result for row in rows))
