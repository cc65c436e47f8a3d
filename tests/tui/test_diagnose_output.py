"""Output of `pfwd diagnose` for many points."""

import json

import pytest

from inversion.notices import Notice, text_notice, text_of
from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.analysis.results import DiagnosisResult, HeldOut
from tui.cli import main
from tui.commands.diagnose import _report_not_held_out, show_all


def empty(name: str) -> Diagnosed:
    rejected = Notice("drop-rejected", {"drop": 1, "reason": text_notice("peaks only")})
    result = DiagnosisResult(
        file="a.F25", point=name, drops=(), rejected=(text_of(rejected),), warnings=(rejected,)
    )
    return Diagnosed("a.F25", result)


COMPLETE = Diagnosed("b.csv", DiagnosisResult(file="b.csv", drops=(1,), verdict="clean"))


def test_points_without_a_drop_take_a_single_line(capsys: pytest.CaptureFixture[str]) -> None:
    points = [empty("1"), COMPLETE, empty("2")]
    show_all([*points, Diagnosed("c.csv", error="no load")], as_json=False)
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0].startswith("3 points: ")
    assert [line for line in lines if "NOTHING TO DIAGNOSE" in line] == [lines[-3]]
    warning = "  warning, a.F25 1, a.F25 2: drop 1: peaks only"
    assert lines[-2:] == [warning, "--details shows each point in full"]
    assert "no load" in err
    show_all(points, as_json=False, details=True)
    out = capsys.readouterr().out
    assert "\nb.csv, drops 1\n" in out
    assert out.splitlines()[-1] == warning


def test_a_single_point_is_printed_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    show_all([empty("1")], as_json=False)
    out = capsys.readouterr().out
    assert "  NOTHING TO DIAGNOSE: no drop" in out
    assert "  drop 1: peaks only" in out


def test_json_has_a_line_for_each_point(capsys: pytest.CaptureFixture[str]) -> None:
    show_all([empty("1"), empty("2"), COMPLETE], as_json=True)
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record.get("point") for record in records] == ["1", "2", None]
    assert records[0]["warning_codes"][0]["code"] == "drop-rejected"


def test_warnings_beyond_a_number_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    points = []
    for number in range(20):
        warnings = (text_notice(f"sensor {chr(65 + number)} drifts"),)
        result = DiagnosisResult(file="s", point=str(number), drops=(1,), warnings=warnings)
        points.append(Diagnosed("s", result))
    show_all(points, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "20 warnings: --details shows them, and each point in full"
    assert not any("drifts" in line for line in lines)


def held_out(name: str, mode: str | None) -> Diagnosed:
    held = None if mode is None else HeldOut(mode=mode, before=0.1, after=0.01)
    return Diagnosed(
        "survey", DiagnosisResult(file="survey", point=name, drops=(1,), held_out=held)
    )


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        ("sensor", "two sensors or more, got fewer at A, C"),
        ("drop", "two drops or more, got fewer at B, C"),
        ("next", "two drops or more, got fewer at A to C"),
        ("point", "two points or more of one device that share something, got fewer at A"),
    ],
)
def test_points_without_data_to_hold_out_are_named(
    mode: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    points = [held_out("A", "drop"), held_out("B", "sensor"), held_out("C", None)]
    _report_not_held_out([*points, Diagnosed("b", error="no load")], mode)
    assert message in capsys.readouterr().err


def test_a_point_without_drops_needs_no_data_to_hold_out(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _report_not_held_out([held_out("A", "drop"), empty("N")], "drop")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("options", "got"), [([], "none"), (["--leave-out", "point"], "point")])
def test_a_number_is_fitted_to_a_held_out_drop_only(
    options: list[str], got: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", "a.csv", "--allow", "stiffness", *options]) == 2
    message = f"--allow stiffness: expected --leave-out next or drop, got {got}"
    assert message in capsys.readouterr().err
