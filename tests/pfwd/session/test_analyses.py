"""What a session asks of its inversion when answers do not come."""

from collections.abc import Callable
from typing import Any

import pytest

from inversion.result import StructureResult
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.analysis.worker.tasks import Task, Urgency
from pfwd.analysis.worker.worker import TaskResponse
from pfwd.files.header import PointSetup
from pfwd.judging import drop_from_traces
from pfwd.session import analyses as module
from pfwd.session.analyses import Analyses
from pfwd.session.events import Notice, SavedDrop
from pfwd_device import Drop


class SilentWorker:
    """Takes every task and answers none, as a computer that is far too slow."""

    asked: list[Urgency]

    def __init__(self, _listener: Callable[[Any], None]) -> None:
        self.asked = []

    def analyse(self, urgency: Urgency, *_task: Any) -> int:
        self.asked.append(urgency)
        return len(self.asked)

    def close(self) -> None:
        """Nothing runs."""


class PromptWorker(SilentWorker):
    """Answers every task at once."""

    def __init__(self, listener: Callable[[Any], None]) -> None:
        super().__init__(listener)
        self._listener = listener
        self.preceding: list[DropResult | None] = []

    def analyse(self, urgency: Urgency, *task: Any) -> int:
        number = super().analyse(urgency)
        self.preceding.append(task[-1])
        work = Task(number, urgency, *task)
        result = DropResult(drop=number, structures=(StructureResult(name="half-space"),))
        self._listener(TaskResponse(work, result))
        return number


def test_a_quick_fit_starts_from_the_preceding_result_of_its_point(
    monkeypatch: pytest.MonkeyPatch, make_drop: Callable[..., Drop]
) -> None:
    monkeypatch.setattr(module, "InversionWorker", PromptWorker)
    analyses = Analyses(AnalysisOptions(), lambda _: None, lambda *_: None)
    drop = make_drop()
    for point in "A", "A", "B":
        view = drop_from_traces(drop, PointSetup(plate_radius=0.15), record=1)
        analyses.request(SavedDrop(point, view, drop, "f"))
        analyses.take_responses()
    preceding = analyses._worker.preceding  # type: ignore[attr-defined]
    # A quick fit and a full search for each drop; the second result is the last of drop 1.
    assert [result and result.drop for result in preceding] == [None, None, 2, None, None, None]


def test_full_searches_that_do_not_keep_up_are_left_out_and_said_once(
    monkeypatch: pytest.MonkeyPatch, make_drop: Callable[..., Drop]
) -> None:
    monkeypatch.setattr(module, "InversionWorker", SilentWorker)
    told: list[Any] = []
    analyses = Analyses(AnalysisOptions(), told.append, lambda *_: None)
    drop = make_drop()
    setup = PointSetup(plate_radius=0.15)
    for number in range(1, 201):
        stored = SavedDrop("1", drop_from_traces(drop, setup, record=number), drop, "f")
        analyses.request(stored)
    asked = analyses._worker.asked  # type: ignore[attr-defined]
    # Every drop has its first modulus; sixty tasks, that is thirty drops, are waited for in full.
    assert asked.count(Urgency.QUICK) == 200
    assert asked.count(Urgency.FULL) == 30
    notices = [event.text for event in told if isinstance(event, Notice)]
    assert len(notices) == 1
    assert notices[0].startswith("this computer is too slow for a full search of every drop")
