"""Diagnoses as text: of one point in full, of several as a table."""

import json
import re
from dataclasses import replace

import pytest

from inversion.notices import Notice, text_notice, text_of
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
    HeldOut,
)
from pfwd.facts import facts_of_state
from pfwd.judging.verdicts import modulus_in_force
from pfwd.procedures import PointModulus
from tui.diagnosis_lines import (
    WIDTH,
    diagnosis_lines,
    diagnosis_sentence,
    diagnosis_warnings,
    printed_diagnosis,
    survey_lines,
    undiagnosed_lines,
    use_sentence,
)


def diagnosis(point: str | None, *warnings: str | Notice) -> DiagnosisResult:
    messages = tuple(text_notice(w) if isinstance(w, str) else w for w in warnings)
    return DiagnosisResult(file="survey", point=point, verdict="clean", warnings=messages)


def left_over(share: float) -> Notice:
    return Notice("rig-not-explained", {"residual_over_peak": share})


def test_a_single_point_has_its_warnings_among_the_lines() -> None:
    lines = diagnosis_lines(diagnosis("A", "no plate mass"))
    assert lines[-1] == "  warning: no plate mass"
    assert "warning:" not in "".join(diagnosis_lines(diagnosis("A", "x"), warnings=False))


def test_several_points_have_each_warning_once_as_ranges() -> None:
    found = [diagnosis(name, "no plate mass") for name in "ABC"]
    found.append(diagnosis("D", "no plate mass", left_over(0.031)))
    found.append(diagnosis("E", left_over(0.045)))
    assert diagnosis_warnings(found) == [
        "  warning, A to D: no plate mass",
        f"  warning, D, E: {text_of(left_over(0.031))}".replace("3.1", "3.1 and 4.5"),
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
    line = diagnosis_sentence(found)
    assert ("after   E 50 MPa (20 to 200), half" in text) == known
    assert ("after   E left open (20 to 200 MPa), half" in text) == (not known)
    assert ("→ left open (20 to 200 MPa), do not use" in line) == (not known)
    assert ("→ 50 MPa (20 to 200), do not use" in line) == known
    assert "Do not use: 20 % of the peak is unexplained" in text
    assert ("the modulus changes from 40.0 to 50.0 MPa, by +25 %" in text) == known
    assert "before  E 40.0 MPa (38.0 to 42.0)" in text


def test_a_modulus_that_is_not_told_is_said_to_be_open() -> None:
    after = replace(state(50e6, 0.7e6, 13e6), modulus_pa=None)
    found = DiagnosisResult(file="survey", verdict="explained", before=after, after=after)
    text = "\n".join(diagnosis_lines(found))
    assert text.count("E left open (0.70 to 13.0 MPa)") == 2
    assert "Do not use: the diagnosis leaves the modulus open; measure again with" in text
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
        ("explained", 30e6, 70e6, 0.01, "Do not use: the interval"),
        ("unexplained", 47e6, 53e6, 0.05, "Do not use: 5 % of the peak"),
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
    (line,) = undiagnosed_lines([*empty, whole])
    assert line.startswith("NOTHING TO DIAGNOSE at km 1 to km 4 (4): no drop can be used")
    (line,) = undiagnosed_lines(empty)
    assert "at all points (4)" in line
    assert undiagnosed_lines([whole]) == []


@pytest.mark.parametrize(("high", "said"), [(52e6, False), (90e6, True)])
def test_what_differs_without_an_effect_is_said(high: float, said: bool) -> None:
    before, after = state(50e6, 48e6, 52e6), state(50e6, 48e6, high)
    found = DiagnosisResult(file="survey", verdict="unexplained", before=before, after=after)
    assert ("no effect is accepted" in "\n".join(diagnosis_lines(found))) is said


@pytest.mark.parametrize(
    ("left", "told"), [(0.0123, "1.2 %"), (0.0996, "10 %"), (0.237, "24 %"), (1.037, "104 %")]
)
def test_what_is_left_is_told_in_percent(left: float, told: str) -> None:
    found = DiagnosisResult(
        file="survey",
        before=FittedState(model="half-space", residual_rms_over_peak=0.01),
        after=FittedState(model="half-space", residual_rms_over_peak=left),
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
        "  NOTHING TO DIAGNOSE: no drop of the point can be used, see the warnings",
        "  false trigger",
        "  drop 1: peaks only",
    ]


DEVICE_EFFECT = EffectResult(
    name="sensor_lag", scope="device", parameters=(), advice="compare the channels"
)
BEDROCK = EffectResult(
    name="bedrock",
    scope="point",
    value=1.55,
    sd=0.09,
    unit="m",
    evidence=289.0,
    parameters=(EffectParameter(name="depth", value=1.55, sd=0.09, unit="m"),),
    advice="a sounding tells the depth",
)


def survey() -> list[DiagnosisResult]:
    """Three points of one device: a design value, one to use with care, one not to use."""
    misfits = {"A": ("explained", 0.004), "B": ("unexplained", 0.02), "C": ("unexplained", 0.05)}
    points = []
    for number, (name, (verdict, misfit)) in enumerate(misfits.items()):
        after = replace(
            state(50e6, 47e6, 53e6),
            residual_rms_over_peak=misfit,
            discrepancy_over_peak=misfit,
            equivalent_modulus_pa=48e6,
            equivalent_modulus_interval_pa=(45e6, 51e6),
        )
        base = replace(state(40e6, 20e6, 60e6), contact_residual_rms_over_peak=0.4)
        points.append(
            DiagnosisResult(
                file="survey",
                point=name,
                drops=(2, 3),
                verdict=verdict,
                before=base,
                after=after,
                effects=(DEVICE_EFFECT, BEDROCK),
                held_out=HeldOut(mode="next", before=0.5, after=0.02 * (number + 1)),
            )
        )
    return points


def lines_of(points: list[DiagnosisResult], width: int = 140) -> list[str]:
    return survey_lines(list(map(judged, points)), width)


def sentence_of(point: DiagnosisResult) -> str:
    return use_sentence(point, facts_of_state(point.after))


def judged(point: DiagnosisResult) -> DiagnosisResult:
    return replace(point, point_modulus=modulus_in_force(point))


def test_the_use_of_the_equivalent_modulus_is_said_where_it_differs() -> None:
    alike, other, third = survey()
    assert alike.after is not None
    wide = replace(alike.after, modulus_interval_pa=(25e6, 80e6))
    differs = replace(alike, after=wide)
    assert (differs.use, differs.equivalent_use) == ("do-not-use", "design")
    (line,) = [text for text in diagnosis_lines(differs) if "Equivalent modulus" in text]
    assert line == "  Equivalent modulus 48 MPa (45 to 51): design value."
    assert not [text for text in diagnosis_lines(alike) if "Equivalent modulus" in text]
    notes = [text for text in lines_of([differs, other, third]) if "Equivalent modulus" in text]
    assert notes == ["Equivalent modulus of A: design value"]
    # Without a fit that may be used it is in force alone.
    alone = replace(differs, before=FittedState(model="half-space", residual_rms_over_peak=0.01))
    lines = lines_of([alone, other, third])
    assert lines[0].startswith("3 points: 1 to use with care, 1 with the equivalent modulus alone")
    assert re.split(" {2,}", lines[3])[1:4] == ["none", "48 (45 to 51)", "equivalent: design value"]
    assert not [text for text in lines_of(survey()) if "Equivalent modulus" in text]


def test_several_points_begin_with_a_table() -> None:
    lines = lines_of(survey())
    assert lines[0] == "3 points: 1 with a design value, 1 to use with care, 1 not to use"
    heading, *rows = [re.split(" {2,}", line) for line in lines[2:6]]
    assert heading == [
        *("point", "E, MPa (95 %)", "at stress, kPa", "equivalent, MPa", "use", "unexplained"),
        *("next drop", "found", "what to do"),
    ]
    rock, equivalent = "bedrock 1.55 m", "48 (45 to 51)"
    assert rows == [
        [
            "A",
            "50 (47 to 53)",
            "100",
            equivalent,
            "design value",
            "0.40 %",
            "2.0 % off",
            rock,
            "use it",
        ],
        [
            "B",
            "50 (47 to 53)",
            "100",
            equivalent,
            "use with care",
            "2.0 %",
            "4.0 % off",
            rock,
            "design with the lower end",
        ],
        ["C", "none", "do not use", "5.0 %", "6.0 % off", rock, "measure again"],
    ]


def test_below_the_table_stand_plate_and_poissons_ratio() -> None:
    points = [
        replace(point, plate="rigid-rough", plate_radius_m=0.15, poisson_ratio=0.35)
        for point in survey()
    ]
    below = " ".join(line.strip() for line in lines_of(points)[7:])
    assert below.startswith(
        "E: secant modulus of the ground at the peak stress of the largest drop"
    )
    assert "radius 0.15 m, Poisson's ratio 0.35." in below


def test_below_the_table_stands_each_advice_once() -> None:
    below = lines_of(survey())[7:]
    assert below[0].startswith("Do not use the modulus of C: 5 % of the peak is unexplained")
    assert below[-2:] == [
        "bedrock, A, B: a sounding tells the depth",
        "device: sensor lag, all points: compare the channels",
    ]


def test_twelve_points_fit_one_screen() -> None:
    many = [replace(point, point=f"km {n}") for n, point in enumerate(4 * survey())]
    lines = lines_of(many, WIDTH)
    assert len(lines) < 40
    assert max(map(len, lines)) <= WIDTH


def test_a_fit_in_force_is_named_beside_a_diagnosis_that_is_not_to_be_used() -> None:
    point = survey()[2]
    assert point.before is not None
    point = replace(point, before=replace(point.before, contact_residual_rms_over_peak=0.01))
    assert "fit without effects" in lines_of([point, *survey()])[3]
    assert sentence_of(judged(point)).startswith(
        "Use the fit without effects: 40 MPa (20 to 60). Do not use the modulus after: 5 %"
    )


def test_a_modulus_of_unsupported_records_is_not_to_be_used() -> None:
    point, *others = survey()
    copied = text_notice("drop 3: its record is a copy")
    modulus = PointModulus(50e6, (47e6, 53e6), "diagnosed", copied)
    point = replace(point, point_modulus=modulus)
    lines = survey_lines([point, *map(judged, others)])
    assert lines[0] == "3 points: 1 to use with care, 2 not to use"
    row = re.split(" {2,}", lines[3])
    assert (row[1], row[2], row[-1]) == ("none", "do not use", "measure again")
    sentence = "drop 3: its record is a copy; measure again."
    assert f"Do not use the modulus of A: {sentence}" in lines
    assert sentence_of(point) == f"Do not use: {sentence}"
    (printed,) = printed_diagnosis(point, as_json=True)
    assert json.loads(printed)["modulus_in_force_pa"] is None


@pytest.mark.parametrize("code", ["sensor-steps", "load-steps"])
def test_the_remedy_is_that_of_the_warning(code: str) -> None:
    values: dict[str, float] = {"drop": 1, "after_s": 0.002}
    values |= {"offset_m": 0.3} if code == "sensor-steps" else {}
    point = replace(survey()[2], warnings=(Notice(code, values),))
    assert "samples of the record are missing" in sentence_of(point)


def test_after_not_explained_no_modulus_is_recommended() -> None:
    for point in survey():
        text = "\n".join(diagnosis_lines(point))
        assert ("UNEXPLAINED" in text) == ("Design value" not in text)


@pytest.mark.parametrize(("before", "after"), [(90.2e6, 88.4e6), (84.6e6, 78.0e6)])
def test_shown_moduli_agree_with_their_change(before: float, after: float) -> None:
    wide = DiagnosisResult(
        file="s",
        verdict="unexplained",
        before=state(before, 20e6, 190e6),
        after=state(after, 20e6, 190e6),
        effects=(BEDROCK,),
    )
    text = "\n".join(diagnosis_lines(wide))
    assert f"E {before / 1e6:.0f} MPa (" in text
    assert f"from {before / 1e6:.1f} to {after / 1e6:.1f} MPa" in text
    assert f"by {100 * (after / before - 1):+.0f} %" in text


def test_an_absurd_interval_is_not_shown() -> None:
    open_state = replace(state(50e6, 1e-20, 7e17), modulus_pa=None)
    found = DiagnosisResult(file="s", verdict="unexplained", before=open_state, after=open_state)
    assert "before  E left open, half-space" in "\n".join(diagnosis_lines(found))
