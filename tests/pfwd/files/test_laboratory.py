"""Files of laboratory programs: each is read through a column map, damaged ones are refused."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.errors import SurveyError, TraceError
from pfwd.files.foreign.laboratory import (
    FORMAT_BYTES,
    laboratory_format,
    read_laboratory,
)
from pfwd.files.foreign.map_draft import draft_map, map_text
from pfwd.files.reading import read_points
from tests.pfwd.files.laboratory_files import WRITERS, Table
from tests.records import known

RATE = 10_000.0
NAMES = ["load", "geophone"]


@pytest.fixture(scope="module")
def table() -> Table:
    """Load in tens of kilonewtons and velocity in metres per second, with noise."""
    time = np.arange(1200) / RATE - 0.02
    pulse = np.where((time > 0) & (time < 0.016), np.sin(np.pi * time / 0.016), 0.0)
    motion = np.where(time > 0, np.exp(-time / 0.01) * np.sin(np.pi * time / 0.012), 0.0)
    noise = 1e-4 * np.random.default_rng(1).standard_normal((2, 1200))
    return np.stack([0.8 * pulse, 0.3 * motion]).T + noise.T


def column_map(folder: Path, names: list[str], time: str) -> Path:
    path = folder / "map.toml"
    path.write_text(
        f'plate_radius_m = 0.15\ngeophone_natural_frequency_hz = 0.0\n[time]\ncolumn = "{time}"\n'
        f'unit = "s"\ntrigger_s = 0.02\n[load]\ncolumn = "{names[0]}"\nfactor = 10000.0\n'
        f'[[sensor]]\ncolumn = "{names[1]}"\nquantity = "velocity"\nunit = "m/s"\noffset_m = 0.0\n'
    )
    return path


def names_in(path: Path) -> list[str]:
    """Names of the channels, the load first: some formats sort or shorten them."""
    form = known(laboratory_format(path.read_bytes()[:FORMAT_BYTES]))
    columns = read_laboratory(str(path), form)
    channels = [each for each in columns if each.name != "time"]
    return [each.name for each in sorted(channels, key=lambda each: -float(each.values.max()))]


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_drop_is_that_of_the_file(suffix: str, table: Table, tmp_path: Path) -> None:
    path = tmp_path / f"drop.{suffix}"
    WRITERS[suffix](path, RATE, NAMES, table)
    (point,) = read_points(path, column_map=column_map(tmp_path, names_in(path), "time"))
    (drop,) = point.drops
    np.testing.assert_allclose(drop.load, 1e4 * table[:, 0], atol=2e-3)
    np.testing.assert_allclose(drop.channels[0].values, table[:, 1], atol=2e-7)
    np.testing.assert_allclose(drop.time, np.arange(1200) / RATE - 0.02, atol=1e-9)


@pytest.mark.parametrize("suffix", WRITERS)
def test_damaged_bytes_give_an_error_or_a_drop(suffix: str, table: Table, tmp_path: Path) -> None:
    path = tmp_path / f"drop.{suffix}"
    WRITERS[suffix](path, RATE, NAMES, table)
    sound, mapped = path.read_bytes(), column_map(tmp_path, names_in(path), "time")
    rng = np.random.default_rng(7)
    for _ in range(30):
        data = bytearray(sound)
        if rng.random() < 0.3:
            data = data[: int(rng.integers(40, len(data)))]
        for at in rng.integers(0, min(len(data), 2000), int(rng.integers(1, 4))):
            data[at] = int(rng.integers(256))
        path.write_bytes(bytes(data))
        message = ""
        try:
            points = read_points(path, column_map=mapped)
            assert all(np.isfinite(drop.load).all() for drop in points[0].drops)
        except SurveyError as err:
            message = str(err)
        assert "\n" not in message


def test_a_number_too_large_for_si_units_is_refused(table: Table, tmp_path: Path) -> None:
    damaged = table.copy()
    damaged[700, 0] = 1e306
    WRITERS["tdms"](tmp_path / "drop.tdms", RATE, NAMES, damaged)
    with pytest.raises(TraceError, match="expected finite numbers in the load"):
        read_points(tmp_path / "drop.tdms", column_map=column_map(tmp_path, NAMES, "time"))


@pytest.mark.parametrize(
    ("suffix", "rows", "old", "new", "message"),
    [
        ("wav", 0, b"", b"", "channels with samples"),
        ("sg2", 1200, b"0.000100", b"0.000200", "traces of one sampling rate"),
    ],
)
def test_channels_without_samples_or_a_common_rate_are_refused(
    suffix: str, rows: int, old: bytes, new: bytes, message: str, table: Table, tmp_path: Path
) -> None:
    path = tmp_path / f"drop.{suffix}"
    WRITERS[suffix](path, RATE, NAMES, table[:rows])
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(TraceError, match=message):
        read_points(path, column_map=column_map(tmp_path, NAMES, "time"))


def test_the_draft_of_a_map_finds_units_and_the_trigger(table: Table, tmp_path: Path) -> None:
    path = tmp_path / "drop.tdms"
    WRITERS["tdms"](path, RATE, NAMES, table)
    text = map_text(draft_map(path))
    assert '[time]\ncolumn = "time"\nunit = "s"' in text
    assert "[text]" not in text
    trigger = next(line for line in text.splitlines() if line.startswith("trigger_s"))
    assert float(trigger.split("=")[1]) == pytest.approx(0.0205, abs=3e-4)


def test_a_missing_map_is_an_error(table: Table, tmp_path: Path) -> None:
    path = tmp_path / "drop.wav"
    WRITERS["wav"](path, RATE, NAMES, table)
    with pytest.raises(TraceError, match="expected a column map, got none"):
        read_points(path)


def test_a_missing_package_is_named(
    table: Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drop.tdms"
    WRITERS["tdms"](path, RATE, NAMES, table)

    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(TraceError, match=r'npTDMS, got none; .* install "pfwd\[laboratory\]"'):
        draft_map(path)
