"""Calibrations from files of rigs, and the device files that they write."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pfwd.analysis.calibrating import calibrate_files, write_calibration
from pfwd.analysis.diagnosis.device_file import read_device
from pfwd.analysis.diagnosis.diagnose import diagnose_files
from pfwd.errors import SurveyError
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Channel, Drop
from tests.inversion.test_calibration import simulated
from tests.records import known
from tui.cli import main
from tui.diagnosis_lines import diagnosis_lines

STIFFNESS = 20e6


def rig_file(
    path: Path, *, declared: float | None = STIFFNESS, actual: float = STIFFNESS, site: str = "a"
) -> str:
    """Four drops as traces, with offsets as records have them."""
    drops = []
    for seed in range(4):
        record = simulated(seed, stiffness=actual)
        channel = Channel(0.0, "velocity", record.velocity + 0.01)
        drops.append(Drop(seed + 1, record.time, record.load + 700.0, (channel,)))
    setup = PointSetup(
        plate_radius=0.0,
        test="stiffness",
        rig_stiffness=declared,
        device="T-1",
        site=site,
        point=f"{site} 1",
    )
    write_traces(path, TracePoint(str(path), setup, tuple(drops)))
    return str(path)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> str:
    return rig_file(tmp_path_factory.mktemp("rig") / "rig.csv")


def test_a_declared_stiffness_calibrates(rig: str, tmp_path: Path) -> None:
    calibration = calibrate_files([rig])
    assert calibration.reasons == ()
    assert (calibration.device, calibration.stiffness) == ("T-1", (STIFFNESS,))
    values = calibration.to_json()
    assert values["repeats"] is True
    assert values["gain"]["value"] == pytest.approx(1.03, rel=3e-3)
    assert values["natural_frequency_hz"]["value"] == pytest.approx(4.5, abs=0.1)
    assert values["damping"]["value"] == pytest.approx(0.6, abs=0.02)
    assert values["delay_s"]["value"] == pytest.approx(1.2e-4, abs=2e-5)
    low, high = values["gain"]["interval"]
    assert low < values["gain"]["value"] < high
    write_calibration(tmp_path / "d.toml", calibration)
    device = read_device(tmp_path / "d.toml")[0]
    assert device["sensor_gain"]["factor"] == pytest.approx(1.03, rel=3e-3)
    assert device["geophone_response"]["natural_frequency"] == pytest.approx(4.5, abs=0.1)
    assert device["sensor_lag"]["delay"] == pytest.approx(1.2e-4, abs=2e-5)


def test_the_gain_may_be_the_load_cells(rig: str, tmp_path: Path) -> None:
    sensor = calibrate_files([rig])
    load = replace(sensor, gain_of="load")
    assert load.gain[0] == pytest.approx(1 / sensor.gain[0])
    assert load.gain[2][0] < load.gain[0] < load.gain[2][1]
    write_calibration(tmp_path / "d.toml", load)
    device = read_device(tmp_path / "d.toml")[0]
    assert set(device) == {"load_gain", "geophone_response", "sensor_lag"}


def test_a_stiffness_of_the_command_replaces_the_declared_stiffness(rig: str) -> None:
    assert calibrate_files([rig], 22e6).gain[0] == pytest.approx(1.1 * 1.03, rel=0.02)


def test_two_rigs_under_the_same_stiffness_are_refused(tmp_path: Path) -> None:
    soft = rig_file(tmp_path / "a.csv", site="2s1p")
    stiff = rig_file(tmp_path / "b.csv", site="4s1p", actual=1.3 * STIFFNESS)
    calibration = calibrate_files([soft, stiff])
    assert any("MN/m on 2s1p, " in text and "--point" in text for text in calibration.reasons)
    with pytest.raises(SurveyError, match="got drops that do not repeat"):
        write_calibration(tmp_path / "d.toml", calibration)
    assert not (tmp_path / "d.toml").exists()
    assert calibrate_files([soft, stiff], point="2s1p").reasons == ()


def test_a_calibration_without_a_stiffness_or_a_point_is_refused(rig: str, tmp_path: Path) -> None:
    undeclared = rig_file(tmp_path / "a.csv", declared=None)
    with pytest.raises(SurveyError, match="--stiffness N/m"):
        calibrate_files([undeclared])
    with pytest.raises(SurveyError, match="none whose name begins with c"):
        calibrate_files([rig], point="c")


def test_the_command_calibrates(
    rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", rig, "--json", "-o", str(tmp_path / "d.toml")]) == 0
    assert json.loads(capsys.readouterr().out)["repeats"] is True
    assert (tmp_path / "d.toml").exists()


def test_a_diagnosis_identifies_a_rig(rig: str) -> None:
    """The gain of the sensor stands in the stiffness: nothing declares which is right."""
    (diagnosed,) = diagnose_files([rig])
    result = known(diagnosed.result)
    assert (result.verdict, result.corrected, result.drops) == ("explained", False, (1, 2, 3, 4))
    (effect,) = result.effects or ()
    assert effect.name == "spring_rig"
    assert effect.value == pytest.approx(STIFFNESS / 1.03, rel=5e-3)
    masses = [each.value for each in effect.parameters or () if each.name == "moving_mass"]
    assert masses == pytest.approx([12.0 / 1.03], rel=0.05)
    assert known(result.after).modulus_pa is None
    assert result.supported_modulus is None
    assert any("no modulus to report" in line for line in diagnosis_lines(result))


def test_a_rig_without_traces_is_no_drop_to_diagnose(tmp_path: Path) -> None:
    still = np.zeros(64)
    time = (np.arange(64) - 16) / 15_000.0
    drop = Drop(1, time, still, (Channel(0.0, "velocity", still),))
    path = tmp_path / "a.csv"
    setup = PointSetup(plate_radius=0.0, test="stiffness")
    write_traces(path, TracePoint(str(path), setup, (drop,)))
    (calibration,) = diagnose_files([str(path)])
    result = known(calibration.result)
    assert (result.verdict, result.effects, len(result.rejected or ())) == ("unexplained", (), 1)
