"""Diagnoses of files: device files, surveys of one device, what machines and people are shown."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import pfwd
from inversion.diagnosis.findings import DeviceValues
from inversion.inference.instrument import InstrumentKnowledge
from inversion.measured.record import CALIBRATED_ERROR
from pfwd.analysis.diagnosis.device_file import (
    device_of,
    read_device,
    write_device_file,
)
from pfwd.analysis.diagnosis.diagnose import Diagnosed, diagnose_files
from pfwd.analysis.diagnosis.entries import DiagnosisRequest
from pfwd.analysis.results import DiagnosisResult
from pfwd.errors import OptionError
from pfwd.export.json_text import json_text
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Channel, Drop
from tests.records import known
from tui.diagnosis_lines import diagnosis_lines

pytestmark = pytest.mark.usefixtures("computed_once")

BUDGET = "[error_budget]\ngain = 0.2\ntilt = 0.01\nclock = 0.02\nlinearity = 0\n"


@pytest.fixture(scope="module")
def found(files: list[str], computed_once: None) -> list[Diagnosed]:
    return list(diagnose_files(files, request=DiagnosisRequest(leave_out="point")))


def test_what_belongs_to_the_device_is_fitted_once(found: list[Diagnosed]) -> None:
    values = set()
    for one, modulus in zip(found, (40e6, 70e6), strict=True):
        assert one.result is not None
        assert one.result.verdict == "explained"
        low, high = one.result.after.modulus_interval_pa
        moved = abs(one.result.after.modulus_pa - one.result.before.modulus_pa)
        assert one.result.corrected is (high - low < moved)
        lag = next(e for e in one.result.effects or () if e.name == "sensor_lag")
        values.add(lag.value)
        assert lag.value == pytest.approx(6e-4, abs=2e-5)
        assert one.result.after.modulus_pa == pytest.approx(modulus, rel=0.012)
        # The delay is an unknown of the fit without effects, too.
        assert one.result.before.modulus_pa == pytest.approx(modulus, rel=0.012)
    assert len(values) == 1


def test_a_point_is_predicted_by_the_others_of_its_device(found: list[Diagnosed]) -> None:
    assert found[0].result is not None
    record = found[0].result.to_json()
    after_alone = {"stress_pa", "modulus_100kpa_pa", "discrepancy_over_peak"}
    after_alone |= {"discrepancy_interval_over_peak"}
    assert set(record["after"]) - set(record["before"]) == after_alone
    (part,) = record["held_out"]["by"]
    assert set(part) - {"name"} == set(record["held_out"]) - {"mode", "by"}
    low, high = record["after"]["modulus_interval_pa"]
    assert low <= record["after"]["modulus_pa"] <= high
    # The two files are one device's: its effects are transferred, the ground is fitted.
    assert "modulus (ground)" in record["held_out"]["fitted"]
    assert record["held_out"]["scaled_record"] is None
    assert record["held_out"]["after"] < 0.001
    text = "\n".join(diagnosis_lines(found[0].result))
    assert "EXPLAINED" in text
    assert "sensor_lag" in text


def test_device_effects_are_kept_and_applied(
    found: list[Diagnosed], files: list[str], tmp_path: Path
) -> None:
    assert device_of(found) == "late unit"
    path = tmp_path / "D.toml"
    write_device_file(path, found, "late unit")
    values = read_device(path)[0]
    assert values["sensor_lag"]["delay"] == pytest.approx(6e-4, abs=2e-5)
    (again,) = diagnose_files(files[:1], request=DiagnosisRequest(device=values))
    assert again.result is not None
    assert again.result.after.modulus_pa == pytest.approx(40e6, rel=0.012)
    assert [effect.name for effect in again.result.effects or ()] == ["sensor_lag"]
    assert found[0].result is not None
    before = found[0].result.before.modulus_pa
    assert again.result.before.modulus_pa == pytest.approx(before)


def test_files_of_two_devices_cannot_be_one_calibration() -> None:
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
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OptionError, match=message):
        read_device(path)[0]


def test_a_device_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"--device .*a readable TOML file"):
        read_device(tmp_path / "none.toml")[0]


def test_a_file_without_a_drop_says_so(tmp_path: Path) -> None:
    quiet = np.zeros(400)
    time = 1e-4 * np.arange(-100, 300)
    drop = Drop(1, time, quiet, (Channel(0.0, "velocity", quiet),))
    path = tmp_path / "quiet.csv"
    write_traces(path, TracePoint(str(path), PointSetup(plate_radius=0.15), (drop,)))
    (one, other) = diagnose_files([str(path), str(tmp_path / "none.csv")])
    assert one.result is not None
    assert one.result.drops == ()
    assert (one.result.effects or ())[0].name == "false_trigger"
    assert other.error is not None


def test_what_is_given_of_the_device_may_move_by_its_deviation(files: list[str]) -> None:
    wrong = {"sensor_lag": {"delay": 4.5e-4}}
    (held,) = diagnose_files(files[:1], request=DiagnosisRequest(device=wrong))
    movable = DiagnosisRequest(device=wrong, spread={"sensor_lag": {"delay": 1e-4}})
    (moved,) = diagnose_files(files[:1], request=movable)
    assert held.result is not None
    assert moved.result is not None

    def lag(result: DiagnosisResult) -> float:
        (effect,) = [e for e in result.effects or () if e.name == "sensor_lag"]
        assert effect.value is not None
        return effect.value

    assert lag(held.result) == 4.5e-4
    assert lag(moved.result) == pytest.approx(6e-4, abs=3e-5)
    for result in (held.result, moved.result):
        assert result.after is not None
        assert result.after.modulus_pa == pytest.approx(40e6, rel=0.012)


def test_the_deviations_of_a_device_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    path.write_text("[sensor_lag]\ndelay_s = 6e-4\ndelay_sd_s = 2e-5\n", encoding="utf-8")
    values, deviations = read_device(path)
    assert values == read_device(path)[0] == {"sensor_lag": {"delay": 6e-4}}
    assert deviations == {"sensor_lag": {"delay": 2e-5}}
    path.write_text("[sensor_lag]\ndelay_s = 6e-4\ndelay_sd_s = -1.0\n", encoding="utf-8")
    with pytest.raises(OptionError, match=r"sensor_lag.delay_sd_s: expected a number >= 0, in s"):
        read_device(path)


def test_the_interval_after_has_the_error_budget_of_the_device(
    files: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "d.toml"
    path.write_text(BUDGET, encoding="utf-8")
    (one,) = diagnose_files(files[:1], request=DiagnosisRequest(device=read_device(path)[0]))
    states = known(one.result).after, known(one.result).before
    after, before = (
        math.log(high / low) / 2
        for low, high in (known(known(state).modulus_interval_pa) for state in states)
    )
    budget = math.hypot(0.2, 0.01, 0.02)
    assert budget < after < 1.1 * budget
    assert before < 0.1


def test_a_gain_in_a_device_file_is_a_calibration() -> None:
    def error(values: DeviceValues) -> float | None:
        return InstrumentKnowledge.from_values(values, None).modulus_error

    gain, lag = {"sensor_gain": {"factor": 1.1}}, {"sensor_lag": {"delay": 1e-4}}
    assert error(gain | lag) == CALIBRATED_ERROR
    assert error(lag) is None
    budget = {"error_budget": {"gain": 0.03, "tilt": 0.04, "clock": 0.0, "linearity": 0.0}}
    assert error(gain | budget) == pytest.approx(0.05)
    assert InstrumentKnowledge.from_values(lag | budget, None).declared_effects == lag


def test_a_list_of_points_of_one_device_is_one_survey(
    found: list[Diagnosed], files: list[str]
) -> None:
    diagnoses = pfwd.diagnose([pfwd.read(file)[0] for file in files])
    for diagnosis, one in zip(diagnoses, found, strict=True):
        assert one.result is not None
        expected = one.result.to_json()
        # Each has a single drop.
        assert diagnosis["held_out"] is None
        assert diagnosis["effects"] == json.loads(json_text(expected))["effects"]
