"""Points are diagnosed while they are measured; the process is a stand-in, but for one test."""

import functools
import math
from dataclasses import replace
from typing import Any

import pytest

from inversion.inference import structures
from inversion.inference.diagnose import diagnose_point
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult, EffectParameter, EffectResult
from pfwd.analysis.screening.drops import Screening
from pfwd.analysis.tasks import diagnose_single
from pfwd.errors import SurveyError
from pfwd.files.traces import TracePoint
from pfwd.jobs import Task
from pfwd.judging import drop_from_traces
from pfwd.session import diagnosing
from pfwd.session.diagnosing import MAX_POINTS, PointDiagnoses
from pfwd.session.events import DiagnosisAwaited, PointDiagnosed, SavedDrop, SessionNotice
from pfwd_device import Drop
from tests.pfwd.report.surveys import SETUP, half_sine_drop


class ScriptedJobs:
    """Stores the calls; a test sets their results."""

    def __init__(self) -> None:
        self.all: dict[int, tuple[Task[Any], tuple[Any, ...]]] = {}

    def submit(self, _function: Any, *args: Any, on_finish: Any) -> Task[Any]:
        task: Task[Any] = Task()
        task.add_done_callback(on_finish)
        self.all[len(self.all) + 1] = task, args
        return task

    @property
    def open(self) -> list[int]:
        return [number for number, (task, _) in self.all.items() if not task.done()]

    def finish(self, number: int, result: DiagnosisResult) -> None:
        self.all[number][0].set_result(result)

    def close(self) -> None:
        pass


class Session:
    """Diagnoses of a session, with everything that they report and store."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.jobs = ScriptedJobs()
        monkeypatch.setattr(diagnosing, "Jobs", lambda: self.jobs)
        self.events: list[PointDiagnosed | DiagnosisAwaited | SessionNotice] = []
        self.diagnosed: list[tuple[int, DiagnosisResult]] = []
        self.before: dict[str, list[SavedDrop]] = {}
        self.diagnoses = PointDiagnoses(
            AnalysisOptions(diagnose=True),
            self.events.append,
            lambda number, finding: self.diagnosed.append((number, finding)),
            lambda point, _number: self.before.get(point, []),
        )

    def drop(self, point: str, number: int, record: int, status: str = "measured") -> None:
        screening = Screening(status)  # type: ignore[arg-type]
        drop = half_sine_drop(number, 8000.0)
        view = drop_from_traces(drop, SETUP, record=record)
        self.diagnoses.request(SavedDrop(point, replace(view, screening=screening), drop))

    def drops_of(self, task: int) -> list[int]:
        point: TracePoint = self.jobs.all[task][1][0]
        return [drop.number for drop in point.drops]

    def device(self, task: int) -> object:
        return self.jobs.all[task][1][2]


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> Session:
    return Session(monkeypatch)


def finding(*effects: EffectResult) -> DiagnosisResult:
    return DiagnosisResult(drops=(1,), verdict="explained", effects=effects)


def lag(value: float, evidence: float = 50.0) -> EffectResult:
    parameter = EffectParameter(name="delay", value=value, unit="s")
    shared = {"name": "sensor_lag", "scope": "device"}
    return EffectResult(**shared, evidence=evidence, parameters=(parameter,))


def test_a_point_is_diagnosed_with_all_of_its_drops(session: Session) -> None:
    session.drop("A", 1, 11)
    session.jobs.finish(1, finding())
    session.drop("A", 2, 12)
    assert session.drops_of(2) == [1, 2]
    session.jobs.finish(2, finding())
    session.diagnoses.take_responses()
    assert [number for number, _ in session.diagnosed] == [11, 12]
    assert session.diagnosed[1][1].point == "A"
    assert session.diagnoses.n_pending == 0
    awaited = [getattr(event, "awaited", event.point) for event in session.events]
    assert awaited == [True, True, "A", "A", False], "the last diagnosis, then that none is awaited"


def test_diagnoses_at_the_end_of_a_session_are_awaited_no_longer(session: Session) -> None:
    session.drop("A", 1, 11)
    session.drop("B", 1, 12)
    session.diagnoses.give_up()
    assert session.events[2:] == [DiagnosisAwaited("A", False), DiagnosisAwaited("B", False)]
    assert session.diagnoses.n_pending == 0


def test_an_older_question_that_waits_is_dropped(session: Session) -> None:
    session.drop("A", 1, 11)
    session.drop("A", 2, 12)
    session.drop("B", 1, 13)
    assert session.jobs.open == [2, 3]
    assert session.diagnoses.n_pending == 2


def test_no_diagnosis_is_requested_before_a_drop_is_measured(session: Session) -> None:
    session.drop("B", 1, 10, "rejected")
    session.drop("A", 1, 11, "seating")
    assert not session.jobs.open, "there is nothing to diagnose: it would be called unexplained"
    session.drop("A", 2, 12)
    assert session.drops_of(1) == [1, 2]
    session.diagnoses.discard(12)
    assert session.jobs.open == [1], "the seating drop alone"


def test_a_discarded_drop_counts_no_more(session: Session) -> None:
    session.drop("A", 1, 11)
    session.drop("A", 2, 12)
    session.diagnoses.discard(11)
    (task,) = session.jobs.open
    assert session.drops_of(task) == [2]
    session.diagnoses.discard(12)
    session.diagnoses.discard(99)
    assert session.jobs.open == [task]


def test_drops_of_a_former_session_count(session: Session) -> None:
    former = [half_sine_drop(number, 8000.0) for number in (1, 2)]
    views = [drop_from_traces(drop, SETUP, record=drop.number) for drop in former]
    session.before["A"] = [SavedDrop("A", *pair) for pair in zip(views, former, strict=True)]
    session.drop("A", 3, 21)
    assert session.drops_of(1) == [1, 2, 3]


def test_traces_of_early_points_leave_memory(session: Session) -> None:
    for number in range(MAX_POINTS + 1):
        session.drop(str(number), 1, number + 1)
    session.drop("1", 2, 100)
    assert session.drops_of(len(session.jobs.all)) == [1, 2]
    session.drop("0", 2, 101)
    assert session.drops_of(len(session.jobs.all)) == [2], "the survey is asked for the others"


def test_the_next_point_has_the_device_effects_of_earlier_points(session: Session) -> None:
    for name, delay in (("A", 4e-4), ("B", 6e-4)):
        session.drop(name, 1, 11)
        assert session.device(len(session.jobs.all)) == {}, "one point determines no device"
        session.jobs.finish(len(session.jobs.all), finding(lag(delay)))
        session.diagnoses.take_responses()
    session.drop("C", 1, 13)
    assert session.device(3) == {"sensor_lag": {"delay": pytest.approx(5e-4)}}
    # What was given is no finding of the point.
    session.jobs.finish(3, finding(lag(5e-4, math.nan)))
    session.diagnoses.take_responses()
    session.drop("D", 1, 14)
    assert session.device(4) == {"sensor_lag": {"delay": pytest.approx(5e-4)}}


def test_a_fault_is_reported(session: Session) -> None:
    session.drop("A", 1, 11)
    session.jobs.all[1][0].set_exception(SurveyError("no pulse"))
    session.diagnoses.take_responses()
    requested, notice, ended = session.events
    assert (requested, ended) == (DiagnosisAwaited("A", True), DiagnosisAwaited("A", False))
    assert "no pulse" in notice.text
    assert not session.diagnosed


def every_second_sample(drop: Drop) -> Drop:
    channels = [replace(each, values=each.values[::2]) for each in drop.channels]
    return Drop(drop.number, drop.time[::2], drop.load[::2], tuple(channels))


def test_the_process_diagnoses_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structures, "candidate_structures", lambda contexts: [frozenset()])
    without = functools.partial(diagnose_point, compare_declarations=False)
    monkeypatch.setattr("pfwd.analysis.diagnosis.shared_device.diagnose_point", without)
    drops = tuple(every_second_sample(half_sine_drop(n, 8000.0)) for n in (1, 2))
    diagnosis = diagnose_single(TracePoint("A", SETUP, drops), AnalysisOptions(), {})
    assert (diagnosis.left_out, diagnosis.drops) == ((1,), (2,))  # one seats
    assert diagnosis.basis
