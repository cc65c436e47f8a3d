"""What cannot be left out of a prediction is said."""

import pytest

from pfwd_survey.inverting.diagnosis.diagnose import Diagnosed
from pfwd_survey.inverting.diagnosis.result import DiagnosisResult, HeldOut
from tui.commands.diagnose import _tell_what_stayed


def point(name: str, mode: str | None) -> Diagnosed:
    held = None if mode is None else HeldOut(mode=mode, before=0.1, after=0.01)
    return Diagnosed(
        "survey", DiagnosisResult(file="survey", point=name, drops=(1,), held_out=held)
    )


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("sensor", "--leave-out sensor: expected two sensors or more, came fewer at A, C"),
        ("drop", "--leave-out drop: expected two drops or more, came fewer at B, C"),
        (
            "point",
            "expected two points or more of one device that share something, came fewer at A",
        ),
    ],
)
def test_points_that_have_nothing_to_leave_out_are_named(
    asked: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [point("A", "drop"), point("B", "sensor"), point("C", None)]
    _tell_what_stayed([*found, Diagnosed("other", error="no load")], asked)
    assert said in capsys.readouterr().err


def test_where_all_could_be_left_out_nothing_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    nothing = Diagnosed("s", DiagnosisResult(file="s", point="N", drops=()))
    _tell_what_stayed([point("A", "drop"), nothing], "drop")
    assert capsys.readouterr().err == ""
