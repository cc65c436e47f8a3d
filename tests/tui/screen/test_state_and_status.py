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
    PointDiagnosed,
    Ready,
    SensorCheck,
    SessionNotice,
    StorageLow,
    SurveyFilesChanged,
    SurveyRead,
    TableBuilding,
)
from pfwd.session.plan import Ending
from pfwd.units import SI
from tests.tui.results import result
from tests.tui.screen.scripted import (
    NOON,
    Session,
    analysed,
    complete_point,
    ready,
    report,
    saved,
    status,
    stored_drop,
)
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
    report(state, SessionStarted(Session(), "7"), *events)
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


def test_a_search_that_fails_keeps_the_quick_result() -> None:
    failed = analysed(1, modulus=None, reason="the analysis process died twice")
    drop = state_after(ready(), saved(1), analysed(1, full=False), failed).current_drops[1]
    assert (drop.modulus, drop.is_refined) == (47.3e6, False)
    assert drop.status == "seating", "the first of three, whatever became of its search"


def test_a_drop_without_a_modulus_is_repeated_where_moduli_are_judged() -> None:
    events = (ready(), saved(1), analysed(1, modulus=None, reason="no table"))
    state = state_after(*events)
    drop = state.current_drops[1]
    assert (drop.status, drop.fault) == ("seating", "no table")
    assert word(state) == "REPEAT"
    state = state_after(*events, JobReported(Job(procedure=find_procedure("mndot"))))
    assert word(state) != "REPEAT", "its deflection is as good as any"


def test_the_stored_survey_is_merged_and_newer_results_win() -> None:
    stored = DropResult(modulus_pa=30e6, status="measured")
    first = stored_drop(1, stored, record=11, notes=("old",))
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
        report(state, saved(number), analysed(number))
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
    for event, expected in (
        (ready(), "SETTLING"),
        (NotReady("the shunt is on"), "NOT READY"),
        (Ready(), "READY"),
        (saved(2, status="rejected", reason="false trigger"), "REPEAT"),
        (InstrumentLost("unplugged", NOON), "CABLE OUT"),
    ):
        report(state, event)
        assert word(state) == expected
    report(state, ready(restarted=True), DropNotSaved("7", 3, "no room"))
    assert word(state) == "NOT SAFE"


def test_the_word_of_a_drop_changes_with_time() -> None:
    state = state_after(ready(), Ready())
    assert word(state, pulse_age=0.1) == "DROP"
    report(state, saved(1, status="seating"))
    assert word(state, later=0.1) == "COMPUTING"
    report(state, analysed(1, full=False, kind="seating"))
    assert word(state, later=0.3) == "SAFE"
    assert word(state, later=SAFE_WORD_S + 0.1) == "READY"


@pytest.mark.parametrize(
    ("event", "expected", "action"),
    [
        (StorageLow("filling", serious=True, drops_remaining=500), "READY", ""),
        (StorageLow("filling", serious=True, drops_remaining=40), "DISK LOW", "about 40 more"),
        (SurveyFilesChanged("the journal is gone"), "NOT SAFE", "the journal is gone"),
        (SensorCheck({}, (text_notice("zero of the load cell"),)), "CHECK", "zero"),
        (TableBuilding("plate 0.15 m", 0.4), "COMPUTING", "40 %"),
    ],
)
def test_a_fault_has_its_word_and_action(event: Any, expected: str, action: str) -> None:
    state = state_after(ready(), Ready(), event)
    assert word(state) == expected
    assert action in status_of(state, 110.0).action


def test_a_fault_that_is_over_has_no_word() -> None:
    state = state_after(
        ready(),
        Ready(),
        StorageLow("filling", serious=True, drops_remaining=40),
        StorageLow("room again", drops_remaining=None),
        TableBuilding("plate 0.15 m", 1.0),
    )
    assert word(state) == "READY"


def test_a_discarded_drop_reopens_a_complete_point() -> None:
    state = state_after(*complete_point(), Ready())
    assert word(state) == "POINT DONE"
    report(state, Edited("discard", None, None, 6))
    assert word(state) == "READY"


def test_a_low_battery_is_reported() -> None:
    assert state_after(ready(), BatteryLow("low", serious=True)).device.battery_low
    assert not state_after(ready(), SessionNotice("battery of a phone")).device.battery_low


def test_advice_is_that_of_the_drop_and_of_the_last_diagnosis() -> None:
    state = state_after(ready(), saved(1, marks=(SATURATED,)))
    (saturated,) = state.advice(state.last)
    effect = EffectResult(name="rough_contact", scope="point", advice="clear stones")
    diagnosis = DiagnosisResult(drops=(1,), verdict="explained", effects=(effect,))
    report(state, PointDiagnosed("7", diagnosis))
    assert any("clear stones" in text for text in state.advice(state.last))
    report(state, PointDiagnosed("7", dataclasses.replace(diagnosis, effects=())))
    assert state.advice(state.last) == [saturated], "the effect is not accepted any more"


def test_a_bounce_is_no_new_drop() -> None:
    state = state_after(ready(), Ready(), saved(1), analysed(1))
    assert word(state, later=0.5, pulse_age=0.1) == "SAFE"
    assert word(state, later=2.3, pulse_age=1.0) == "SETTLING"
    assert word(state, later=2.3, pulse_age=0.4) == "DROP"  # later than any bounce
    assert word(state, later=6.0, pulse_age=0.1) == "DROP"


def test_the_action_names_the_next_drop() -> None:
    state = state_after(ready(), Ready())
    assert "seating drop 1 of 3" in status_of(state, 110.0).action
    for number in range(1, 5):
        kind = "seating" if number <= 3 else "measured"
        report(state, saved(number, status=kind), analysed(number))
    assert "measured drop 2 of 3" in status_of(state, 110.0).action


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


def test_a_verdict_on_a_fitted_modulus_waits_for_the_diagnosis() -> None:
    state = state_after(*complete_point(), target=45e6)
    verdict, text = state.progress.verdict, verdict_word(state.current)
    assert verdict is not Verdict.NONE
    for event in (DiagnosisAwaited("7", True), SurveyRead((PointView("7", job=state.job),))):
        report(state, event)
        assert verdict_word(state.current) == ("PENDING", "strong")
    assert state.progress.verdict is Verdict.NONE
    report(state, DiagnosisAwaited("7", False))
    assert (state.progress.verdict, verdict_word(state.current)) == (verdict, text)

    # Peaks need no diagnosis.
    report(state, JobReported(Job(procedure=find_procedure("tp-bf-stb-b8.3"), target=45e6), ()))
    verdict = state.progress.verdict
    report(state, DiagnosisAwaited("7", True))
    assert state.progress.verdict is verdict is not Verdict.NONE


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


def test_a_drop_has_no_modulus_where_its_point_has_no_modulus() -> None:
    events = [
        dataclasses.replace(event, result=result(at_bound=["bedrock_depth"]))
        if isinstance(event, DropAnalysed)
        else event
        for event in complete_point()
    ]
    state = state_after(*events)
    assert state.last is not None
    of_the_fit = SI.value_and_ends(modulus_of_drop(state.last))
    assert of_the_fit[0].endswith("*")
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
    assert SI.value_and_ends(modulus_of_drop(state.last)) == of_the_fit, (
        "the diagnosis is not in force any more"
    )
