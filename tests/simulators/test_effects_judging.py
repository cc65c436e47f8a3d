"""The benchmark's judgement of diagnoses: it says what is right, and that wrong is wrong."""

import json
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.__main__ import main
from benchmarks.loop import Judged, covered, grouped, run, summarise
from benchmarks.output import Proportion, Reporter
from tests.campaigns.blind import Case

CASE = Case(
    file="0001.csv",
    effect="sensor_lag",
    key="sensor_lag",
    known=True,
    scope="device",
    level=1,
    strength=1e-4,
    parameters={"delay_s": 1e-4},
    misread="viscosity",
    modulus_pa=40e6,
    viscosity_pa_s=5e4,
    density_kg_m3=1900.0,
    bedrock_depth_m=None,
    depth_declared=True,
    radius_m=0.15,
    poisson_ratio=0.35,
    drops=2,
    sensors=1,
    quantity="velocity",
    noise=1e-3,
    noise_colour=0.0,
    device=None,
)
CLEAN = replace(CASE, effect="clean", key="clean", level=-1, parameters={}, group="clean")
UNKNOWN = replace(CASE, effect="gain_glitch", key="gain_glitch", known=False, group="unknown")


def said(
    verdict: str,
    before: float,
    after: float,
    *names: str,
    residual: float = 1.0,
    alternatives: tuple[str, ...] = (),
) -> dict[str, Any]:
    """A record with moduli in MPa."""
    state = {"modulus_sd_pa": 1e5, "residual_over_noise": residual}
    return {
        "verdict": verdict,
        "before": {"modulus_pa": before * 1e6, **state},
        "after": {"modulus_pa": after * 1e6, **state},
        "effects": [{"name": name, "alternatives": list(alternatives)} for name in names],
        "rejected": [],
        "warnings": [],
        "warning_codes": [],
    }


def test_an_effect_matters_by_modulus_or_by_residual() -> None:
    assert Judged(CASE, said("clean", 41, 41)).matters
    assert not Judged(CASE, said("clean", 40.3, 40.3)).matters
    assert Judged(CASE, said("clean", 40, 40, residual=3.5)).matters
    assert not Judged(CASE, said("clean", 41, 41)).visible


def test_the_right_name_may_be_an_alternative() -> None:
    assert Judged(CASE, said("explained", 44, 40, "sensor_lag")).right
    assert Judged(CASE, said("explained", 44, 40, "viscosity", alternatives=("sensor_lag",))).right
    assert not Judged(CASE, said("explained", 44, 40, "viscosity")).right
    assert not Judged(CASE, None).right


def with_interval(verdict: str, low: float, high: float) -> dict[str, Any]:
    """A record that finds 40 MPa, with an interval in MPa."""
    record = said(verdict, 44, 40)
    record["after"]["modulus_interval_pa"] = [low * 1e6, high * 1e6]
    return record


def test_coverage_asks_whether_the_interval_holds_the_truth() -> None:
    inside = Judged(CASE, with_interval("explained", 38, 42))
    outside = Judged(CASE, with_interval("unexplained", 41, 43))
    rig = Judged(replace(CASE, modulus_pa=None), with_interval("explained", 38, 42))
    assert (inside.held, outside.held, rig.held) == (True, False, None)
    assert inside.half_width == pytest.approx(0.05)
    assert Judged(CASE, said("clean", 40, 40)).held is None
    silent = Judged(UNKNOWN, with_interval("unexplained", 20, 80))
    visible = Judged(UNKNOWN, said("explained", 44, 40, "bedrock", residual=3.1))
    assert covered([inside, outside, rig, silent, visible]) == {
        "clean_and_known": [inside, outside],
        "silent": [silent],
        "visible": [visible],
    }
    assert visible.is_explained_wrongly
    assert not silent.is_explained_wrongly
    assert not inside.lacks_modulus
    assert Judged(CASE, None).lacks_modulus


OTHER = replace(UNKNOWN, effect="damping_law", key="damping_law", group="soil", soil="constant-q")


def test_other_soil_is_a_group_of_its_own() -> None:
    lag = replace(CASE, soil="growth")
    judged = [
        Judged(CASE, said("explained", 44, 40, "sensor_lag")),
        Judged(lag, said("explained", 44, 60, "bedrock")),
        Judged(UNKNOWN, said("unexplained", 44, 44)),
        Judged(OTHER, with_interval("explained", 50, 60)),
        Judged(CLEAN, said("clean", 40, 40)),
    ]
    groups = grouped(judged)
    assert groups["known effects"] == judged[:1]
    assert groups["other soil, known effects"] == judged[1:2]
    assert groups["constant-Q soil alone"] == [judged[3]]
    assert groups["unknown effect or other soil"] == [judged[2], judged[1], judged[3]]
    assert "growth with depth alone" not in groups


def test_an_unknown_effect_is_admitted_by_verdict_or_interval() -> None:
    assert Judged(UNKNOWN, with_interval("unexplained", 50, 60)).unexplained_or_held
    assert Judged(UNKNOWN, with_interval("explained", 35, 45)).unexplained_or_held
    assert not Judged(UNKNOWN, with_interval("explained", 50, 60)).unexplained_or_held
    assert not Judged(UNKNOWN, said("clean", 44, 44)).unexplained_or_held


def test_wilson_limits_are_those_of_the_tables() -> None:
    """Newcombe (1998), Stat. Med. 17, 857-872, table I, method 3."""
    low, high = Proportion(81, 263).limits
    assert (round(low, 4), round(high, 4)) == (0.2553, 0.3662)
    low, high = Proportion(15, 148).limits
    assert (round(low, 4), round(high, 4)) == (0.0624, 0.1605)
    low, high = Proportion(0, 20).limits
    assert (round(low, 4), round(high, 4)) == (0.0, 0.1611)
    assert str(Proportion(0, 0)) == "-"
    assert Proportion.among([1, 2, 3], lambda item: item > 1) == Proportion(2, 3)


def test_rejected_drops_and_clipped_samples_count_as_named() -> None:
    record = said("clean", 40, 40) | {"rejected": ["drop 2: false trigger"]}
    assert "false_trigger" in Judged(CASE, record).named
    record = said("clean", 40, 40) | {
        "warnings": ["load clipped at 8 kN"],
        "warning_codes": [{"code": "load-clipped", "values": {}}],
    }
    assert "saturation" in Judged(CASE, record).named


def test_the_summary_is_one_object_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    nothing = {"before": None, "after": None}
    spring = replace(CASE, effect="spring_rig", key="spring_rig", modulus_pa=None)
    judged = [
        Judged(CASE, said("explained", 44, 40, "sensor_lag")),
        Judged(spring, said("unexplained", 44, 40) | nothing),
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


def test_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--kinds", "soil,bedrok"]) == 2
    assert "bedrok" in capsys.readouterr().err
    assert main(["loop", "--cases", "many"]) == 2
    assert "--cases" in capsys.readouterr().err
