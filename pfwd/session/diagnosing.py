"""Diagnoses of the points of a session while they are measured.

They have a process of their own: the first modulus of the next drop must not wait for it. Effects
of the device that the points so far show are used for the next one.
"""

import queue
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.analysis.worker.tasks import Building
from pfwd.analysis.worker.worker import InversionWorker, TaskResponse
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint
from pfwd.procedures import Kind
from pfwd.session.events import Notice, PointDiagnosed, SavedDrop

MIN_POINTS_WITH_EFFECT = 2
"""Number of points with a device effect from which the next point is presumed to have it."""

DeviceEffects = dict[str, dict[str, float]]
KeepDiagnosis = Callable[[int, DiagnosisResult], object]
EarlierDrops = Callable[[str, int], list[SavedDrop]]
"""Function that reads the drops of a point before a number from the survey."""

MAX_POINTS = 20
"""Points whose traces stay in memory, some 10 MB. A discard at an earlier point requests no new
diagnosis; when a drop falls there again, the traces of the others are read from the survey."""


@dataclass(slots=True)
class _Point:
    """Point with the traces of its drops."""

    setup: PointSetup
    drops: dict[int, SavedDrop]
    """Safe drops by their number within the point."""
    task: int | None = None
    """Number of the waiting or running task."""

    @property
    def has_measured_drop(self) -> bool:
        """True: a drop neither seats the plate nor is rejected, and there is a residual."""
        return any(_is_measured(drop, self.setup) for drop in self.drops.values())


def _is_measured(drop: SavedDrop, setup: PointSetup) -> bool:
    if drop.view.screening is not None:
        return drop.view.screening.status == "measured"
    return drop.view.own.kind is not Kind.REJECTED and drop.number > setup.seating_drops


class PointDiagnoses:
    """Diagnoses of one session; a new drop of a point replaces the request that still waits.

    Parameters
    ----------
    options : AnalysisOptions
    report : callable
        Receives diagnoses and notices, in the thread that calls the methods.
    keep : callable
        Stores a diagnosis; receives the number within the survey of the point's last drop, too.
    earlier : callable
        Reads the drops of a point that are not in memory.
    """

    def __init__(
        self,
        options: AnalysisOptions,
        report: Callable[[PointDiagnosed | Notice], None],
        keep: KeepDiagnosis,
        earlier: EarlierDrops,
    ) -> None:
        self._options = options
        self._report, self._keep, self._earlier = report, keep, earlier
        self._responses: queue.SimpleQueue[TaskResponse | Building] = queue.SimpleQueue()
        self._worker = InversionWorker(self._responses.put)
        self._points: dict[str, _Point] = {}
        self._pending: dict[int, tuple[str, int | None]] = {}
        self._device_effects: dict[str, DeviceEffects] = {}

    @property
    def n_pending(self) -> int:
        """Number of diagnoses under way."""
        return len(self._pending)

    def request(self, saved: SavedDrop) -> None:
        """Diagnose the point of a safe drop, unless it seats the plate or is rejected."""
        point = self._points.pop(saved.point, None)
        if point is None:
            earlier = self._earlier(saved.point, saved.number)
            point = _Point(saved.setup, {drop.number: drop for drop in earlier})
        self._points[saved.point] = point  # the last one
        while len(self._points) > MAX_POINTS:
            del self._points[next(iter(self._points))]
        point.setup = saved.setup
        point.drops[saved.number] = saved
        if saved.screening.status == "measured":
            self._request(saved.point, point)

    def discard(self, record: int) -> None:
        """Diagnose the point of a drop without it."""
        for name, point in self._points.items():
            discarded = [number for number, drop in point.drops.items() if drop.record == record]
            for number in discarded:
                del point.drops[number]
            if discarded and point.has_measured_drop:
                self._request(name, point)

    def _request(self, name: str, point: _Point) -> None:
        if point.task is not None and self._worker.forget(point.task):
            self._pending.pop(point.task, None)
        drops = [point.drops[number] for number in sorted(point.drops)]
        traces = TracePoint(name, point.setup, tuple(drop.drop for drop in drops))
        point.task = self._worker.diagnose(traces, self._options, self._device(name))
        self._pending[point.task] = name, drops[-1].record

    def _device(self, name: str) -> DeviceEffects:
        """Return the medians of the device effects that most of the other points show."""
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
        """Report the outcomes of the responses."""
        while not self._responses.empty():
            response = self._responses.get()
            if not isinstance(response, Building):
                self._take(response)

    def close(self) -> None:
        """End the process; waiting requests are dropped."""
        self._worker.close()

    def _take(self, response: TaskResponse) -> None:
        name, record = self._pending.pop(response.task.number, (None, None))
        if name is None:
            return
        point = self._points.get(name)
        if point is not None and point.task == response.task.number:
            point.task = None
        if response.fault is not None:
            self._report(Notice(f"point {name}: {response.fault}", details=response.details))
        for diagnosis in response.diagnoses:
            result = replace(diagnosis, point=name)
            self._note_device(name, result)
            if record is not None:
                self._keep(record, result)
            self._report(PointDiagnosed(name, result))

    def _note_device(self, name: str, result: DiagnosisResult) -> None:
        """Record the device effects that the point showed, without those that were presumed."""
        measured: DeviceEffects = {}
        for effect in result.effects or ():
            if effect.scope == "device" and effect.evidence is not None:
                values = {
                    str(p.name): p.value for p in effect.parameters or () if p.value is not None
                }
                measured[str(effect.name)] = values
        declared = [e for e in result.effects or () if e.scope == "device" and e.evidence is None]
        if not declared:
            self._device_effects[name] = measured
