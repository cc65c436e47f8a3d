"""JILS time histories and peaks: units, signs, stations, and peaks beside histories."""

import re
from pathlib import Path

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from tests.pfwd.files.foreign.builders import DAT_HEAD, SENSOR_OFFSETS, dat, pulse, thy

DROPS = [
    (1, 1, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=40e3, channels=3)),
    (1, 2, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=50e3, channels=3)),
    (2, 1, pulse(samples=470, rate=1e3 / 0.1707, pre=0.0, peak=60e3, channels=3)),
]


@pytest.fixture
def header(tmp_path: Path) -> Path:
    path = tmp_path / "h.toml"
    path.write_text(SENSOR_OFFSETS)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.THY"
    path.write_bytes(thy(DROPS))
    return path


def test_units_and_signs_are_ours(file: Path, header: Path) -> None:
    first, second = read_points(file, header)
    assert (first.setup.point, second.setup.point) == ("station 1 lane 1", "station 2 lane 1")
    assert [drop.number for drop in first.drops] == [1, 2]
    for drop, (_, _, recorded) in zip([*first.drops, *second.drops], DROPS, strict=True):
        assert [channel.offset for channel in drop.channels] == [0.0, 0.3]
        np.testing.assert_allclose(drop.load, recorded.load, atol=0.01)
        for channel, values in zip(drop.channels, recorded.sensors, strict=False):
            assert channel.quantity == "displacement"
            assert channel.values.max() > 0
            np.testing.assert_allclose(channel.values, values, atol=2e-11)
        assert drop.time[0] == 0
        assert np.diff(drop.time) == pytest.approx(0.1707e-3, rel=1e-6)
    assert first.setup.temperature == 20.0
    assert (first.setup.site, first.setup.operator) == ("Test road", "A. B.")
    desired = first.setup.extra["imported"]["desired_peak_force_n"]
    assert desired == pytest.approx([40033.99, 40033.99], abs=0.01)


@pytest.mark.parametrize(
    ("declared", "offsets", "remark"),
    [
        ("sensor_offsets_m = [0.0, 0.3, -0.3]", [0.0, 0.3, -0.3], None),
        ("sensor_offsets_m = [0.0, 0.3, 0.3]", [0.0, 0.3], "a second sensor at 0.3 m is left out"),
        ("", [0.0], "sensors in the file: 9"),
    ],
)
def test_sensors_are_where_they_are_declared(
    tmp_path: Path, file: Path, declared: str, offsets: list[float], remark: str | None
) -> None:
    header = tmp_path / "h.toml"
    header.write_text(f"plate_radius_m = 0.15\n{declared}\n")
    first, _ = read_points(file, header)
    for drop, (_, _, recorded) in zip(first.drops, DROPS, strict=False):
        assert [channel.offset for channel in drop.channels] == offsets
        for channel, values in zip(drop.channels, recorded.sensors, strict=False):
            np.testing.assert_allclose(channel.values, values, atol=2e-11)
    sensors = [text for text in map(text_of, first.warnings) if "sensor" in text]
    assert len(sensors) == (remark is not None)
    assert all(remark is not None and remark in text for text in sensors)


def test_rounded_times_become_even(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.thy"
    path.write_bytes(thy(DROPS, digits=2))
    first, _ = read_points(path, header)
    steps = np.diff(first.drops[0].time)
    assert steps.max() - steps.min() < 1e-12


def test_a_repeated_number_becomes_the_next_number(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.thy"
    path.write_bytes(thy([DROPS[0], DROPS[0]]))
    (point,) = read_points(path, header)
    assert [drop.number for drop in point.drops] == [1, 2]


def of_drops(station: int) -> list[tuple[float, list[float]]]:
    return [
        (float(recorded.load.max()), [float(row.max()) for row in recorded.sensors])
        for number, _, recorded in DROPS
        if number == station
    ]


def test_peaks_alone_are_read_as_peaks(tmp_path: Path, header: Path) -> None:
    path = tmp_path / "a.DAT"
    path.write_text(DAT_HEAD + dat(1, of_drops(1)) + dat(2, of_drops(2)))
    first, second = read_points(path, header)
    assert (first.setup.point, second.setup.point) == ("station 1 lane 1", "station 2 lane 1")
    assert (first.setup.latitude, first.setup.longitude) == (34.5, -89.25)
    noted = first.setup.extra["imported"]
    assert (noted["note"], noted["position_dop"]) == ("retest", 1.5)
    assert (noted["surface_temperature_c"], noted["air_temperature_c"]) == (20.0, 22.0)
    for drop, (load, moved) in zip(first.drops, of_drops(1), strict=True):
        assert drop.only_peaks is not None
        assert drop.only_peaks.load == pytest.approx(load, abs=23)
        assert dict(drop.only_peaks.displacements) == pytest.approx(
            {0.0: moved[0], 0.3: moved[1]}, abs=1.3e-7
        )


def test_peaks_with_histories_are_compared(tmp_path: Path, file: Path, header: Path) -> None:
    def read_with(peaks: str) -> tuple[TracePoint, TracePoint, str, str]:
        (tmp_path / "a.DAT").write_text(DAT_HEAD + peaks)
        first, second = read_points(file, header)
        texts = ("\n".join(map(text_of, point.warnings)) for point in (first, second))
        return first, second, *texts  # type: ignore[return-value]

    good, ((load, moved),) = of_drops(1), of_drops(2)
    wrong = dat(1, good) + dat(2, [(load, [moved[0], 9e-4, 0.0])], "again")
    _, second, of_first, of_second = read_with(wrong)
    assert (second.setup.latitude, second.setup.longitude) == (34.5, -89.25)
    assert second.setup.extra["imported"]["note"] == "again"
    assert ".DAT" not in of_first
    differing = re.findall(r"a\.DAT, line 14: peak of sensor (\d)", of_second)
    assert differing == ["2", "3"]
    *_, of_first, of_second = read_with(dat(1, good[:1]) + dat(2, [(1.1 * load, moved)]))
    assert "1 drops of this station, 2 in the .THY" in of_first
    assert "line 13: load" in of_second
    # A damaged one keeps nobody from the histories.
    *_, of_first, _ = read_with("1 1   0.000 1 x 5.83 71.3\n")
    assert "a.DAT: not read: line 9: expected" in of_first
