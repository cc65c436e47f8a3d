"""The benchmarks of devices and archives report what they promise."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import archive_drops, devices
from benchmarks.__main__ import CAMPAIGNS, PARTS, QUICK, main
from benchmarks.devices import DEVICES, SITES, Case, Reading
from benchmarks.output import Reporter
from pfwd.files.traces import read_traces
from simulators.drop import SimulatedDrop

TOP = Path(__file__).resolve().parents[1]


def reading(
    device: devices.Device, site: devices.Site, inverted: float = 1.0, peak: float = 1.1
) -> Reading:
    truth = site.modulus
    return Reading(
        Case(device, site), peak * truth, inverted * truth, 0.9 * truth, 1.1 * truth, True
    )


def summary(
    readings: list[Reading], capsys: pytest.CaptureFixture[str]
) -> tuple[int, list[dict[str, Any]]]:
    status = devices.summarise(Reporter(["--json"]), readings)
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_the_help_lists_the_parts_that_exist() -> None:
    modules = (TOP / "benchmarks").glob("*.py")
    parts = {path.stem for path in modules if "\ndef run(" in path.read_text(encoding="utf-8")}
    assert set(PARTS) == parts | set(CAMPAIGNS)
    assert set(QUICK) <= parts


def test_the_devices_cover_what_is_asked_of_them() -> None:
    radii = [device.radius for device in DEVICES]
    assert (min(radii), max(radii)) == (0.05, 0.30)
    assert (min(d.plate_mass for d in DEVICES), max(d.plate_mass for d in DEVICES)) == (2.0, 40.0)
    assert (min(d.pulse for d in DEVICES), max(d.pulse for d in DEVICES)) == (0.008, 0.030)
    assert {d.centre for d in DEVICES} == {"plate", "ground"}
    assert {d.load for d in DEVICES} == {"cell", "assumed"}
    assert len(SITES) == 10
    assert {math.isinf(site.depth) for site in SITES} == {True, False}


def test_a_device_with_a_load_cell_that_is_off_misses_the_target(
    capsys: pytest.CaptureFixture[str],
) -> None:
    one, other, assumed = DEVICES[0], DEVICES[1], DEVICES[-1]
    good = [reading(one, SITES[0]), reading(other, SITES[0], 1.02), reading(assumed, SITES[0], 1.5)]
    status, records = summary(good, capsys)
    assert status == 0
    assert records[-1]["readings"] == 2  # the assumed load does not count
    status, records = summary([*good[:1], reading(other, SITES[0], 1.04)], capsys)
    assert status == 1
    assert records[-1]["worst_deviation"] == pytest.approx(0.04)
    (spread,) = [r for r in records if "ground" in r and "peak_method" in r]
    assert spread["inverted"] == pytest.approx(1.04)


def test_a_drop_that_was_not_inverted_is_no_success(capsys: pytest.CaptureFixture[str]) -> None:
    lost = replace(reading(DEVICES[1], SITES[0]), inverted=math.nan)
    status, records = summary([reading(DEVICES[0], SITES[0]), lost], capsys)
    assert status == 1
    assert records[-1]["within_target"] == 1


def test_an_assumed_load_is_the_half_sine_of_unyielding_ground() -> None:
    device = DEVICES[-1]
    time = np.arange(0.0, 0.06, 1e-4)
    empty = np.zeros((1, time.size))
    drop = SimulatedDrop(time, 3.0 + time, time, time, time, np.zeros(1), empty, empty)
    load = devices.recorded(device, drop).load
    assert np.max(load) == pytest.approx(device.peak, rel=1e-3)
    assert np.flatnonzero(load > 0)[-1] * 1e-4 == pytest.approx(device.pulse, abs=2e-4)
    assert np.array_equal(devices.recorded(DEVICES[0], drop).load, drop.load)


@pytest.mark.slow
def test_the_truth_does_not_reach_the_inversion(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen: list[Any] = []
    real = devices.analyse_point
    monkeypatch.setattr(
        devices, "analyse_point", lambda point, *more: (seen.append(point), real(point, *more))[1]
    )
    found = devices.read(Case(DEVICES[0], SITES[3], cache=tmp_path))
    setup = seen[0].setup
    assert (setup.bedrock_depth, setup.density, setup.extra) == (None, None, {})
    assert found.inverted == pytest.approx(SITES[3].modulus, rel=devices.TARGET)
    assert abs(found.peak / SITES[3].modulus - 1.0) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("declared", [True, False])
def test_the_drops_of_an_archive_declare_the_depth_or_do_not(
    declared: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive_drops, "SITES", archive_drops.SITES[:1])
    truth = archive_drops.write_archive(
        tmp_path / "drops", 22, tmp_path / "cache", depth_declared=declared
    )
    files = sorted((tmp_path / "drops").rglob("*.csv"))
    points = [read_traces(path) for path in files]
    assert [len(point.drops) for point in points] == [5, 5, 5, 5, 2]
    assert len(set(truth)) == len(truth) == 5
    assert {point.setup.bedrock_depth for point in points} == {0.6 if declared else None}
    assert {len(point.drops[0].channels) for point in points} == {1, 3}


@pytest.mark.parametrize("part", ["archive", "devices"])
def test_wrong_usage_is_status_2(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([part, "--jobs", "many"]) == 2
    assert "--jobs" in capsys.readouterr().err
