"""Content of the trace files of simulated drops."""

import csv
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simulators import demo
from simulators.demo import DEMO_PLATE, demo_drops, demo_ground
from simulators.drop import SimulatedDrop, simulate_drop
from simulators.mesh import GroundError
from simulators.traces import Geophone, Recording, geophone_output, record_drop, write_traces
from tests.simulators.coarse import COARSE

TIME_STEP = 1e-4


@pytest.fixture
def drop() -> SimulatedDrop:
    """Drop with a half-sine load and a velocity in proportion to it."""
    time = np.arange(401) * TIME_STEP
    pulse = np.where(time < 0.013, np.sin(np.pi * time / 0.013), 0.0)
    ground = np.array([1.0, 0.3])[:, None] * pulse
    return SimulatedDrop(
        time, 8e3 * pulse, 8e3 * pulse, ground[0], ground[0], np.array([0.0, 0.3]), ground, ground
    )


def read(path: Path) -> tuple[dict[str, object], list[str], NDArray[np.float64]]:
    """Return header, column names and numbers, read as TOML and CSV."""
    lines = path.read_text(encoding="utf-8").splitlines()
    header = [line.removeprefix("# ") for line in lines if line.startswith("# ")]
    rows = list(csv.reader(lines[len(header) :]))
    return tomllib.loads("\n".join(header)), rows[0], np.array(rows[1:], dtype=float)


def test_a_file_declares_plate_and_sensors_only(drop: SimulatedDrop, tmp_path: Path) -> None:
    declared = {"bedrock_depth_m": float("inf"), "site": 'Hill "A"', "seating_drops": 1}
    path = write_traces(tmp_path / "t.csv", [drop, drop], DEMO_PLATE, 0.35, declared=declared)
    header, columns, table = read(path)
    assert path.read_text(encoding="utf-8").startswith("# pfwd-traces = 1\n")
    assert header == {
        "pfwd-traces": 1,
        "plate_radius_m": DEMO_PLATE.radius,
        "plate_mass_kg": DEMO_PLATE.mass,
        "poisson_ratio": 0.35,
        "geophone_natural_frequency_hz": 0.0,  # the simulated sensor has no response of its own
        **declared,
    }
    sensors = ["velocity_m_s@0.0000", "velocity_m_s@0.3000"]
    assert columns == ["drop", "time_s", "load_N", *sensors]
    first, second = table[table[:, 0] == 1], table[table[:, 0] == 2]
    np.testing.assert_array_equal(first[:, 1:], second[:, 1:])  # no noise: equal
    np.testing.assert_allclose(np.diff(first[:, 1]), TIME_STEP, rtol=1e-6)
    assert first[0, 1] == pytest.approx(-0.015)
    assert not np.any(first[first[:, 1] <= 0, 2:])
    np.testing.assert_allclose(first[first[:, 1] > -1e-9, 3:].T, drop.ground_velocity, rtol=1e-8)


def test_displacement_is_written_on_request(drop: SimulatedDrop, tmp_path: Path) -> None:
    recording = Recording(quantity="displacement", pre_trigger=0.0)
    _, columns, table = read(write_traces(tmp_path / "t.csv", [drop], DEMO_PLATE, 0.35, recording))
    assert columns[3] == "displacement_m@0.0000"
    np.testing.assert_allclose(table[:, 3:].T, drop.ground_displacement, rtol=1e-8)


def test_noise_has_the_stated_size_on_each_channel(drop: SimulatedDrop) -> None:
    recording = Recording(pre_trigger=0.5, load_noise=20.0, sensor_noise=(1e-3, 4e-3))
    record = record_drop(drop, recording, np.random.default_rng(3))
    before = record.time < 0
    assert np.count_nonzero(before) == 5000
    assert np.std(record.load[before]) == pytest.approx(20, rel=0.04)
    np.testing.assert_allclose(np.std(record.sensors[:, before], axis=1), [1e-3, 4e-3], rtol=0.04)
    neighbours = np.corrcoef(record.load[before][1:], record.load[before][:-1])[0, 1]
    assert abs(neighbours) < 0.05


def test_quantised_values_are_integer_counts(drop: SimulatedDrop) -> None:
    recording = Recording(load_resolution=5.0, sensor_resolution=1e-3, load_noise=3.0)
    record = record_drop(drop, recording, np.random.default_rng(0))
    counts = record.load / 5
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.max(np.abs(record.sensors[:, 150:] - drop.ground_velocity)) <= 0.5e-3 + 1e-12


@pytest.mark.parametrize("frequency", [1.0, 4.5, 40.0])
def test_a_geophone_has_its_textbook_response(frequency: float) -> None:
    # |s^2 / (s^2 + 2 z w0 s + w0^2)| and its phase, at s = i w, once the start has died away.
    geophone = Geophone(natural_frequency=4.5, damping=0.6)
    time = np.arange(0, 4, TIME_STEP * 5)
    s, natural = 2j * np.pi * frequency, 2 * np.pi * 4.5
    response = s**2 / (s**2 + 2 * 0.6 * natural * s + natural**2)
    output = geophone_output(np.sin(2 * np.pi * frequency * time), TIME_STEP * 5, geophone)
    expected = np.imag(response * np.exp(s * time))
    late = time > 2
    np.testing.assert_allclose(output[late], expected[late], atol=2e-3)


def test_a_geophone_is_declared_and_needs_velocity(drop: SimulatedDrop, tmp_path: Path) -> None:
    recording = Recording(geophone=Geophone(4.5, 0.6))
    header, _, table = read(write_traces(tmp_path / "t.csv", [drop], DEMO_PLATE, 0.35, recording))
    assert header["geophone_natural_frequency_hz"] == 4.5
    assert header["geophone_damping"] == 0.6
    assert np.min(table[:, 3]) < -0.05  # the undershoot
    wrong = Recording(quantity="displacement", geophone=Geophone(4.5, 0.6))
    with pytest.raises(GroundError, match="geophone: expected velocity channels"):
        record_drop(drop, wrong, np.random.default_rng(0))
    with pytest.raises(GroundError, match="drops: expected at least one"):
        write_traces(tmp_path / "t.csv", [], DEMO_PLATE, 0.35)


@pytest.fixture
def demonstration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(demo, "simulate_drop", partial(simulate_drop, resolution=COARSE))
    return demo_drops(3, 7, tmp_path / "new")


def test_the_demonstration_is_a_single_point_without_the_truth(demonstration: Path) -> None:
    header, columns, table = read(demonstration)
    assert set(table[:, 0]) == {1, 2, 3}
    assert columns[3:] == [f"velocity_m_s@{r:.4f}" for r in (0.0, 0.3, 0.6)]
    assert "bedrock_depth_m" not in header
    assert "density_kg_m3" not in header
    ground = demo_ground(7)
    text = demonstration.read_text(encoding="utf-8").split("drop,time_s")[0]
    assert f"{ground.bedrock_depth:.2f}" not in text
    assert f"{ground.layers[0].modulus / 1e6:.0f}" not in text
    loads = [np.max(table[table[:, 0] == k, 2]) for k in (1, 2, 3)]
    assert 8e3 < min(loads) < max(loads) < 12e3
    assert max(loads) > 1.002 * min(loads)


def test_the_demonstration_is_reproducible(demonstration: Path, tmp_path: Path) -> None:
    assert demo_drops(3, 7, tmp_path).read_bytes() == demonstration.read_bytes()


def test_the_ground_depends_on_the_seed() -> None:
    moduli = [demo_ground(seed).layers[0].modulus for seed in range(40)]
    assert np.mean(moduli) == pytest.approx(45e6, rel=0.1)
    assert 0.05 < np.std(moduli) / np.mean(moduli) < 0.25
