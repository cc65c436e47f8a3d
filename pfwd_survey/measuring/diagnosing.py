"""Has the points of a session diagnosed while they are measured, beside the moduli of the drops.

A process of its own: the first modulus of the next drop must not wait for it.  What the points so
far show of the device is used for the next one.
"""

import queue
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from pfwd_device import Drop
from pfwd_survey.files.header import PointSetup
from pfwd_survey.files.traces import TracePoint
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.worker.tasks import Building
from pfwd_survey.inverting.worker.worker import Answer, InversionWorker
from pfwd_survey.measuring.events import Notice, PointDiagnosed, SavedDrop

FEWEST_POINTS = 2
"""With an effect of the device, from which on the next point is taken to have it."""

DeviceEffects = dict[str, dict[str, float]]
KeepDiagnosis = Callable[[int, DiagnosisResult], object]
EarlierDrops = Callable[[str, int], list[tuple[int, Drop]]]
"""Of a point, before a drop: drops of former sessions with their numbers in the survey."""


@dataclass(slots=True)
class _Point:
    """The drops of a point that are safe, with their numbers within the survey."""

    setup: PointSetup
    drops: dict[int, Drop] = field(default_factory=dict)
    records: dict[int, int | None] = field(default_factory=dict)
    measured: set[int] = field(default_factory=set)
    """Those that neither seat the plate nor are rejected: without one there is nothing to ask."""
    asked: int | None = None
    """Number of the task that waits or is under way."""


class PointDiagnoses:
    """The diagnoses of one session; the last drops of a point count, older questions are dropped.

    Parameters
    ----------
    options : AnalysisOptions
    tell : callable
        Told what comes of it, in the thread that calls the methods.
    keep : callable
        Given the number within the survey of the last measured drop, and a diagnosis to be saved.
    earlier : callable
        Drops of the point from former sessions.
    """

    def __init__(
        self,
        options: AnalysisOptions,
        tell: Callable[[PointDiagnosed | Notice], None],
        keep: KeepDiagnosis,
        earlier: EarlierDrops,
    ) -> None:
        self._options = options
        self._tell, self._keep, self._earlier = tell, keep, earlier
        self._answers: queue.SimpleQueue[Answer | Building] = queue.SimpleQueue()
        self._worker = InversionWorker(self._answers.put)
        self._points: dict[str, _Point] = {}
        self._asked: dict[int, tuple[str, int | None]] = {}
        self._shown: dict[str, DeviceEffects] = {}

    @property
    def unanswered(self) -> int:
        """How many are under way."""
        return len(self._asked)

    def ask(self, handed: SavedDrop) -> None:
        """A drop is safe: have its point diagnosed with it, unless it seats or was rejected."""
        point = self._points.get(handed.point)
        if point is None or point.setup != handed.setup:
            point = self._points[handed.point] = _Point(handed.setup)
            for record, drop in self._earlier(handed.point, handed.number):
                point.drops[drop.number], point.records[drop.number] = drop, record
                if drop.number > handed.setup.seating_drops:
                    point.measured.add(drop.number)
        point.drops[handed.number], point.records[handed.number] = handed.drop, handed.record
        if handed.screening.status == "measured":
            point.measured.add(handed.number)
            self._ask(handed.point, point)

    def discard(self, record: int) -> None:
        """A drop counts no more."""
        for name, point in self._points.items():
            gone = [number for number, known in point.records.items() if known == record]
            for number in gone:
                del point.drops[number], point.records[number]
                point.measured.discard(number)
            if gone and point.measured:
                self._ask(name, point)

    def _ask(self, name: str, point: _Point) -> None:
        if point.asked is not None and self._worker.forget(point.asked):
            self._asked.pop(point.asked, None)
        drops = tuple(point.drops[number] for number in sorted(point.drops))
        last = point.records[max(point.drops)]
        point.asked = self._worker.diagnose(
            TracePoint(name, point.setup, drops), self._options, self._device(name)
        )
        self._asked[point.asked] = name, last

    def _device(self, name: str) -> DeviceEffects:
        """What most of the other points show of the device, in the middle."""
        others = [shown for point, shown in self._shown.items() if point != name]
        device: DeviceEffects = {}
        for effect in {effect for shown in others for effect in shown}:
            having = [shown[effect] for shown in others if effect in shown]
            if len(having) >= max(FEWEST_POINTS, len(others) / 2):
                keys = set.intersection(*map(set, having))
                device[effect] = {
                    key: statistics.median(shown[key] for shown in having) for key in keys
                }
        return device

    def take_answers(self) -> None:
        """Tell what has been answered."""
        while not self._answers.empty():
            answer = self._answers.get()
            if not isinstance(answer, Building):
                self._take(answer)

    def close(self) -> None:
        """End the process; what is not answered stays so."""
        self._worker.close()

    def _take(self, answer: Answer) -> None:
        name, record = self._asked.pop(answer.task.number, (None, None))
        if name is None:
            return
        point = self._points[name]
        if point.asked == answer.task.number:
            point.asked = None
        if answer.fault is not None:
            self._tell(Notice(f"point {name}: {answer.fault}", details=answer.details))
        for diagnosis in answer.diagnoses:
            result = replace(diagnosis, point=name)
            self._note_device(name, result)
            if record is not None:
                self._keep(record, result)
            self._tell(PointDiagnosed(name, result))

    def _note_device(self, name: str, found: DiagnosisResult) -> None:
        """Effects of the device that the point itself showed: not those that it was given."""
        own: DeviceEffects = {}
        for effect in found.effects or ():
            if effect.scope == "device" and effect.evidence is not None:
                values = {
                    str(p.name): p.value for p in effect.parameters or () if p.value is not None
                }
                own[str(effect.name)] = values
        given = [e for e in found.effects or () if e.scope == "device" and e.evidence is None]
        if not given:
            self._shown[name] = own
