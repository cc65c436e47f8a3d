"""Diagnoses of many points: each warning once."""

from pfwd_survey.inverting.diagnosis.result import DiagnosisResult
from tui.diagnosis_lines import diagnosis_lines, diagnosis_warnings


def diagnosis(point: str | None, *warnings: str) -> DiagnosisResult:
    return DiagnosisResult(file="survey", point=point, verdict="clean", warnings=warnings)


def test_a_single_point_has_its_warnings_among_the_lines() -> None:
    lines = diagnosis_lines(diagnosis("A", "no plate mass"))
    assert lines[-1] == "  warning: no plate mass"
    assert "warning" not in "".join(diagnosis_lines(diagnosis("A", "x"), warnings=False))


def test_several_points_have_each_warning_once_as_ranges() -> None:
    found = [diagnosis(name, "no plate mass") for name in "ABC"]
    found.append(diagnosis("D", "no plate mass", "left 3.1 %"))
    found.append(diagnosis("E", "left 4.5 %"))
    assert diagnosis_warnings(found) == [
        "  warning, A to D: no plate mass",
        "  warning, D, E: left 3.1 and 4.5 %",
    ]
    assert diagnosis_warnings(found[:3]) == ["  warning, all points: no plate mass"]
