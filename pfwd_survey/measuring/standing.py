"""How the points of a session stand, from what the session tells: the judgement of `judging`.

The screen and the headless lines feed the same events to it. What a survey held before the session
is told as `PointKnown`; in a replay a known drop counts from when it comes again.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from pfwd_survey.files.moving import moved_to
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from pfwd_survey.inverting.kept import is_sound, rests_on
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.judging import (
    Job,
    JudgedPoint,
    MeasuredDrop,
    MeasuredPoint,
    judge_point,
    measured_drop,
)
from pfwd_survey.measuring.events import (
    DropAnalysed,
    DropSaved,
    Edited,
    HandedOn,
    JobKnown,
    PointDiagnosed,
    PointKnown,
    SessionEvent,
)
from pfwd_survey.procedures import PointProgress, PointValue


@dataclass(slots=True)
class _Point:
    """A point as far as it is known."""

    name: str
    title: str = ""
    target: float | None = None
    discarded: bool = False
    drops: dict[int, MeasuredDrop] = field(default_factory=dict)
    """That have come, or were there before, by number."""
    known: dict[int, MeasuredDrop] = field(default_factory=dict)
    """Of a replay: with the result that the survey holds."""
    records: dict[int, int] = field(default_factory=dict)
    """Number within the point by number within the survey."""
    diagnosis: DiagnosisResult | None = None
    """The last one; None: nobody asked."""
    version: int = 0
    """Grows with everything that may change how it stands."""


class Standing:
    """The points of a session.

    Parameters
    ----------
    job : Job, optional
        Until the session tells another.
    """

    def __init__(self, job: Job | None = None) -> None:
        self.job = job or Job()
        self._points: dict[str, _Point] = {}
        self._judged: dict[str, tuple[int, int, PointProgress]] = {}
        self._jobs = 0

    def take(self, event: SessionEvent) -> str | None:
        """Take an event in; the name of the point that may stand otherwise now."""
        match event:
            case JobKnown(job):
                self.job = job
                self._jobs += 1
            case PointKnown():
                self._know(event)
                return event.point
            case DropSaved(handed):
                self._saved(handed)
                return handed.point
            case DropAnalysed():
                self._analysed(event)
                return event.handed.point
            case PointDiagnosed(name, result):
                point = self._of(name)
                point.diagnosis = result
                point.version += 1
                return name
            case Edited():
                return self._edited(event)
        return None

    def progress_of(self, name: str) -> PointProgress:
        """How a point stands; judged anew when something has changed."""
        point = self._points.get(name) or _Point(name)
        kept = self._judged.get(name)
        if kept is not None and kept[:2] == (self._jobs, point.version):
            return kept[2]
        drops = [point.drops[number] for number in sorted(point.drops)]
        measured = MeasuredPoint(
            point.title or name, drops, point.target, point.discarded, point.diagnosis
        )
        found = judge_point(self.job, measured)
        self._judged[name] = self._jobs, point.version, found
        return found

    def judged(self, name: str) -> JudgedPoint:
        """A point with how it stands, by the name that its drops have."""
        point = self._points.get(name) or _Point(name)
        return JudgedPoint(point.title or name, self.progress_of(name), point.discarded)

    def facts_of(self, name: str, number: int) -> MeasuredDrop | None:
        """What takes part in the judgement of a drop."""
        point = self._points.get(name)
        return None if point is None else point.drops.get(number)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the points, as their drops name them."""
        return tuple(self._points)

    def _of(self, name: str) -> _Point:
        return self._points.setdefault(name, _Point(name))

    def _know(self, event: PointKnown) -> None:
        point = self._of(event.point)
        known = event.measured
        point.title, point.target, point.discarded = known.name, known.target, known.discarded
        point.diagnosis = known.diagnosis
        drops = {drop.facts.number: drop for drop in known.drops}
        if event.comes_again:
            point.known = drops
        else:
            # What has come since is newer than what was read.
            point.drops = drops | point.drops
        point.records |= {record: number for number, record in event.records.items()}
        point.version += 1

    def _saved(self, handed: HandedOn) -> None:
        point = self._of(handed.point)
        known = point.known.get(handed.number)
        # By its own record: what it is beside the others may change when one of them is moved.
        point.drops[handed.number] = known or measured_drop(handed.drop, handed.setup)
        if handed.record is not None:
            point.records[handed.record] = handed.number
        point.version += 1

    def _analysed(self, event: DropAnalysed) -> None:
        handed, point = event.handed, self._of(event.handed.point)
        known = point.known.get(handed.number)
        if known is not None and known.facts.modulus is not None:
            return  # the survey's own result counts
        drop = point.drops.get(handed.number)
        if drop is None or not _counts(event.result, drop):
            return
        point.drops[handed.number] = drop.with_result(event.result)
        point.version += 1

    def _edited(self, event: Edited) -> str | None:
        if event.point is not None:
            point = self._of(event.point)
            match event.what:
                case "target":
                    number = event.value
                    point.target = float(number) if isinstance(number, int | float) else None
                case "discard" | "restore":
                    point.discarded = event.what == "discard"
                case "name":
                    point.title = str(event.value)
            point.version += 1
            return event.point
        for point in self._points.values():
            number_within = point.records.get(event.number or 0)
            if number_within is None or event.what not in ("discard", "restore"):
                continue
            reason = None if event.what == "restore" else str(event.value or "")
            where = moved_to(event.value)
            for drops in (point.drops, point.known):
                known = drops.get(number_within)
                if known is not None:
                    drops[number_within] = (
                        known.with_discarding(reason) if where is None else known.with_move(where)
                    )
            point.version += 1
            return point.name
        return None


def _counts(result: DropResult, drop: MeasuredDrop) -> bool:
    """Whether a result is one that a survey would be judged by, as `judging.kept_result` has it."""
    return not result.is_trial and is_sound(result) and rests_on(result, drop.setup)


class CompletePoints:
    """Says of a point how it stands when it is complete, and again when that changes.

    A point that was told and is not complete any more is told again, as what it is by now; one
    whose value alone has changed is told again in the end, so that what was said of it last holds.

    Parameters
    ----------
    tell : callable
        Given the point.
    analysed : bool
        Whether drops are inverted; then a drop's last answer is waited for.
    """

    def __init__(self, tell: Callable[[JudgedPoint], None], *, analysed: bool) -> None:
        self._tell = tell
        self._analysed = analysed
        self._standing = Standing()
        self._told: dict[str, _Told] = {}
        self._waiting: dict[str, set[int]] = {}

    def take(self, event: SessionEvent) -> None:
        """Take an event in."""
        name = self._standing.take(event)
        if isinstance(event, DropAnalysed) and event.final:
            self._waiting.get(event.handed.point, set()).discard(event.handed.number)
        if isinstance(event, DropSaved) and self._analysed:
            waiting = self._waiting.setdefault(event.handed.point, set())
            if event.handed.screening.status != "rejected":
                waiting.add(event.handed.number)
        if isinstance(event, JobKnown):
            for known in self._told:
                self._say(known)
        elif name is not None and not isinstance(event, PointKnown):
            self._say(name)

    def rest(self) -> None:
        """Nothing more comes: say of every point what was not said for a search under way."""
        self._waiting.clear()
        for name in self._standing.names:
            self._say(name, last=True)

    def _say(self, name: str, *, last: bool = False) -> None:
        point = self._standing.judged(name)
        progress, told = point.progress, self._told.get(name)
        if self._waiting.get(name) or not (progress.complete or told):
            return
        now = _Told((progress.complete, progress.verdict, progress.target), progress.value)
        if told is None or told.stands != now.stands or (last and told.value != now.value):
            self._told[name] = now
            self._tell(point)


@dataclass(frozen=True, slots=True)
class _Told:
    """What was said of a point last."""

    stands: tuple[object, ...]
    value: PointValue | None
