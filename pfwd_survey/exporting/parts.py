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
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import DropFacts
from pfwd_device.recording.drop_place import DropPlace
from pfwd_device.recording.index import no_collections
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.survey_content import (
    Result,
    SurveyContent,
    SurveyDrop,
    SurveyPoint,
    read_result,
)
from pfwd_survey.exporting.rows import JudgedValues, Order, Row, row_of
from pfwd_survey.spawning import worker_pool

LARGE_LEDGER = 600_000
"""Bytes of a ledger, those of 2,000 drops: in the time that a second process takes to start the
rows of so many are made."""

DROPS_AT_ONCE = 250
"""In a part: some 50 ms, for which one process may have to wait for the other in the end."""

Texts = Callable[[Iterable[Row]], Iterator[str]]
"""Makes the text of each row, one after the other; a function that a module has by its name."""

Drops = Sequence[tuple[SurveyPoint, SurveyDrop]]


class Part(NamedTuple):
    """What the second process has made."""

    text: str
    results: int
    """How many of the drops have a result."""


Asked = Future[Part]


class SecondProcess:
    """A process that makes parts of the rows."""

    def __init__(self) -> None:
        self._pool = worker_pool(1)
        self._pool.submit(_load)

    def make(
        self,
        content: SurveyContent,
        texts: Texts,
        parts: Sequence[Drops],
        judged: JudgedValues,
    ) -> Sequence[Asked | None]:
        """Ask for these parts; the last one is made first. None: the process has ended."""
        asked: list[Asked | None] = [None] * len(parts)
        with contextlib.suppress(BrokenProcessPool):
            for number in reversed(range(len(parts))):
                drops = _DropsElsewhere(parts[number])
                names = {point.name for point, _ in parts[number]}
                known = {name: judged[name] for name in names if name in judged}
                asked[number] = self._pool.submit(_part, texts, content.survey_id, drops, known)
        return asked

    def close(self) -> None:
        """End it; what it has not begun is not done."""
        self._pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def second_process(survey: str, jobs: int) -> Iterator[SecondProcess | None]:
    """One for the block; None when it would not help, or cannot be had.

    Parameters
    ----------
    survey : path of a survey
    jobs : int
        Processes that may work, this one included.
    """
    second = None
    if jobs > 1 and processors() > 1 and is_large(survey):
        with contextlib.suppress(OSError):  # the system starts no more: this one does it alone
            second = SecondProcess()
    try:
        yield second
    finally:
        if second is not None:
            second.close()


def is_large(survey: str) -> bool:
    """Whether the folder of a survey has so many records that two processes are quicker."""
    try:
        return Layout(Path(survey)).ledger.stat().st_size >= LARGE_LEDGER
    except OSError:
        return False  # an exported survey, or none at all, which is said when it is read


def processors() -> int:
    """How many of them this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on Windows and macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def row_texts(order: Order, texts: Texts) -> Iterator[str]:
    """The texts of all rows, point by point; those of several rows in one where it comes so.

    Parameters
    ----------
    order : Order
        Is told how many drops have a result.
    texts : callable
    """
    drops = [(point, drop) for point in order.content.points for drop in point.drops]
    parts = [drops[at : at + DROPS_AT_ONCE] for at in range(0, len(drops), DROPS_AT_ONCE)]
    asked: Sequence[Asked | None] = [None] * len(parts)
    if order.second is not None and order.inverted is None:
        asked = order.second.make(order.content, texts, parts, order.judged)
    count = 0
    for part, future in zip(parts, asked, strict=True):
        made = None if future is None else _made(future)
        if made is not None:
            count += made.results
            yield made.text
            continue
        for point, drop in part:
            row = row_of(order.content.survey_id, point, drop, order.inverted, order.judged)
            count += row.has_result
            yield from texts([row])
    vars(order)["results"] = count  # where `cached_property` keeps it


def _made(asked: Asked) -> Part | None:
    """What the second process has made, or is about to; None: this process has to."""
    if asked.cancel():
        return None
    # Whatever went wrong there goes wrong here too, and is then said in the order of rows.
    return None if asked.exception() is not None else asked.result()


class _DropsElsewhere:
    """Drops as they are sent to the other process, which reads them itself.

    They are made ready when they are sent, and most of those that the first process makes are not.
    """

    def __init__(self, drops: Drops) -> None:
        self._drops = drops

    def __reduce__(self) -> tuple[Any, ...]:
        points: dict[str, SurveyPoint] = {}  # sent once, not with every drop
        sent = []
        for point, drop in self._drops:
            place, result = drop.place, drop.last_result
            if place is None:
                raise RecordingError(f"drop {drop.number} is not in the journal")
            if point.name not in points:
                points[point.name] = replace(point, drops=())
            said = (drop.discarded, drop.notes, drop.position, drop.target, drop.edits)
            path = None if result is None else os.fspath(result)
            sent.append((points[point.name], place, path, *said))
        return _drops_here, (sent,)


# In the second process.


class _NotThere(Exception):
    """A drop is not whole at its place; the first process looks for it elsewhere, or says so."""


def _load() -> None:
    """Nothing: what the other functions need has been imported for it."""


def _drops_here(sent: list[tuple[Any, ...]]) -> Drops:
    return [(point, _drop(*drop)) for point, *drop in sent]


def _drop(
    place: DropPlace,
    result: str | None,
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
        _origin=_Elsewhere(place, None if result is None else Path(result)),
    )


class _Elsewhere:
    """The survey of one drop, of which a row needs the facts and the last result alone."""

    def __init__(self, place: DropPlace, result: Path | None) -> None:
        self._place = place
        self._result = result

    def place_of(self, _number: int) -> DropPlace:
        return self._place

    def last_result_of(self, _number: int) -> Path | None:
        return self._result

    def read_facts(self, _number: int) -> DropFacts:
        try:
            return self._place.read_facts()
        except RecordingError as err:
            raise _NotThere(str(err)) from err

    def read_last_result(self, _number: int) -> Result | None:
        return None if self._result is None else read_result(self._result)

    def key_of(self, number: int) -> NoReturn:
        _refuse(number)

    def results_of(self, number: int) -> NoReturn:
        _refuse(number)

    def result_count_of(self, number: int) -> NoReturn:
        _refuse(number)

    def file_of(self, number: int) -> NoReturn:
        _refuse(number)

    def file_bytes_of(self, number: int) -> NoReturn:
        _refuse(number)

    def read_drop(self, number: int) -> NoReturn:
        _refuse(number)

    def read_traces(self, number: int) -> NoReturn:
        _refuse(number)

    def read_results(self, number: int) -> NoReturn:
        _refuse(number)

    def read_diagnosis(self, number: int) -> NoReturn:
        _refuse(number)


def _refuse(number: int) -> NoReturn:
    raise _NotThere(f"of drop {number} a row needs nothing else")


def _part(texts: Texts, survey_id: str, drops: Any, judged: JudgedValues) -> Part:
    """The drops were `_DropsElsewhere` when they were sent."""
    with no_collections():
        rows = [row_of(survey_id, point, drop, None, judged) for point, drop in drops]
        return Part("".join(texts(rows)), sum(row.has_result for row in rows))
