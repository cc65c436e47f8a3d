"""What a session tells, as lines for machines and for people; the log file."""

import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from inversion.notices import Notice, text_notice
from pfwd.analysis.results import DropResult
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
from pfwd_device import Drop
from tests.pfwd.scripted_feed import Publisher
from tests.records import read
from tui.format import drop_line
from tui.log_file import MAX_BYTES, MAX_OLD_FILES, survey_log
from tui.session_lines import SessionLines

RESULT = {
    "file": "x.h5",
    "point": "not this",
    "drop": 99,
    "status": "measured",
    "method": "posterior",
    "model": "layer",
    "modulus_pa": 40e6,
    "modulus_interval_pa": [39e6, 41e6],
    "equivalent_modulus_pa": 40e6,
    "equivalent_modulus_interval_pa": [39e6, 41e6],
    "plate": "rigid-rough",
    "plate_radius_m": 0.15,
    "poisson_ratio": 0.35,
    "viscosity_pa_s": 3e4,
    "density_kg_m3": 1900.0,
    "warnings": [],
    "half_sine": {"peak_pressure_pa": 100e3},
    "peak_load_n": 7068.6,
    "residual_rms_over_peak": 0.01,
    "explained": True,
    "at_bound": [],
}

CUT_OFF = Notice("cut-off", {"reason": "full"})


@pytest.fixture
def one(make_drop: Callable[..., Drop]) -> Callable[..., SavedDrop]:
    def make(number: int = 1, status: Any = "measured", record: int | None = 5) -> SavedDrop:
        reason = "no pulse" if status == "rejected" else None
        found = Screening(status, reason and text_notice(reason))
        traces = make_drop(number=number)
        view = drop_from_traces(
            traces, PointSetup(0.15), record=record, awaits_result=status != "rejected"
        )
        return SavedDrop("A", replace(view, screening=found), traces, "x.h5")

    return make


def analysed(one: SavedDrop, modulus: float | None, *, full: bool, **more: Any) -> DropAnalysed:
    result = RESULT | {"modulus_pa": modulus, "method": "mpga" if full else "posterior"} | more
    found = replace(read(DropResult, result), modulus_sd_pa=float("inf"))
    return DropAnalysed(one, 0.123, found, None, full, full)


def test_two_lines_a_drop_for_machines_and_nothing_else(
    one: Callable[..., SavedDrop],
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    lines = SessionLines(as_json=True, analysed=True, bell=True)
    cut_off = replace(one().view, metadata={"marks": [CUT_OFF.to_json()]})
    lines.print_event(DropSaved(replace(one(), view=cut_off)))
    assert capsys.readouterr().out == ""  # its first modulus is awaited
    lines.print_event(analysed(one(), 40e6, full=False))
    lines.print_event(analysed(one(), 40.1e6, full=True))
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


def test_a_line_that_says_complete_is_of_a_complete_point(
    one: Callable[..., SavedDrop], capsys: pytest.CaptureFixture[str]
) -> None:
    for as_json in (True, False):
        lines = SessionLines(as_json=as_json, analysed=True)
        report = Publisher(lines.print_event)
        report(JobReported(Job(procedure=plain_procedure(0, 1), target=30e6), ()))
        report(DropSaved(one()))
        report(analysed(one(), 40e6, full=True))
        report(Edited("discard", None, None, 5))
        text = capsys.readouterr().out.splitlines()[-2:]
        if as_json:
            before, after = map(json.loads, text)
            assert before["complete"] is True
            assert "complete" not in after
            assert (after["point"], after["open_again"], after["used"]) == ("A", True, [])
        else:
            assert text[0].startswith("point A: ")
            assert text[1].startswith("point A is not complete any more: ")


def test_a_complete_point_has_its_line_after_its_diagnosis(
    one: Callable[..., SavedDrop], capsys: pytest.CaptureFixture[str]
) -> None:
    def points() -> list[str]:
        lines = capsys.readouterr().out.splitlines()
        return [line for line in lines if line.startswith("point A: ")]

    for ended_by in (True, False):
        lines = SessionLines(as_json=False, analysed=True)
        report = Publisher(lines.print_event)
        report(JobReported(Job(procedure=plain_procedure(0, 1), target=30e6), ()))
        report(DropSaved(one()))
        report(DiagnosisAwaited("A", True))
        report(analysed(one(), 40e6, full=True))
        assert points() == []
        if ended_by:
            lines.finish()
            assert "UNDECIDED" not in points()[0]
        else:
            report(DiagnosisAwaited("A", False))
            assert "PASS" in points()[0]


def test_a_rejected_drop_has_its_line_at_once_with_all_keys(
    one: Callable[..., SavedDrop], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = SessionLines(as_json=True, analysed=True)
    lines.print_event(DropSaved(one(status="rejected")))
    (line,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert (line["status"], line["reason"]) == ("rejected", "no pulse")
    assert line["modulus_pa"] is None
    assert line["warnings"] == []


@pytest.mark.parametrize(
    ("record", "identical", "saved"),
    [(5, None, True), (None, True, True), (None, False, True), (None, None, False)],
)
def test_saved_is_said_of_what_is_safe(
    one: Callable[..., SavedDrop],
    capsys: pytest.CaptureFixture[str],
    record: int | None,
    identical: bool | None,
    saved: bool,
) -> None:
    lines = SessionLines(as_json=True, analysed=False)
    lines.print_event(DropSaved(one(record=record), identical))
    (line,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert line["saved"] is saved
    assert line.get("identical") is identical
    assert ("record" in line) is (record is not None)


@pytest.mark.parametrize(("second", "count"), [(40.1e6, 1), (41e6, 2), (None, 2)])
def test_people_read_a_second_line_only_if_it_says_something_else(
    one: Callable[..., SavedDrop],
    capsys: pytest.CaptureFixture[str],
    second: float | None,
    count: int,
) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    lines.print_event(DropSaved(one()))
    lines.print_event(analysed(one(), 40e6, full=False))
    lines.print_event(analysed(one(), second, full=True))
    assert len(capsys.readouterr().out.splitlines()) == count


def test_a_quick_answer_that_failed_is_followed_by_the_full_one(
    one: Callable[..., SavedDrop], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    lines.print_event(
        analysed(one(), None, full=False, status="rejected", reason=text_notice("failed").to_json())
    )
    lines.print_event(analysed(one(), 40e6, full=True))
    assert capsys.readouterr().out.splitlines()[0] == "A/1  rejected: failed"


def test_a_long_day_takes_no_memory(one: Callable[..., SavedDrop]) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    for number in range(1, 200):
        lines.print_event(DropSaved(one(number), True))
        lines.print_event(analysed(one(number), 40e6, full=False))
        lines.print_event(analysed(one(number), 40e6, full=True))
        lines.print_event(DropSaved(one(number, status="rejected")))
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


def test_that_no_drop_can_be_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    lines = SessionLines(as_json=True, analysed=True)
    for _ in range(100):  # an instrument may switch its shunt without end
        lines.print_event(NotReady("the shunt is on"))
    assert capsys.readouterr().err == "pfwd: not ready: the shunt is on\n" * N_REPORTED_FIRST


def test_a_drop_on_one_line() -> None:
    assert drop_line("A", 3, read(DropResult, RESULT)) == (
        "A/3  E 40.0 MPa (39.0 to 41.0)  equivalent 40.0 MPa (39.0 to 41.0)  soil on bedrock, "
        "rigid plate without slip 0.15 m, "
        "ν 0.35  7.07 kN  residual 1.0 %  local fits"
    )
    seating = RESULT | {"status": "seating", "explained": False, "at_bound": ["viscosity"]}
    assert drop_line("A", 3, read(DropResult, seating)).endswith(
        "seating  UNEXPLAINED  AT BOUND viscosity"
    )
    assert drop_line("a\x1b[2J", 1, DropResult(status="rejected", reason=text_notice("b\nc"))) == (
        "a\ufffd[2J/1  rejected: b\ufffdc"
    )
    assert drop_line("A", 1, DropResult(status="measured")) == "A/1  measured"


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Path]:
    raises = logging.raiseExceptions
    with survey_log(tmp_path):
        yield tmp_path / "log"
    logging.raiseExceptions = raises


def test_the_log_rotates(log: Path) -> None:
    logger = logging.getLogger("pfwd.test")
    line = "x" * 10_000
    for _ in range((MAX_OLD_FILES + 3) * MAX_BYTES // 10_000):
        logger.info("%s", line)
    files = sorted(log.iterdir())
    assert [path.name for path in files] == ["pfwd.log", *(f"pfwd.log.{n}" for n in range(1, 6))]
    assert all(path.stat().st_size <= MAX_BYTES for path in files)


def test_nothing_in_the_log_moves_a_cursor_or_forges_a_line(log: Path) -> None:
    logger = logging.getLogger("pfwd.test")
    logger.warning("name %s", "a\x1b[2J\r\u202eb\n2026-01-01T00:00:00.000Z INFO pfwd: all is well")
    try:
        raise ValueError("planted\x07")
    except ValueError:
        logger.exception("failed")
    text = (log / "pfwd.log").read_text(encoding="utf-8")
    first, second, *more = text.splitlines()
    assert first.endswith("WARNING pfwd.test: name a\ufffd[2J\ufffd\ufffdb")
    assert second.startswith("    2026-01-01")
    assert any(line.startswith("    Traceback") for line in more)
    assert not set("\x1b\r\x07\u202e") & set(text)
    assert first[:20].replace("-", "").replace(":", "").startswith("20")
    assert first[23] == "Z"


def test_a_folder_of_the_log_that_goes_costs_nothing(log: Path) -> None:
    import shutil

    shutil.rmtree(log.parent)
    logging.getLogger("pfwd.test").info("one")
    assert not log.parent.exists()
    log.parent.mkdir()
    log.write_text("a file now")
    logging.getLogger("pfwd.test").info("two")
    assert log.read_text() == "a file now"


def test_a_wrong_drop_height_and_a_saturated_channel_are_said_at_the_drop(
    one: Callable[..., SavedDrop], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = SessionLines(as_json=False, analysed=True)
    report = Publisher(lines.print_event)
    report(JobReported(Job(procedure=find_procedure("tp-bf-stb-b8.3")), ()))
    marks = [Notice("saturated", {"samples": 16, "channel": "g0"}).to_json()]
    report(DropSaved(replace(one(), view=replace(one().view, metadata={"marks": marks}))))
    error = capsys.readouterr().err
    assert "at drop A/1: wrong drop height: " in error
    assert "kN, the procedure needs 7.07 kN: set the drop height as calibrated" in error
    assert "at drop A/1: a channel is at the end of its range" in error
