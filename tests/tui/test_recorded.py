"""What ``pfwd log`` prints and keeps, replayed, inverted, edited, imported, checked; the demo."""

import json
from pathlib import Path
from typing import Any

import pytest

from simulators.instrument import serve
from tests.tui.console import (
    PLAIN,
    RATE,
    WITH_SHUNT,
    checked,
    numbers,
    pfwd,
    records,
)
from tui.output import next_commands

INVERT_KEYS = {
    *("file", "status", "method", "model", "modulus_pa", "modulus_sd_pa", "viscosity_pa_s"),
    *("viscosity_sd_pa_s", "density_kg_m3", "density_sd_kg_m3", "bedrock_depth_m"),
    *("bedrock_depth_sd_m", "modulus_interval_pa", "modulus_depth_correlation", "poisson_ratio"),
    *("plate_radius_m", "plate", "load", "half_sine", "peak_modulus_pa", "peak_factor"),
    *("r_squared", "residual_rms_over_peak", "contact_residual_rms_over_peak", "converged"),
    *("at_bound", "forward_solves", "elapsed_s", "seed", "warnings"),
}


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A survey of two drops with its capture, and what ``pfwd log`` printed."""
    survey = tmp_path_factory.mktemp("captured") / "survey"
    with serve(PLAIN, drops=2, rate=RATE, seed=1) as instrument:
        done = pfwd("log", instrument.url, "-o", survey, "--json", "--capture", "--point", "P 1")
    assert done.returncode == 0, done.stderr
    return survey, done


def test_json_lines_are_those_of_the_contract(captured: tuple[Path, Any]) -> None:
    survey, done = captured
    lines = records(done.stdout)
    assert (
        numbers(sorted(lines, key=lambda line: line["drop"])) == [("P 1", 1)] * 2 + [("P 1", 2)] * 2
    )
    for number in (1, 2):
        quick, full = [line for line in lines if line["drop"] == number]
        assert (quick["method"], full["method"]) == ("posterior", "mpga")
        for line in (quick, full):
            assert list(line)[:3] == ["point", "drop", "saved"]
            assert line["saved"] is True
            assert line["record"] == number
            assert set(line) >= INVERT_KEYS
            assert line["status"] == "measured"
            assert line["half_sine"].keys() == {"peak_pressure_pa", "duration_s", "rms_over_peak"}
            assert 2e7 < line["modulus_pa"] < 9e7
            assert line["file"].endswith(f"drop-{number:06d}.h5")
            assert Path(line["file"]).is_file()
    assert "plate radius 0.15 m" in done.stderr
    assert done.stderr.index("plate radius") < done.stderr.index("ready")
    assert pfwd("check", survey).stdout.endswith("complete\n")


def test_a_replay_says_that_the_traces_are_the_same(captured: tuple[Path, Any]) -> None:
    survey, done = captured
    again = pfwd("replay", survey, "--json", "--no-invert")
    lines = records(again.stdout)
    assert numbers(lines) == [("P 1", 1), ("P 1", 2)]
    assert all(line["identical"] is True and line["saved"] is True for line in lines)
    assert again.returncode == 0
    del done


def test_a_capture_gives_the_same_drops_and_results(
    captured: tuple[Path, Any], tmp_path: Path
) -> None:
    from pfwd_device.recording import read_survey

    survey, done = captured
    (capture,) = (survey / "captures").glob("*.pfwdc")
    again = pfwd("replay", capture, "--json", "-o", tmp_path / "copy")
    assert again.returncode == 0, again.stderr
    first = {(line["drop"], line["method"]): line for line in records(done.stdout)}
    lines = records(again.stdout)
    assert len(lines) == 4
    for line in lines:
        before = first[line["drop"], line["method"]]
        assert line["modulus_pa"] == before["modulus_pa"]
        assert line["bedrock_depth_m"] == before["bedrock_depth_m"]
    kept = [drop.read() for drop in read_survey(survey).drops]
    copied = [drop.read() for drop in read_survey(tmp_path / "copy").drops]
    for one, other in zip(kept, copied, strict=True):
        assert one.counts is not None
        assert other.counts is not None
        assert one.counts.tobytes() == other.counts.tobytes()
        assert one.drop.load.tobytes() == other.drop.load.tobytes()
        assert one.metadata["key"] == other.metadata["key"]
    # Into the survey that it is from: nothing is recorded twice.
    same = pfwd("replay", capture, "--json", "--no-invert", "-o", survey)
    assert (same.returncode, same.stdout) == (0, "")
    assert same.stderr.count("not recorded twice") == 2


def test_invert_of_a_survey_and_of_its_file(captured: tuple[Path, Any]) -> None:
    survey, done = captured
    quick = {line["drop"]: line for line in records(done.stdout) if line["method"] == "posterior"}
    found = pfwd("invert", survey, "--method", "posterior", "--json")
    for line in records(found.stdout):
        assert line["modulus_pa"] == pytest.approx(quick[line["drop"]]["modulus_pa"], rel=1e-6)
    one = pfwd("invert", survey / "drops" / "drop-000002.h5", "--method", "posterior", "--json")
    (line,) = records(one.stdout)
    assert line["drop"] == 2
    assert line["modulus_pa"] == pytest.approx(quick[2]["modulus_pa"], rel=1e-6)


def test_edit_and_import(captured: tuple[Path, Any], tmp_path: Path) -> None:
    survey, _ = captured
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(survey, copy)
    done = pfwd("edit", copy, "--drop", 2, "--discard", "wet", "--note", "a\x1b[2Jb")
    assert done.returncode == 0, done.stderr
    assert "drop 2: DISCARDED" in done.stdout
    assert "\x1b" not in done.stdout
    options = ("--set", "bedrock_depth_m=inf", "--position", "48,11", "--target", 45, "--json")
    (point,) = records(pfwd("edit", copy, *options).stdout)
    assert (point["target_pa"], point["position"]) == (45e6, {"latitude": 48.0, "longitude": 11.0})
    assert point["declared"]["bedrock_depth_m"] is None  # infinite
    assert [drop["discarded"] for drop in point["drops"]] == [False, True]
    moved = pfwd("import", copy, "-o", tmp_path / "other", "--json")
    (line,) = records(moved.stdout)
    assert (line["point"], line["drop"], line["saved"], line["before"]) == ("P 1", 1, True, False)


def test_the_demo_is_a_point_that_passes_and_names_what_comes_next(tmp_path: Path) -> None:
    survey = tmp_path / "first survey"
    done = pfwd("demo", "--rate", WITH_SHUNT, "-o", survey)
    assert done.returncode == 0, done.stderr
    # The fit of the last drop may end after the verdict, which does not need it.
    (last,) = (line for line in done.stdout.splitlines() if line.startswith("point 1: E_vd "))
    assert "target 45 MPa  PASS: the whole 95 % interval reaches the target" in last
    assert f"next: {next_commands(survey)[0]}" in done.stderr
    assert f"next: {next_commands(survey)[1]}" in done.stderr
    job = json.loads(pfwd("job", survey, "--json").stdout)
    assert (job["procedure"], job["target"]) == ("tp-bf-stb-b8.3", 45e6)
    point = records(pfwd("replay", survey, "--json", "--no-invert").stdout)[-1]
    assert (point["value"]["quantity"], point["value"]["drops"]) == ("E_vd", 3)
    assert 55e6 < point["value"]["value"] < 65e6, "within what the method measures"
    assert point["value"]["interval"][0] > 45e6
    truth = (
        done.stderr.split("simulated moduli, which the measurement did not use:")[1]
        .strip()
        .splitlines()
    )
    measured = [float(line.split("E ")[1].split(" MPa")[0]) for line in truth[3:]]
    assert measured == [52.0] * 3, "the ground is above the target as well"
    assert all(abs(float(line.rsplit(",", 1)[1].strip(" %"))) < 3 for line in truth)
    assert checked(survey)["ok"]


def test_a_demo_of_another_scenario_or_of_few_drops_decides_nothing(tmp_path: Path) -> None:
    options = ("--rate", WITH_SHUNT, "-o")
    soft = pfwd("demo", "--scenario", "default", "--drops", 1, *options, tmp_path / "soft")
    assert soft.returncode == 0, soft.stderr
    job = json.loads(pfwd("job", tmp_path / "soft", "--json").stdout)
    assert (job["procedure"], job["target"]) == (None, None)
    few = pfwd("demo", "--drops", 2, *options, tmp_path / "few")
    assert few.returncode == 0, few.stderr
    assert "PASS" not in few.stdout
    done = pfwd("report", tmp_path / "few", "-o", tmp_path / "r.html", "--json")
    (point,) = records(done.stdout)
    assert (point["verdict"], point["complete"], point["target"]) == ("undecided", False, 45e6)
