"""Diagnosis of the points of a session while they are measured.

A diagnosis explains the residual of a point's fit by effects of the ground or of the device. It
takes long and therefore has a process of its own, so that the first modulus of the next drop does
not wait. Device effects that several points show are presumed for the next point.
"""

import math
import queue
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace

from pfwd.analysis import tasks
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd.jobs import Jobs, Task
from pfwd.procedures import Kind
from pfwd.session.events import DiagnosisAwaited, PointDiagnosed, SavedDrop, SessionNotice

MIN_POINTS_WITH_EFFECT = 2
"""Smallest number of points with a device effect for which the next point is presumed to have it.
"""

DeviceEffects = dict[str, dict[str, float]]
KeepDiagnosis = Callable[[int, DiagnosisResult], object]
EarlierDrops = Callable[[str, int], list[SavedDrop]]
"""Function that reads the drops of a point (name) before a drop (number) from the survey."""

MAX_POINTS = 20
"""Number of points whose traces stay in memory, some 10 MB. A discard at an earlier point requests
no new diagnosis; the traces of an earlier point are read from the survey when it gets a new drop.
"""


@dataclass(slots=True)
class _Point:
    """Point with the traces of its drops."""

    setup: PointSetup
    drops: dict[int, SavedDrop]
    """Saved drops by their number within the point."""
    task: Task[DiagnosisResult] | None = None
    """Waiting or running diagnosis; None: there is none."""

    @property
    def has_measured_drop(self) -> bool:
        """True if at least one drop is neither a seating drop nor rejected."""
        return any(_is_measured(drop, self.setup) for drop in self.drops.values())


def _is_measured(drop: SavedDrop, setup: PointSetup) -> bool:
    if drop.view.screening is not None:
        return drop.view.screening.status == "measured"
    return drop.view.own.kind is not Kind.REJECTED and drop.number > setup.seating_drops


class PointDiagnoses:
    """Requests the diagnoses of one session and reports their results.

    A new drop of a point replaces a request for the same point that has not started.

    Parameters
    ----------
    options : AnalysisOptions
    report : callable
        Receives diagnoses and notices, in the thread that calls the methods.
    keep : callable
        Saves a diagnosis; called with the number of the point's last drop within the survey and the
        diagnosis.
    earlier : callable
        Reads the drops of a point that are not in memory.
    """

    def __init__(
        self,
        options: AnalysisOptions,
        report: Callable[[PointDiagnosed | DiagnosisAwaited | SessionNotice], None],
        keep: KeepDiagnosis,
        earlier: EarlierDrops,
    ) -> None:
        self._options = options
        self._report, self._keep, self._earlier = report, keep, earlier
        self._responses: queue.SimpleQueue[Task[DiagnosisResult]] = queue.SimpleQueue()
        self._jobs = Jobs()
        self._points: dict[str, _Point] = {}
        self._pending: dict[Task[DiagnosisResult], tuple[str, int | None]] = {}
        self._device_effects: dict[str, DeviceEffects] = {}

    @property
    def n_pending(self) -> int:
        """Number of requested diagnoses that have no result yet."""
        return len(self._pending)

    def request(self, saved: SavedDrop) -> None:
        """Request the diagnosis of the point of a saved drop; seating and rejected drops request
        none.
        """
        point = self._points.pop(saved.point, None)
        if point is None:
            earlier = self._earlier(saved.point, saved.number)
            point = _Point(saved.setup, {drop.number: drop for drop in earlier})
        self._points[saved.point] = point  # at the end: the first entry is removed first
        while len(self._points) > MAX_POINTS:
            del self._points[next(iter(self._points))]
        point.setup = saved.setup
        point.drops[saved.number] = saved
        if saved.screening.status == "measured":
            self._request(saved.point, point)

    def discard(self, record: int) -> None:
        """Request the diagnosis of a point again, without a discarded drop.

        Parameters
        ----------
        record : int
            Number of the drop within the survey.
        """
        for name, point in self._points.items():
            discarded = [number for number, drop in point.drops.items() if drop.record == record]
            for number in discarded:
                del point.drops[number]
            if discarded and point.has_measured_drop:
                self._request(name, point)

    def _request(self, name: str, point: _Point) -> None:
        if point.task is not None and point.task.cancel():
            self._pending.pop(point.task, None)
        drops = [point.drops[number] for number in sorted(point.drops)]
        traces = TracePoint(name, point.setup, tuple(drop.drop for drop in drops))
        request = (traces, self._options, self._device(name))
        put = self._responses.put
        point.task = self._jobs.submit(tasks.diagnose_single, *request, on_finish=put)
        self._pending[point.task] = name, drops[-1].record
        self._report(DiagnosisAwaited(name, True))

    def _device(self, name: str) -> DeviceEffects:
        """Return the device effects to presume for a point: their medians over the other points.

        An effect is presumed if at least half of the other points show it.
        """
        of_points = [effects for point, effects in self._device_effects.items() if point != name]
        device: DeviceEffects = {}
        for effect in {effect for effects in of_points for effect in effects}:
            having = [effects[effect] for effects in of_points if effect in effects]
            if len(having) >= max(MIN_POINTS_WITH_EFFECT, len(of_points) / 2):
                keys = set.intersection(*map(set, having))
                device[effect] = {
                    key: statistics.median(effects[key] for effects in having) for key in keys
                }
        return device

    def take_responses(self) -> None:
        """Report the diagnoses that the process has returned so far."""
        while not self._responses.empty():
            self._take(self._responses.get())

    def give_up(self) -> None:
        """Report that the remaining diagnoses are awaited no longer."""
        for name in dict.fromkeys(name for name, _ in self._pending.values()):
            self._report(DiagnosisAwaited(name, False))
        self._pending.clear()

    def close(self) -> None:
        """End the process; waiting requests are dropped."""
        self._jobs.close()

    def _take(self, task: Task[DiagnosisResult]) -> None:
        name, record = self._pending.pop(task, (None, None))
        if name is None:
            return
        error = task.exception()
        if error is not None:
            text = f"point {name}: {tasks.failure_text(error)}"
            self._report(SessionNotice(text, details=tasks.failure_details(error)))
        else:
            result = replace(task.result(), point=name)
            self._note_device(name, result)
            if record is not None:
                self._keep(record, result)
            self._report(PointDiagnosed(name, result))
        point = self._points.get(name)
        if point is not None and point.task is task:
            point.task = None
        if name not in {point_name for point_name, _ in self._pending.values()}:
            self._report(DiagnosisAwaited(name, False))

    def _note_device(self, name: str, result: DiagnosisResult) -> None:
        """Store the device effects that a point shows.

        A point for which effects were presumed is no independent evidence and is left out.
        """
        measured: DeviceEffects = {}
        for effect in result.effects:
            if effect.scope == "device":
                if math.isnan(effect.evidence):
                    return
                measured[effect.name] = effect.values_by_name
        self._device_effects[name] = measured
