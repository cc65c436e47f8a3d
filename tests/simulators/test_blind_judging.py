"""Comparison of the diagnoses of a blind campaign with the simulated effects."""

import json
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.__main__ import main
from benchmarks.loop import Judged, covered, grouped, run, summarise
from benchmarks.output import Proportion, Reporter
from tests.campaigns.blind import Case

LAG = Case(
    file="0001.csv",
    effect="sensor_lag",
    key="sensor_lag",
    level=1,
    strength=1e-4,
    parameters={"delay_s": 1e-4},
    modulus_pa=40e6,
    bedrock_depth_m=None,
    radius_m=0.15,
    drops=2,
    sensors=1,
    quantity="velocity",
    noise=1e-3,
    device=None,
)
CLEAN = replace(LAG, effect="clean", key="clean", level=-1, parameters={}, group="clean")
UNKNOWN = replace(LAG, effect="gain_glitch", key="gain_glitch", group="unknown")
CONSTANT_Q = replace(UNKNOWN, effect="damping_law", group="soil", soil="constant-q")


def diagnosed(
    case: Case,
    verdict: str,
    *names: str,
    mpa: tuple[float, float] = (44, 40),
    interval_mpa: tuple[float, float] | None = None,
    residual: float = 1.0,
    alternatives: tuple[str, ...] = (),
    **entries: Any,
) -> Judged:
    """Return a point with its diagnosis; the moduli are those before and after, MPa."""
    before, after = ({"modulus_pa": value * 1e6, "residual_over_noise": residual} for value in mpa)
    if interval_mpa is not None:
        after["modulus_interval_pa"] = [limit * 1e6 for limit in interval_mpa]
    effects = [{"name": name, "alternatives": list(alternatives)} for name in names]
    record = {"verdict": verdict, "before": before, "after": after, "effects": effects}
    return Judged(case, {**record, "rejected": [], "warning_codes": [], **entries})


@pytest.mark.parametrize(
    ("mpa", "residual", "matters"),
    [((41, 41), 1, True), ((40.3, 40.3), 1, False), ((40, 40), 3.5, True)],
)
def test_an_effect_matters_by_modulus_or_residual(
    mpa: tuple[float, float], residual: float, matters: bool
) -> None:
    point = diagnosed(LAG, "clean", mpa=mpa, residual=residual)
    assert (point.matters, point.visible) == (matters, residual > 3)


@pytest.mark.parametrize(
    ("point", "right"),
    [
        (diagnosed(LAG, "explained", "sensor_lag"), True),
        (diagnosed(LAG, "explained", "viscosity", alternatives=("sensor_lag",)), True),
        (diagnosed(LAG, "explained", "viscosity"), False),
        (Judged(LAG, None), False),
        (
            diagnosed(replace(LAG, effect="false_trigger"), "clean", rejected=["drop 2"]),
            True,
        ),
        (
            diagnosed(
                replace(LAG, effect="saturation"), "clean", warning_codes=[{"code": "load-clipped"}]
            ),
            True,
        ),
    ],
)
def test_a_diagnosis_is_right_if_it_names_the_effect(point: Judged, right: bool) -> None:
    assert point.right is right


def test_intervals_are_compared_with_the_truth_in_three_groups() -> None:
    inside = diagnosed(LAG, "explained", interval_mpa=(38, 42))
    outside = diagnosed(LAG, "unexplained", interval_mpa=(41, 43))
    rig = diagnosed(replace(LAG, modulus_pa=None), "explained", interval_mpa=(38, 42))
    silent = diagnosed(UNKNOWN, "unexplained", interval_mpa=(20, 80))
    visible = diagnosed(UNKNOWN, "explained", "bedrock", residual=3.1)
    assert [p.held for p in (inside, outside, rig, visible)] == [True, False, None, None]
    assert inside.half_width == pytest.approx(0.05)
    assert covered([inside, outside, rig, silent, visible]) == {
        "clean_and_known": [inside, outside],
        "silent": [silent],
        "visible": [visible],
    }
    assert visible.is_explained_wrongly
    assert not silent.is_explained_wrongly
    assert not inside.lacks_modulus
    assert Judged(LAG, None).lacks_modulus


def test_soil_that_is_not_kelvin_voigt_has_separate_groups() -> None:
    lag, grown, glitch, damped, clean = judged = [
        diagnosed(LAG, "explained", "sensor_lag"),
        diagnosed(replace(LAG, soil="growth"), "explained", "bedrock"),
        diagnosed(UNKNOWN, "unexplained"),
        diagnosed(CONSTANT_Q, "explained"),
        diagnosed(CLEAN, "clean"),
    ]
    assert grouped(judged) == {
        "all": judged,
        "clean": [clean],
        "known effects": [lag],
        "unknown effects": [glitch],
        "constant-Q soil alone": [damped],
        "other soil, known effects": [grown],
        "other soil, all": [grown, damped],
        "unknown effect or other soil": [glitch, grown, damped],
    }


@pytest.mark.parametrize(
    ("verdict", "interval_mpa", "accepted"),
    [
        ("unexplained", (50, 60), True),
        ("explained", (35, 45), True),
        ("explained", (50, 60), False),
        ("clean", None, False),
    ],
)
def test_an_unknown_effect_is_admitted_by_verdict_or_interval(
    verdict: str, interval_mpa: tuple[float, float] | None, accepted: bool
) -> None:
    point = diagnosed(UNKNOWN, verdict, interval_mpa=interval_mpa)
    assert point.unexplained_or_held is accepted


def test_wilson_limits_agree_with_published_values() -> None:
    """Newcombe (1998), Stat. Med. 17, 857-872, table I, method 3."""
    published = {(81, 263): (0.2553, 0.3662), (15, 148): (0.0624, 0.1605), (0, 20): (0.0, 0.1611)}
    for (count, total), limits in published.items():
        assert Proportion(count, total).limits == pytest.approx(limits, abs=5e-5)
    assert str(Proportion(0, 0)) == "-"
    assert Proportion.among([1, 2, 3], lambda item: item > 1) == Proportion(2, 3)


def test_the_summary_has_a_line_for_each_point_and_kind(
    capsys: pytest.CaptureFixture[str],
) -> None:
    spring = replace(LAG, effect="spring_rig", key="spring_rig", modulus_pa=None)
    judged = [
        diagnosed(LAG, "explained", "sensor_lag"),
        diagnosed(spring, "unexplained", before=None, after=None),
        Judged(CLEAN, None),
    ]
    summarise(Reporter(["--json"]), judged)
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kinds = {record["kind"]: record for record in records if "kind" in record}
    assert kinds["sensor_lag"]["right"]["count"] == kinds["sensor_lag"]["right"]["of"] == 1
    assert kinds["clean"]["group"] == "clean"
    points = [record for record in records if "point" in record]
    assert [point["true"] for point in points] == ["sensor_lag", "spring_rig", "clean"]
    assert points[0]["before_error"] == pytest.approx(0.1)
    assert {"true": "sensor_lag", "named": "sensor_lag 1"} in records


def test_unknown_kinds_and_invalid_options_have_status_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["--kinds", "soil,bedrok"]) == 2
    assert "bedrok" in capsys.readouterr().err
    assert main(["loop", "--cases", "many"]) == 2
