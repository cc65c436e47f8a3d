"""Random surveys: what was measured and said in any order, and what a session tells meanwhile."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from benchmarks.scale import UnsyncedStorage
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, DropResult, FittedState
from pfwd.analysis.screening.drops import compare
from pfwd.files.editing import MOVED_TO, move_with
from pfwd.files.header import declared_values
from pfwd.judging import (
    JobRequest,
    PointView,
    Station,
    drop_from_traces,
    job_of,
    point_view,
)
from pfwd.procedures import Kind, find_procedure, plain_procedure
from pfwd.session.events import (
    DropAnalysed,
    DropSaved,
    Edited,
    JobReported,
    PointDiagnosed,
    SavedDrop,
)
from pfwd.session.live_view import CompletePoints, apply_event
from pfwd.session.setup_file import setup_of
from pfwd.session.stored_drops import point_event, read_point_event
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of
from tests.records import read
from tui.screen.session.screen_events import SessionStarted
from tui.screen.session.state import SessionState

POINTS = ("1", "2")
PROCEDURES = (
    plain_procedure(1, 2),
    plain_procedure(0, 1),
    *map(find_procedure, ("mndot", "mchw-885", "tp-bf-stb-b8.3", "paper")),
)
"""What points may be called, and the name that their drops have."""

DECLARED = declared_values(SETUP)

PLACE = {"position": {"latitude": 48.1, "longitude": 11.5}}
"""Without one a point is not on the map."""

points = st.sampled_from(POINTS)
numbers = st.integers(1, 9)
targets = st.sampled_from((30e6, 44e6, 60e6, 4e-4, 6e-4))
drops = st.tuples(
    st.just("drop"),
    points,
    # A knock, a rebound beside the others, two heights.
    st.sampled_from((900.0, 1600.0, 6000.0, 8000.0, 8100.0, 9000.0)),
    st.sampled_from((None, 40e6, 45e6, 45.5e6)),
)
stations = st.builds(
    lambda target, other: (Station("12+300", target=target), Station("2", target=other)),
    targets | st.none(),
    targets | st.none(),
)
edits = st.one_of(
    st.tuples(st.sampled_from(("discard", "restore")), numbers, st.none()),
    st.tuples(st.sampled_from(("discard", "restore", "target", "name")), points, st.none()),
    st.tuples(st.just("target"), points, targets),
    st.sampled_from([("name", *named) for named in (("1", "12+300"), ("1", "left"), ("2", "3"))]),
    st.tuples(st.just("move"), numbers, points),
    st.tuples(st.just("diagnosis"), points, st.sampled_from((41e6, 46e6))),
    st.tuples(st.just("job"), st.just(""), st.builds(JobRequest, target=targets)),
    st.tuples(st.just("job"), st.just(""), st.builds(JobRequest, stations=stations)),
    st.tuples(
        st.just("job"), st.just(""), st.builds(JobRequest, procedure=st.sampled_from(PROCEDURES))
    ),
)


def measured(target: float | None, count: int = 7) -> list[Any]:
    """A point with so many good drops and its target."""
    heights = (8000.0, 8100.0)
    moduli = (45e6, 45.5e6)
    fallen = [("drop", "1", heights[n % 2], moduli[n % 2]) for n in range(count)]
    return [*fallen, ("target", "1", target)]


beginnings = st.one_of(
    st.just([("drop", "1", 8000.0, 45e6)]),
    # Points that pass, fail, and are not decided: few stories of random parts come to that.
    st.builds(measured, targets),
    st.builds(
        lambda procedure, target: [("job", "", procedure), *measured(target)],
        st.builds(JobRequest, procedure=st.sampled_from(PROCEDURES), target=targets),
        targets | st.none(),
    ),
    st.just([*measured(44e6), ("diagnosis", "1", 41e6)]),
)
stories = st.builds(
    lambda beginning, rest: [*beginning, *rest],
    beginnings,
    st.lists(drops | edits, max_size=14),
)


def writing(folder: Path) -> SurveyWriter:
    """A writer of the survey."""
    return SurveyWriter.open(folder, publish=False, storage=UnsyncedStorage())


class Told:
    """Writes a survey, and tells what a session would tell while it is written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._begin()

    def _begin(self) -> None:
        self.state = SessionState()
        self.state.take(SessionStarted(None, "1"))
        self._said: list[PointView] = []
        self._complete = CompletePoints(self._said.append)
        self._largest = dict.fromkeys(POINTS, 0.0)

    def play(self, story: Iterable[Any]) -> None:
        """A session, from its start to its end."""
        with writing(self.folder) as writer:
            self.tell(JobReported(job_of(writer.contents())))
            for what, *about in story:
                match what:
                    case "drop":
                        self._drop(writer, *about)
                    case "job":
                        news = about[1].news(job_of(writer.contents()))
                        for event in news.events():
                            writer.note_event(*event)
                        self.tell(JobReported(job_of(writer.contents())))
                    case "move":
                        self._move(writer, *about)
                    case "diagnosis":
                        self._diagnose(writer, *about)
                    case _:
                        self._edit(writer, what, *about)
        self._complete.rest()

    def tell(self, event: Any) -> None:
        """Tell it to everybody who listens."""
        self.state.take(event)
        if (change := apply_event(self.state.view, event)) is not None:
            self.state.take(change)
            self._complete.take(change)

    @property
    def last_lines(self) -> dict[str, dict[str, Any]]:
        """What the headless log said of each point last, by the name that its drops have."""
        return {point.name: point.as_json() for point in self._said}

    def _drop(self, writer: SurveyWriter, point: str, peak: float, modulus: float | None) -> None:
        number = writer.next_number(point)
        drop = half_sine_drop(number, peak)
        record = writer.save_drop(DropRecord(point, drop, None, DECLARED, PLACE))
        setup = setup_of(DECLARED, "test")
        view = drop_from_traces(drop, setup, record=record)
        assert view.screening is not None
        largest = self._largest[point] = max(view.own_pulse_peak, self._largest[point])
        screening = compare(view.screening, view.own_pulse_peak, largest)
        stored = SavedDrop(point, replace(view, screening=screening), drop)
        self.tell(DropSaved(stored))
        if screening.status == "rejected":
            return None
        if modulus is None:
            return self.tell(DropAnalysed(stored, None, DropResult(), None, True, True))
        result = read(DropResult, result_of(number, modulus))
        writer.save_result(record, result.to_stored())
        return self.tell(DropAnalysed(stored, None, result, None, True, True))

    def _edit(self, writer: SurveyWriter, what: str, where: int | str, value: Any) -> None:
        if isinstance(where, int):
            if where <= writer.drops_acknowledged:
                writer.edit(what, value, number=where)
                self.tell(Edited(what, value, None, where))
        elif where in _names(writer) and (value is not None or what in ("discard", "restore")):
            writer.edit(what, value, point=where)
            self.tell(Edited(what, value, where, None))

    def _move(self, writer: SurveyWriter, number: int, to: str) -> None:
        drop = next((d for d in writer.contents().drops if d.number == number), None)
        if drop is None or drop.discarded or drop.point == to:
            return
        within = move_with(writer, drop, to)
        value = {MOVED_TO: {"point": to, "drop": within}}
        self.tell(Edited("discard", value, None, number))
        known = read_point_event(writer, to)
        assert known is not None
        self.tell(known)

    def _diagnose(self, writer: SurveyWriter, name: str, modulus: float) -> None:
        point = next((p for p in writer.contents().points if p.name == name and p.drops), None)
        if point is None:
            return
        measured = point_view(point, job_of(writer.contents()))
        left_out = (Kind.DISCARDED, Kind.REJECTED)
        used = [d.facts.number for d in measured.drops if d.facts.kind not in left_out]
        found = DiagnosisResult(
            verdict="explained",
            corrected=True,
            drops=tuple(used),
            after=FittedState(
                model="half-space",
                modulus_pa=modulus,
                modulus_interval_pa=(modulus - 1e6, 44.5e6),
                equivalent_modulus_pa=modulus,
                equivalent_modulus_interval_pa=(modulus - 1e6, 44.5e6),
                residual_rms_over_peak=0.01,
            ),
            basis=basis_of(measured.drops[-1].setup),
            left_out=(),
        )
        writer.save_result(point.drops[-1].number, found.to_stored(), "diagnosis")
        self.tell(PointDiagnosed(name, found))

    def begin_again(self) -> None:
        """Another program start: what the survey holds is told, as a session does."""
        self._begin()
        for point in read_survey(self.folder).points:
            known = point_event(point)
            self.tell(known)
            peaks = [drop.pulse_peak for drop in known.point.drops]
            self._largest[point.name] = max(peaks, default=0.0)


def _names(writer: SurveyWriter) -> set[str]:
    return {point.name for point in writer.contents().points}


def shown(point: PointView) -> tuple[Any, ...]:
    """What must be alike wherever a point is judged."""
    progress = point.progress
    value = progress.value
    return (
        value and (value.quantity, value.value, value.interval, value.drops),
        progress.target,
        progress.verdict,
        progress.verdict_reason,
        progress.used,
        progress.complete,
    )


cuts = st.integers(0, 20)
"""Where a story is cut into two sessions."""


def whole(story: list[Any]) -> list[Any]:
    """The same with a result of every drop: a report inverts what has none, and keeps it."""
    return [
        (what, *about[:-1], about[-1] or 45e6) if what == "drop" else (what, *about)
        for what, *about in story
    ]
