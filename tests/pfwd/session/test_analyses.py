"""Inversions that a session requests, and its reports when results do not come."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from inversion.notices import text_of
from inversion.result import StructureResult
from pfwd.analysis import tasks
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.analysis.tasks import Urgency
from pfwd.files.header import PointSetup
from pfwd.jobs import Task, WorkerDied
from pfwd.judging import drop_from_traces
from pfwd.session import analyses as module
from pfwd.session.analyses import Analyses
from pfwd.session.events import DropAnalysed, SavedDrop, SessionNotice
from pfwd_device import Drop
from tests.pfwd.scripted_feed import IDENTITY

PATIENCE = 60.0
SETUP = PointSetup(plate_radius=0.15, plate_mass=10.0, bedrock_depth=float("inf"))
OPTIONS = AnalysisOptions(seed=3)


class ScriptedJobs:
    """Each inversion has its result or error at once; it never ends on a computer too slow."""

    def __init__(self, *, is_slow: bool = False, error: Exception | None = None) -> None:
        self.requested: list[Urgency] = []
        self.preceding: list[DropResult | None] = []
        self._is_slow, self._error = is_slow, error

    def submit(self, function: Any, *args: Any, priority: Urgency, **callbacks: Any) -> Task[Any]:
        task: Task[Any] = Task()
        if function is not tasks.invert_drop:
            return task
        self.requested.append(priority)
        self.preceding.append(args[-1])
        if self._error is not None:
            task.set_exception(self._error)
        elif not self._is_slow:
            structures = (StructureResult(name="half-space", probability=1.0, modulus_pa=4e7),)
            task.set_result((DropResult(drop=len(self.requested), structures=structures), None))
        if task.done():
            callbacks["on_finish"](task)
        return task


def saved_drop(drop: Drop, setup: PointSetup = SETUP, point: str = "1", record: int = 1) -> Any:
    return SavedDrop(point, drop_from_traces(drop, setup, record=record), drop, "f")


def test_a_quick_fit_starts_from_the_preceding_result_of_its_point(
    monkeypatch: pytest.MonkeyPatch, make_drop: Callable[..., Drop]
) -> None:
    jobs = ScriptedJobs()
    monkeypatch.setattr(module, "Jobs", lambda: jobs)
    analyses = Analyses(AnalysisOptions(), lambda _: None, lambda *_: None)
    for point in "A", "A", "B":
        analyses.request(saved_drop(make_drop(), point=point))
        analyses.take_responses()
    # A quick fit and a full search for each drop; the second result is the last of drop 1.
    drops = [result and result.drop for result in jobs.preceding]
    assert drops == [None, None, 2, None, None, None]


def test_full_searches_that_take_too_long_are_omitted_and_reported_once(
    monkeypatch: pytest.MonkeyPatch, make_drop: Callable[..., Drop]
) -> None:
    jobs = ScriptedJobs(is_slow=True)
    monkeypatch.setattr(module, "Jobs", lambda: jobs)
    events: list[Any] = []
    analyses = Analyses(AnalysisOptions(), events.append, lambda *_: None)
    drop = make_drop()
    for number in range(1, 201):
        analyses.request(saved_drop(drop, record=number))
    # Every drop has its first modulus; sixty tasks, that is thirty drops, are awaited in full.
    assert jobs.requested.count(Urgency.QUICK) == 200
    assert jobs.requested.count(Urgency.FULL) == 30
    assert len([event for event in events if isinstance(event, SessionNotice)]) == 1


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (AttributeError("no screening"), "AttributeError: no screening"),
        (WorkerDied("worker process: it died"), "the drop is safe"),
    ],
)
def test_an_inversion_that_fails_is_a_result_with_the_reason(
    error: Exception, reason: str, monkeypatch: pytest.MonkeyPatch, drop: Drop, events: list[Any]
) -> None:
    error.add_note("Traceback ...")
    monkeypatch.setattr(module, "Jobs", lambda: ScriptedJobs(error=error))
    analyses = Analyses(OPTIONS, events.append, lambda *_: None)
    analyses.request(saved_drop(drop))
    analyses.take_responses()
    notice, failed = events[:2]
    assert reason in notice.text
    assert notice.details == "Traceback ..."
    assert text_of(failed.result.reason) == notice.text
    assert analyses.n_pending == 0


@pytest.fixture
def events() -> list[Any]:
    return []


@pytest.fixture
def analyses(events: list[Any]) -> Iterator[Analyses]:
    """Analyses with their real worker process."""
    analyses = Analyses(OPTIONS, events.append, lambda *_: None)
    yield analyses
    analyses.close()


@pytest.fixture
def drop(make_drop: Callable[..., Drop]) -> Drop:
    return make_drop(pre_trigger=0.02, window=0.1)


def test_a_quick_result_is_first(analyses: Analyses, events: list[Any], drop: Drop) -> None:
    analyses.prepare(IDENTITY, SETUP)
    analyses.request(saved_drop(drop))
    analyses.wait_for_responses(PATIENCE)
    quick, full = (event for event in events if isinstance(event, DropAnalysed))
    assert (quick.full, quick.final, full.full, full.final) == (False, False, True, True)
    assert (quick.result.method, full.result.method) == ("posterior", "mpga")
    assert quick.result.modulus_pa == pytest.approx(full.result.modulus_pa, rel=1e-3)
    assert quick.result.history is None
    assert np.isfinite(quick.curves.predicted).all()
    assert not [event for event in events if isinstance(event, SessionNotice)]


def test_an_unfinished_analysis_is_reported(
    analyses: Analyses, events: list[Any], drop: Drop
) -> None:
    analyses.prepare(IDENTITY, SETUP)
    analyses.request(saved_drop(drop))
    assert analyses.n_pending == 2
    analyses.wait_for_responses(0.0)
    assert analyses.n_pending == 0
    (unfinished,) = [event for event in events if isinstance(event, DropAnalysed)]
    assert unfinished.final
    assert unfinished.result.reason.code == "analysis-not-ended"
    assert unfinished.result.modulus_pa is None
    assert [event.serious for event in events if isinstance(event, SessionNotice)] == [True]


def test_a_rejected_drop_is_not_analysed(analyses: Analyses, drop: Drop) -> None:
    analyses.request(saved_drop(Drop(1, drop.time, np.zeros_like(drop.load), drop.channels)))
    assert analyses.n_pending == 0
