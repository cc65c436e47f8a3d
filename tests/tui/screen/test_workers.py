"""Work in further processes: fits with other settings, the diagnosis."""

import dataclasses
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.analysis.worker.tasks import DiagnosisProgress, DiagnosisTask, TaskOutcome
from tests.tui.screen.scripted import saved_drop
from tui.screen.session.diagnosis import Diagnoser, RunningDiagnosis, diagnosis_text
from tui.screen.session.drop_fits import RefitWorker
from tui.screen.session.screen_events import DiagnosisFinished, Refit

PATIENCE = 120.0


class EventList(list[Any]):
    """List of received events; a thread can wait for the last one."""

    def __init__(self) -> None:
        super().__init__()
        self.changed = threading.Event()

    def __call__(self, event: Any) -> None:
        self.append(event)
        if isinstance(event, Refit | DiagnosisFinished):
            self.changed.set()

    def last(self) -> Any:
        assert self.changed.wait(PATIENCE)
        return self[-1]


def test_a_trial_fit_runs_in_a_separate_process() -> None:
    events = EventList()
    refits = RefitWorker(events)
    try:
        options = AnalysisOptions(model="half-space", method="posterior")
        refits.start(saved_drop(4), options, options.label)
        finished = events.last()
    finally:
        refits.close()
    assert (finished.point, finished.number, finished.fault) == ("7", 4, "")
    assert finished.label == "half-space, posterior"
    assert finished.result.refit == finished.label
    assert finished.result.model == "half-space"
    assert finished.curves is not None
    assert refits.n_running == 0


def test_labels_name_the_changed_options() -> None:
    assert AnalysisOptions().label == "as declared"
    assert AnalysisOptions(published=True).label == "published method"
    options = AnalysisOptions(bedrock_depth=1.2, elastic=True, plate="rigid-smooth")
    assert options.label == "bedrock 1.2 m, elastic, rigid-smooth plate"
    assert AnalysisOptions(layers="auto").label == "auto layers"
    assert AnalysisOptions(layers=2, elastic=True).label == "2 layers, elastic"


def test_an_impossible_diagnosis_is_a_sentence(tmp_path: Path) -> None:
    events = EventList()
    diagnoser = Diagnoser(events)
    assert diagnoser.start(str(tmp_path / "none"))
    finished = events.last()
    assert finished.results == ()
    assert "none failed:" in finished.error
    assert "\n" not in finished.error
    assert diagnoser.file == ""


def test_results_of_a_diagnosis_arrive_as_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = []

    def request(_process: Any, task: DiagnosisTask, _report: Any) -> TaskOutcome:
        tasks.append(task)
        return TaskOutcome(fault="point 2: no load", diagnoses=(DiagnosisResult(point="1"),))

    monkeypatch.setattr("tui.screen.session.diagnosis.request", request)
    events = EventList()
    assert Diagnoser(events).start(str(tmp_path))
    finished = events.last()
    assert [task.source for task in tasks] == [str(tmp_path)]
    assert (finished.file, finished.results, finished.error) == (
        str(tmp_path),
        (DiagnosisResult(point="1"),),
        "",
    )


def test_a_running_diagnosis_reports_point_work_and_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported, resume = threading.Event(), threading.Event()

    def request(_process: Any, _task: DiagnosisTask, report: Any) -> TaskOutcome:
        report(DiagnosisProgress("each point by itself", "ring road, point PV01 3", 4, 12))
        reported.set()
        assert resume.wait(PATIENCE)
        return TaskOutcome()

    monkeypatch.setattr("tui.screen.session.diagnosis.request", request)
    events = EventList()
    diagnoser = Diagnoser(events)
    diagnoser.start(str(tmp_path / "ring road"))
    assert reported.wait(PATIENCE)
    running = diagnoser.progress
    assert running is not None
    started = dataclasses.replace(running, start=100.0, kind_start=102.0)
    assert diagnosis_text("a/ring road", started, 142.0) == (
        "diagnosing ring road: point PV01 3, 4 of 12 points done, each point by itself; "
        "42 s so far, about 1 min 20 s to go"
    )
    assert diagnosis_text("ring road", RunningDiagnosis(100.0), 103.0) == (
        "diagnosing ring road, reading the drops; 3 s so far"
    )
    later = started.at(DiagnosisProgress("with what other points show", "", 0, 3), 150.0)
    assert later.remaining(160.0) is None, "a new kind of work has its own pace"
    resume.set()
    events.last()
    assert diagnoser.progress is None


def test_a_second_diagnosis_waits_and_the_first_can_be_stopped(tmp_path: Path) -> None:
    events = EventList()
    diagnoser = Diagnoser(events)
    assert diagnoser.start(str(tmp_path / "one"))
    assert not diagnoser.start(str(tmp_path / "two"))
    started = time.monotonic()
    while diagnoser._process is None and time.monotonic() < started + PATIENCE:
        time.sleep(0.01)
    diagnoser.stop()
    stopped = events.last()
    assert stopped.file.endswith("one")
    assert stopped.error == "the diagnosis of one was stopped"
