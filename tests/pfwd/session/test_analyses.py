"""What a session asks of its inversion when answers do not come."""

from collections.abc import Callable
from typing import Any

import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.worker.tasks import Urgency
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
