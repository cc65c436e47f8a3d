"""Diagnoses as text: of one point in full, of several as a table, of held-out data."""

import json
import re
from dataclasses import replace
from typing import Any

import pytest

from inversion.notices import Notice, text_notice, text_of
from pfwd.analysis.results import (
    DiagnosisResult,
    EffectParameter,
    EffectResult,
    FittedState,
    HeldOut,
    HeldOutPart,
)
from pfwd.facts import facts_of_state
from pfwd.judging.verdicts import modulus_in_force
from pfwd.procedures import PointModulus
from pfwd.units import SI
from tui.diagnosis_lines import (
    WIDTH,
    diagnosis_lines,
    diagnosis_sentence,
    diagnosis_warnings,
    point_cells,
    printed_diagnosis,
    survey_lines,
    undiagnosed_lines,
    use_sentence,
)


def diagnosis(point: str | None = None, *warnings: str | Notice, **values: Any) -> DiagnosisResult:
    messages = tuple(text_notice(w) if isinstance(w, str) else w for w in warnings)
    fields = {"verdict": "unexplained", "warnings": messages, **values}
    return DiagnosisResult(file="survey", point=point, **fields)


def state(modulus: float | None, low: float, high: float, residual: float = 0.2) -> FittedState:
    return FittedState(
        model="half-space",
        modulus_pa=modulus,
        modulus_interval_pa=(low, high),
        residual_rms_over_peak=residual,
        stress_pa=1e5,
    )


def text_of_point(point: DiagnosisResult) -> str:
    return "\n".join(diagnosis_lines(point))


def test_a_single_point_has_its_warnings_among_the_lines() -> None:
    lines = diagnosis_lines(diagnosis("A", "no plate mass"))
    assert lines[-1] == "  warning: no plate mass"
    assert "warning:" not in "".join(diagnosis_lines(diagnosis("A", "x"), warnings=False))


def test_several_points_have_each_warning_once_as_ranges() -> None:
    residuals = [Notice("rig-not-explained", {"residual_over_peak": r}) for r in (0.031, 0.045)]
    points = [diagnosis(name, "no plate mass") for name in "ABC"]
    assert diagnosis_warnings(points) == ["  warning, all points: no plate mass"]
    points.append(diagnosis("D", "no plate mass", residuals[0]))
    points.append(diagnosis("E", residuals[1]))
    assert diagnosis_warnings(points) == [
        "  warning, A to D: no plate mass",
        f"  warning, D, E: {text_of(residuals[0])}".replace("3.1", "3.1 and 4.5"),
    ]


@pytest.mark.parametrize(("factor", "is_known"), [(9.9, True), (10.1, False)])
def test_a_modulus_with_a_wide_interval_is_open(factor: float, is_known: bool) -> None:
    point = diagnosis(
        before=state(40e6, 38e6, 42e6),
        after=state(50e6, 20e6, 20e6 * factor),
        effects=(EffectResult(name="bedrock"),),
    )
    text, sentence = text_of_point(point), diagnosis_sentence(point)
    assert ("after   E 50 MPa (20 to 200), half" in text) == is_known
    assert ("after   E left open (20 to 200 MPa), half" in text) == (not is_known)
    assert ("→ left open (20 to 200 MPa), do not use" in sentence) == (not is_known)
    assert ("→ 50 MPa (20 to 200), do not use" in sentence) == is_known
    assert ("the modulus changes from 40.0 to 50.0 MPa, by +25 %" in text) == is_known
    assert "before  E 40.0 MPa (38.0 to 42.0)" in text


def test_an_open_modulus_is_not_to_be_used_and_an_absurd_interval_not_printed() -> None:
    for low, high, text in (
        (0.7e6, 13e6, "E left open (0.70 to 13.0 MPa), half"),
        (1e-20, 7e17, "E left open, half"),
    ):
        after = state(None, low, high)
        text_on_page = text_of_point(diagnosis(verdict="explained", before=after, after=after))
        assert text_on_page.count(text) == 2
        assert "Do not use: the diagnosis leaves the modulus open" in text_on_page


@pytest.mark.parametrize(
    ("verdict", "low", "high", "residual", "text"),
    [
        ("explained", 47e6, 53e6, 0.01, "Design value 50 MPa (47 to 53), secant modulus at"),
        ("unexplained", 47e6, 53e6, 0.02, "(47 to 53), secant modulus at 100 kPa: 2 % of the peak"),
        ("explained", 30e6, 70e6, 0.01, "Do not use: the interval"),
        ("unexplained", 47e6, 53e6, 0.05, "Do not use: 5 % of the peak"),
    ],
)
def test_a_sentence_states_the_use_of_the_modulus(
    verdict: str, low: float, high: float, residual: float, text: str
) -> None:
    after = replace(state(50e6, low, high, residual), residual_over_noise=1e3)
    point = diagnosis(verdict=verdict, before=after, after=after)
    (line,) = [line for line in diagnosis_lines(point) if text in line]
    assert line.endswith(".")


@pytest.mark.parametrize(
    ("value", "sd", "unit", "text"),
    [
        (-0.00204, 0.00003, "s", "x -2.04 ± 0.03 ms"),
        (20e6, 2.3e6, "N/m", "x 20.0 ± 2.3 MN/m"),
        (1.62e5, 0.0, "Pa", "x 162 kPa"),
        (0.43, 0.13, "-", "x 0.43 ± 0.13 ["),
    ],
)
def test_parameters_are_printed_in_everyday_units(
    value: float, sd: float, unit: str, text: str
) -> None:
    parameter = EffectParameter(name="x", value=value, sd=sd, unit=unit)
    effect = EffectResult(
        name="effect", parameters=(parameter,), evidence=50.0, alternatives=("lag",)
    )
    text_on_page = text_of_point(diagnosis(verdict="explained", effects=(effect,)))
    assert text in text_on_page
    assert "it could also be lag" in text_on_page


@pytest.mark.parametrize(("residual", "text"), [(0.0123, "1.2 %"), (0.0996, "10 %")])
def test_the_residual_is_printed_in_percent(residual: float, text: str) -> None:
    point = diagnosis(before=state(5e7, 4e7, 6e7), after=state(5e7, 4e7, 6e7, residual))
    assert f"residual {text} of the peak" in text_of_point(point)


def test_points_without_a_drop_are_listed_in_a_single_line() -> None:
    empty = [DiagnosisResult(file="a.F25", point=f"km {n}", drops=()) for n in range(1, 5)]
    diagnosed = DiagnosisResult(file="a.F25", point="km 5", drops=(1,))
    (line,) = undiagnosed_lines([*empty, diagnosed])
    assert line.startswith("NOTHING TO DIAGNOSE at km 1 to km 4 (4): no drop can be used")
    (line,) = undiagnosed_lines(empty)
    assert "at all points (4)" in line
    assert undiagnosed_lines([diagnosed]) == []
    rejected = replace(
        empty[0], effects=(EffectResult(name="false_trigger"),), rejected=("drop 1: peaks only",)
    )
    assert diagnosis_lines(rejected) == [
        "a.F25, point km 1, drops none",
        "  NOTHING TO DIAGNOSE: no drop of the point can be used, see the warnings",
        "  false trigger",
        "  drop 1: peaks only",
    ]
    sentence = diagnosis_sentence(diagnosis("A", Notice("no-measured-drop"), drops=()), SI)
    assert sentence == "not made: no measured drop to diagnose"


@pytest.mark.parametrize(("high", "differs"), [(52e6, False), (90e6, True)])
def test_a_difference_without_an_effect_is_explained(high: float, differs: bool) -> None:
    point = diagnosis(before=state(50e6, 48e6, 52e6), after=state(50e6, 48e6, high))
    assert ("no effect is accepted" in text_of_point(point)) is differs


@pytest.mark.parametrize(("before", "after"), [(90.2e6, 88.4e6), (84.6e6, 78.0e6)])
def test_printed_moduli_agree_with_their_change(before: float, after: float) -> None:
    states = [state(modulus, 20e6, 190e6) for modulus in (before, after)]
    text = text_of_point(diagnosis(before=states[0], after=states[1], effects=(BEDROCK,)))
    assert f"E {before / 1e6:.0f} MPa (" in text
    assert f"from {before / 1e6:.1f} to {after / 1e6:.1f} MPa" in text
    assert f"by {100 * (after / before - 1):+.0f} %" in text


# Several points

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


def judged(point: DiagnosisResult) -> DiagnosisResult:
    return replace(point, point_modulus=modulus_in_force(point))


def survey() -> list[DiagnosisResult]:
    """Three points of one device: a design value, one to use with care, one not to use."""
    misfits = {"A": ("explained", 0.004), "B": ("unexplained", 0.02), "C": ("unexplained", 0.05)}
    points = []
    for number, (name, (verdict, misfit)) in enumerate(misfits.items(), 1):
        after = replace(
            state(50e6, 47e6, 53e6, misfit),
            discrepancy_over_peak=misfit,
            equivalent_modulus_pa=48e6,
            equivalent_modulus_interval_pa=(45e6, 51e6),
        )
        point = diagnosis(
            name,
            drops=(2, 3),
            verdict=verdict,
            before=replace(state(40e6, 20e6, 60e6), contact_residual_rms_over_peak=0.4),
            after=after,
            effects=(DEVICE_EFFECT, BEDROCK),
            held_out=HeldOut(mode="next", before=0.5, after=0.02 * number),
            plate="rigid-rough",
            plate_radius_m=0.15,
            poisson_ratio=0.35,
        )
        points.append(judged(point))
    return points


def cells(line: str) -> list[str]:
    return re.split(" {2,}", line)


def test_several_points_begin_with_a_table() -> None:
    lines = survey_lines(survey(), 140)
    assert lines[0] == "3 points: 1 with a design value, 1 to use with care, 1 not to use"
    rock, modulus, equivalent = "bedrock 1.55 m", "50 (47 to 53)", "48 (45 to 51)"
    assert list(map(cells, lines[2:6])) == [
        [
            *("point", "E, MPa (95 %)", "at stress, kPa", "equivalent, MPa", "use", "unexplained"),
            *("next drop", "found", "what to do"),
        ],
        ["A", modulus, "100", equivalent, "design value", "0.40 %", "2.0 % off", rock, "use it"],
        [
            *("B", modulus, "100", equivalent, "use with care", "2.0 %", "4.0 % off", rock),
            "design with the lower end",
        ],
        ["C", "none", "do not use", "5.0 %", "6.0 % off", rock, "measure again"],
    ]
    do_not_use = "Do not use the modulus of C: 5 % of the peak is unexplained"
    assert any(line.startswith(do_not_use) for line in lines)
    assert "radius 0.15 m, Poisson's ratio 0.35." in " ".join(line.strip() for line in lines[7:])
    assert lines[-2:] == [
        "bedrock, A, B: a sounding tells the depth",
        "device: sensor lag, all points: compare the channels",
    ]
    many = [replace(point, point=f"km {n}") for n, point in enumerate(4 * survey())]
    lines = survey_lines(many, WIDTH)
    assert len(lines) < 40, "twelve points fit one screen"
    assert max(map(len, lines)) <= WIDTH


def test_the_use_of_the_equivalent_modulus_is_printed_where_it_differs() -> None:
    same, second, third = survey()
    assert same.after is not None
    differs = judged(replace(same, after=replace(same.after, modulus_interval_pa=(25e6, 80e6))))
    assert (differs.use, differs.equivalent_use) == ("do-not-use", "design")

    def notes(lines: list[str]) -> list[str]:
        return [line.strip() for line in lines if "Equivalent modulus" in line]

    assert notes(diagnosis_lines(differs)) == [
        "Equivalent modulus 48 MPa (45 to 51): design value."
    ]
    assert notes(survey_lines([differs, second, third], 140)) == [
        "Equivalent modulus of A: design value"
    ]
    assert notes(diagnosis_lines(same) + survey_lines(survey(), 140)) == []
    # Without a fit that may be used it is in force by itself.
    no_fit = judged(
        replace(differs, before=replace(state(None, 1e6, 1e9), residual_rms_over_peak=0.01))
    )
    lines = survey_lines([no_fit, second, third], 140)
    assert lines[0].startswith("3 points: 1 to use with care, 1 with the equivalent modulus alone")
    assert cells(lines[3])[1:4] == ["none", "48 (45 to 51)", "equivalent: design value"]


def test_a_fit_in_force_is_named_with_a_diagnosis_that_is_not_to_be_used() -> None:
    point = survey()[2]
    assert point.before is not None
    before = replace(point.before, contact_residual_rms_over_peak=0.01)
    rough = EffectResult(name="rough_contact", scope="point")
    point = judged(replace(point, before=before, effects=(rough,)))
    row = survey_lines([point, *survey()], 140)[3]
    assert "fit without effects" in row
    assert "rough contact" in row, "an effect without a depth"
    assert use_sentence(point, facts_of_state(point.after)).startswith(
        "Use the fit without effects: 40 MPa (20 to 60). Do not use the modulus after: 5 %"
    )


def test_a_modulus_of_unsupported_records_is_not_to_be_used() -> None:
    point, second, third = survey()
    copied = text_notice("drop 3: its record is a copy")
    point = replace(point, point_modulus=PointModulus(50e6, (47e6, 53e6), "diagnosed", copied))
    lines = survey_lines([point, second, third])
    assert lines[0] == "3 points: 1 to use with care, 2 not to use"
    row = cells(lines[3])
    assert (row[1], row[2], row[-1]) == ("none", "do not use", "measure again")
    sentence = "drop 3: its record is a copy; measure again."
    assert f"Do not use the modulus of A: {sentence}" in lines
    assert use_sentence(point, facts_of_state(point.after)) == f"Do not use: {sentence}"
    (printed,) = printed_diagnosis(point, as_json=True)
    assert json.loads(printed)["modulus_in_force_pa"] is None


@pytest.mark.parametrize("code", ["sensor-steps", "load-steps"])
def test_the_remedy_is_that_of_the_warning(code: str) -> None:
    values: dict[str, float] = {"drop": 1, "after_s": 0.002}
    values |= {"offset_m": 0.3} if code == "sensor-steps" else {}
    point = replace(survey()[2], warnings=(Notice(code, values),))
    sentence = use_sentence(point, facts_of_state(point.after))
    assert "samples of the record are missing" in sentence


# Held-out data


def held_out_lines(**values: Any) -> list[str]:
    errors = {"before": 0.5, "after": 0.09, "contact_before": 0.4, "contact_after": 0.08}
    held = HeldOut(**errors, **values)
    return diagnosis_lines(DiagnosisResult(file="s", drops=(1, 2), held_out=held))[2:]


def test_a_prediction_is_compared_with_the_scaled_record() -> None:
    scaled = {"scaled_record": 0.06, "contact_scaled_record": 0.07}
    assert held_out_lines(mode="next", fitted=("stiffness (drop 3)",), **scaled) == [
        "  next drop predicted: off by 9.0 % of the peak (contact 8.0 %), base model 50 % (40 %), "
        "preceding record scaled by the peak loads 6.0 % (7.0 %)",
        "    fitted to the held-out data: stiffness (drop 3)",
    ]
    first, last = held_out_lines(mode="next", fitted=())
    assert first.endswith("no preceding record to scale")
    assert last == "    fitted to the held-out data: nothing"


@pytest.mark.parametrize(
    ("mode", "start"),
    [
        ("point", "  device of the other points, everything else fitted: off by 9.0 % of the peak"),
        ("drop", "  ground of the other drops, everything else fitted: off by 9.0 %"),
        ("next", "  next drop predicted: off by 9.0 % of the peak"),
    ],
)
def test_fitted_data_are_not_called_a_prediction(mode: str, start: str) -> None:
    fitted = ("choice of effects", "modulus_ratio (ground)")
    first, last = held_out_lines(mode=mode, fitted=fitted)
    assert first.startswith(start)
    assert last == "    fitted to the held-out data: choice of effects, modulus ratio (ground)"


@pytest.mark.parametrize(
    ("errors", "text"),
    [
        (
            {"largest_peak_error": 0.031, "peak_error_points": 9},
            "largest error at 9 other points 3.1 %",
        ),
        (
            {"peak_error_interval": (-0.0312, 0.04), "peak_error_points": 24},
            "95 % interval by 24 other points -3.1 to +4.0 %",
        ),
    ],
)
def test_the_error_of_a_peak_is_compared_between_points(errors: dict[str, Any], text: str) -> None:
    part = (HeldOutPart(name="drop 3", after=0.09, peak_error=-0.013),)
    line = held_out_lines(mode="next", fitted=(), by=part, **errors)[1]
    assert line == f"    recorded peak -1.3 % from the predicted one; {text}"
    assert len(held_out_lines(mode="next", fitted=(), by=part)) == 2


def test_a_held_out_sensor_is_compared_with_its_neighbours() -> None:
    parts = (
        HeldOutPart(name="sensor at 0.3 m", after=0.04, interpolated=0.06),
        HeldOutPart(name="sensor at 0.6 m", after=0.12),
    )
    first, each, _ = held_out_lines(mode="sensor", fitted=(), by=parts, side_difference=0.03)
    assert first.startswith("  each sensor predicted: off by 9.0 % of the peak")
    assert first.endswith(", sides of the plate differ by 3.0 %")
    assert each == (
        "    sensor at 0.3 m 4.0 % (between its neighbours 6.0 %), sensor at 0.6 m 12 %"
    )
    first = held_out_lines(mode="sensor", fitted=(), by=parts)[0]
    assert first.endswith("no two sensors at one distance to compare the sides of the plate")


def test_held_out_sensors_are_not_judged_where_the_sides_of_the_plate_differ() -> None:
    held = HeldOut(mode="sensor", fitted=(), side_difference=0.13)
    point = diagnosis("A", drops=(1, 2), held_out=held)
    assert diagnosis_lines(point)[2:] == [
        "  each sensor predicted, but not judged: sides of the plate differ by 13 % of the peak"
    ]
    assert point_cells("A", point).prediction_error == "sides differ 13 %"
