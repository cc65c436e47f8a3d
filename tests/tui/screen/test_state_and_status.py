"""State of a session after its events, and its status word."""

import dataclasses
from typing import Any

import pytest

from inversion.notices import Notice, text_notice, text_of
from pfwd.analysis.result_store import basis_of
from pfwd.analysis.results import DiagnosisResult, DropResult, EffectResult, FittedState
from pfwd.judging import Job, PointView
from pfwd.procedures import Verdict, find_procedure
from pfwd.session.events import (
    BatteryLow,
    DiagnosisAwaited,
    DropAnalysed,
    DropNotSaved,
    Edited,
    InstrumentLost,
    JobReported,
    NotReady,
    PointBegan,
    PointDiagnosed,
    Ready,
    Rebounded,
    SensorCheck,
    SessionNotice,
    StorageLow,
    SurveyFilesChanged,
    SurveyRead,
    TableBuilding,
)
from pfwd.session.plan import Ending
from pfwd.units import SI
from tests.tui.screen.scripted import (
    NOON,
    Session,
    analysed,
    complete_point,
    ready,
    report,
    result,
    saved,
    status,
    stored_drop,
)
from tui.diagnosis_lines import diagnosis_sentence
from tui.screen.pages.drop_texts import modulus_of_drop, remark, verdict_of, verdict_word
from tui.screen.session.screen_events import SessionEnded, SessionStarted
from tui.screen.session.state import SessionState
from tui.screen.session.status import SAFE_WORD_S, status_of


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


SATURATED = Notice("saturated", {"samples": 16, "channel": "g0"})


def state_after(*events: Any, target: float | None = None) -> SessionState:
    state = SessionState(target=target, clock=Clock())
    report(state, SessionStarted(Session(), "7"))
    for event in events:
        report(state, event)
    return state


def word(state: SessionState, later: float = 10.0, pulse_age: float | None = None) -> str:
    return status_of(state, Clock.now + later, pulse_age).word


def test_the_device_state_follows_its_identity() -> None:
    device = state_after(ready(), status(lost=3, battery=7.1)).device
    assert (device.serial_number, device.rate) == ("T-1042", 10_000.0)
    assert (device.lost_samples, device.battery) == (3, 7.1)
    assert str(device.due) == "2027-03-02"


def test_a_drop_appears_when_saved_and_gets_its_modulus_when_analysed() -> None:
    state = state_after(ready(), saved(1))
    drop = state.current_drops[1]
    assert drop.awaits_modulus
    assert drop.peak_load == pytest.approx(9900, rel=1e-3)
    assert drop.peak_deflection == pytest.approx(6.4e-4, rel=0.06)  # from where the load begins
    report(state, analysed(1, full=False))
    drop = state.current_drops[1]
    assert (drop.modulus, drop.is_refined) == (47.3e6, True)
    report(state, analysed(1, modulus=47.4e6))
    drop = state.current_drops[1]
    assert (drop.modulus, drop.is_refined) == (47.4e6, False)
    assert len(drop.memory.results) == 2


def test_a_search_that_fails_takes_the_first_answer_not_back() -> None:
    state = state_after(ready(), saved(1), analysed(1, full=False))
    report(state, analysed(1, modulus=None, reason="the analysis process died twice"))
    drop = state.current_drops[1]
    assert drop.modulus == 47.3e6
    assert not drop.is_refined
    assert drop.status == "seating", "the first of three, whatever became of its search"


def test_a_drop_without_a_modulus_is_repeated_where_moduli_are_judged() -> None:
    events = (ready(), saved(1), analysed(1, modulus=None, reason="no table"))
    state = state_after(*events)
    drop = state.current_drops[1]
    assert (drop.status, drop.fault) == ("seating", "no table")
    assert word(state) == "REPEAT"
    state = state_after(*events, JobReported(Job(procedure=find_procedure("mndot"))))
    assert word(state) != "REPEAT", "its deflection is as good as any"


def test_rebounds_notes_marks_and_names_are_stored() -> None:
    state = state_after(
        ready(),
        saved(1, marks=("3 samples missing",)),
        Rebounded("7", 1, 0.4, 3300.0),
        Edited("note", "wet", None, 1),
        Edited("name", "km 3", "7", None),
        Edited("position", {"latitude": 48.1, "longitude": 11.5}, "7", None),
        Edited("discard", None, "7", None),
    )
    drop = state.current_drops[1]
    assert drop.view.rebounds == (3300.0,)
    assert drop.view.marks == (text_notice("3 samples missing"),)
    assert drop.view.notes == ("wet",)
    point = state.current
    assert (point.shown_name, point.position, point.discarded) == ("km 3", (48.1, 11.5), True)


def test_a_new_point_is_empty_and_the_first_point_stays() -> None:
    state = state_after(*complete_point(), PointBegan("8"))
    assert state.point == "8"
    assert state.last is None
    assert len(state.drops_of(state.points["7"])) == 6


def test_the_stored_survey_is_merged_and_newer_results_win() -> None:
    result = DropResult(modulus_pa=30e6, status="measured")
    first = stored_drop(1, result, record=11, notes=("old",))
    second = stored_drop(2, None, record=12, discarded=Notice("discarded"))
    contents = PointView(
        "7", (first, second), 45e6, title="km 3", place={"latitude": 1.0, "longitude": 2.0}
    )
    state = state_after(saved(2), SurveyRead((contents,)))
    drops = state.drops_of(state.points["7"])
    assert drops[1].modulus == 30e6
    assert drops[2].saved is not None
    assert drops[2].discarded
    assert state.progress.target == 45e6


def test_old_traces_leave_memory_but_no_drop_does() -> None:
    state = state_after(ready())
    for number in range(1, 60):
        report(state, saved(number))
        report(state, analysed(number))
    drops = state.drops_of(state.points["7"])
    assert len(drops) == 59
    assert drops[1].saved is None
    assert drops[1].memory.curves is None
    assert drops[1].modulus is not None
    assert drops[59].saved is not None


def test_every_state_has_its_word() -> None:
    assert word(SessionState(clock=Clock())) == "STARTING"
    state = state_after()
    assert word(state) == "WAITING"
    report(state, ready())
    assert word(state) == "SETTLING"
    report(state, NotReady("the shunt is on"))
    assert word(state) == "NOT READY"
    report(state, Ready())
    assert word(state) == "READY"
    assert word(state, pulse_age=0.1) == "DROP"
    report(state, saved(1, status="seating"))
    assert word(state, later=0.1) == "COMPUTING"
    report(state, analysed(1, full=False, kind="seating"))
    assert word(state, later=0.3) == "SAFE"
    assert word(state, later=SAFE_WORD_S + 0.1) == "READY"
    report(state, saved(2, status="rejected", reason="false trigger"))
    assert word(state) == "REPEAT"
    report(state, InstrumentLost("unplugged", NOON))
    assert word(state) == "CABLE OUT"
    report(state, ready(restarted=True))
    report(state, DropNotSaved("7", 3, "no room"))
    assert word(state) == "NOT SAFE"


def test_a_bounce_is_no_new_drop() -> None:
    state = state_after(ready(), Ready(), saved(1), analysed(1))
    assert word(state, later=0.5, pulse_age=0.1) == "SAFE"
    assert word(state, later=2.3, pulse_age=1.0) == "SETTLING"
    assert word(state, later=2.3, pulse_age=0.4) == "DROP"  # later than any bounce
    assert word(state, later=6.0, pulse_age=0.1) == "DROP"


def test_the_action_says_which_drop_is_next() -> None:
    state = state_after(ready(), Ready())
    assert "seating drop 1 of 3" in status_of(state, 110.0).action
    for number in range(1, 5):
        kind = "seating" if number <= 3 else "measured"
        report(state, saved(number, status=kind))
        report(state, analysed(number))
    assert "measured drop 2 of 3" in status_of(state, 110.0).action


def test_a_discarded_drop_reopens_a_complete_point() -> None:
    state = state_after(*complete_point(), Ready())
    assert word(state) == "POINT DONE"
    report(state, Edited("discard", None, None, 6))
    assert word(state) == "READY"


def test_a_disk_is_reported_before_it_is_full() -> None:
    state = state_after(ready(), Ready(), StorageLow("filling", serious=True, drops_remaining=500))
    assert word(state) == "READY"
    report(state, StorageLow("filling", serious=True, drops_remaining=40))
    assert word(state) == "DISK LOW"
    assert "room for about 40 more drops" in status_of(state, 110.0).action
    report(state, StorageLow("room again", drops_remaining=None))
    assert word(state) == "READY"


def test_a_low_battery_is_reported() -> None:
    state = state_after(ready(), BatteryLow("whatever it says", serious=True))
    assert state.device.battery_low
    assert not state_after(ready(), SessionNotice("battery of something else")).device.battery_low


def test_removed_files_have_priority() -> None:
    state = state_after(ready(), Ready(), SurveyFilesChanged("the journal is gone"))
    assert (word(state), status_of(state, 110.0).action) == ("NOT SAFE", "the journal is gone")


def test_a_faulty_load_cell_is_reported() -> None:
    state = state_after(
        ready(), Ready(), SensorCheck({}, (text_notice("zero of the load cell is off"),))
    )
    point_diagnosis = status_of(state, 110.0)
    assert (point_diagnosis.word, point_diagnosis.role) == ("CHECK", "alarm")
    assert "zero" in point_diagnosis.action


def test_the_table_is_awaited() -> None:
    state = state_after(ready(), Ready(), TableBuilding("plate 0.15 m", 0.4))
    assert status_of(state, 110.0).action.endswith("40 %")
    report(state, TableBuilding("plate 0.15 m", 1.0))
    assert word(state) == "READY"


@pytest.mark.parametrize(
    ("ended", "expected"),
    [
        (SessionEnded(Ending.DONE), "END"),
        (SessionEnded(Ending.LOST), "LOST"),
        (SessionEnded(Ending.UNSAVED), "UNSAVED"),
        (SessionEnded(None, "no port", 2.0, no_device=True), "NO DEVICE"),
        (SessionEnded(None, "no room", 2.0), "NOT READY"),
        (SessionEnded(None, "an error"), "STOPPED"),
    ],
)
def test_every_end_has_its_word(ended: SessionEnded, expected: str) -> None:
    assert word(state_after(ready(), ended)) == expected


def test_the_diagnosis_of_a_measured_point_gives_advice() -> None:
    state = SessionState()
    effect = EffectResult(name="rough_contact", scope="point", advice="clear stones")
    point_diagnosis = DiagnosisResult(drops=(1,), verdict="explained", effects=(effect,))
    for event in (ready(), saved(), PointDiagnosed("7", point_diagnosis)):
        report(state, event)
    assert [text for text in state.advice(state.last) if "clear stones" in text]
    report(state, PointDiagnosed("7", dataclasses.replace(point_diagnosis, effects=())))
    assert state.advice(state.last) == [], "with further drops it is not found any more"


def test_a_verdict_on_a_fitted_modulus_waits_for_the_diagnosis() -> None:
    state = state_after(*complete_point(), target=45e6)
    given, expected = state.progress.verdict, verdict_word(state.current)
    assert given is not Verdict.NONE
    report(state, DiagnosisAwaited("7", True))
    assert state.progress.verdict is Verdict.NONE
    assert verdict_word(state.current) == ("PENDING", "strong")
    report(state, SurveyRead((PointView("7", job=state.job),)))
    assert verdict_word(state.current) == ("PENDING", "strong")
    report(state, DiagnosisAwaited("7", False))
    assert (state.progress.verdict, verdict_word(state.current)) == (given, expected)

    # Peaks need no diagnosis.
    report(state, JobReported(Job(procedure=find_procedure("tp-bf-stb-b8.3"), target=45e6), ()))
    given = state.progress.verdict
    report(state, DiagnosisAwaited("7", True))
    assert state.progress.verdict is given is not Verdict.NONE


def test_a_point_that_could_not_be_diagnosed_says_why() -> None:
    no_drop = DiagnosisResult(
        drops=(), verdict="unexplained", warnings=(Notice("no-measured-drop"),)
    )
    assert diagnosis_sentence(no_drop, SI) == "not made: no measured drop to diagnose"


def test_a_drop_at_the_end_of_the_range_is_advised_at_once() -> None:
    state = state_after(ready(), saved(1, marks=(SATURATED,)))
    assert [text for text in state.advice(state.last) if "use a lower drop height" in text]


def test_a_saturated_drop_is_never_clean() -> None:
    marks = (SATURATED,)
    events = (ready(), saved(1, status="seating", marks=marks), analysed(1))
    drop = state_after(*events).last
    assert drop is not None
    assert drop.result is not None
    assert drop.result.explained
    text, role = verdict_of(drop)
    assert text.startswith("SATURATED")
    assert role == "bad"
    assert verdict_of(drop, "EXPLAINED by saturation") == (text, role)


def test_the_fit_of_a_drop_is_not_shown_where_its_point_has_no_modulus() -> None:
    events = [
        dataclasses.replace(event, result=result(at_bound=["bedrock_depth"]))
        if isinstance(event, DropAnalysed)
        else event
        for event in complete_point()
    ]
    state = state_after(*events)
    assert state.last is not None
    shown = SI.value_and_ends(modulus_of_drop(state.last))
    assert shown[0].endswith("*")
    numbers = tuple(drop.number for drop in state.current.drops)
    basis = basis_of(state.current.setup)
    diagnosis = DiagnosisResult(
        drops=numbers,
        basis=basis,
        after=FittedState(model="half-space", residual_rms_over_peak=0.01),
    )
    report(state, PointDiagnosed("7", diagnosis))
    assert SI.value_and_ends(modulus_of_drop(state.last)) == ("-", "")
    assert f"no modulus: {text_of(diagnosis.use_reason)}" in remark(state.last, SI)
    report(state, PointDiagnosed("7", dataclasses.replace(diagnosis, drops=())))
    assert SI.value_and_ends(modulus_of_drop(state.last)) == shown, (
        "the diagnosis is not in force any more"
    )
