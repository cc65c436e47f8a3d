"""Inversion of the drops of a session: a quick fit first, then the full search.

The quick fit starts from the preceding result of the point, if there is one. Both run in a worker
process, so that recording never waits for them.
"""

import contextlib
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from inversion.notices import Notice, text_notice
from pfwd.analysis import tasks
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropAnalysis, DropResult
from pfwd.analysis.tasks import Urgency
from pfwd.files.header import PointSetup
from pfwd.jobs import Jobs, Task, TaskProgress
from pfwd.session.events import DropAnalysed, SavedDrop, SessionNotice, TableBuilding
from pfwd_device.calibration import calibrate
from pfwd_device.identity import Identity


@dataclass(frozen=True, eq=False, slots=True)
class _PendingAnalysis:
    """Analysis that was requested and has no result yet."""

    saved: SavedDrop
    urgency: Urgency
    final: bool
    """True: no further result of the drop follows."""


MAX_PENDING_FOR_FULL_SEARCH = 60
"""Number of pending analyses above which no full search is requested: on a computer that is too
slow for them, more and more drops would wait in memory."""


class Analyses:
    """Requests the inversions of one session and reports their results.

    Parameters
    ----------
    options : AnalysisOptions
        Options of the full search; the quick fit has the same with the method "posterior".
    report : callable
        Receives results and notices, in the thread that calls the methods.
    keep_result : callable
        Saves a result; called with the number of the drop within the survey and the result.
    """

    def __init__(
        self,
        options: AnalysisOptions,
        report: Callable[[DropAnalysed | SessionNotice | TableBuilding], None],
        keep_result: Callable[[int, DropResult], object],
    ) -> None:
        self._options = options
        self._report = report
        self._keep_result = keep_result
        self._responses: queue.SimpleQueue[Task[Any] | TaskProgress] = queue.SimpleQueue()
        self._jobs = Jobs()
        self._jobs.submit(tasks.load_solvers, priority=Urgency.PREPARE)
        self._pending: dict[Task[Any], _PendingAnalysis] = {}
        self._behind = False
        self._preceding: dict[str, DropResult] = {}
        """Last result of the present point, by its name."""
        # The published method is one search without a quick fit.
        self._has_single_answer = options.published or options.method == "posterior"

    @property
    def n_pending(self) -> int:
        """Number of requested analyses that have no result yet."""
        return len(self._pending)

    def prepare(self, identity: Identity, setup: PointSetup) -> None:
        """Compute the response tables of the model in advance, for the drops of this instrument."""
        counts = np.zeros((64, len(identity.channels)), np.int32)
        drop = calibrate(1, counts, (), 32, identity)
        self._submit(Urgency.PREPARE, tasks.load_tables, drop, setup, self._options)

    def request(self, saved: SavedDrop) -> None:
        """Request the inversion of a drop, unless the drop is rejected."""
        if saved.screening.status == "rejected":
            return
        if self._has_single_answer:
            self._request(saved, Urgency.QUICK, self._options)
            return
        quick = replace(self._options, method="posterior")
        if len(self._pending) < MAX_PENDING_FOR_FULL_SEARCH:
            self._behind = False
            preceding = self._preceding.get(saved.point)
            self._request(saved, Urgency.QUICK, quick, final=False, preceding=preceding)
            self._request(saved, Urgency.FULL, self._options)
            return
        self._request(saved, Urgency.QUICK, quick)
        if not self._behind:
            self._behind = True
            text = (
                "this computer is too slow for a full search of every drop. Drops without it have "
            )
            self._report(
                SessionNotice(
                    text + "the modulus of a quick fit; pfwd invert does the search later"
                )
            )

    def _request(
        self,
        saved: SavedDrop,
        urgency: Urgency,
        options: AnalysisOptions,
        *,
        final: bool = True,
        preceding: DropResult | None = None,
    ) -> None:
        request = (saved.drop, saved.setup, saved.screening, options, saved.file, preceding)
        task = self._submit(urgency, tasks.invert_drop, *request)
        self._pending[task] = _PendingAnalysis(saved, urgency, final)

    def _submit(self, urgency: Urgency, function: Callable[..., Any], *args: Any) -> Task[Any]:
        put = self._responses.put
        return self._jobs.submit(function, *args, priority=urgency, on_progress=put, on_finish=put)

    def take_responses(self) -> None:
        """Report the results that the worker has returned so far."""
        while not self._responses.empty():
            self._take(self._responses.get())

    def wait_for_responses(self, timeout: float) -> None:
        """Wait for the pending analyses and report their results, or that they did not end in time.

        Parameters
        ----------
        timeout : float, s
        """
        until = time.monotonic() + timeout
        while self._pending and (remaining := until - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                self._take(self._responses.get(timeout=remaining))
        if not self._pending:
            return
        text = f"analyses that did not end in time: {len(self._pending)}. The drops are safe; run "
        self._report(SessionNotice(text + "pfwd invert on the survey", serious=True))
        unfinished, self._pending = list(self._pending.values()), {}
        for pending in unfinished:
            if pending.urgency is Urgency.QUICK:  # the drop has no result at all
                result = _failed(pending.saved, Notice("analysis-not-ended"))
                self._report(DropAnalysed(pending.saved, None, result, None, False, True))

    def close(self) -> None:
        """End the worker process; drops with a pending analysis get no result."""
        self._jobs.close()

    def _take(self, response: Task[Any] | TaskProgress) -> None:
        if isinstance(response, TaskProgress):
            self._report(TableBuilding(response.item, response.count / response.total))
            return
        error = response.exception()
        if error is not None:
            details = tasks.failure_details(error)
            self._report(SessionNotice(tasks.failure_text(error), serious=True, details=details))
        pending = self._pending.pop(response, None)
        if pending is None:
            return
        saved, full = pending.saved, pending.urgency is Urgency.FULL
        curves = None
        if error is not None:
            result = _failed(saved, text_notice(tasks.failure_text(error)))
        else:
            result, curves = response.result()
            if saved.record is not None:
                self._keep_result(saved.record, result)
        if result.structures:
            self._preceding = {saved.point: result}
        delay = None if saved.received is None else time.monotonic() - saved.received
        self._report(DropAnalysed(saved, delay, result, curves, full, pending.final))


def _failed(saved: SavedDrop, fault: Notice) -> DropResult:
    """Return the result of a drop whose inversion failed; it has the reason and no modulus."""
    failed = DropAnalysis(saved.drop, saved.screening, None, fault, saved.setup)
    return drop_result(saved.file, failed)
