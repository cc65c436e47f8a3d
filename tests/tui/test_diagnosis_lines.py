"""Diagnoses of many points: each warning once."""

from dataclasses import replace

import pytest

from pfwd.analysis.diagnosis.result import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
)
from tui.diagnosis_lines import diagnosis_line, diagnosis_lines, diagnosis_warnings, nothing_lines


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


def state(modulus: float, low: float, high: float) -> FittedState:
    return FittedState(
        model="half-space",
        modulus_pa=modulus,
        modulus_interval_pa=(low, high),
        residual_rms_over_peak=0.2,
        stress_pa=1e5,
    )


@pytest.mark.parametrize(("factor", "known"), [(9.9, True), (10.1, False)])
def test_a_modulus_that_the_record_leaves_open_is_not_told(factor: float, known: bool) -> None:
    found = DiagnosisResult(
        file="survey",
        verdict="unexplained",
        before=state(40e6, 38e6, 42e6),
        after=state(50e6, 20e6, 20e6 * factor),
        effects=(EffectResult(name="bedrock"),),
    )
    text = "\n".join(diagnosis_lines(found))
    line = diagnosis_line("A", found)
    assert ("after   E 50 MPa (20 to 200), half" in text) == known
    assert ("after   E left open (20 to 200 MPa), half" in text) == (not known)
    assert ("E left open (20 to 200 MPa), UNEXPLAINED" in line) == (not known)
    assert ("The record leaves the modulus open: take none from it." in text) == (not known)
    assert ("the modulus changes by +25.0 %" in text) == known
    assert "before  E 40 MPa (38 to 42)" in text


def test_a_modulus_that_is_not_told_is_said_to_be_open() -> None:
    after = replace(state(50e6, 0.7e6, 13e6), modulus_pa=None)
    found = DiagnosisResult(file="survey", verdict="explained", before=after, after=after)
    text = "\n".join(diagnosis_lines(found))
    assert text.count("E left open (0.7 to 13 MPa)") == 2
    assert "The record leaves the modulus open: take none from it." in text
    assert "no ground" not in text


@pytest.mark.parametrize(
    ("verdict", "low", "high", "residual", "text"),
    [
        (
            "explained",
            47e6,
            53e6,
            0.01,
            "Design value 50 MPa (47 to 53), secant modulus at",
        ),
        ("unexplained", 47e6, 53e6, 0.02, "(47 to 53), secant modulus at 100 kPa: 2 % of the peak"),
        ("explained", 30e6, 70e6, 0.01, "Do not use the diagnosed modulus: the interval"),
        ("unexplained", 47e6, 53e6, 0.05, "Do not use the diagnosed modulus: 5 % of the peak"),
    ],
)
def test_one_sentence_says_what_the_modulus_may_be_used_for(
    verdict: str, low: float, high: float, residual: float, text: str
) -> None:
    after = replace(state(50e6, low, high), residual_rms_over_peak=residual)
    after = replace(after, residual_over_noise=1e3)
    found = DiagnosisResult(file="survey", verdict=verdict, before=after, after=after)
    (line,) = [line for line in diagnosis_lines(found) if text in line]
    assert line.endswith(".")


@pytest.mark.parametrize(
    ("value", "sd", "unit", "told"),
    [
        (-0.00204, 0.00003, "s", "x -2.04 ± 0.03 ms"),
        (20e6, 2.3e6, "N/m", "x 20.0 ± 2.3 MN/m"),
        (0.0012, 0.0004, "m/s", "x 1.2 ± 0.4 mm/s"),
        (1.62e5, 0.0, "Pa", "x 162 kPa"),
        (5.1e4, 2e3, "Pa s", "x 51.0 ± 2.0 kPa s"),
        (1.2, 0.1, "m", "x 1.20 ± 0.10 m"),
        (0.43, 0.13, "-", "x 0.43 ± 0.13 ["),
    ],
)
def test_numbers_are_told_in_the_units_that_people_read(
    value: float, sd: float, unit: str, told: str
) -> None:
    parameter = EffectParameter(name="x", value=value, sd=sd, unit=unit)
    effect = EffectResult(name="effect", parameters=(parameter,), evidence=50.0)
    found = DiagnosisResult(file="survey", verdict="explained", effects=(effect,))
    assert told in "\n".join(diagnosis_lines(found))


def test_points_without_a_drop_stand_in_one_line() -> None:
    empty = [DiagnosisResult(file="a.F25", point=f"km {n}", drops=()) for n in range(1, 5)]
    whole = DiagnosisResult(file="a.F25", point="km 5", drops=(1,))
    (line,) = nothing_lines([*empty, whole])
    assert line.startswith("NOTHING TO DIAGNOSE at km 1 to km 4 (4): none of their drops")
    (line,) = nothing_lines(empty)
    assert "at all points (4)" in line
    assert nothing_lines([whole]) == []


@pytest.mark.parametrize(("high", "said"), [(52e6, False), (90e6, True)])
def test_what_differs_without_an_effect_is_said(high: float, said: bool) -> None:
    before, after = state(50e6, 48e6, 52e6), state(50e6, 48e6, high)
    found = DiagnosisResult(file="survey", verdict="unexplained", before=before, after=after)
    assert ("no effect is taken over" in "\n".join(diagnosis_lines(found))) is said


@pytest.mark.parametrize(
    ("left", "told"), [(0.0123, "1.2 %"), (0.0996, "10 %"), (0.237, "24 %"), (1.037, "104 %")]
)
def test_what_is_left_is_told_in_percent(left: float, told: str) -> None:
    found = DiagnosisResult(
        file="survey", before=FittedState(), after=FittedState(residual_rms_over_peak=left)
    )
    assert f"residual {told} of the peak" in "\n".join(diagnosis_lines(found))


def test_a_point_without_a_drop_that_can_be_used_says_so() -> None:
    found = DiagnosisResult(
        file="survey",
        drops=(),
        verdict="unexplained",
        effects=(EffectResult(name="false_trigger"),),
        rejected=("drop 1: peaks only",),
    )
    assert diagnosis_lines(found) == [
        "survey, drops none",
        "  NOTHING TO DIAGNOSE: no drop of the point can be used",
        "  false_trigger",
        "  drop 1: peaks only",
    ]
