"""Work in processes besides the session: fits with other settings, and the diagnosis."""

import queue
import re
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DiagnosisResult
from pfwd.jobs import Task, TaskProgress
from pfwd.units import SI
from tests.tui.screen.scripted import saved_drop
from tui.screen.command_process import run_command
from tui.screen.session.diagnosis import RequestedDiagnoses, diagnosis_text
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.screen_events import DiagnosisFinished

PATIENCE = 120.0


class Screen:
    """Messages and events of fits and diagnoses."""

    def __init__(self) -> None:
        self.events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.put = self.events.put
        self.messages: list[str] = []

    def event(self) -> Any:
        return self.events.get(timeout=PATIENCE)


@pytest.fixture
def screen() -> Screen:
    return Screen()


@pytest.fixture
def diagnoses(screen: Screen, tmp_path: Path) -> Iterator[RequestedDiagnoses]:
    source: Any = SimpleNamespace(survey=tmp_path / "other", writes=True)
    state: Any = SimpleNamespace(points={})
    diagnoses = RequestedDiagnoses(source, screen, state, screen.messages.append)  # type: ignore[arg-type]
    yield diagnoses
    diagnoses.close()


def test_a_trial_fit_runs_in_a_separate_process(screen: Screen) -> None:
    unused: Any = None
    fits = DropFits(unused, screen, unused, screen.messages.append, unused)  # type: ignore[arg-type]
    try:
        options = AnalysisOptions(model="half-space", method="posterior")
        fits.refit(saved_drop(4), options, options.label)
        assert fits.n_running == 1
        finished = screen.event()
        assert fits.n_running == 0
    finally:
        fits.close()
    assert (finished.point, finished.number, finished.fault) == ("7", 4, "")
    assert finished.label == "half-space, posterior"
    assert finished.result.refit == finished.label
    assert finished.result.model == "half-space"
    assert finished.curves is not None


def test_an_impossible_diagnosis_is_a_sentence(
    diagnoses: RequestedDiagnoses, screen: Screen, tmp_path: Path
) -> None:
    diagnoses.start(str(tmp_path / "none"))
    finished = screen.event()
    assert finished.results == ()
    assert "none failed:" in finished.error
    assert "\n" not in finished.error
    assert diagnoses.task is not None
    diagnoses.on_diagnosed(finished, SI)
    assert diagnoses.task is None


def test_diagnoses_are_stored_by_the_session_of_their_survey_only(
    diagnoses: RequestedDiagnoses, screen: Screen, tmp_path: Path
) -> None:
    stored: list[tuple[int, DiagnosisResult]] = []
    session = SimpleNamespace(keep_diagnosis=lambda *diagnosis: stored.append(diagnosis))
    screen.request = lambda action: action(session) is None  # type: ignore[attr-defined]
    new, old = DiagnosisResult(drops=(4,)), DiagnosisResult(drops=(8,), stored=True)
    reason = "results are not stored: another program writes the survey"
    task = Task[Any]()
    task.set_result(([(4, new), (8, old)], reason))
    diagnoses._finish("survey", task)
    diagnoses.on_diagnosed(screen.event(), SI)
    assert screen.messages == [f"the diagnosis is done: 4 shows it; {reason}"]
    diagnoses._finish(str(tmp_path / "other"), task)
    finished = screen.event()
    assert finished.results == (new, old)
    assert finished.not_stored == ""
    assert stored == [(4, new)]


def test_a_running_diagnosis_reports_point_work_and_times() -> None:
    task = Task[tuple[DiagnosisResult, ...]]()
    start = task.start
    assert diagnosis_text("ring road", task, start + 3.0) == (
        "diagnosing ring road, reading the drops; 3 s so far"
    )
    task.take_progress(TaskProgress("each point by itself", "ring road, point PV01 3", 4, 12))
    task._work_start = start + 2.0
    assert diagnosis_text("a/ring road", task, start + 42.0) == (
        "diagnosing ring road: point PV01 3, 4 of 12 points done, each point by itself; "
        "42 s so far, about 1 min 20 s to go"
    )


def test_a_second_diagnosis_waits_and_the_first_can_be_stopped(
    diagnoses: RequestedDiagnoses, screen: Screen, tmp_path: Path
) -> None:
    diagnoses.start(str(tmp_path / "one"))
    diagnoses.start(str(tmp_path / "two"))
    assert screen.messages[-1] == "a diagnosis is under way; 4 and k stop it"
    end = time.monotonic() + PATIENCE
    while diagnoses.task and not diagnoses.task.process and time.monotonic() < end:
        time.sleep(0.001)
    diagnoses.stop()
    stopped = screen.event()
    assert isinstance(stopped, DiagnosisFinished)
    assert stopped.file.endswith("one")
    assert stopped.error == "the diagnosis of one was stopped"


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("report", "road"), r"pfwd report: error: the following arguments are required: -o"),
        (("schema", "setup"), r"$"),
    ],
)
def test_a_command_in_a_process_returns_its_error(words: tuple[str, ...], error: str) -> None:
    text = run_command(words)
    assert re.match(error, text)
    assert "\n" not in text
