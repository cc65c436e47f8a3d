"""Events of a session as lines for machines and for people."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from inversion.notices import Notice, text_notice
from pfwd.analysis.screening.drops import Screening
from pfwd.files.header import PointSetup
from pfwd.judging import Job, drop_from_traces
from pfwd.procedures import find_procedure, plain_procedure
from pfwd.session.events import (
    N_REPORTED_FIRST,
    DiagnosisAwaited,
    DropAnalysed,
    DropNotSaved,
    DropSaved,
    Edited,
    JobReported,
    NotReady,
    SavedDrop,
    SensorCheck,
    SessionNotice,
    TableBuilding,
)
from tests.pfwd.report.surveys import half_sine_drop
from tests.pfwd.scripted_feed import Publisher
from tests.tui.results import result
from tui.session_lines import SessionLines

CUT_OFF = Notice("cut-off", {"reason": "full"})


def saved_drop(number: int = 1, status: Any = "measured", record: int | None = 5) -> SavedDrop:
    reason = text_notice("no pulse") if status == "rejected" else None
    traces = half_sine_drop(number, 8000.0)
    view = drop_from_traces(
        traces, PointSetup(0.15), record=record, awaits_result=status != "rejected"
    )
    return SavedDrop("A", replace(view, screening=Screening(status, reason)), traces, "x.h5")


def analysed(
    modulus: float | None, *, full: bool, drop: SavedDrop | None = None, **more: Any
) -> DropAnalysed:
    method = "mpga" if full else "posterior"
    drop_result = result(modulus, point="not this", method=method, **more)
    drop_result = replace(drop_result, drop=99, modulus_sd_pa=float("inf"))
    return DropAnalysed(drop or saved_drop(), 0.123, drop_result, None, full, full)


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """Return the lines printed since the last call."""
    return lambda: capsys.readouterr().out.splitlines()


def test_machines_read_two_lines_for_each_drop(
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    lines = SessionLines(as_json=True, analysed=True, bell=True)
    cut_off = replace(saved_drop().view, metadata={"marks": [CUT_OFF.to_json()]})
    lines.print_event(DropSaved(replace(saved_drop(), view=cut_off)))
    assert capsys.readouterr().out == ""  # its first modulus is awaited
    lines.print_event(analysed(40e6, full=False))
    lines.print_event(analysed(40.1e6, full=True))
    lines.print_event(SessionNotice("something", serious=True, details="Traceback\n  more"))
    lines.print_event(DropNotSaved("A", 2, "full"))
    lines.print_event(TableBuilding("a table", 0.1))
    lines.print_event(TableBuilding("a table", 0.2))
    output = capsys.readouterr()
    first, second = (json.loads(line) for line in output.out.splitlines())
    assert list(first)[:5] == ["point", "drop", "saved", "record", "delay_s"]
    assert first["delay_s"] == 0.123  # no key of the result replaces it
    assert (first["point"], first["drop"], first["saved"], first["record"]) == ("A", 1, True, 5)
    assert (first["method"], second["method"]) == ("posterior", "mpga")
    assert (first["preliminary"], second["preliminary"]) == (True, False)
    assert first["modulus_sd_pa"] is None
    assert "identical" not in first
    assert "drop A/1: cut off: full" in caplog.text
    assert "drop A/2 is NOT SAFE yet" in output.err
    assert output.err.count("a table") == 1


def judged_session(*, as_json: bool) -> tuple[SessionLines, Publisher]:
    """Lines of a session with a target that needs a single drop, and its events."""
    lines = SessionLines(as_json=as_json, analysed=True)
    report = Publisher(lines.print_event)
    report(JobReported(Job(procedure=plain_procedure(0, 1), target=30e6), ()))
    report(DropSaved(saved_drop()))
    return lines, report


@pytest.mark.parametrize("as_json", [True, False])
def test_a_complete_line_belongs_to_a_complete_point(
    as_json: bool, printed: Callable[[], list[str]]
) -> None:
    _, report = judged_session(as_json=as_json)
    report(analysed(40e6, full=True))
    report(Edited("discard", None, None, 5))
    text = printed()[-2:]
    if as_json:
        before, after = map(json.loads, text)
        assert before["complete"] is True
        assert "complete" not in after
        assert (after["point"], after["open_again"], after["used"]) == ("A", True, [])
    else:
        assert text[0].startswith("point A: ")
        assert text[1].startswith("point A is not complete any more: ")


@pytest.mark.parametrize("is_diagnosed", [True, False])
def test_a_complete_point_has_its_line_after_its_diagnosis(
    is_diagnosed: bool, printed: Callable[[], list[str]]
) -> None:
    lines, report = judged_session(as_json=False)
    report(DiagnosisAwaited("A", True))
    report(analysed(40e6, full=True))
    assert not any(line.startswith("point A: ") for line in printed())
    if is_diagnosed:
        report(DiagnosisAwaited("A", False))
    else:
        lines.finish()
    (line,) = printed()
    assert line.startswith("point A: ")
    assert ("PASS" in line) == is_diagnosed
    assert "UNDECIDED" not in line


@pytest.mark.parametrize(
    ("record", "identical", "saved"),
    [(5, None, True), (None, True, True), (None, False, True), (None, None, False)],
)
def test_only_a_safe_drop_is_reported_as_saved(
    printed: Callable[[], list[str]], record: int | None, identical: bool | None, saved: bool
) -> None:
    lines = SessionLines(as_json=True, analysed=False)
    lines.print_event(DropSaved(saved_drop(record=record), identical))
    (line,) = map(json.loads, printed())
    assert line["saved"] is saved
    assert line.get("identical") is identical
    assert ("record" in line) is (record is not None)


def test_a_rejected_drop_has_its_line_at_once_with_all_keys(
    printed: Callable[[], list[str]],
) -> None:
    lines = SessionLines(as_json=True, analysed=True)
    lines.print_event(DropSaved(saved_drop(status="rejected")))
    (line,) = map(json.loads, printed())
    assert (line["status"], line["reason"]) == ("rejected", "no pulse")
    assert (line["modulus_pa"], line["warnings"]) == (None, [])


@pytest.mark.parametrize(
    ("first", "second", "count"),
    [(40e6, 40.1e6, 1), (40e6, 41e6, 2), (40e6, None, 2), (None, 40e6, 2)],
)
def test_people_read_a_second_line_only_if_it_differs(
    printed: Callable[[], list[str]], first: float | None, second: float | None, count: int
) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    lines.print_event(DropSaved(saved_drop()))
    lines.print_event(analysed(first, full=False))
    lines.print_event(analysed(second, full=True))
    assert len(printed()) == count


def test_a_long_day_takes_no_memory() -> None:
    lines = SessionLines(as_json=False, analysed=True)
    for number in range(1, 200):
        lines.print_event(DropSaved(saved_drop(number), True))
        lines.print_event(analysed(40e6, full=False, drop=saved_drop(number)))
        lines.print_event(analysed(40e6, full=True, drop=saved_drop(number)))
        lines.print_event(DropSaved(saved_drop(number, status="rejected")))
    assert not lines._first_moduli
    assert not lines._identical


def test_the_check_of_the_sensors(capsys: pytest.CaptureFixture[str]) -> None:
    lines = SessionLines(as_json=True, analysed=True)
    lines.print_event(
        SensorCheck({"zero_n": 12.4, "span_ratio": 0.97}, (text_notice("the span is off"),))
    )
    lines.print_event(SensorCheck({"zero_n": 12.4, "span_ratio": None}, ()))
    output = capsys.readouterr()
    assert output.out == ""
    assert "load cell NOT OK: zero 12 N, span 97.0 %" in output.err
    assert "load cell OK: zero 12 N, no shunt to check the span" in output.err


def test_repeated_reasons_against_recording_are_printed_a_limited_number_of_times(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = SessionLines(as_json=True, analysed=True)
    for _ in range(100):  # an instrument may switch its shunt without end
        lines.print_event(NotReady("the shunt is on"))
    assert capsys.readouterr().err == "pfwd: not ready: the shunt is on\n" * N_REPORTED_FIRST


def test_a_wrong_drop_height_and_a_saturated_channel_are_reported_at_the_drop(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    report = Publisher(lines.print_event)
    report(JobReported(Job(procedure=find_procedure("tp-bf-stb-b8.3")), ()))
    marks = [Notice("saturated", {"samples": 16, "channel": "g0"}).to_json()]
    drop = saved_drop()
    report(DropSaved(replace(drop, view=replace(drop.view, metadata={"marks": marks}))))
    error = capsys.readouterr().err
    assert "at drop A/1: wrong drop height: " in error
    assert "at drop A/1: a channel is at the end of its range" in error
