"""Diagnoses of files: device files, surveys of one device, what machines and people are shown."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfwd
from inversion.diagnosis.findings import DeviceValues
from inversion.inference.instrument import InstrumentKnowledge
from inversion.measured.record import CALIBRATED_ERROR
from pfwd.analysis.diagnosis.device_file import device_of, read_device, write_device_file
from pfwd.analysis.diagnosis.diagnose import Diagnosed, diagnose_files
from pfwd.analysis.diagnosis.entries import DiagnosisRequest
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import OptionError
from pfwd.export.json_text import json_text
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Channel, Drop
from tests.pfwd.analysis.diagnosis.conftest import DELAY
from tests.records import known
from tui.diagnosis_lines import diagnosis_lines

pytestmark = pytest.mark.usefixtures("computed_once")

BUDGET = "[error_budget]\ngain = 0.2\ntilt = 0.01\nclock = 0.02\nlinearity = 0\n"


@pytest.fixture(scope="module")
def diagnosed(files: list[str], computed_once: None) -> list[DiagnosisResult]:
    return results(files, leave_out="point")


def results(files: list[str], **options: Any) -> list[DiagnosisResult]:
    request = DiagnosisRequest(**options)
    return [known(each.result) for each in diagnose_files(files, request=request)]


def lag_of(result: DiagnosisResult) -> float:
    (effect,) = [effect for effect in result.effects or () if effect.name == "sensor_lag"]
    return known(effect.value)


def moduli(result: DiagnosisResult) -> list[float]:
    """Moduli without effects and with them."""
    return [known(known(state).modulus_pa) for state in (result.before, result.after)]


def test_a_device_effect_is_fitted_once_for_all_points(diagnosed: list[DiagnosisResult]) -> None:
    for result, modulus in zip(diagnosed, (40e6, 70e6), strict=True):
        assert result.verdict == "explained"
        # The delay is an unknown of the fit without effects, too.
        assert moduli(result) == pytest.approx([modulus] * 2, rel=0.012)
        low, high = known(known(result.after).modulus_interval_pa)
        before, after = moduli(result)
        assert low <= after <= high
        assert result.corrected is (high - low < abs(after - before))
    (lag,) = set(map(lag_of, diagnosed))
    assert lag == pytest.approx(DELAY, abs=2e-5)


def test_a_point_is_predicted_by_its_peers(diagnosed: list[DiagnosisResult]) -> None:
    record = diagnosed[0].to_json()
    only_after = {"stress_pa", "modulus_100kpa_pa", "discrepancy_over_peak"}
    only_after |= {"discrepancy_interval_over_peak"}
    assert set(record["after"]) - set(record["before"]) == only_after
    (part,) = record["held_out"]["by"]
    assert set(part) - {"name"} == set(record["held_out"]) - {"mode", "by"}
    # The two files are one device's: its effects are transferred, the ground is fitted.
    assert "modulus (ground)" in record["held_out"]["fitted"]
    assert record["held_out"]["scaled_record"] is None
    assert record["held_out"]["after"] < 0.001
    text = "\n".join(diagnosis_lines(diagnosed[0]))
    assert "EXPLAINED" in text
    assert "sensor_lag" in text


def test_device_effects_are_written_and_applied(
    diagnosed: list[DiagnosisResult], files: list[str], tmp_path: Path
) -> None:
    device = [Diagnosed(file, result) for file, result in zip(files, diagnosed, strict=True)]
    assert device_of(device) == "late unit"
    path = tmp_path / "D.toml"
    write_device_file(path, device, "late unit")
    values = read_device(path)[0]
    assert values["sensor_lag"]["delay"] == pytest.approx(DELAY, abs=2e-5)
    (with_device,) = results(files[:1], device=values)
    assert [effect.name for effect in with_device.effects or ()] == ["sensor_lag"]
    assert moduli(with_device) == pytest.approx([moduli(diagnosed[0])[0], 40e6], rel=0.012)


def test_files_of_two_devices_give_no_calibration() -> None:
    two = [Diagnosed(name, DiagnosisResult(device=f"device {name}")) for name in ("a", "b")]
    with pytest.raises(OptionError, match=r"--write-device: expected files of one device"):
        device_of(two)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[no_such_effect]\nx = 1", "expected a known key, got 'no_such_effect'; known are device"),
        ("[bedrock]\ndepth_m = 1", "expected a known key, got 'bedrock'"),
        ("[sensor_lag]\ndelay = 1", r"sensor_lag: expected a known key, got 'delay'.*delay_s"),
        ("[sensor_lag]\ndrops = 1", r"sensor_lag.delay_s: expected a number from .*, got none"),
        ("[sensor_lag]\ndelay_s = 1.0", r"sensor_lag.delay_s: expected .* -0.008 to 0.008, in s"),
        ("[sensor_lag", "expected TOML"),
        ("[error_budget]", r"error_budget.gain: expected a number .*, got none"),
        ("[error_budget]\ngain = 0.02", r"error_budget.tilt: expected .*, got none"),
        (f"{BUDGET}drift = 0.01", r"error_budget: expected a known key, got 'drift'"),
        (BUDGET.replace("0.2", "2"), r"error_budget.gain: .* >= 0 and < 1, got 2"),
    ],
)
def test_a_wrong_device_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "D.toml"
    with pytest.raises(OptionError, match=r"--device .*a readable TOML file"):
        read_device(path)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OptionError, match=message):
        read_device(path)


def test_a_file_without_a_drop_says_so(tmp_path: Path) -> None:
    quiet = np.zeros(400)
    time = 1e-4 * np.arange(-100, 300)
    drop = Drop(1, time, quiet, (Channel(0.0, "velocity", quiet),))
    path = tmp_path / "quiet.csv"
    write_traces(path, TracePoint(str(path), PointSetup(plate_radius=0.15), (drop,)))
    (quiet, missing) = diagnose_files([str(path), str(tmp_path / "none.csv")])
    assert quiet.result.drops == ()
    assert (quiet.result.effects or ())[0].name == "false_trigger"
    assert missing.error is not None


def test_a_declared_device_effect_moves_within_its_deviation(files: list[str]) -> None:
    wrong = {"sensor_lag": {"delay": 4.5e-4}}
    (fixed,) = results(files[:1], device=wrong)
    (moved,) = results(files[:1], device=wrong, spread={"sensor_lag": {"delay": 1e-4}})
    assert lag_of(fixed) == 4.5e-4
    assert lag_of(moved) == pytest.approx(DELAY, abs=3e-5)
    for result in (fixed, moved):
        assert moduli(result)[1] == pytest.approx(40e6, rel=0.012)


def test_the_deviations_of_a_device_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    path.write_text("[sensor_lag]\ndelay_s = 6e-4\ndelay_sd_s = 2e-5\n", encoding="utf-8")
    values, deviations = read_device(path)
    assert values == read_device(path)[0] == {"sensor_lag": {"delay": 6e-4}}
    assert deviations == {"sensor_lag": {"delay": 2e-5}}
    path.write_text("[sensor_lag]\ndelay_s = 6e-4\ndelay_sd_s = -1.0\n", encoding="utf-8")
    with pytest.raises(OptionError, match=r"sensor_lag.delay_sd_s: expected a number >= 0, in s"):
        read_device(path)


def test_the_interval_has_the_error_budget_of_the_device(files: list[str], tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    path.write_text(BUDGET, encoding="utf-8")
    (result,) = results(files[:1], device=read_device(path)[0])
    before, after = (
        math.log(high / low) / 2
        for state in (result.before, result.after)
        for low, high in [known(known(state).modulus_interval_pa)]
    )
    budget = math.hypot(0.2, 0.01, 0.02)
    assert budget < after < 1.1 * budget
    assert before < 0.1


def test_a_gain_in_a_device_file_is_a_calibration() -> None:
    def error(values: DeviceValues) -> float | None:
        return InstrumentKnowledge.from_values(values, None).modulus_error

    gain, lag = {"sensor_gain": {"factor": 1.1}}, {"sensor_lag": {"delay": 1e-4}}
    assert (error(gain | lag), error(lag)) == (CALIBRATED_ERROR, None)
    budget = {"error_budget": {"gain": 0.03, "tilt": 0.04, "clock": 0.0, "linearity": 0.0}}
    assert error(gain | budget) == pytest.approx(0.05)


def test_a_list_of_points_is_a_survey(diagnosed: list[DiagnosisResult], files: list[str]) -> None:
    diagnoses = pfwd.diagnose([pfwd.read(file)[0] for file in files])
    for diagnosis, result in zip(diagnoses, diagnosed, strict=True):
        assert diagnosis["held_out"] is None  # each has a single drop
        assert diagnosis["effects"] == json.loads(json_text(result.to_json()))["effects"]
