"""Inversion of the drops of a session: a quick fit first, the full search after it."""

import contextlib
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropAnalysis, DropResult
from pfwd.analysis.worker.tasks import Building, Urgency
from pfwd.analysis.worker.worker import InversionWorker, TaskResponse
from pfwd.files.header import PointSetup
from pfwd.session.events import DropAnalysed, Notice, SavedDrop, TableBuilding
from pfwd_device.calibration import calibrate
from pfwd_device.identity import Identity


@dataclass(frozen=True, eq=False, slots=True)
class _PendingAnalysis:
    """Analysis that runs in the worker."""

    saved: SavedDrop
    urgency: Urgency
    final: bool
    """True: no further result follows."""


MAX_PENDING_FOR_FULL_SEARCH = 60
"""Analyses under way from which on no full search is requested any more: a computer that is too
slow for them would hold ever more drops in memory. The first modulus is worth nearly as much."""


class Analyses:
    """Analyses of one session.

    Parameters
    ----------
    options : AnalysisOptions
        Of the full search; the quick answer has the same with least squares.
    report : callable
        Receives the outcomes, in the thread that calls the methods.
    keep_result : callable
        Given the number within the survey and a result to be saved.
    """

    def __init__(
        self,
        options: AnalysisOptions,
        report: Callable[[DropAnalysed | Notice | TableBuilding], None],
        keep_result: Callable[[int, DropResult], object],
    ) -> None:
        self._options = options
        self._report = report
        self._keep_result = keep_result
        self._responses: queue.SimpleQueue[TaskResponse | Building] = queue.SimpleQueue()
        self._worker = InversionWorker(self._responses.put)
        self._pending: dict[int, _PendingAnalysis] = {}
        self._behind = False
        # The published method is one search as a whole: no quick answer goes before it.
        self._has_single_answer = options.published or options.method == "least-squares"

    @property
    def n_pending(self) -> int:
        """Number of analyses under way."""
        return len(self._pending)

    def prepare(self, identity: Identity, setup: PointSetup) -> None:
        """Build the model's table for drops of this instrument."""
        counts = np.zeros((64, len(identity.channels)), np.int32)
        self._worker.prepare(calibrate(1, counts, (), 32, identity), setup, self._options)

    def request(self, saved: SavedDrop) -> None:
        """Request the inversion of a drop."""
        if saved.screening.status == "rejected":
            return
        if self._has_single_answer:
            self._request(saved, Urgency.QUICK, self._options)
            return
        quick = replace(self._options, method="least-squares")
        if len(self._pending) < MAX_PENDING_FOR_FULL_SEARCH:
            self._behind = False
            self._request(saved, Urgency.QUICK, quick, final=False)
            self._request(saved, Urgency.FULL, self._options)
            return
        self._request(saved, Urgency.QUICK, quick)
        if not self._behind:
            self._behind = True
            self._report(Notice("the full searches do not keep up; drops are left without them"))

    def _request(
        self, saved: SavedDrop, urgency: Urgency, options: AnalysisOptions, *, final: bool = True
    ) -> None:
        number = self._worker.analyse(
            urgency, saved.drop, saved.setup, saved.screening, options, saved.file
        )
        self._pending[number] = _PendingAnalysis(saved, urgency, final)

    def take_responses(self) -> None:
        """Report the outcomes of the responses."""
        while not self._responses.empty():
            self._take(self._responses.get())

    def wait_for_responses(self, timeout: float) -> None:
        """Wait a number of seconds for the pending analyses, and report those that did not end."""
        until = time.monotonic() + timeout
        while self._pending and (remaining := until - time.monotonic()) > 0:
            with contextlib.suppress(queue.Empty):
                self._take(self._responses.get(timeout=remaining))
        if not self._pending:
            return
        fault = "the analysis did not end in time; the drop is safe, invert it again later"
        self._report(Notice(f"{len(self._pending)} analyses did not end in time", serious=True))
        unfinished, self._pending = list(self._pending.values()), {}
        for pending in unfinished:
            if pending.urgency is Urgency.QUICK:  # a drop without any answer
                result = _failed(pending.saved, fault)
                self._report(DropAnalysed(pending.saved, None, result, None, False, True))

    def close(self) -> None:
        """End the worker; pending drops get no result."""
        self._worker.close()

    def _take(self, response: TaskResponse | Building) -> None:
        if isinstance(response, Building):
            self._report(TableBuilding(response.what, response.fraction))
            return
        if response.fault is not None:
            self._report(Notice(response.fault, serious=True, details=response.details))
        pending = self._pending.pop(response.task.number, None)
        if pending is None:
            return
        saved, full = pending.saved, pending.urgency is Urgency.FULL
        result = response.result
        if result is None:
            result = _failed(saved, str(response.fault))
        elif saved.record is not None:
            self._keep_result(saved.record, result)
        delay = None if saved.received is None else time.monotonic() - saved.received
        self._report(DropAnalysed(saved, delay, result, response.curves, full, pending.final))


def _failed(saved: SavedDrop, fault: str) -> DropResult:
    """Return the result of a drop that could not be inverted, with all its keys."""
    failed = DropAnalysis(saved.drop, saved.screening, None, fault, saved.setup)
    return drop_result(saved.file, failed)
