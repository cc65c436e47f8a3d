"""From files of rigs to a calibration, and on as a device."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pfwd.analysis.calibrating import calibrate_files, write_calibration
from pfwd.analysis.diagnosis.device_file import read_device
from pfwd.analysis.diagnosis.diagnose import diagnose_files
from pfwd.errors import OptionError, SurveyError
from pfwd.files.header import PointSetup
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Channel, Drop
from tests.inversion.test_calibration import simulated
from tui.cli import main

STIFFNESS = 20e6


def rig_file(
    path: Path, *, declared: float | None = STIFFNESS, actual: float = STIFFNESS, site: str = "a"
) -> str:
    """Four drops as traces, with offsets as records have them."""
    drops = []
    for seed in range(4):
        one = simulated(seed, stiffness=actual)
        channel = Channel(0.0, "velocity", one.velocity + 0.01)
        drops.append(Drop(seed + 1, one.time, one.load + 700.0, (channel,)))
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
    found = calibrate_files([rig])
    assert found.reasons == ()
    assert (found.device, found.stiffness) == ("T-1", (STIFFNESS,))
    said = found.to_json()
    assert said["repeats"] is True
    assert said["gain"]["value"] == pytest.approx(1.03, rel=3e-3)
    assert said["natural_frequency_hz"]["value"] == pytest.approx(4.5, abs=0.1)
    assert said["damping"]["value"] == pytest.approx(0.6, abs=0.02)
    assert said["delay_s"]["value"] == pytest.approx(1.2e-4, abs=2e-5)
    low, high = said["gain"]["interval"]
    assert low < said["gain"]["value"] < high
    write_calibration(tmp_path / "d.toml", found)
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


def test_what_is_given_wins_over_what_is_declared(rig: str) -> None:
    assert calibrate_files([rig], 22e6).gain[0] == pytest.approx(1.1 * 1.03, rel=0.02)


def test_several_rigs_under_one_stiffness_are_told_apart(tmp_path: Path) -> None:
    soft = rig_file(tmp_path / "a.csv", site="2s1p")
    stiff = rig_file(tmp_path / "b.csv", site="4s1p", actual=1.3 * STIFFNESS)
    found = calibrate_files([soft, stiff])
    assert any("MN/m on 2s1p, " in text and "--point" in text for text in found.reasons)
    with pytest.raises(
        SurveyError, match="drops that agree on a calibration, got drops that do not repeat"
    ):
        write_calibration(tmp_path / "d.toml", found)
    assert not (tmp_path / "d.toml").exists()
    assert calibrate_files([soft, stiff], point="2s1p").reasons == ()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"declared": None}, "the stiffness of the rig, got none; give --stiffness N/m"),
        ({"point": "c"}, "none whose name begins with c"),
    ],
)
def test_what_is_missing_is_said(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    path = rig_file(tmp_path / "a.csv", declared=changes.get("declared", STIFFNESS))  # type: ignore[arg-type]
    with pytest.raises(SurveyError, match=message):
        calibrate_files([path], point=changes.get("point"))  # type: ignore[arg-type]


def test_the_command_line(rig: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", rig, "--json", "-o", str(tmp_path / "d.toml")]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["repeats"] is True
    assert "calibration written" in printed.err
    assert main(["calibrate", rig]) == 0
    assert "natural frequency 4.49" in capsys.readouterr().out
    other = rig_file(tmp_path / "b.csv", site="b", actual=1.3 * STIFFNESS)
    assert main(["calibrate", rig, other, "-o", str(tmp_path / "no.toml")]) == 1
    assert "the drops do not repeat" in capsys.readouterr().err
    assert not (tmp_path / "no.toml").exists()


def test_gains_are_never_guessed_and_can_be_given(tmp_path: Path) -> None:
    from inversion.effects import BY_NAME

    for name in ("load_gain", "sensor_gain"):
        assert not BY_NAME[name].offered(())
        assert BY_NAME[name].scope == "device"
    (tmp_path / "d.toml").write_text("[sensor_gain]\nfactor = 20.0\n")
    with pytest.raises(OptionError, match=r"factor: expected a number from 0\.1 to 10"):
        read_device(tmp_path / "d.toml")[0]


def test_records_of_gains() -> None:
    from inversion.effects import BY_NAME

    record = np.ones((1, 3))
    context = None
    read = {
        n: BY_NAME[n].record(record, {"factor": 1.25}, context)
        for n in ("load_gain", "sensor_gain")
    }  # type: ignore[arg-type]
    np.testing.assert_allclose(read["sensor_gain"], 1.25)
    np.testing.assert_allclose(read["load_gain"], 0.8)


def test_diagnose_calls_a_rig_a_rig(rig: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The gain of the sensor stands in the stiffness: nobody declared which is right."""
    assert main(["diagnose", rig, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["verdict"], said["corrected"]) == ("explained", False)
    (effect,) = said["effects"]
    assert effect["name"] == "spring_rig"
    assert effect["value"] == pytest.approx(STIFFNESS / 1.03, rel=5e-3)
    mass = {one["name"]: one["value"] for one in effect["parameters"]}["moving_mass"]
    assert mass == pytest.approx(12.0 / 1.03, rel=0.05)
    assert said["after"]["modulus_pa"] is None
    assert said["drops"] == [1, 2, 3, 4]
    assert main(["diagnose", rig]) == 0
    text = capsys.readouterr().out
    assert "this is a rig on springs, no ground: there is no modulus to report" in text


def test_a_rig_without_traces_is_no_drop_to_diagnose(tmp_path: Path) -> None:
    still = np.zeros(64)
    time = (np.arange(64) - 16) / 15_000.0
    drop = Drop(1, time, still, (Channel(0.0, "velocity", still),))
    path = tmp_path / "a.csv"
    setup = PointSetup(plate_radius=0.0, test="stiffness")
    write_traces(path, TracePoint(str(path), setup, (drop,)))
    (found,) = diagnose_files([str(path)])
    assert found.result is not None
    assert (found.result.verdict, found.result.effects) == ("unexplained", ())
    assert found.result.rejected == ("drop 1: no trace of a sensor in the centre",)
