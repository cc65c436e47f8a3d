"""What cannot be left out of a prediction is said."""

from typing import Any

import pytest

from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.analysis.results import DiagnosisResult, HeldOut, HeldOutPart
from tui.cli import main
from tui.commands.diagnose import _report_not_held_out
from tui.diagnosis_lines import diagnosis_lines, point_cells


def point(name: str, mode: str | None) -> Diagnosed:
    held = None if mode is None else HeldOut(mode=mode, before=0.1, after=0.01)
    return Diagnosed(
        "survey", DiagnosisResult(file="survey", point=name, drops=(1,), held_out=held)
    )


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("sensor", "--leave-out sensor: expected two sensors or more, got fewer at A, C"),
        ("drop", "--leave-out drop: expected two drops or more, got fewer at B, C"),
        ("next", "--leave-out next: expected two drops or more, got fewer at A to C"),
        (
            "point",
            "expected two points or more of one device that share something, got fewer at A",
        ),
    ],
)
def test_points_that_have_nothing_to_leave_out_are_named(
    asked: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [point("A", "drop"), point("B", "sensor"), point("C", None)]
    _report_not_held_out([*found, Diagnosed("other", error="no load")], asked)
    assert said in capsys.readouterr().err


def test_where_all_could_be_left_out_nothing_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    nothing = Diagnosed("s", DiagnosisResult(file="s", point="N", drops=()))
    _report_not_held_out([point("A", "drop"), nothing], "drop")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("options", "came"), [([], "none"), (["--leave-out", "point"], "point")])
def test_a_number_is_fitted_to_a_held_out_drop_alone(
    options: list[str], came: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", "a.csv", "--allow", "stiffness", *options]) == 2
    said = capsys.readouterr().err
    assert f"--allow stiffness: expected --leave-out next or drop, got {came}" in said


def lines(**keys: Any) -> list[str]:
    held = HeldOut(before=0.5, after=0.09, contact_before=0.4, contact_after=0.08, **keys)
    return diagnosis_lines(DiagnosisResult(file="s", drops=(1, 2), held_out=held))[2:]


def test_a_prediction_stands_beside_the_scaled_record() -> None:
    scaled = {"scaled_record": 0.06, "contact_scaled_record": 0.07}
    assert lines(mode="next", fitted=(), **scaled) == [
        "  next drop predicted: off by 9.0 % of the peak (contact 8.0 %), base model 50 % (40 %), "
        "preceding record scaled by the peak loads 6.0 % (7.0 %)",
        "    fitted to the held-out data: nothing",
    ]
    last = lines(mode="next", fitted=("stiffness (drop 3)",), **scaled)[-1]
    assert last == "    fitted to the held-out data: stiffness (drop 3)"


def test_what_is_fitted_is_called_no_prediction() -> None:
    first, last = lines(mode="point", fitted=("choice of effects", "modulus_ratio (ground)"))
    assert first.startswith(
        "  device of the other points, everything else fitted: off by 9.0 % of the peak"
    )
    assert first.endswith("no preceding record to scale")
    assert last == "    fitted to the held-out data: choice of effects, modulus ratio (ground)"
    of_drops = lines(mode="drop", fitted=("choice of effects",))[0]
    assert of_drops.startswith("  ground of the other drops, everything else fitted: off by 9.0 %")


def test_a_next_drop_that_had_a_part_in_the_choice_of_effects_says_so() -> None:
    first, last = lines(mode="next", fitted=("choice of effects",))
    assert first.startswith("  next drop predicted: off by 9.0 % of the peak")
    assert last == "    fitted to the held-out data: choice of effects"


def test_the_error_of_a_peak_stands_beside_those_at_other_points() -> None:
    part = (HeldOutPart(name="drop 3", after=0.09, peak_error=-0.013),)
    few = lines(mode="next", fitted=(), by=part, largest_peak_error=0.031, peak_error_points=9)
    assert few[1] == (
        "    recorded peak -1.3 % from the predicted one; largest error at 9 other points 3.1 %"
    )
    ends = (-0.0312, 0.04)
    many = lines(mode="next", fitted=(), by=part, peak_error_interval=ends, peak_error_points=24)
    assert many[1] == (
        "    recorded peak -1.3 % from the predicted one; "
        "95 % interval by 24 other points -3.1 to +4.0 %"
    )
    assert len(lines(mode="next", fitted=(), by=part)) == 2


def test_a_left_out_sensor_stands_beside_what_its_neighbours_say() -> None:
    near, far = (
        HeldOutPart(name="sensor at 0.3 m", after=0.04, interpolated=0.06),
        HeldOutPart(name="sensor at 0.6 m", after=0.12),
    )
    first, each, _ = lines(mode="sensor", fitted=(), by=(near, far), side_difference=0.03)
    assert first.startswith("  each sensor predicted: off by 9.0 % of the peak")
    assert first.endswith(", sides of the plate differ by 3.0 %")
    assert each == (
        "    sensor at 0.3 m 4.0 % (between its neighbours 6.0 %), sensor at 0.6 m 12 %"
    )
    alone = lines(mode="sensor", fitted=(), by=(near, far))[0]
    assert alone.endswith("no two sensors at one distance to compare the sides of the plate")


def test_left_out_sensors_are_not_judged_where_the_sides_of_the_plate_differ() -> None:
    held = HeldOut(mode="sensor", fitted=(), side_difference=0.13)
    result = DiagnosisResult(file="s", point="A", drops=(1, 2), held_out=held)
    assert diagnosis_lines(result)[2:] == [
        "  each sensor predicted, but not judged: sides of the plate differ by 13 % of the peak"
    ]
    assert point_cells("A", result).prediction_error == "sides differ 13 %"
