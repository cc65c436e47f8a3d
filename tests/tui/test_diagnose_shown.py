"""What a diagnosis of many points prints."""

import json

import pytest

from inversion.notices import Notice, text_notice, text_of
from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.analysis.results import DiagnosisResult
from tui.commands.diagnose import show_all


def empty(name: str) -> Diagnosed:
    rejected = Notice("drop-rejected", {"drop": 1, "reason": text_notice("peaks only")})
    result = DiagnosisResult(
        file="a.F25", point=name, drops=(), rejected=(text_of(rejected),), warnings=(rejected,)
    )
    return Diagnosed("a.F25", result)


WHOLE = Diagnosed("b.csv", DiagnosisResult(file="b.csv", drops=(1,), verdict="clean"))


def test_many_points_without_a_drop_take_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    show_all([empty("1"), WHOLE, empty("2"), Diagnosed("c.csv", error="no load")], as_json=False)
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[0].startswith("3 points: ")
    assert [line for line in lines if "NOTHING TO DIAGNOSE" in line] == [lines[-3]]
    assert lines[-2] == "  warning, a.F25 1, a.F25 2: drop 1: peaks only"
    assert lines[-1] == "--details shows each point in full"
    assert "no load" in err
    show_all([empty("1"), WHOLE, empty("2")], as_json=False, details=True)
    out = capsys.readouterr().out
    assert "\nb.csv, drops 1\n" in out
    assert out.splitlines()[-1] == "  warning, a.F25 1, a.F25 2: drop 1: peaks only"


def test_one_has_its_own_block(capsys: pytest.CaptureFixture[str]) -> None:
    show_all([empty("1")], as_json=False)
    out = capsys.readouterr().out
    assert "  NOTHING TO DIAGNOSE: no drop" in out
    assert "  drop 1: peaks only" in out


def test_json_has_a_line_for_each(capsys: pytest.CaptureFixture[str]) -> None:
    show_all([empty("1"), empty("2"), WHOLE], as_json=True)
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record.get("point") for record in records] == ["1", "2", None]
    assert records[0]["warning_codes"][0]["code"] == "drop-rejected"


def test_many_warnings_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    points = []
    for number in range(20):
        warnings = (text_notice(f"sensor {chr(65 + number)} drifts"),)
        result = DiagnosisResult(file="s", point=str(number), drops=(1,), warnings=warnings)
        points.append(Diagnosed("s", result))
    show_all(points, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "20 warnings: --details shows them, and each point in full"
    assert not any("drifts" in line for line in lines)
