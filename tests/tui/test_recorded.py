"""Output and survey of ``pfwd log``, replayed, inverted, edited, imported, checked; the demo."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from pfwd_device.recording.survey_reader import read_survey
from simulators.instrument import serve
from tests.tui.console import (
    PLAIN,
    RATE,
    WITH_SHUNT,
    checked,
    logged,
    numbers,
    pfwd,
    records,
)
from tui.commands.demo import measured_moduli
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
def captured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[dict[str, Any]]]:
    """A survey of two drops with its capture, and the lines of ``pfwd log``."""
    survey = tmp_path_factory.mktemp("captured") / "survey"
    with serve(PLAIN, drops=2, rate=RATE, seed=1) as instrument:
        lines = logged(instrument, survey, "--capture", "--point", "P 1")
    return survey, lines


def test_json_lines_are_those_of_the_contract(captured: tuple[Path, list[dict[str, Any]]]) -> None:
    survey, lines = captured
    assert sorted(numbers(lines)) == [("P 1", 1)] * 2 + [("P 1", 2)] * 2
    for number in (1, 2):
        quick, full = [line for line in lines if line["drop"] == number]
        assert (quick["method"], full["method"]) == ("posterior", "mpga")
        for line in (quick, full):
            assert list(line)[:3] == ["point", "drop", "saved"]
            assert (line["saved"], line["record"], line["status"]) == (True, number, "measured")
            assert set(line) >= INVERT_KEYS
            assert line["half_sine"].keys() == {"peak_pressure_pa", "duration_s", "rms_over_peak"}
            assert 2e7 < line["modulus_pa"] < 9e7
            assert line["file"].endswith(f"drop-{number:06d}.h5")
            assert Path(line["file"]).is_file()
    assert pfwd("check", survey).out.endswith("complete\n")


def test_a_survey_and_its_capture_are_replayed_and_inverted(
    captured: tuple[Path, list[dict[str, Any]]], tmp_path: Path
) -> None:
    survey, lines = captured
    quick = {line["drop"]: line for line in lines if line["method"] == "posterior"}
    replayed = records(pfwd("replay", survey, "--json", "--no-invert").out)
    assert numbers(replayed) == [("P 1", 1), ("P 1", 2)]
    assert all(line["identical"] is True and line["saved"] is True for line in replayed)
    (capture,) = (survey / "captures").glob("*.pfwdc")
    copy = pfwd("replay", capture, "--json", "--no-invert", "-o", tmp_path / "copy")
    assert numbers(records(copy.out)) == [("1", 1), ("1", 2)], "a capture has no names"
    same = pfwd("replay", capture, "--json", "--no-invert", "-o", survey)
    assert (same.status, same.out) == (0, ""), "no drop is recorded twice"
    assert same.err.count("not recorded twice") == 2
    for source in (survey, survey / "drops" / "drop-000002.h5"):
        for line in records(pfwd("invert", source, "--method", "posterior", "--json").out):
            modulus = quick[line["drop"]]["modulus_pa"]
            assert line["modulus_pa"] == pytest.approx(modulus, rel=1e-6)


def test_a_survey_is_edited_and_imported(
    captured: tuple[Path, list[dict[str, Any]]], tmp_path: Path
) -> None:
    copy = shutil.copytree(captured[0], tmp_path / "copy")
    edited = pfwd("edit", copy, "--drop", 2, "--discard", "wet", "--note", "a\x1b[2Jb")
    assert edited.status == 0, edited.err
    assert "drop 2: DISCARDED" in edited.out
    assert "\x1b" not in edited.out
    options = ("--set", "bedrock_depth_m=inf", "--position", "48,11", "--target", 45, "--json")
    (point,) = records(pfwd("edit", copy, *options).out)
    assert (point["target_pa"], point["position"]) == (45e6, {"latitude": 48.0, "longitude": 11.0})
    assert point["declared"]["bedrock_depth_m"] is None  # infinite
    assert [drop["discarded"] for drop in point["drops"]] == [False, True]
    (line,) = records(pfwd("import", copy, "-o", tmp_path / "merged", "--json").out)
    assert (line["point"], line["drop"], line["saved"], line["before"]) == ("P 1", 1, True, False)


def test_the_demo_is_a_point_that_passes_and_names_the_next_commands(tmp_path: Path) -> None:
    survey = tmp_path / "first survey"
    demo = pfwd("demo", "--rate", WITH_SHUNT, "-o", survey)
    assert demo.status == 0, demo.err
    # The fit of the last drop may end after the verdict, which does not need it.
    (last,) = (line for line in demo.out.splitlines() if line.startswith("point 1: E_vd "))
    assert "target 45 MPa  PASS: the whole 95 % interval reaches the target" in last
    assert f"next: {next_commands(survey)[0]}" in demo.err
    assert f"next: {next_commands(survey)[1]}" in demo.err
    job = json.loads(pfwd("job", survey, "--json").out)
    assert (job["procedure"], job["target"]) == ("tp-bf-stb-b8.3", 45e6)
    point = records(pfwd("replay", survey, "--json", "--no-invert").out)[-1]
    assert (point["value"]["quantity"], point["value"]["drops"]) == ("E_vd", 3)
    assert 55e6 < point["value"]["value"] < 65e6, "within what the method measures"
    assert point["value"]["interval"][0] > 45e6
    truth = (
        demo.err.split("simulated moduli, which the measurement did not use:")[1]
        .strip()
        .splitlines()
    )
    measured = [float(line.split("E ")[1].split(" MPa")[0]) for line in truth[3:]]
    assert measured == [52.0] * 3, "the ground is above the target as well"
    assert all(abs(float(line.rsplit(",", 1)[1].strip(" %"))) < 3 for line in truth)
    assert checked(survey)["ok"]


def test_a_recorded_drop_is_compared_with_the_simulated_one_at_its_time(
    captured: tuple[Path, list[dict[str, Any]]],
) -> None:
    survey = captured[0]
    found = [drop.read().metadata["detection"] for drop in read_survey(survey).drops]
    begins = [each["first_sample"] + each["trigger"] for each in found]
    truth = [{"drop": n, "touch_sample": at} for n, at in enumerate((10, *begins), start=1)]
    assert measured_moduli(truth, survey, {1: 41e6, 2: 42e6}) == {2: 41e6, 3: 42e6}
    assert measured_moduli(truth, survey, {2: 42e6}) == {3: 42e6}
